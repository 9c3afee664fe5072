"""Steps of the room's light beside a stripe: where lines show one, they are measured with it.

The silhouette of an object, or the edge of a shadow, goes on from line to line. Of a colour neutral light cancels, and
hardly a step is left; a grey photograph shows all of it.
"""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.images.stripes.batch import NARROW
from jaxscan.images.stripes.bell import FWHM
from jaxscan.images.stripes.evidence import over
from jaxscan.images.stripes.look import Looker, places_of
from jaxscan.images.stripes.settle import Looked
from jaxscan.images.stripes.stray_light import mostly
from jaxscan.robust import NORMAL_MAD

# The ends of a window differ by this multiple of the noise at the least, and by this part of the stripe's strength. Of
# a line and its neighbours on either side, this number do, the same way.
_DIFFER, _OF_STRENGTH = 6.0, 0.03
_NEIGHBOURS, _FEWEST = 3, 4
# Where more than this part of a frame's lines has a step, the usual width is read off them, first with hardly a prior
# (in ln s), then with no less than the other spread; from this number of lines on.
_MANY, _ANY, _LEAST_SPREAD, _ENOUGH = 0.3, 1.0, 0.1, 20


def beside_steps(looker: Looker, looked: Looked, peak: Int[np.ndarray, "frames lines"]) -> Looked:
    """What was found, with lines measured again beside which the room's light has a step.

    Args:
        looker: who has looked, by the fit.
        looked: what was found in each line.
        peak: where.
    """
    asked = _asked(looker, looked)
    if not asked.any():
        return looked
    measured = looked.measured
    many = asked.sum(1) > _MANY * looked.strong.sum(1)
    if many.any():
        # Along most of the stripe a step makes it look broad: its width is read again.
        widths, taken = _again(_of_any_width(looker, many), measured, peak, asked & many[:, None])
        looker = _of_usual_width(looker, widths.width, taken)
    found, taken = _again(looker, measured, peak, asked)
    found = jax.tree.map(lambda old, new: np.where(taken, new, old), measured, found)
    return looked._replace(measured=_as_before(found, measured, taken))


def _again(
    looker: Looker, measured: Any, peak: Int[np.ndarray, "frames lines"], asked: Bool[np.ndarray, "frames lines"]
) -> tuple[Any, Bool[np.ndarray, "frames lines"]]:
    """What the lines that are asked show with a step, and in which of them it stands."""
    found = looker.again(jax.tree.map(np.ravel, measured), places_of(peak), asked.ravel(), NARROW, "beside a step")
    found = jax.tree.map(lambda new: new.reshape(peak.shape), found)
    taken = asked & (found.position != measured.position)
    return found, taken & mostly(taken, asked)


def _of_any_width(looker: Looker, many: Bool[np.ndarray, "frames"]) -> Looker:
    spread = np.array(looker.light.sensor.ln_s_spread)
    spread[: len(many)][many] = _ANY
    return looker.with_sensor(ln_s_spread=spread)


def _of_usual_width(
    looker: Looker, width: Float[np.ndarray, "frames lines"], taken: Bool[np.ndarray, "frames lines"]
) -> Looker:
    sensor = looker.light.sensor
    ln_s, spread = np.array(sensor.ln_s), np.array(sensor.ln_s_spread)
    for frame in np.flatnonzero(taken.sum(1) >= _ENOUGH):
        own = np.log(width[frame, taken[frame]] / FWHM)
        ln_s[frame] = np.median(own)
        spread[frame] = max(NORMAL_MAD * float(np.median(np.abs(own - ln_s[frame]))), _LEAST_SPREAD)
    return looker.with_sensor(ln_s=ln_s, ln_s_spread=spread)


def _as_before(found: Any, measured: Any, taken: Bool[np.ndarray, "frames lines"]) -> Any:
    """Nothing is asked of a line with a step any more; how bright it is was known before."""
    kept = {name: getattr(measured, name) for name in ("strength", "relief", "breadth", "ln_light")}
    return replace(found, **kept, strained=measured.strained & ~taken)


def _asked(looker: Looker, looked: Looked) -> Bool[np.ndarray, "frames lines"]:
    uneven, count = looked.measured.uneven, len(looked.strong)
    read = np.asarray(looker.light.sensor.read)[:count, None]
    can = looked.strong & looked.measured.whole & ~looked.cramped & ~looker.light.video[:count, None]
    can &= np.abs(uneven) * read > _OF_STRENGTH * looked.measured.strength
    asked = np.zeros_like(can)
    for side in (uneven > _DIFFER, uneven < -_DIFFER):
        there = can & side
        asked |= there & (over(there, _NEIGHBOURS) >= _FEWEST)
    return asked
