"""A cloud moved rigidly onto a surface: nearest points and least squares in turn, with outliers left out.

Each round moves the points p by x ↦ p + ω × p + τ so that Σ ((p + ω × p + τ − q) · n)² is least, q and n the nearest
points of the surface and the normals there (Chen and Medioni 1992), over the points no further away than three times
the median. Rounds go on until a round moves nothing by more than a ten-thousandth of a millimetre.
"""

from itertools import product
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.robust import NORMAL_MAD
from jaxscan.surface.reference import Reference, diagonal

_STILL_MM: Final = 1e-4
_ROUNDS: Final = 100
# Starts that are tried, each with so few points and rounds.
_TRY_POINTS, _TRY_ROUNDS, _FOLLOWED = 250, 6, 3
_POINTS: Final = 5_000
_SEED: Final = 2003
# Where the misfit is more than this part of the surface's size, the mirror image is tried; where that fits so much
# better than the thing itself, it is no accident.
_SUSPICIOUS, _MIRRORED = 0.001, 0.4
# Distances count up to this part of the surface's size.
_FAR: Final = 0.05


def rigid_fit_to(reference: Reference, cloud: Float[np.ndarray, "points 3"]) -> Pose:
    """The rigid motion that carries a cloud onto a surface.

    It starts from the cloud where it is, and from the 24 ways in which its principal axes can lie along those of the
    surface's box; the best three of them are followed.

    Raises:
        InputError: there are fewer than six points, or the cloud fits much better when it is mirrored.
    """
    cloud = np.asarray(cloud, np.float64)
    if len(cloud) < 6:
        raise InputError(f"{len(cloud)} points cannot be fitted: six or more can")
    cloud = cloud[np.random.default_rng(_SEED).permutation(len(cloud))[:_POINTS]]
    few = cloud[:_TRY_POINTS]
    misfit, best = _best(reference, few)
    if misfit > _SUSPICIOUS * diagonal(reference):
        other, _ = _best(reference, few * [-1.0, 1.0, 1.0])
        if other < _MIRRORED * misfit:
            raise InputError(
                f"the mirror image fits better ({other:.3g} mm in the mean) than the original ({misfit:.3g} mm): "
                "one of the two is mirrored; mirror it back"
            )
    return _rounds(reference, cloud, best, _ROUNDS)[1]


def _best(reference: Reference, few: Float[np.ndarray, "points 3"]) -> tuple[float, Pose]:
    """The misfit and the motion of the best start, followed further than the others."""
    trials = [_rounds(reference, few, start, _TRY_ROUNDS) for start in _starts(reference, few)]
    trials = sorted(trials, key=lambda trial: trial[0])[:_FOLLOWED]
    return min((_rounds(reference, few, motion, _ROUNDS) for _, motion in trials), key=lambda trial: trial[0])


def _starts(reference: Reference, cloud: Float[np.ndarray, "points 3"]) -> list[Pose]:
    centre, middle = cloud.mean(axis=0), reference.bounds.mean(axis=0)
    axes = np.linalg.svd(cloud - centre, full_matrices=False)[2]
    starts = [Pose.identity()]
    for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
        for signs in product((1.0, -1.0), repeat=3):
            R = np.diag(signs) @ axes[list(order)]
            if np.linalg.det(R) > 0:
                starts.append(Pose.from_matrix(R, middle - R @ centre))
    return starts


def _rounds(reference: Reference, cloud: Float[np.ndarray, "points 3"], start: Pose, rounds: int) -> tuple[float, Pose]:
    """The misfit after some rounds from one start, and the motion."""
    T = start
    away = np.full(len(cloud), np.inf)
    for _ in range(rounds):
        p = T.apply(cloud)
        q, n = reference.nearest(p)
        away = np.linalg.norm(p - q, axis=1)
        near = away <= max(3 * NORMAL_MAD * float(np.median(away)), 1e-9)
        centre = p[near].mean(axis=0)
        arm = np.cross(p[near] - centre, n[near])
        size = max(float(np.sqrt((arm**2).sum(axis=1).mean())), 1e-9)
        A = np.column_stack([arm / size, n[near]])
        # What the surface leaves open, turns of a ball for one, is left as it is.
        step = np.linalg.lstsq(A, ((q - p)[near] * n[near]).sum(axis=1), rcond=1e-4)[0]
        T = Pose.about(step[:3] / size, centre, step[3:]) @ T
        if np.linalg.norm(step) < _STILL_MM:
            break
    # Outliers are as far away from every start, and count no more than this.
    return float(np.minimum(away, _FAR * diagonal(reference)).mean()), T
