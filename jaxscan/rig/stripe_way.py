"""Which way a stripe runs over the image: with how many pixels each of its lines meets it."""

from typing import Final

import numpy as np

from jaxscan.phrases import stripe_of
from jaxscan.rig.light import inverse_depths
from jaxscan.rig.projection import pixel_rays
from jaxscan.rig.rig import Rig

# A stripe that runs more steeply than this against the lines in which it is looked for is badly measured.
STEEP: Final = 2.0
# Pixels at which the sheet is asked, each way.
_GRID: Final = 7


def stripe_slope(rig: Rig, light: str) -> float:
    """How steeply the stripe of a light runs over the image on surfaces that face the camera, |dv / du|.

    There the sheet has one depth along it: with w the sheet's inverse depth at a pixel, the stripe is a line of equal
    w, and its slope is |∂w/∂u| / |∂w/∂v|; the median over the pixels that see the sheet.

    Returns:
        0 of a stripe from left to right, infinite of one straight down; NaN where no pixel sees the sheet.
    """
    width, height = rig.camera.image_size
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(1, width - 2, _GRID), np.linspace(1, height - 2, _GRID)))
    pixels = np.stack([np.stack([u + du, v + dv], axis=-1) for du, dv in ((0, 0), (1, 0), (0, 1))])
    w = inverse_depths(rig.light(light), pixel_rays(rig.camera, pixels).reshape(-1, 3))[0].reshape(3, -1)
    along_u, along_v = np.abs(w[1:] - w[0])
    seen = (w[0] > 0) & (along_u + along_v > 0)
    with np.errstate(divide="ignore"):
        return float(np.median(along_u[seen] / along_v[seen])) if seen.any() else float("nan")


def slope_across(rig: Rig, light: str, *, columns: bool) -> float:
    """The same against the lines in which it is looked for: columns, or rows."""
    slope = stripe_slope(rig, light)
    return slope if columns else 1 / max(slope, 1e-9)


def way_across(*, columns: bool) -> str:
    """Which way a stripe runs that is looked for across it, in words."""
    return "up and down" if columns else "from left to right"


def setting_instead(*, columns: bool) -> str:
    """The setting that fits such a stripe."""
    return f"set columns = {str(not columns).lower()} under [laser]"


def across_note(laser: str, where: str, *, columns: bool) -> str:
    """What is said of a laser whose stripe is looked for across its way, and where."""
    return (
        f"the {stripe_of(laser)} runs {way_across(columns=columns)} {where}, where it is badly measured with the "
        f"present setting: {setting_instead(columns=columns)}"
    )


def steep_notes(rig: Rig, laser: str, where: str, *, columns: bool) -> list[str]:
    """As `across_note`, of a laser whose sheet shows that; none of another."""
    steep = slope_across(rig, laser, columns=columns) > STEEP
    return [across_note(laser, where, columns=columns)] if steep else []
