"""How thick a sheet of light is, from the widths of its stripes on the boards.

A stripe is as wide as the lens's blur and the sheet's thickness make it. The sheet, σ = s mm, covers g s pixels of an
image line, g the pixels for each mm by which the board leaves the sheet's middle; that depends on how the board leans
and how far away it is. So the variance of a stripe's profile is

    w² = b² (1 + m²) + s² g²

with m the stripe's slope against the lines' own normal, which a blur that is alike in all directions meets askew. The
blur may depend on the distance; two terms in 1 / z follow that.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.observations import Observations
from jaxscan.calibration.on_board import meet_board, pose_of
from jaxscan.geometry import Pose
from jaxscan.images.stripes.bell import FWHM
from jaxscan.rig import Rig
from jaxscan.rig.board_shape import BentBoard
from jaxscan.rig.light import distance, stood
from jaxscan.robust import NORMAL_MAD

# Stripes with fewer points than this say little, and with fewer stripes than that nothing is said.
_POINTS: Final = 20
_STRIPES: Final = 10
# s² counts from this multiple of its own σ on.
_SURE: Final = 4.0
# Rounds in which stripes count less that are further off than this multiple of the usual.
_ROUNDS, _FAR = 5, 2.0
_TINY: Final = 1e-12


def sheet_sigma_mm(
    observations: Observations, rig: Rig, poses: Pose[np.ndarray], laser: int, bent: Sequence[BentBoard] | None = None
) -> float | None:
    """σ of a sheet's thickness, mm; None where the stripes do not tell it.

    Args:
        observations: the photographs, with the widths of their stripes.
        rig: the rig that was found.
        poses: T_cam_board of each photograph.
        laser: which of the rig's lights.
        bent: the board of each photograph, where it is not flat.
    """
    rows = []
    for i, view in enumerate(observations.photographs()):
        for stripe in view.stripes:
            if stripe.laser != laser or stripe.widths is None:
                continue
            half = np.array([0.0, 0.5] if stripe.columns else [0.5, 0.0])
            board = None if bent is None else bent[i]
            ends = [meet_board(rig.camera, pose_of(poses, i), stripe.pixels + by, board)[0] for by in (-half, half)]
            light = stood(rig.lights[laser], stripe.position)
            off = [distance(light, X) for X in ends]
            with np.errstate(divide="ignore", invalid="ignore"):
                spread = 1 / np.abs(off[1] - off[0])
            known = np.isfinite(spread) & np.isfinite(stripe.widths)
            if known.sum() >= _POINTS:
                depth = rig.camera.chart.range_of(ends[0][known])
                along, across = (stripe.pixels[known] if stripe.columns else stripe.pixels[known, ::-1]).T
                slope = np.median(np.diff(across) / np.diff(along))
                variance = np.median(stripe.widths[known] / FWHM) ** 2
                rows.append((variance, np.median(spread[known] ** 2), 1 + slope**2, np.median(1 / depth)))
    return _thickness(np.array(rows)) if len(rows) >= _STRIPES else None


def _thickness(rows: Float[np.ndarray, "stripes 4"]) -> float | None:
    """The sheet's s of w², g², 1 + m² and 1 / z of stripes."""
    w2, g2, askew, near = rows.T
    at = (near - near.mean()) / max(np.ptp(near), _TINY)
    A = np.stack([askew, g2, askew * at, askew * at**2], axis=1)
    weight, found, left = np.ones(len(w2)), np.zeros(A.shape[1]), w2
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        found = np.linalg.lstsq(root[:, None] * A, root * w2, rcond=None)[0]
        left = w2 - A @ found
        usual = NORMAL_MAD * float(np.median(np.abs(left)))
        weight = np.minimum(1.0, (_FAR * usual / np.maximum(np.abs(left), _TINY)) ** 2)
    freedom = max(weight.sum() - A.shape[1], 1)
    variance = (weight * left**2).sum() / freedom * np.linalg.pinv(A.T @ (weight[:, None] * A))[1, 1]
    return float(np.sqrt(found[1])) if found[1] > _SURE * np.sqrt(variance) else None
