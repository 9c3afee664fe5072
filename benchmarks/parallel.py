"""Boards that are parallel: how far points are off and how far σ covers it, beside boards that are tilted every way.

Sessions of the simulated rig of 2003 are drawn with the poses of its views turned about their mean turn by less. The
board on the stage keeps its own. Boards are flat, or bent by what a careful print is; all are solved as flat.
"""

from typing import Final

import numpy as np

from benchmarks.board_shape import solved
from benchmarks.drawn import Noise, redrawn
from benchmarks.drawn_bent import bent_session, flat
from benchmarks.metric import Metric
from jaxscan.errors import JaxscanError
from jaxscan.images import Board
from jaxscan.simulation import rig_2003
from jaxscan.view.verdict import verdict

_SEEDS, _SEEDS_QUICK = 12, 2
_SPREADS: Final = {"tilted": 1.0, "half": 0.5, "a_fifth": 0.2, "parallel": 0.0}
_BENDS_MM: Final = (0.0, 0.01, 0.03)
# Corners of sharp simulated photographs, and of real ones.
_CORNERS_PX: Final = (0.007, 0.05)
_HALF_MM: Final = 64.0


def measure(quick: bool) -> list[Metric]:
    """RMS error of points (mm) and in σ, and shares of sessions that are refused or not to be used."""
    metrics = []
    for corner in _CORNERS_PX:
        for bend in _BENDS_MM if corner == _CORNERS_PX[0] else (0.0,):
            for name, spread in _SPREADS.items():
                stem = f"parallel.corners_{corner:g}_px.bent_{bend:g}_mm.{name}"
                metrics += _of(stem, spread, bend, corner, range(_SEEDS_QUICK if quick else _SEEDS))
    return metrics


def _of(stem: str, spread: float, bend: float, corner: float, seeds: range) -> list[Metric]:
    def bulge(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return bend * (1 - (x / _HALF_MM - 1) ** 2) + 0 * y

    found, stopped, refused = [], 0, 0
    for seed in seeds:
        board: Board = rig_2003.BOARD
        rig, exact = bent_session(seed, lambda _: bulge if bend else flat, board=board, columns_apart=4, spread=spread)
        try:
            found.append(solved((rig, redrawn(exact, Noise(corner), np.random.default_rng([seed, 8]))), "flat"))
        except JaxscanError:
            refused += 1
            continue
        stopped += verdict(found[-1].calibration).level == "stop"
    points, z = (np.array([getattr(each, name) for each in found]) for name in ("points_mm", "points_z"))
    return [
        Metric(f"{stem}.points_rms", float(np.sqrt((points**2).mean())) if found else np.nan, "mm"),
        Metric(f"{stem}.points_in_sigma", float(np.sqrt((z**2).mean())) if found else np.nan),
        Metric(f"{stem}.refused", refused / len(seeds)),
        Metric(f"{stem}.not_to_be_used", stopped / len(seeds)),
    ]
