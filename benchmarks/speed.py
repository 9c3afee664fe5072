"""Time, against the pipeline of 2003 in Octave, on one machine and in one run.

- Reconstruction: photographs (JPEG, 1920 × 1080, a stripe in every column; and 640 × 480) to points, decoding included,
  with the default detector and with the quickest. Beside it detection alone, of photographs in memory.
  Both read the very same files, and the number of frames stated is what both were timed on.
- Calibration of 40 views with 31 stage photographs: camera, light plane and stage, from corners and stripe pixels;
  detection is apart in both. Ours finds the covariance too. Beside it the camera by itself.

- Start-up: what is imported, and the command line's help.

Octave's loops are timed once, ours after a first call that compiles (printed apart), the median of five. The scripts go
through points one by one as they did in 2003; what they take with whole photographs at once stands beside.
"""

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks import octave
from benchmarks.drawn_2003 import STEPS_APART, Drawing
from benchmarks.metric import Metric, ratio
from benchmarks.pipeline_2003 import Outcome, Quirks
from benchmarks.real import corners_only
from benchmarks.throughput import CLOSED, OF_A_SCAN
from benchmarks.timing import timed
from jaxscan.calibration import calibrate
from jaxscan.files.axes import STAGE
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings, detect_stripe, read_image
from jaxscan.images.stripes.batch import FRAMES_AT_ONCE
from jaxscan.reconstruction import reconstruct
from jaxscan.reconstruction.frames import aligned

_VIEWS, _STAGE_VIEWS = 40, 31
_SCAN_STEPS: Final = ("read_scan", "detect", "triangulate")
_CALIBRATION_STEPS: Final = ("camera", "lines", "laser_plane", "stage")
_FRAMES_SEEN: Final = 40


def measure(quick: bool) -> list[Metric]:
    """Both; in the short form few frames and views."""
    if octave.octave() is None:
        print(f"  {octave.MISSING}: nothing measured")
        return []
    sizes = (((1920, 1080), 8),) if quick else (((1920, 1080), 200), ((640, 480), 37))
    metrics = [m for size, frames in sizes for m in reconstruction(size, frames)]
    return metrics + calibration(10 if quick else _VIEWS) + start_up()


def reconstruction(size: tuple[int, int], frames: int) -> list[Metric]:
    """Photographs to points."""
    with tempfile.TemporaryDirectory() as name:
        drawing = Drawing(Path(name), size, every=16, ending=".jpg")
        # The stripe leaves the photograph after some forty frames: then it enters it again.
        job = drawing.job(3, 3, min(frames, _FRAMES_SEEN))
        job = replace(job, scan_photos=(job.scan_photos * -(-frames // _FRAMES_SEEN))[:frames])
        looped, at_once = (octave.run(job, quirks) for quirks in (Quirks(), Quirks(loops=False)))
        scan = Scan(
            Path(name) / "scan.toml",
            StripeSettings("red"),
            frames=job.scan_photos,
            axes={STAGE: tuple(STEPS_APART * i for i in range(frames))},
        )
        rig = RigFile(drawing.rig())
        ours = {name: timed(lambda name=name: reconstruct(rig, scan, detector=name)) for name in OF_A_SCAN}
        some = aligned((FRAMES_AT_ONCE, *size[::-1], 3), np.uint8)
        for path, frame in zip(job.scan_photos, some, strict=False):
            read_image(path, frame)
        detection = {
            name: timed(lambda name=name: detect_stripe(some, scan.laser, detector=name)).median / len(some)
            for name in CLOSED
        }
    stem = f"speed.reconstruction.{size[0]}"
    octave_s = _of(looped, _SCAN_STEPS)
    print(f"  {frames} frames of {size[0]} x {size[1]}: Octave {octave_s:.2f} s for {len(looped.points)} points")
    metrics = []
    for name, (first, seconds, image) in ours.items():
        print(f"    {name}: {seconds:.3f} s for {image.valid.sum()} points (first call {first:.1f} s)")
        # The goal is for large photographs, and for the detector that keeps up with decoding best.
        over = ratio(f"{stem}.{name}.octave_over_ours", octave_s / seconds, 80, "higher")
        of_the_goal = size[0] == 1920 and name == OF_A_SCAN[-1]
        metrics += [
            over if of_the_goal else replace(over, better="shown", target=None),
            Metric(f"{stem}.{name}.octave_without_loops_over_ours", _of(at_once, _SCAN_STEPS) / seconds),
            Metric(f"{stem}.{name}.ours", 1e3 * seconds / frames, "ms"),
        ]
    octave_detects = looped.seconds["detect"] / frames
    for name, seconds in detection.items():
        over = ratio(f"{stem}.{name}.octave_detects_over_ours", octave_detects / seconds, 250, "higher")
        metrics.append(over if size[0] == 1920 else replace(over, better="shown", target=None))
    return [
        *metrics,
        *(Metric(f"{stem}.octave.{step}", 1e3 * looped.seconds[step] / frames, "ms") for step in _SCAN_STEPS),
        Metric(f"{stem}.frames", frames),
    ]


def calibration(views: int) -> list[Metric]:
    """Corners and stripe pixels to a rig."""
    with tempfile.TemporaryDirectory() as name:
        # As many stripe points on a board as the simulated rig of 2003 has.
        drawing = Drawing(Path(name), every=2)
        job = drawing.job(views, _STAGE_VIEWS, 0)
        looped, at_once = (octave.run(job, quirks) for quirks in (Quirks(), Quirks(loops=False)))
        observations = drawing.observations(job)
    first, seconds, _ = timed(lambda: calibrate(observations))
    alone = timed(lambda: calibrate(corners_only(observations), plain=True)).median
    stem = f"speed.calibration.{views}_views"
    print(
        f"  calibration of {views} views: Octave {_of(looped, _CALIBRATION_STEPS):.2f} s "
        f"({', '.join(f'{step} {looped.seconds[step]:.2f}' for step in _CALIBRATION_STEPS)}), "
        f"ours {seconds:.3f} s (first call {first:.1f} s); "
        f"the camera alone: Octave {looped.seconds['camera']:.2f} s, ours {alone:.3f} s"
    )
    return [
        ratio(f"{stem}.octave_over_ours", _of(looped, _CALIBRATION_STEPS) / seconds, 20, "higher"),
        Metric(f"{stem}.octave_without_loops_over_ours", _of(at_once, _CALIBRATION_STEPS) / seconds),
        Metric(f"{stem}.camera_alone.octave_over_ours", looped.seconds["camera"] / alone),
        Metric(f"{stem}.octave", _of(looped, _CALIBRATION_STEPS), "s"),
        Metric(f"{stem}.ours", seconds, "s"),
        Metric(f"{stem}.ours_first_call_with_compiling", first, "s"),
    ]


def start_up() -> list[Metric]:
    """From a command to its end: Python by itself, what is imported, the command line's help."""
    programs = {
        "python": "pass",
        "numpy_and_cv2": "import numpy, cv2",
        "jax": "import jax",
        "jaxscan": "import jaxscan",
        "jaxscan_help": "from jaxscan.cli.main import main; main(['--help'])",
        "jaxscan_calibrate": "from jaxscan import calibrate, read_session",
    }
    metrics = []
    for name, program in programs.items():
        command = [sys.executable, "-c", program]
        seconds = timed(lambda command=command: subprocess.run(command, check=True, capture_output=True)).median
        metrics.append(Metric(f"speed.start_up.{name}", 1e3 * seconds, "ms"))
    return metrics


def _of(outcome: Outcome, steps: tuple[str, ...]) -> float:
    return sum(outcome.seconds[step] for step in steps)
