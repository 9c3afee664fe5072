"""The centre of gravity in place of the fitted profile, in frames in which it scatters less along the stripe.

Where the profile is the model's, no detector is better than its fit. Where lines leave something in common, as far out
of focus, behind a tone curve or where a burnt-out photograph was scaled, the fit takes for speckle what is none, and
weighs pixels by it. Which centres are better, neighbouring lines show: their third differences are error alone on a
smooth surface (`by_scatter`). Much of what the two differ by changes with the place in a pixel, and is alike in
lines that the stripe passes at the same place. So they are compared over distances along which the stripe moves.

Of a cross-section that is skewed the two centres are apart by the same amount everywhere, which a calibration by either
takes up. A frame that changed over alone would be off by that: it counts as scatter of the centre of gravity.
"""

from dataclasses import replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.images.stripes.by_scatter import ALONE, moves, of_one_surface, surfaces, third_differences
from jaxscan.images.stripes.cross_section import size_of
from jaxscan.images.stripes.look import Looker, places_of
from jaxscan.images.stripes.processed import at_half_resolution
from jaxscan.images.stripes.ranks import ranked
from jaxscan.images.stripes.settle import replaced

# The centre of gravity is taken where the fit scatters more by this factor, over all distances: their geometric mean,
# by how many differences there are over each.
_MORE: Final = 1.05
# So much of a normal number's values are within σ. A quotient of two scatters of n lines is off by this over √n.
_WITHIN, _BY_CHANCE = 0.683, 2.0
# Over a distance along which half of the lines differ by less, px, errors that change with the place in a pixel are
# alike. As few differences as this say nothing.
_MOVES_PX: Final = 0.2
_FEWEST: Final = 40


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
    taken = in_doubt(looker) & valid.any(axis=1)
    if not taken.any():
        return measured, taken
    places = places_of(peak, taken)
    found = replace(looker.with_sensor(smooth=None, cut=None), detector="gravity").at(places).measured
    own = measured.position[taken]
    position, sigma, whole = (x.reshape(own.shape) for x in (found.position, found.sigma, found.whole))
    known = valid[taken] & whole & (np.abs(position - own) < measured.width[taken])
    here, there = (np.where(known, x, np.float32(0)) for x in (own, position))
    # A step of the surface is one for both.
    ends = [np.diff(surfaces(x, known), axis=1) > 0 for x in (here, there)]
    steps = np.pad(np.cumsum(ends[0] & ends[1], axis=1), ((0, 0), (1, 0)))
    apart = np.nan_to_num(ranked(here - there, known, 0.5))
    steadier = scatters_more(scatters(here, steps), scatters(there, steps), apart, known.sum(axis=1))
    taken[taken] = steadier
    known[~steadier] = False
    which = np.zeros_like(valid)
    which[taken] = known[steadier]
    put = partial(replaced, at=which)
    centre, its_sigma = put(measured.position, new=position[known]), put(measured.sigma, new=sigma[known])
    return replace(measured, position=centre, sigma=its_sigma), taken


def in_doubt(looker: Looker) -> Bool[np.ndarray, "frames"]:
    """In which frames lines leave something in common, or did before the laser had a cross-section of its own.

    In a JPEG with colours at half resolution what is left depends on the place in a block, and lines do not share it.
    """
    sensor, count = looker.light.sensor, looker.batch.count
    common = ~np.asarray(sensor.apart)[:count] | at_half_resolution(sensor)[:count]
    return common if sensor.shape is None else common | (size_of(sensor.shape)[:count] > 0)


class Scatters(NamedTuple):
    """How much centres scatter along the stripe, over each distance.

    Attributes:
        px: of third differences, px.
        number: of them; 0 where they are few, and where the stripe stays where it is: that has the same error
            everywhere, which no difference shows.
    """

    px: Float[np.ndarray, "distances frames"]
    number: Int[np.ndarray, "distances frames"]


def scatters(position: Float[np.ndarray, "frames lines"], steps: Int[np.ndarray, "frames lines"]) -> Scatters:
    """How much centres scatter.

    Args:
        position: of each line, px.
        steps: on which surface it is.
    """
    one, found = np.ones_like(position), []
    for apart in ALONE:
        if position.shape[1] <= 3 * apart:
            break
        values, used = third_differences(position, one, apart), of_one_surface(steps, apart)
        scatter = ranked(np.where(used, values, 0), used, _WITHIN)
        count = used.sum(axis=1)
        told = (count >= _FEWEST) & moves(position, used, apart, _MOVES_PX) & (scatter > 0)
        found.append((scatter, np.where(told, count, 0)))
    none = np.zeros((0, len(position)))
    return Scatters(*map(np.array, zip(*found, strict=True))) if found else Scatters(none, none.astype(int))


def scatters_more(
    ours: Scatters, theirs: Scatters, apart: Float[np.ndarray, "frames"], lines: Int[np.ndarray, "frames"]
) -> Bool[np.ndarray, "frames"]:
    """In which frames the first scatter more, and by more than chance does.

    Args:
        ours: how much they do.
        theirs: likewise.
        apart: how far the two are apart in all lines, px.
        lines: how many there are.
    """
    weight = np.minimum(ours.number, theirs.number)
    logs = np.log(np.where(weight > 0, ours.px, 1) / np.where(weight > 0, np.hypot(theirs.px, apart), 1))
    mean = (weight * logs).sum(axis=0) / np.maximum(weight.sum(axis=0), 1)
    return mean > np.log(np.maximum(_MORE, 1 + _BY_CHANCE / np.sqrt(np.maximum(lines, 1))))
