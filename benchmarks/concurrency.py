"""Calibrations of boards of many sizes, two at a time in one process, on pools of 1, 2, 4 and 16 threads.

Each pool is a process of its own: JAX's pool of threads has the size that `NPROC` says, and photographs are looked at
in as many threads, whatever the machine has. A process that shows no finished calibration for `_STILL_S` seconds hangs.
Each calibration's time is compared with the median of the same board in the same process. Before that all boards are
calibrated once, which compiles.
"""

import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.metric import Metric

# Inner corners from 12 to 600.
BOARDS: Final = ((4, 3), (7, 5), (9, 6), (11, 8), (13, 12), (20, 15), (30, 20))
QUICK_BOARDS: Final = ((7, 5), (13, 12), (30, 20))
THREADS: Final = (1, 2, 4, 16)
MINUTES, _QUICK_MINUTES = 30.0, 1.0
_VIEWS: Final = 5
_IMAGE_SIZE: Final = (960, 720)
_SQUARE_MM: Final = 10.0
_STILL_S: Final = 300.0


def measure(quick: bool) -> list[Metric]:
    """Calibrate until the time is up; how many ended, which did not, and how much longer than usual any took."""
    boards = QUICK_BOARDS if quick else BOARDS
    minutes = _QUICK_MINUTES if quick else MINUTES
    found = []
    with tempfile.TemporaryDirectory() as folder:
        sessions = [str(_session(Path(folder) / f"{c}x{r}", (c, r))) for c, r in boards]
        for threads in THREADS:
            done, hung = _run(threads, 60 * minutes / len(THREADS), sessions)
            found += [
                Metric(f"concurrency.{threads}_threads.calibrations", len(done)),
                Metric(f"concurrency.{threads}_threads.hangs", float(hung), "", "lower", 0.0, slack=0.0),
            ]
            if ratios := list(_over_median(done)):
                name = f"concurrency.{threads}_threads.longest_over_median"
                found.append(Metric(name, max(ratios), "", "lower", 3.0, slack=1.0, target_suffices=True))
    return found


def _over_median(done: list[tuple[str, float]]) -> Iterator[float]:
    """Each calibration's time over the median of its board."""
    for name in {name for name, _ in done}:
        times = [seconds for other, seconds in done if other == name]
        yield from (seconds / float(np.median(times)) for seconds in times)


def _run(threads: int, seconds: float, sessions: list[str]) -> tuple[list[tuple[str, float]], bool]:
    """What a process with `threads` threads has calibrated, (session, seconds) each, and whether it hung."""
    work = [sys.executable, "-m", "benchmarks.concurrency", str(threads), str(seconds), *sessions]
    process = subprocess.Popen(work, env=os.environ | {"NPROC": str(threads)}, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()

    def read(stream: Iterator[str]) -> None:
        for line in stream:
            lines.put(line)
        lines.put(None)

    threading.Thread(target=read, args=(process.stdout,), daemon=True).start()
    done = []
    try:
        while (line := lines.get(timeout=_STILL_S)) is not None:
            # What compiles gives a sign of life and no figure.
            if line.strip():
                done.append(tuple(json.loads(line)))
    except queue.Empty:
        return done, True
    finally:
        process.kill()
        status = process.wait()
    # One that ended by itself, but badly, is no better than one that hangs.
    return done, status not in (0, -9)


def _calibrate_all(threads: int, seconds: float, sessions: list[str]) -> None:
    """Two calibrations at a time, one board after the other, until the time is up."""
    os.cpu_count = lambda: threads
    from jaxscan.calibration import calibrate
    from jaxscan.calibration.observe import observe
    from jaxscan.files.session import read_session

    printing = threading.Lock()
    failed: list[BaseException] = []
    for path in sessions:
        calibrate(observe(read_session(Path(path))))
        print(flush=True)
    until = time.monotonic() + seconds

    def work(first: int) -> None:
        k = first
        # Every board at least three times, so that there is a median.
        while not failed and (time.monotonic() < until or k < first + 3 * len(sessions)):
            path, begin = sessions[k % len(sessions)], time.monotonic()
            try:
                calibrate(observe(read_session(Path(path))))
            except BaseException as error:
                failed.append(error)
                raise
            with printing:
                print(json.dumps([path, time.monotonic() - begin]), flush=True)
            k += 1

    both = [threading.Thread(target=work, args=(first,)) for first in (0, len(sessions) // 2)]
    for each in both:
        each.start()
    for each in both:
        each.join()
    sys.exit(1 if failed else 0)


def _session(folder: Path, counts: tuple[int, int]) -> Path:
    """Photographs of a board that fills most of the image, tilted each way, as a session."""
    import cv2

    (folder / "boards").mkdir(parents=True)
    columns, rows = counts
    fine = 8
    squares = np.indices((rows + 1, columns + 1)).sum(0) % 2 == 1
    board = np.pad(np.where(squares, 215, 35).astype(np.uint8), 1, constant_values=215)
    texture = np.kron(board, np.ones((fine, fine), np.uint8))
    random = np.random.default_rng(columns)
    width, height = _IMAGE_SIZE
    half = np.array([columns + 3, rows + 3]) * _SQUARE_MM / 2
    for k in range(_VIEWS):
        tilt = np.array([0.35 * np.cos(2 * np.pi * k / _VIEWS), 0.35 * np.sin(2 * np.pi * k / _VIEWS), 0.05])
        R = cv2.Rodrigues(tilt)[0]
        distance = 1000 * max(half[0] / (0.42 * width), half[1] / (0.42 * height)) * (1 + 0.1 * k)
        K = np.array([[1000.0, 0, (width - 1) / 2], [0, 1000.0, (height - 1) / 2], [0, 0, 1]])
        to_image = K @ np.column_stack([R[:, 0], R[:, 1], [0, 0, distance]])
        scale = _SQUARE_MM / fine
        to_board = np.array([[scale, 0, scale / 2 - half[0]], [0, scale, scale / 2 - half[1]], [0, 0, 1]])
        # Four samples a pixel each way, then their mean: edges are smooth enough for the corner fit.
        finer = np.diag([4.0, 4.0, 1.0]) + np.array([[0, 0, 1.5], [0, 0, 1.5], [0, 0, 0]])
        big = cv2.warpPerspective(
            texture, finer @ to_image @ to_board, (4 * width, 4 * height), flags=cv2.INTER_LINEAR, borderValue=180
        )
        image = cv2.GaussianBlur(cv2.resize(big, _IMAGE_SIZE, interpolation=cv2.INTER_AREA).astype(float), (0, 0), 0.6)
        noisy = np.rint(image + random.standard_normal(image.shape)).clip(0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / "boards" / f"{k}.png"), noisy)
    (folder / "session.toml").write_text(
        f"[board]\ninner_corners = [{columns}, {rows}]\nsquare_mm = {_SQUARE_MM}\n\n"
        '[views]\nboards = "boards/*.png"\n\n[camera]\nlens = "none"\n'
    )
    return folder


if __name__ == "__main__":
    _calibrate_all(int(sys.argv[1]), float(sys.argv[2]), sys.argv[3:])
