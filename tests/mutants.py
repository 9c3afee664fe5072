"""Faults put into the statistics and the solve, one at a time: do the tests of the quick run notice each?

    .venv/bin/python -m tests.mutants          all
    .venv/bin/python -m tests.mutants 0 3 17   some, by their numbers

Each is a line that is changed in a copy of the tree. A mutant is noticed where one of its tests fails.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
_COPIED = ("jaxscan", "hardware", "benchmarks", "tests", "pyproject.toml")
_LONGEST_S = 900.0


class Mutant(NamedTuple):
    """What is changed, where, and which tests should notice it."""

    what: str
    file: str
    old: str
    new: str
    tests: str


_SIZE = "tests/calibration/test_how_large_sigma_is.py"
_CALIBRATE = "tests/calibration/test_calibrate.py"
_ARROW = "tests/calibration/test_block_arrow.py"
_REGISTER = "tests/surface/test_register.py"
_POINTS = "tests/reconstruction/test_point_sigma.py"
_ROUNDS = "jaxscan/calibration/rounds.py"
_EQUATIONS = "jaxscan/calibration/block_arrow.py"
_UNCERTAINTY = "jaxscan/calibration/uncertainty.py"

MUTANTS = (
    Mutant("redundancy of corners without leverage", _ROUNDS, "1 - h[:, :n]", "1 - 0 * h[:, :n]", _SIZE),
    Mutant("τ is not applied", _ROUNDS, "float(single.stripe) * tau**0.5", "float(single.stripe)", _SIZE),
    Mutant("stripes are left out beyond 8 σ", _ROUNDS, "STRIPE_LIMIT = 4.0", "STRIPE_LIMIT = 8.0", _SIZE),
    Mutant(
        "registration without its variance factor",
        "jaxscan/surface/register.py",
        "max(variance, 1.0) * inverse_H",
        "inverse_H",
        _REGISTER,
    ),
    Mutant("redundancy of stripes without leverage", _ROUNDS, "1 - h[:, n : n +", "1 - 0 * h[:, n : n +", _SIZE),
    Mutant("corners are left out beyond 9 σ", _ROUNDS, "CORNER_LIMIT = 4.5", "CORNER_LIMIT = 9.0", _SIZE),
    Mutant(
        "σ² is divided by the redundancy twice",
        _ROUNDS,
        "np.sqrt(squares / redundancy)",
        "np.sqrt(squares) / redundancy",
        _CALIBRATE,
    ),
    Mutant(
        "corners' given weights are never doubted",
        _ROUNDS,
        "common = min(_COMMON_PARTS, key=unlikeliness)",
        "common = 0.0",
        "tests/calibration/test_rounds.py",
    ),
    Mutant(
        "τ counts each lag once",
        "jaxscan/calibration/correlation.py",
        "tau = 2 * np.cumsum(covariance / covariance[0]) - 1",
        "tau = np.cumsum(covariance / covariance[0])",
        _SIZE,
    ),
    Mutant(
        "τ ends at the first lags",
        "jaxscan/calibration/correlation.py",
        "_WINDOW = 5.0",
        "_WINDOW = 0.5",
        _SIZE,
    ),
    Mutant(
        "a block's covariance without the shared part",
        _UNCERTAINTY,
        "[cross, inverse - cross @",
        "[cross, inverse - 0 * cross @",
        _ARROW,
    ),
    Mutant("the sign of what ties blocks to the rig", _UNCERTAINTY, "cross = -K @", "cross = K @", _ARROW),
    Mutant(
        "half of the leverage",
        _UNCERTAINTY,
        "((J @ joint) * J)",
        "0.5 * ((J @ joint) * J)",
        f"{_ARROW} {_SIZE}",
    ),
    Mutant(
        "Schur's complement without the blocks", _EQUATIONS, "gaps - sum(e.schur for e in eliminated)", "gaps", _ARROW
    ),
    Mutant("a covariance without what blocks take away", _UNCERTAINTY, "0.0, 1.0)) - eliminated", "0.0, 1.0))", _ARROW),
    Mutant(
        "a gradient without the blocks'",
        _EQUATIONS,
        "self.g - sum(e.gradient for e in eliminated)",
        "self.g",
        _ARROW,
    ),
    Mutant("blocks do not follow the rig", _EQUATIONS, "-(e.own + e.coupling @ step)", "-e.own", _ARROW),
    Mutant(
        "blocks are not damped",
        _EQUATIONS,
        "Group(group.V + damping * d[..., None]",
        "Group(group.V + 0 * damping * d[..., None]",
        _ARROW,
    ),
    Mutant(
        "the solve stops early",
        "jaxscan/calibration/levenberg_marquardt.py",
        "_CONVERGED = 1e-14",
        "_CONVERGED = 1e-2",
        f"{_CALIBRATE} tests/calibration/test_adjustment.py",
    ),
    Mutant(
        "derivatives through the solve of the other sign",
        "jaxscan/calibration/implicit.py",
        "Group(group.V, group.W, -b)",
        "Group(group.V, group.W, b)",
        "tests/calibration/test_implicit.py",
    ),
    Mutant(
        "stripe points of equal weight",
        "jaxscan/calibration/residuals.py",
        "stripe, 0.0) * (self.stripe_weights / noise.stripe)",
        "stripe, 0.0) / noise.stripe",
        "tests/calibration/test_residuals.py tests/calibration/test_observe.py tests/calibration/test_adjustment.py",
    ),
    Mutant(
        "the loss is never robust",
        "jaxscan/calibration/residuals.py",
        "_tamed(noise.robustness**2 * stripe**2)",
        "1.0",
        "tests/calibration/test_residuals.py",
    ),
    Mutant(
        "σ of a point without the rig's covariances",
        "jaxscan/reconstruction/point_sigma.py",
        "np.sqrt(variance + pixel**2)",
        "np.sqrt(0 * variance + pixel**2)",
        _POINTS,
    ),
    Mutant(
        "boards do not go along where σ grows",
        "jaxscan/calibration/widening.py",
        "blocks.append(joint + E @ by @ E.mT)",
        "blocks.append(joint)",
        "tests/calibration/diagnostics/test_board_points.py",
    ),
    Mutant(
        "σ does not grow by what residuals show",
        "jaxscan/calibration/widening.py",
        "covariance=C + by",
        "covariance=C",
        "tests/calibration/diagnostics/test_board_points.py",
    ),
)


def main() -> int:
    """Try them; 1 where one was not noticed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("numbers", nargs="*", type=int, help="which ones, from 0; all if none is given")
    numbers = parser.parse_args().numbers or range(len(MUTANTS))
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        for name in _COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(ROOT / name, tree)
        every = sorted({test for number in numbers for test in MUTANTS[number].tests.split()})
        if not passes(every, tree):
            raise SystemExit(f"without a mutant these do not all pass: {' '.join(every)}")
        for number in numbers:
            started = time.monotonic()
            noticed = is_noticed(MUTANTS[number], tree)
            missed += not noticed
            took = time.monotonic() - started
            print(
                f"{number:2} {'noticed' if noticed else 'NOT NOTICED'}: {MUTANTS[number].what} ({took:.0f} s)",
                flush=True,
            )
    return int(bool(missed))


def is_noticed(mutant: Mutant, tree: Path) -> bool:
    """Whether one of its tests fails with it in a copy of the tree."""
    path = tree / mutant.file
    text = path.read_text(encoding="utf-8")
    path.write_text(mutated(mutant, text), encoding="utf-8")
    try:
        return not passes(mutant.tests.split(), tree)
    finally:
        path.write_text(text, encoding="utf-8")


def passes(tests: list[str], tree: Path) -> bool:
    """Whether tests pass in a copy of the tree."""
    pytest = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-q", *tests]
    env = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(pytest, cwd=tree, env=env, capture_output=True, timeout=_LONGEST_S, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(f"pytest ended with {done.returncode}\n{done.stdout.decode()}")
    return done.returncode == 0


def mutated(mutant: Mutant, text: str) -> str:
    """A file's text with the fault in it.

    Raises:
        ValueError: what is to be changed stands there more or less than once.
    """
    if text.count(mutant.old) != 1:
        raise ValueError(f"{mutant.file}: {mutant.old!r} stands there {text.count(mutant.old)} times, not once")
    return text.replace(mutant.old, mutant.new)


if __name__ == "__main__":
    sys.exit(main())
