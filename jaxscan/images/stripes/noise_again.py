"""The noise of a frame is read once more where its first survey was misled: off lines that show nothing but noise.

The survey reads noise and speckle off what the fits of a frame's lines leave. Where edges of reflectance run along most
of the stripe, or other light lies beside much of it, they leave more than noise does, and are taken for it.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.images.stripes.bell import FWHM
from jaxscan.images.stripes.evidence import mostly_torn
from jaxscan.images.stripes.light import MOSTLY_BURNT
from jaxscan.images.stripes.look import Looker
from jaxscan.images.stripes.settle import Looked
from jaxscan.images.stripes.stray_light import in_other_light, near_to

# ln of the standard deviation of the narrowest stripe in which an edge is measured, px.
_NARROWEST_TORN: Final = float(np.log(0.9))
# This part of the lines with an edge is narrower than the stripe.
_WHOLE: Final = 0.9
# Where more than this part of a frame's lines have other light beside them, it is taken for noise.
_MANY: Final = 0.05
# Lines near to these are left out as well, unless all together are more than this part.
_MOST: Final = 0.35
# With the noise without them more of them may be found: this number of times.
_ROUNDS: Final = 2


def noise_again(looker: Looker, looked: Looked, peak: Int[np.ndarray, "frames lines"]) -> tuple[Looker, Looked]:
    """Who knows the noise of lines without edges or other light, and what the frames show with it.

    Args:
        looker: who has looked, by the fit.
        looked: what was found in each line.
        peak: where.
    """
    seems = in_other_light(looker, looked)
    first, plain = looked.measured, without_halo(looked) & ~near_to(seems, looked)
    torn, even = mostly_torn(first.h3, first.h4, plain)
    torn &= can_be_torn(looker)
    without = np.zeros_like(plain)
    for _ in range(_ROUNDS):
        other = without | _or_near_to(seems, looked) & ~torn[:, None]
        many = (other & ~without).sum(1) > _MANY * looked.strong.sum(1)
        if not many.any():
            break
        without |= other & many[:, None]
        knowing = replace(looker, seen=looker.seen & ~without)
        looker = knowing.with_light(looker.light.read_again(looker.batch, without))
        looked = looker.again_in(looked, peak, many)
        seems = in_other_light(looker, looked)
    if torn.any():
        without |= torn[:, None] & ~even
        looker = looker.with_light(looker.light.read_again(looker.batch, without))
        looker = _of_whole_width(looker, first.width, plain, torn)
        looked = looker.again_in(looked, peak, torn)
    return looker, looked


def _or_near_to(seems: Bool[np.ndarray, "frames lines"], looked: Looked) -> Bool[np.ndarray, "frames lines"]:
    """Lines that seem to have other light, and those near to them where enough others are left."""
    near = near_to(seems, looked)
    few = near.sum(1, keepdims=True) <= _MOST * looked.strong.sum(1, keepdims=True)
    return np.where(few, near, seems)


def without_halo(looked: Looked) -> Bool[np.ndarray, "frames lines"]:
    """Which lines have a stripe that is not burnt out, nor near to such a one.

    The halo of a burnt-out stripe, and of lines nearly so beside it, strains the profile too, and is no edge.
    """
    halo = looked.burnt | (looked.burnt.mean(axis=1, keepdims=True) > MOSTLY_BURNT)
    return looked.strong & ~looked.cramped & ~halo


def can_be_torn(looker: Looker) -> Bool[np.ndarray, "frames"]:
    """In which frames edges show.

    What blurs a narrower stripe hides the shape that an edge leaves in it; a JPEG leaves such shapes of its own.
    """
    return np.asarray(looker.light.sensor.ln_s)[: looker.batch.count] > _NARROWEST_TORN


def _of_whole_width(
    looker: Looker,
    width: Float[np.ndarray, "frames lines"],
    seen: Bool[np.ndarray, "frames lines"],
    has_edge: Bool[np.ndarray, "frames"],
) -> Looker:
    """Where most lines of a frame have an edge, its usual width is the whole stripe's: an edge makes lines narrower."""
    sensor = looker.light.sensor
    ln_s = np.array(sensor.ln_s)
    for frame in np.flatnonzero(has_edge & seen.any(1)):
        ln_s[frame] = np.log(np.quantile(width[frame, seen[frame]], _WHOLE) / FWHM)
    return looker.with_sensor(ln_s=ln_s)
