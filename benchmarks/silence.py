"""How long the screen stands still: each command on a terminal of its own, with nothing compiled before.

A command writes to a pseudo-terminal. Noted are the time of its first word and the longest time without a change, from
its start to its end, its last output included.
"""

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import tempfile
import termios
import time
from itertools import pairwise
from pathlib import Path
from typing import Final

from benchmarks.metric import Metric

_FIRST_S: Final = 2.0
_STILL_S: Final = 5.0
# What each command is called in the figures, and its command line in the folder of a simulated world.
_LINEAR: Final = {
    "simulate": "simulate . --force --apart 1000",
    "calibrate": "calibrate session -o rig.json",
    "calibrate_report": "calibrate session -o rig.json --report report",
    "inspect_session": "inspect session --png views.png",
    "reconstruct": "reconstruct scan --rig rig.json -o a.npz -o a.ply",
    "reconstruct_colour": "reconstruct scan --rig rig.json -o b.npz --colour frames --albedo",
    "inspect": "inspect a.npz",
    "inspect_png": "inspect a.npz --png a-views.png",
    "inspect_ply": "inspect a.ply",
    "mesh": "mesh a.npz -o a.stl --png a.png",
    "mesh_textured": "mesh b.npz -o b.glb --photographs scan --rig rig.json",
    "mesh_grid": "mesh a.npz -o c.stl --grid 0.3 --fill 3",
    "mesh_delaunay": "mesh a.ply -o d.stl --simplify 20000",
    "mesh_poisson": "mesh a.npz -o e.stl --method poisson",
    "compare": "compare a.npz a.stl --fit --png difference.png -o difference.ply",
    "compare_clouds": "compare a.npz a.ply --fit",
    "view_png": "view a.stl --png view.png",
    "view_cloud": "view a.npz --rig rig.json --png view.png",
    "batch": "batch . --rig rig.json -o clouds",
}
_TURNING: Final = {
    "simulate_turntable": "simulate . --force --turntable --object figure",
    "calibrate_turntable": "calibrate session -o rig.json",
    "reconstruct_turntable": "reconstruct scan --rig rig.json -o a.npz",
    "inspect_turntable": "inspect a.npz --png a-views.png",
    "mesh_turntable": "mesh a.npz -o a.stl --png a.png",
    "mesh_turntable_poisson": "mesh a.npz -o b.stl --method poisson",
    "view_turntable": "view a.npz --rig rig.json --png view.png",
}
_SIDES: Final = {
    "simulate_sides": "simulate . --force --object figure --sides 4",
    "calibrate_sides": "calibrate session -o rig.json",
    "merge": "merge scan-000 scan-090 scan-180 scan-270 --rig rig.json --turn 90 -o all.ply --png all.png",
}


def measure(quick: bool) -> list[Metric]:
    """Every command of a linear scanner, and in the long form of a turntable and of several sides."""
    metrics = []
    with tempfile.TemporaryDirectory() as folder:
        worlds = {"linear": _LINEAR} | ({} if quick else {"turning": _TURNING, "sides": _SIDES})
        for name, commands in worlds.items():
            world = Path(folder) / name
            world.mkdir()
            for key, line in commands.items():
                first, still, whole = watched(line.split(), world, Path(folder) / "cache")
                metrics += [
                    Metric(f"silence.{key}.first", first, "s", "lower", _FIRST_S, slack=2.0, target_suffices=True),
                    Metric(f"silence.{key}.still", still, "s", "lower", _STILL_S, slack=2.0, target_suffices=True),
                    Metric(f"silence.{key}.whole", whole, "s"),
                ]
    return metrics


def watched(words: list[str], folder: Path, cache: Path) -> tuple[float, float, float]:
    """A command on a terminal: seconds to its first output, the longest without any, and to its end.

    Raises:
        RuntimeError: it failed.
    """
    ours, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
    env = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    begin = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "jaxscan", *words],
        cwd=folder,
        env=env | {"XDG_CACHE_HOME": str(cache), "PYTHONPATH": str(Path(__file__).parents[1])},
        stdin=subprocess.DEVNULL,
        stdout=its,
        stderr=its,
    )
    os.close(its)
    moments, shown = [begin], b""
    while True:
        if select.select([ours], [], [], 0.05)[0]:
            try:
                said = os.read(ours, 65536)
            except OSError:  # the other end is closed
                break
            if not said:
                break
            moments.append(time.monotonic())
            shown += said
        elif process.poll() is not None:
            break
    status = process.wait()
    moments.append(time.monotonic())
    os.close(ours)
    if status:
        raise RuntimeError(f"jaxscan {' '.join(words)} ended with status {status}: {shown.decode(errors='replace')}")
    return moments[1] - begin, max(b - a for a, b in pairwise(moments)), moments[-1] - begin
