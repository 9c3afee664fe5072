"""Lines that see two surfaces at once: where a depth has a step, a lens shows the stripe of both in one line.

Up to about the stripe's breadth apart the two melt into one bump, with its centre somewhere between them: a point on no
surface. With e₋ and e₊ what straight lines through some neighbours on either side make of the line's place, there is a
step where these differ by more than noise, and a centre that lies between them is as likely as not moved from the
nearer one by its whole distance, which is added to σ.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.robust import NORMAL_MAD

# Neighbours of one side, in lines: the next one may see both surfaces too.
_NEIGHBOURS: Final = np.arange(2, 5)
# So many show whether that side is even.
_FURTHER: Final = np.arange(2, 8)
# Of the straight line through them, at the line itself.
_EXTRAPOLATE: Final = (
    1 / len(_NEIGHBOURS)
    - _NEIGHBOURS.mean() * (_NEIGHBOURS - _NEIGHBOURS.mean()) / ((_NEIGHBOURS - _NEIGHBOURS.mean()) ** 2).sum()
)
# A step is so many standard deviations high.
_STEP = 3.0
# Stripes that are further apart than so many full widths are two.
_TOGETHER = 2.0

Lines = Float[np.ndarray, "frames lines"]


def widened_between(sigma: Lines, position: Lines, width: Lines) -> Lines:
    """σ with the distance to the nearer surface, where a centre lies between two.

    Args:
        sigma: of each line's centre, px; NaN where there is none.
        position: the centre.
        width: of the stripe, full at half height, px.
    """
    reach = int(_NEIGHBOURS[-1])
    if position.shape[1] <= 2 * reach:
        return sigma
    lines = np.arange(position.shape[1])
    # On a rough surface each line has its own place.
    scatter = np.maximum(sigma, _own_scatter(position)[:, None])

    def told_by(side: int) -> Lines:
        neighbours = position[:, np.clip(lines + side * _NEIGHBOURS[:, None], 0, len(lines) - 1)]
        return np.einsum("n,fnl->fl", _EXTRAPOLATE, neighbours).astype(position.dtype)

    def even(side: int) -> Bool[np.ndarray, "frames lines"]:
        """Whether further neighbours bend by no more than noise does, or are none."""
        at = position[:, np.clip(lines + side * _FURTHER[:, None], 0, len(lines) - 1)]
        return ~(np.abs(np.diff(at, 2, axis=1)) > _STEP * np.sqrt(6) * scatter[:, None]).any(axis=1)

    off = np.stack([position - told_by(side) for side in (-1, 1)])
    step = np.abs(off).sum(axis=0)
    with np.errstate(invalid="ignore"):
        between = (off[0] * off[1] < 0) & (step > _STEP * scatter * np.sqrt(2 * (_EXTRAPOLATE**2).sum()))
        between &= (step < _TOGETHER * width) & even(-1) & even(1)
    between[:, :reach] = between[:, -reach:] = False
    return np.where(between, np.hypot(sigma, np.abs(off).min(axis=0)), sigma)


def _own_scatter(position: Lines) -> Float[np.ndarray, "frames"]:
    """The standard deviation of each frame's lines about their neighbours, by second differences; 0 of empty frames."""
    bends = np.abs(np.diff(position, 2, axis=1))
    found = [np.median(each[known]) if (known := np.isfinite(each)).any() else 0.0 for each in bends]
    return np.array(found, position.dtype) * NORMAL_MAD / np.float32(np.sqrt(6))
