"""Light beside a stripe that is not its own: a second reflection, a lamp, the room.

Beside the stripe a pixel's noise is small, so that a little light there draws the fit of the profile far. It goes on
from line to line, which noise does not. Where a run of lines has pixels beside the stripe that are off by more than
noise makes them, these lines are measured again with such pixels counting for little.
"""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Int

from jaxscan.images.stripes.evidence import over
from jaxscan.images.stripes.look import Looker, places_of
from jaxscan.images.stripes.settle import Looked

# Of a line and its neighbours on either side, this number have light beside the stripe.
_NEIGHBOURS, _FEWEST = 3, 3
# Lines so near to such a run are measured as it is: where other light comes nearer to the stripe than there, the plain
# fit takes it in, and no pixel seems off.
_NEAR = 10


def without_stray_light(looker: Looker, looked: Looked, peak: Int[np.ndarray, "frames lines"]) -> Looked:
    """What was found, with lines measured again beside which other light falls.

    Args:
        looker: who has looked, by the fit.
        looked: what was found in each line.
        peak: where.
    """
    measured, which = looked.measured, in_other_light(looker, looked)
    if not which.any():
        return looked
    before = jax.tree.map(np.ravel, measured)
    after = looker.beside_stray_light(before, places_of(peak), which.ravel())
    taken = (which.ravel() & after.whole).reshape(peak.shape)
    found: Any = jax.tree.map(lambda old, new: np.where(taken, new.reshape(old.shape), old), measured, after)
    # Whether there is an edge besides is asked of the plain fit, unless what is left is noise.
    noise = taken & mostly(taken & ~found.strained, which)
    h3, h4 = (np.where(noise, new, old) for new, old in ((found.h3, measured.h3), (found.h4, measured.h4)))
    strained = measured.strained & ~noise
    return looked._replace(measured=replace(found, stray=taken, strained=strained, h3=h3, h4=h4))


def in_other_light(looker: Looker, looked: Looked) -> Bool[np.ndarray, "frames lines"]:
    """Which lines have other light beside them, as their neighbours have."""
    measured = looked.measured
    asked = looked.strong & measured.whole & ~(looked.burnt | looked.cramped)
    goes_on = asked & (over(measured.stray & asked, _NEIGHBOURS) >= _FEWEST)
    return asked & (over(goes_on, _NEAR) > 0) & ~looker.light.video[: len(asked), None]


def mostly(
    true: Bool[np.ndarray, "frames lines"], of: Bool[np.ndarray, "frames lines"]
) -> Bool[np.ndarray, "frames lines"]:
    """In which runs of lines it is true of more than half of them."""
    run = np.cumsum(np.diff(of, axis=1, prepend=False).ravel()).reshape(of.shape)
    share = np.bincount(run.ravel(), true.ravel()) / np.maximum(np.bincount(run.ravel(), of.ravel()), 1)
    return share[run] > 0.5
