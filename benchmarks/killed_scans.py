"""Scans killed by SIGKILL at random moments, then continued: what was reported as taken, and what comes of it."""

import contextlib
import random
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.full_disk import full
from hardware.cli.main import main
from jaxscan.files.axes import STAGE
from jaxscan.files.scan import SCAN_FILE, Scan, read_scan, write_scan
from jaxscan.images import StripeSettings, read_image, write_image

FRAMES, APART = 12, 1000
_SIZE = (96, 128)
# Between two reports, or a little later.
_LATEST_S = 0.03


@dataclass(frozen=True)
class Killed:
    """What a kill left.

    Attributes:
        reported: frames that the scan had reported as taken.
        listed: frames that its folder lists.
        whole: whether all that it reported are listed, and all that it lists are whole and the right ones.
        same: whether the scan that was continued equals the one that was not killed.
        running: whether it was still running when it was killed.
    """

    reported: int
    listed: int
    whole: bool
    same: bool
    running: bool


def prepare(folder: Path) -> Path:
    """A recorded scan for the camera to show, a scanner that has it, and an uninterrupted scan to compare with."""
    recorded = folder / "recorded"
    (recorded / "frames").mkdir(parents=True)
    paths = tuple(recorded / "frames" / f"{i}.png" for i in range(FRAMES))
    for i, path in enumerate(paths):
        noise = np.random.default_rng(i).integers(0, 255, (*_SIZE, 3), np.uint8)
        write_image(path, cv2.GaussianBlur(noise, (5, 5), 0))
    steps = tuple(APART * i for i in range(FRAMES))
    write_scan(Scan(recorded / "scan.toml", StripeSettings(), frames=paths, axes={STAGE: steps}))
    scanner = folder / "scanner.toml"
    scanner.write_text(
        '[camera]\nkind = "folder"\nsource = "recorded"\n[stage]\nkind = "simulated"\n[laser]\nkind = "simulated"\n'
    )
    if main(command(folder, folder / "whole")) != 0:
        raise RuntimeError("the uninterrupted scan failed")
    return folder


def command(folder: Path, scan: Path, resume: bool = False) -> list[str]:
    """The arguments of `scanner` for one scan."""
    what = ["--resume"] if resume else ["--frames", str(FRAMES), "--apart", str(APART), "--settle", "0"]
    return ["scan", str(scan), "--scanner", str(folder / "scanner.toml"), *what]


def fill_disk(child: "subprocess.Popen[str]") -> None:
    """Let no file of a process grow any more, and wait until it has ended for that."""
    with contextlib.suppress(ProcessLookupError), full(child.pid):
        child.wait(60)


def kill_and_resume(
    folder: Path, seed: int, strike: "Callable[[subprocess.Popen[str]], object]" = subprocess.Popen.kill
) -> Killed:
    """Begin a scan, kill it or strike it otherwise, look, continue it, compare."""
    random_ = random.Random(seed)
    scan = folder / f"killed-{seed}"
    argv = [sys.executable, "-m", "hardware", *command(folder, scan)]
    child = subprocess.Popen(argv, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    assert child.stderr is not None
    lines = [child.stderr.readline() for _ in range(random_.randrange(FRAMES))]
    while not lines and not (scan / "plan.json").exists() and child.poll() is None:
        time.sleep(0.001)
    time.sleep(random_.uniform(0, _LATEST_S))
    running = child.poll() is None
    if running:
        strike(child)
    lines += child.stderr.read().splitlines()
    child.wait()
    child.stderr.close()
    reported = sum(line.startswith("taken ") for line in lines)
    listed = read_scan(scan)
    whole = len(listed.frames) >= reported and all(
        np.array_equal(read_image(path), read_image(folder / "recorded" / "frames" / f"{i}.png"))
        for i, path in enumerate(listed.frames)
    )
    if main(command(folder, scan, resume=True)) != 0:
        raise RuntimeError(f"{scan}: --resume failed")
    return Killed(reported, len(listed.frames), whole, contents(scan) == contents(folder / "whole"), running)


def contents(scan: Path) -> dict[str, Any]:
    """Every file of a scan folder, hidden ones too; but for which frames were verified, as none before a kill is."""
    files: dict[str, Any] = {str(p.relative_to(scan)): p.read_bytes() for p in scan.rglob("*") if p.is_file()}
    listing = tomllib.loads(files[SCAN_FILE].decode())
    listing["scan"].pop("checks", None)
    return {**files, SCAN_FILE: listing}
