"""The unit of length of a cloud: millimetres, unless another is said; what is too small for that is pointed out."""

import warnings
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.files.cloud import Cloud

UNITS: Final = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
# What is smaller than this across, mm, was not scanned by a line of light; in metres it would be up to two across.
_TOO_SMALL_MM: Final = 2.0

# How near to another unit a length must come to be taken for one in it.
_NEAR: Final = 0.05


class UnitsWarning(UserWarning):
    """Coordinates are so small that they are hardly millimetres."""


def too_small(points: Float[np.ndarray, "points 3"]) -> float | None:
    """How far points reach, mm, if that is so little that they will be in metres; else None."""
    across = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    return across if 0 < across < _TOO_SMALL_MM else None


def times_of_units(value: float, nominal: float) -> float | None:
    """How many times its nominal value a length is, if that is about the ratio of two of `UNITS`; else None."""
    ratios = sorted({a / b for a in UNITS.values() for b in UNITS.values() if a != b})
    ratio = value / nominal if nominal else 0.0
    return next((each for each in ratios if abs(ratio / each - 1) < _NEAR), None)


def in_millimetres(
    name: str, points: Float[np.ndarray, "points 3"], units: str | None, option: str = "--units"
) -> Float[np.ndarray, "points 3"]:
    """Points in millimetres.

    Nothing is converted unless it is said: where no unit is given and the points are far too close together for
    millimetres, there is a `UnitsWarning`.

    Args:
        name: what the points are called.
        points: in `units`.
        units: one of `UNITS`; None for millimetres that nobody has spoken of.
        option: by which it is said.
    """
    if units is not None:
        return points * points.dtype.type(UNITS[units])
    across = too_small(points)
    if across is not None:
        warnings.warn(
            f"{name}: is {across:.3g} mm across, taken for millimetres: if its numbers are metres, say {option} m; "
            f"if not, what they are: {option} mm, cm or inch",
            UnitsWarning,
            stacklevel=2,
        )
    return points


def cloud_in_millimetres(name: str, cloud: Cloud, units: str | None) -> Cloud:
    """A cloud with its σ in millimetres, as `in_millimetres`."""
    scale = np.float32(UNITS[units or "mm"])
    return replace(
        cloud,
        points=in_millimetres(name, cloud.points, units),
        sigma=None if cloud.sigma is None else scale * cloud.sigma,
        sigma_pixel=None if cloud.sigma_pixel is None else scale * cloud.sigma_pixel,
    )
