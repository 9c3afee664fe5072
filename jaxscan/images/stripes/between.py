"""Lines that see two surfaces at once: where a depth has a step, a lens shows the stripe of both in one line.

Up to about the stripe's breadth apart the two melt into one bump, with its centre somewhere between them: a point on no
surface. With e₋ and e₊ what straight lines through some neighbours on either side make of the line's place, there is a
step where these differ by more than noise, and a centre that lies between them is as likely as not moved from the
nearer one by its whole distance, which is added to σ.
"""

from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.images.stripes.ranks import ranked
from jaxscan.robust import NORMAL_MAD

# Neighbours of one side, in lines: the next one may see both surfaces too. All show whether that side is even.
_DISTANCES: Final = np.arange(2, 8)
# Of the straight line through the nearest of them, at the line itself.
_NEAREST: Final = _DISTANCES[:3]
_EXTRAPOLATE: Final = (
    1 / len(_NEAREST) - _NEAREST.mean() * (_NEAREST - _NEAREST.mean()) / ((_NEAREST - _NEAREST.mean()) ** 2).sum()
)
# Least height of a step, standard deviations.
_STEP = 3.0
# Two stripes that are further apart than this number of full widths are separate.
_TOGETHER = 2.0

Lines = Float[np.ndarray, "frames lines"]


def widened_between(sigma: Lines, position: Lines, width: Lines) -> Lines:
    """σ with the distance to the nearer surface, where a centre lies between two.

    Args:
        sigma: of each line's centre, px; NaN where there is none.
        position: the centre.
        width: of the stripe, full at half height, px.
    """
    reach = int(_NEAREST[-1])
    if position.shape[1] <= 2 * reach:
        return sigma
    lines = np.arange(position.shape[1])
    # On a rough surface each line has its own place.
    scatter = np.maximum(sigma, _own_scatter(position)[:, None])

    off, even = [], np.ones(position.shape, bool)
    for side in (-1, 1):
        beside = position[:, np.clip(lines + side * _DISTANCES[:, None], 0, len(lines) - 1)]
        # A side whose neighbours bend by more than noise does has no straight line; those that are missing do not bend.
        even &= ~(np.abs(np.diff(beside, 2, axis=1)) > _STEP * np.sqrt(6) * scatter[:, None]).any(axis=1)
        off.append(position - np.einsum("n,fnl->fl", _EXTRAPOLATE, beside[:, : len(_NEAREST)]).astype(position.dtype))
    step = np.abs(off).sum(axis=0)
    with np.errstate(invalid="ignore"):
        between = (off[0] * off[1] < 0) & (step > _STEP * scatter * np.sqrt(2 * (_EXTRAPOLATE**2).sum()))
        between &= (step < _TOGETHER * width) & even
    between[:, :reach] = between[:, -reach:] = False
    return np.where(between, np.hypot(sigma, np.abs(off).min(axis=0)), sigma)


def _own_scatter(position: Lines) -> Float[np.ndarray, "frames"]:
    """The standard deviation of each frame's lines about their neighbours, by second differences; 0 of empty frames."""
    bends = np.abs(np.diff(position, 2, axis=1))
    return np.nan_to_num(ranked(bends, np.isfinite(bends), 0.5)) * np.float32(NORMAL_MAD / np.sqrt(6))
