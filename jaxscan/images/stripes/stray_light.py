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
# Lines so near to such a run may have it too, if the run has this number of lines: where other light comes nearer to
# the stripe than there, the plain fit takes it in, and no pixel seems off.
_NEAR, _SOLID = 10, 8


def without_stray_light(looker: Looker, looked: Looked, peak: Int[np.ndarray, "frames lines"]) -> Looked:
    """What was found, with lines measured again beside which other light falls.

    An edge of reflectance leaves light beside the stripe as well. There the model without other light stands, and what
    is left with other light out of the way is more than noise: such lines stay as they were.

    Args:
        looker: who has looked, by the fit.
        looked: what was found in each line.
        peak: where.
    """
    measured, seems = looked.measured, in_other_light(looker, looked)
    if not seems.any():
        return looked
    asked = near_to(seems, looked)
    after = looker.beside_stray_light(jax.tree.map(np.ravel, measured), places_of(peak), asked.ravel())
    after = jax.tree.map(lambda new: new.reshape(peak.shape), after)
    noise = asked & after.whole & ~after.strained
    runs = seems & mostly(noise, seems)
    taken = after.whole & (runs | near_to(runs, looked) & noise)
    found: Any = jax.tree.map(lambda old, new: np.where(taken, new, old), measured, after)
    return looked._replace(measured=replace(found, stray=taken, strained=measured.strained & ~taken))


def in_other_light(looker: Looker, looked: Looked) -> Bool[np.ndarray, "frames lines"]:
    """Which lines seem to have other light beside them, as their neighbours have."""
    asked = _can_have(looked)
    goes_on = asked & (over(looked.measured.stray & asked, _NEIGHBOURS) >= _FEWEST)
    return goes_on & ~looker.light.video[: len(asked), None]


def near_to(runs: Bool[np.ndarray, "frames lines"], looked: Looked) -> Bool[np.ndarray, "frames lines"]:
    """Lines of some runs, and those so near to one that the same light may lie beside them."""
    solid = runs & (over(runs, _NEAR) >= _SOLID)
    return _can_have(looked) & (runs | (over(solid, _NEAR) > 0))


def _can_have(looked: Looked) -> Bool[np.ndarray, "frames lines"]:
    return looked.strong & looked.measured.whole & ~(looked.burnt | looked.cramped)


def mostly(
    true: Bool[np.ndarray, "frames lines"], of: Bool[np.ndarray, "frames lines"]
) -> Bool[np.ndarray, "frames lines"]:
    """In which runs of lines it is true of more than half of them."""
    run = np.cumsum(np.diff(of, axis=1, prepend=False).ravel()).reshape(of.shape)
    share = np.bincount(run.ravel(), true.ravel()) / np.maximum(np.bincount(run.ravel(), of.ravel()), 1)
    return share[run] > 0.5
