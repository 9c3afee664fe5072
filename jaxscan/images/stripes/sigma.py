"""σ of each line's centre: what the fit predicts, and all that a line's own pixels do not show."""

from functools import partial
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float32

from jaxscan.images.stripes.across_blocks import ALONE, IN_BLOCKS, beyond_usual, sigma_across_blocks
from jaxscan.images.stripes.along import widened_by_flanks, widened_by_scatter
from jaxscan.images.stripes.batch import SHORT
from jaxscan.images.stripes.between import widened_between
from jaxscan.images.stripes.look import GROUPS, Looker, groups
from jaxscan.images.stripes.printed import widened_by_print
from jaxscan.images.stripes.smoothed import widening

# Up to this one the stripe has about three pixels, which do not show their own noise.
_SCARCE_LN_PX: Final = float(np.log(0.6))

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
    sensor, ln_s = light.sensor, np.asarray(light.sensor.ln_s)[:count]
    for i in np.flatnonzero(light.correlation[:count, 0]):
        sigma[i] *= widening(light.correlation[i], sensor, int(i), width[i], measured.relief[i])
    independent = widened_by_flanks(sigma, measured.breadth, measured.burnt, sensor)
    sigma = widened_by_scatter(independent, position, measured.burnt, sensor)
    # The few native pixels of a stripe that is hardly wider than they are apart do not show its speckle.
    coded = (light.jpeg | light.video)[:count]
    scarce = ((ln_s < _SCARCE_LN_PX) & mosaic | by_gravity) & ~coded
    for some, burnt, apart in ((coded, measured.burnt, IN_BLOCKS), (scarce, np.zeros_like(measured.burnt), ALONE)):
        if some.any():
            here = independent[some], position[some], width[some], burnt[some], light.sharp[:count][some]
            sigma[some] = sigma_across_blocks(*here, apart)
    sigma = widened_between(sigma, position, width)
    seen_in = batch.images, batch.background, sensor, light.correlation, batch.settings, batch.half(SHORT)
    printed = widened_by_print(sigma, position, width, ~with_edge, *seen_in, partial(groups, sizes=GROUPS))
    by_scatter = coded | scarce
    printed[by_scatter] = beyond_usual(sigma[by_scatter], printed[by_scatter])
    return printed
