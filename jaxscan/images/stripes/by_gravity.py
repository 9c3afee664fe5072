"""The centre of gravity in place of the fitted profile, in frames in which it scatters less along the stripe.

Where the profile is the model's, no detector is better than its fit. Where lines leave something in common, as far out
of focus, behind a tone curve or where a burnt-out photograph was scaled, the fit takes for speckle what is none, and
weighs pixels by it. Which centres are better, neighbouring lines show: their third differences are error alone on a
smooth surface (`across_blocks`). They are compared over short and over long distances, because an error that changes
with the place in a pixel is alike in neighbours.

Of a cross-section that is skewed the two centres are apart by the same amount everywhere, which a calibration by either
takes up. A frame that changed over alone would be off by that: it counts as scatter of the centre of gravity.
"""

from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.images.stripes.across_blocks import ALONE, IN_BLOCKS, is_level, surfaces, third_differences
from jaxscan.images.stripes.cross_section import size_of
from jaxscan.images.stripes.look import Looker, places_of
from jaxscan.images.stripes.ranks import ranked
from jaxscan.images.stripes.settle import replaced

# The centre of gravity is taken where the fit scatters more by this factor, over all distances: their geometric mean.
_MORE: Final = 1.15
# So much of a normal number's values are within σ. A quotient of two scatters of n lines is off by this over √n.
_WITHIN, _BY_CHANCE = 0.683, 4.0
# A stripe is level if lines so far apart differ by less, px: over the longest differences it stays in its pixel.
LEVEL_BY, LEVEL_PX = 12, 0.1
# As few differences as this say nothing.
_FEWEST: Final = 100


def steadier_by_gravity(
    looker: Looker, measured: Any, peak: Int[np.ndarray, "frames lines"], valid: Bool[np.ndarray, "frames lines"]
) -> tuple[Any, Bool[np.ndarray, "frames"]]:
    """What was measured, with the centres of gravity in frames where these scatter less; and which frames these are.

    Args:
        looker: who has measured, by the fit.
        measured: `Measured` of each line.
        peak: where.
        valid: which lines have a stripe.
    """
    taken = _in_doubt(looker) & valid.any(axis=1)
    if not taken.any():
        return measured, taken
    light = replace(looker.light, sensor=replace(looker.light.sensor, smooth=None, cut=None))
    places = places_of(peak, taken)
    found = replace(looker, light=light, detector="gravity").at(places).measured
    own = measured.position[taken]
    position, sigma, whole = (x.reshape(own.shape) for x in (found.position, found.sigma, found.whole))
    known = valid[taken] & whole & (np.abs(position - own) < measured.width[taken])
    here, there = (np.where(known, x, np.float32(0)) for x in (own, position))
    # A step of the surface is one for both.
    ends = [np.diff(surfaces(x, known), axis=1) > 0 for x in (here, there)]
    steps = np.pad(np.cumsum(ends[0] & ends[1], axis=1), ((0, 0), (1, 0)))
    ours, theirs = (scatters(x, steps) for x in (here, there))
    apart = np.nan_to_num(ranked(here - there, known, 0.5))
    steadier = scatters_more(ours, theirs, apart, known.sum(axis=1))
    # A level stripe has the same error everywhere, which no difference shows.
    steadier &= ~is_level(here, steps, LEVEL_BY, LEVEL_PX)
    taken[taken] = steadier
    known[~steadier] = False
    which = np.zeros_like(valid)
    which[taken] = known[steadier]
    put = partial(replaced, at=which)
    centre, its_sigma = put(measured.position, new=position[known]), put(measured.sigma, new=sigma[known])
    return replace(measured, position=centre, sigma=its_sigma), taken


def _in_doubt(looker: Looker) -> Bool[np.ndarray, "frames"]:
    """In which frames lines leave something in common, or did before the laser had a cross-section of its own."""
    sensor, count = looker.light.sensor, looker.batch.count
    in_doubt = ~np.asarray(sensor.apart)[:count]
    return in_doubt if sensor.shape is None else in_doubt | (size_of(sensor.shape)[:count] > 0)


def scatters(
    position: Float[np.ndarray, "frames lines"], steps: Int[np.ndarray, "frames lines"]
) -> Float[np.ndarray, "distances frames"]:
    """The scatter of third differences over each distance, px; NaN where there are few.

    Args:
        position: of each line, px.
        steps: on which surface it is.
    """
    one, found = np.ones_like(position), []
    for apart in (*ALONE, *IN_BLOCKS):
        if position.shape[1] <= 3 * apart:
            break
        values, used = third_differences(position, one, steps, apart)
        scatter = ranked(np.where(used, values, 0), used, _WITHIN)
        found.append(np.where(used.sum(axis=1) < _FEWEST, np.nan, scatter))
    return np.array(found).reshape(-1, len(position))


def scatters_more(
    ours: Float[np.ndarray, "distances frames"],
    theirs: Float[np.ndarray, "distances frames"],
    apart: Float[np.ndarray, "frames"],
    count: Int[np.ndarray, "frames"],
) -> Bool[np.ndarray, "frames"]:
    """In which frames the first scatter more, and by more than chance does.

    Args:
        ours: scatters, px.
        theirs: likewise.
        apart: how far the two are apart in all lines, px.
        count: of lines.
    """
    known = np.isfinite(ours) & np.isfinite(theirs) & (theirs > 0) & (ours > 0)
    logs = np.log(np.where(known, ours, 1) / np.where(known, np.hypot(theirs, apart), 1))
    mean = logs.sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return mean > np.log(np.maximum(_MORE, 1 + _BY_CHANCE / np.sqrt(np.maximum(count, 1))))
