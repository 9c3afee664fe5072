"""The pipeline of 2003 in its own language: `benchmarks/matlab/scan2003.m`, run by GNU Octave."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Final

import numpy as np
from scipy.io import loadmat, savemat

from benchmarks.pipeline_2003 import BOARD_THRESHOLD, SCAN_THRESHOLD, Job, Outcome, Quirks

SCRIPTS: Final = Path(__file__).parent / "matlab"
MISSING: Final = "GNU Octave is not installed (on Debian: apt-get install --no-install-recommends octave)"
_LIMIT_S = 3600.0


def octave() -> str | None:
    """The interpreter, or None where it is not installed."""
    return shutil.which("octave-cli")


def evaluate(statement: str) -> str:
    """Run one statement with the scripts on the path; returns what it prints.

    Raises:
        RuntimeError: Octave is not installed, or the statement failed.
    """
    program = octave()
    if program is None:
        raise RuntimeError(MISSING)
    command = [program, "--quiet", "--no-init-file", "--no-history", "--path", str(SCRIPTS), "--eval", statement]
    # One thread, as MATLAB had in 2003: threads that wait for each other in small products only cost.
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, env=environment)
    if done.returncode:
        raise RuntimeError(f"Octave ended with status {done.returncode}: {done.stderr.strip()[-2000:]}")
    return done.stdout


def run(job: Job, quirks: Quirks | None = None) -> Outcome:
    """Run the pipeline.

    Raises:
        RuntimeError: Octave is not installed, or the scripts failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "given.mat", Path(folder) / "found.mat"
        values = {
            "image_size": np.asarray(job.image_size, float),
            "board": job.board,
            "corners": np.moveaxis(job.corners, 0, 2),
            "stage_corners": np.moveaxis(job.stage_corners, 0, 2),
            "board_photos": _cells(job.board_photos),
            "scan_photos": _cells(job.scan_photos),
            "board_threshold": BOARD_THRESHOLD,
            "scan_threshold": SCAN_THRESHOLD,
            "clicks": job.clicks,
            "ply": str(job.ply or ""),
            "quirks": {name: float(on) for name, on in (quirks or Quirks()).as_dict().items()},
        }
        savemat(given, values)
        evaluate(f"scan2003('{given}', '{found}')")
        result = loadmat(found)
    first = 1 if quirks is None or quirks.pixels_from_one else 0
    seconds = result["seconds"][0, 0]
    return Outcome(
        focal=result["fc"].ravel(),
        principal=result["cc"].ravel(),
        k1=float(result["kc"].item()),
        rotations=result["rotations"].T,
        translations=result["translations"].T,
        planes=result["planes"].T,
        lines=result["lines"].T,
        laser_plane=result["laser_plane"].ravel(),
        stage_move=result["stage_move"].ravel(),
        board_stripes=result["board_stripes"],
        points=result["points"],
        frame=result["frame"].ravel().astype(int) - 1,
        column=result["column"].ravel().astype(int) - first,
        kept=result["kept"].ravel().astype(bool),
        faces=result["faces"].reshape(-1, 3).astype(int) - 1,
        seconds={name: float(seconds[name].item()) for name in seconds.dtype.names},
    )


def _cells(paths: tuple[Path, ...]) -> np.ndarray:
    """Names as a cell array."""
    cells = np.empty(len(paths), object)
    cells[:] = [str(path) for path in paths]
    return cells
