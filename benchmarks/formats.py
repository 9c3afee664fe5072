"""Ten million points with all that may be known of them, through each format and back.

Each format has a process of its own, whose largest memory is counted; of that of a process that has only made the
points, which come in parts of 500,000, and has imported what it needs. A coordinate may be off by half the format's
step and by what float32 rounds at 500 mm; values and colours that the format keeps are to be the same to the last bit.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.metric import Metric
from jaxscan.files.cloud import NUMBERS, Cloud
from jaxscan.files.exchange import CLOUDS, read_cloud, writing_cloud
from jaxscan.files.range_npz import RangeArrays, read_range_npz, writing_range_npz

# Points of a part, in frames of this number of columns where they are a range image.
_PART, _COLUMNS = 500_000, 1000
_FARTHEST_MM: Final = 500.0
# Step of a coordinate, mm; 0 where it is exact.
_STEPS: Final = {".xyz": 1e-5, ".laz": 1e-4, ".las": 1e-4, ".e57": 1e-9}
_MOST_GIB: Final = 3.0


def measure(quick: bool) -> list[Metric]:
    """A million points in the short form."""
    metrics = []
    for ending in (*CLOUDS, ".npz"):
        if ending == ".las":
            continue
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "benchmarks.formats", ending, folder, str(10**6 if quick else 10**7)]
            found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        name = f"formats.{ending[1:]}"
        metrics += [
            Metric(f"{name}.error_over_step", found["error_over_step"], "", "lower", 1.0, floor=0.01),
            Metric(f"{name}.values_changed", found["changed"], "", "lower", 0.0),
            Metric(f"{name}.write", found["write"], "s", "lower", slack=1.0),
            Metric(f"{name}.read", found["read"], "s", "lower", slack=1.0),
            Metric(f"{name}.memory", found["memory"], "GiB", "lower", _MOST_GIB, slack=0.2, target_suffices=True),
        ]
    return metrics


def part(seed: int) -> Cloud:
    """Some points, with all that may be known of them."""
    random = np.random.default_rng([20, seed])
    values = {name: random.random(_PART, dtype=np.float32) for name in NUMBERS}
    points = random.uniform([-300, -300, 200], [300, 300, _FARTHEST_MM], (_PART, 3)).astype(np.float32)
    return Cloud(points, colours=random.integers(1, 256, (_PART, 3), dtype=np.uint8), **values)


def _arrays(cloud: Cloud) -> RangeArrays:
    """As frames of a range image."""
    grid = (-1, _COLUMNS)
    points, colours = cloud.points.reshape(*grid, 3), cloud.colours
    assert colours is not None
    one = {name: getattr(cloud, name).reshape(grid) for name in ("strength", "sigma", "sigma_pixel", "albedo")}
    valid = np.ones(points.shape[:2], bool)
    return RangeArrays(points, valid=valid, steps=np.arange(len(valid)), colours=colours.reshape(*grid, 3), **one)


def _there_and_back(path: Path, count: int) -> dict[str, float]:
    ending, parts = path.suffix, range(count // _PART)
    write = 0.0
    with ExitStack() as files:
        if ending == ".npz":
            add_arrays = files.enter_context(writing_range_npz(path))
            add: Callable[[Cloud], None] = lambda cloud: add_arrays(_arrays(cloud))  # noqa: E731
        else:
            add = files.enter_context(writing_cloud(path))
        for i in parts:
            some = part(i)
            begin = time.monotonic()
            add(some)
            write += time.monotonic() - begin
            del some
        begin = time.monotonic()
    write += time.monotonic() - begin
    begin = time.monotonic()
    if ending == ".npz":
        image = read_range_npz(path)
        flat = {name: getattr(image, name).ravel() for name in NUMBERS}
        assert image.colours is not None
        read = Cloud(image.points.reshape(-1, 3), colours=image.colours.reshape(-1, 3), **flat)
    else:
        read = read_cloud(path)
    spent = time.monotonic() - begin
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    allowed = _STEPS.get(ending, 0.0) / 2 + (float(np.spacing(np.float32(_FARTHEST_MM))) if ending in _STEPS else 0.0)
    worst, changed = 0.0, int(len(read.points) != count)
    for i in parts:
        own, here = part(i), slice(i * _PART, (i + 1) * _PART)
        off = float(np.abs(own.points.astype(np.float64) - read.points[here]).max())
        worst = max(worst, off / allowed if allowed else float(off > 0) * 2)
        for name in (*NUMBERS, "colours"):
            back = getattr(read, name)
            changed += 0 if back is None else int((back[here] != getattr(own, name)).sum())
    return {"error_over_step": worst, "changed": changed, "write": write, "read": spent, "memory": memory}


if __name__ == "__main__":
    print(json.dumps(_there_and_back(Path(sys.argv[2]) / f"points{sys.argv[1]}", int(sys.argv[3]))))
