"""σ of each line's centre: what the fit predicts, and all that a line's own pixels do not show."""

from functools import partial
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float32

from jaxscan.images.stripes.along import widened_by_flanks, widened_by_scatter
from jaxscan.images.stripes.batch import SHORT
from jaxscan.images.stripes.between import widened_between
from jaxscan.images.stripes.by_gravity import in_doubt
from jaxscan.images.stripes.by_scatter import ALONE, IN_BLOCKS, agreed, beyond_usual, sigma_by_scatter
from jaxscan.images.stripes.look import GROUPS, Looker, groups
from jaxscan.images.stripes.printed import widened_by_print
from jaxscan.images.stripes.smoothed import widening

# Where lines leave something in common σ is too small by no more than this factor.
_MOST_IN_COMMON: Final = 2.0

Lines = Float32[np.ndarray, "frames lines"]


def sigma_of_centres(
    looker: Looker,
    measured: Any,
    valid: Bool[np.ndarray, "frames lines"],
    with_edge: Bool[np.ndarray, "frames lines"],
    by_gravity: Bool[np.ndarray, "frames"],
    mosaic: bool,
) -> Lines:
    """σ of each line's centre, px; NaN where there is none.

    Args:
        looker: who has measured.
        measured: `Measured` of each line.
        valid: which lines have a stripe.
        with_edge: which were measured with an edge of reflectance.
        by_gravity: in which frames it is the centre of gravity: their noise is misread.
        mosaic: whether the photographs are the native pixels of a mosaic.
    """
    batch, light, count = looker.batch, looker.light, looker.batch.count
    position, sigma, width = (
        np.where(valid, x, np.float32(np.nan)) for x in (measured.position, measured.sigma, measured.width)
    )
    sensor = light.sensor
    for i in np.flatnonzero(light.correlation[:count, 0]):
        sigma[i] *= widening(light.correlation[i], sensor, int(i), width[i], measured.relief[i])
    # Bounds that a burnt-out stripe's pixels set may leave its centre anywhere between its flanks, and no further.
    anywhere = np.where(measured.burnt, measured.breadth / np.float32(np.sqrt(12)), np.float32(np.inf))
    sigma = np.where(sigma > anywhere, anywhere, sigma)
    independent = widened_by_flanks(sigma, measured.breadth, measured.burnt, sensor)
    sigma = widened_by_scatter(independent, position, measured.burnt, sensor)
    coded = (light.jpeg | light.video)[:count]
    grained = np.asarray(sensor.grain)[:count] > 0
    sigma[~coded] = agreed(sigma[~coded], position[~coded], grained[~coded])
    # Of these the pixels do not show all errors: of the last ones most.
    processed = (by_gravity | (light.correlation[:count, 0] != 0) | mosaic) & ~coded
    in_common = in_doubt(looker) & ~(processed | coded)
    of_scatter = coded | processed | in_common
    most = np.where(in_common, _MOST_IN_COMMON, np.inf)
    no_burnt = np.zeros_like(measured.burnt)
    for some, said, burnt, least_apart, moving in (
        (coded & ~by_gravity, independent, measured.burnt, IN_BLOCKS[0], False),
        (coded & by_gravity, independent, measured.burnt, IN_BLOCKS[0], True),
        (processed | in_common, sigma, no_burnt, ALONE[0], True),
    ):
        if some.any():
            here = said[some], position[some], width[some], burnt[some], light.sharp[:count][some]
            sigma[some] = sigma_by_scatter(*here, least_apart, moving, most[some])
    sigma = widened_between(sigma, position, width)
    seen_in = batch.images, batch.background, sensor, light.correlation, batch.settings, batch.half(SHORT)
    printed = widened_by_print(sigma, position, width, ~with_edge, *seen_in, partial(groups, sizes=GROUPS))
    printed[of_scatter] = beyond_usual(sigma[of_scatter], printed[of_scatter])
    return printed
