"""How the stripes of a swept light lie beside its sheet: alike at one step, on one board, or neither.

Each offset is one in motor steps of the light's axis, so that an angle is the same number at all distances. A drive
whose steps are uneven puts the stripes of one step beside the sheet alike on all boards. A drive with play, or a board
that moved after its corners were photographed, puts all stripes of one board beside it alike. The two are told apart by
the squares that means of each step, of each board, and both together leave: an F test with the other in the model.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.special import fdtrc

from jaxscan.calibration.diagnostics.stripe_shapes import StripeShape

# Means are a cause if they explain this share of the squares, and if chance does so less often than this. Honest
# sessions have p above 0.05 and shares below 0.3; uneven steps, and play, shares above 0.9.
_SHARE, _CHANCE = 0.5, 1e-4
# Stripes sag alike where a common curve explains this share of the squares: straight sheets have 0.03, curved ones 0.9.
_ALIKE = 0.7


@dataclass(frozen=True)
class SweptOffsets:
    """What the offsets of one laser's stripes have in common.

    Attributes:
        by: "steps" where they are alike at the same step on all boards, "boards" where all of one board are; None where
            neither is clear.
        share: of the squares of all offsets that this explains.
        least: the board or step whose stripes are furthest to one side, and their mean, motor steps.
        most: the same on the other side.
    """

    by: Literal["steps", "boards"] | None
    share: float
    least: tuple[str, float]
    most: tuple[str, float]


def swept_offsets(stripes: Sequence[StripeShape]) -> SweptOffsets:
    """Of all stripes of one laser whose light moves."""
    off = np.array([stripe.off_steps for stripe in stripes])
    names: dict[Literal["steps", "boards"], list[str]] = {
        "steps": [f"{stripe.position:g}" for stripe in stripes],
        "boards": [stripe.name for stripe in stripes],
    }
    groups = {by: np.unique(own, return_inverse=True) for by, own in names.items()}
    columns = {by: _columns(which, len(each)) for by, (each, which) in groups.items()}
    left, terms = _left(np.concatenate(list(columns.values()), axis=1), off)
    dof, tested = len(off) - terms, []
    for by, other in (("steps", "boards"), ("boards", "steps")):
        without, fewer = _left(columns[other], off)
        if dof > 0 and terms > fewer:
            chance = float(fdtrc(terms - fewer, dof, (without - left) / (terms - fewer) / max(left / dof, 1e-30)))
            share = 1 - _left(columns[by], off)[0] / max(float(off @ off), 1e-30)
            tested.append((share, chance, by))
    clear = [(share, by) for share, chance, by in tested if share > _SHARE and chance < _CHANCE]
    share, by = max(clear, default=(0.0, None))
    each, which = groups[by or "boards"]
    means = np.bincount(which, off) / np.bincount(which)
    least, most = ((str(each[i]), float(means[i])) for i in (np.argmin(means), np.argmax(means)))
    return SweptOffsets(by, share, least, most)


def curved_alike_mm(stripes: Sequence[StripeShape]) -> float:
    """How far the stripes of one laser sag in the median, to the same side on all boards; 0 where they do not.

    The sag of a curved sheet goes with the square of a stripe's length over its distance.
    """
    sag = np.array([stripe.sag_mm for stripe in stripes])
    usual = np.array([stripe.length_mm**2 / stripe.depth_mm for stripe in stripes])
    if not sag.any() or not usual.any():
        return 0.0
    left = sag - usual * (sag @ usual) / (usual @ usual)
    return float(np.median(np.abs(sag))) if 1 - left @ left / (sag @ sag) > _ALIKE else 0.0


def _columns(which: Int[np.ndarray, "stripes"], count: int) -> Float[np.ndarray, "stripes groups"]:
    """1 where a stripe is of a group, 0 elsewhere."""
    return np.eye(count)[which]


def _left(columns: Float[np.ndarray, "stripes groups"], off: Float[np.ndarray, "stripes"]) -> tuple[float, int]:
    """The sum of squares that least squares leave, and of how many terms."""
    found, _, rank, _ = np.linalg.lstsq(columns, off)
    left = off - columns @ found
    return float(left @ left), int(rank)
