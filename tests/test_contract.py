"""The shape of the project: who may import whom, what is called how, and that help is quick."""

import json
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import jaxscan
from jaxscan.cli.main import COMMANDS

ROOT = Path(__file__).parents[1]
SLOW_IMPORTS = ("jax", "numpy", "cv2", "equinox", "trimesh", "scipy", "matplotlib", "yaml")

HELP = f"""
import contextlib, io, json, sys, time
begin = time.process_time()
from jaxscan.cli.main import main
with contextlib.redirect_stdout(io.StringIO()) as out:
    status = main(sys.argv[1:])
slow = [name for name in {SLOW_IMPORTS} if name in sys.modules]
print(json.dumps([status, time.process_time() - begin, slow, len(out.getvalue())]))
"""


def test_imports_walk_one_way():
    lint = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    argv = [sys.executable, "-c", lint, "--no-cache"]
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_verbs_and_packages_differ_in_name():
    packages = {module.name for module in pkgutil.iter_modules(jaxscan.__path__)}
    assert packages.isdisjoint(getattr(jaxscan, "__all__", ()))


@pytest.mark.parametrize("command", [[], *([name] for name in COMMANDS)], ids=lambda argv: " ".join(["jaxscan", *argv]))
def test_help_is_quick_and_imports_nothing_slow(command):
    times = []
    for _ in range(3):
        argv = [sys.executable, "-c", HELP, *command, "--help"]
        done = subprocess.run(argv, capture_output=True, text=True, timeout=60, check=True)
        status, seconds, slow, length = json.loads(done.stdout)
        assert status == 0
        assert slow == []
        assert length > 100
        times.append(seconds)
        if seconds < 0.5:
            break
    assert min(times) < 0.5


def test_a_scan_imports_nothing_of_the_calibration():
    """It took 0.8 s of each command, and SciPy's parts that a scan seldom needs another half."""
    unused = ("jaxscan.calibration", "optimistix", "scipy.stats", "scipy.spatial", "scipy.ndimage", "scipy.fft")
    code = f"""
import sys
from jaxscan.files.rig_file import read_rig
from jaxscan.files.scan import read_scan
from jaxscan.reconstruction import Scanner
print(*[name for name in {unused} if name in sys.modules])
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []
