"""What the noise of the photographs alone leaves of a cloud, whoever reconstructs it: Cramér and Rao's bound.

In each column the photograph without noise and its derivative by the stripe's row are rendered, twice, with the sheet a
little to either side. A pixel is normal, of the variance of the sensor's noise, of rounding and of speckle, and says
less where it is full (a censored datum); level of the ground, height and width of the stripe are unknown. The rig is
the true one, so that a calibrated one's part comes on top.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr, ndtr

from jaxscan.images.decode import NUMBERS_PER_LEVEL
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import LightPlane, Rig
from jaxscan.rig.projection import pixel_rays
from jaxscan.simulation.distance import distance
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.profile import Profile, true_profile
from jaxscan.simulation.render import plane_of, render
from jaxscan.simulation.scene import Scene

# The laser is dimmed so far that no pixel is full; 16 bits have digits enough.
_DIMMED: Final = 30.0
# Part by which the sheet's dual plane is changed to either side: about 0.05 px.
_ASIDE: Final = 1e-4
_HALF_PX: Final = 8
# A dimmer stripe is none, grey levels; a point that moves by more than this between the two sheets is at an edge, px.
_LEAST_LEVEL, _FARTHEST_PX = 30.0, 0.5
_SMALL_PX: Final = 0.01


def cloud_bound(
    rig: Rig, scene: Scene, steps: tuple[int, ...], lighting: Lighting, sensor: Sensor
) -> Mapping[str, float]:
    """RMS over the points of these frames, mm: `absolute`, from the surface, and `to_true_point`."""
    frames = [_frame(rig, scene, n, lighting, sensor) for n in steps]
    place, off = (np.concatenate(parts) for parts in zip(*frames, strict=True))
    return {"absolute": _rms(off), "to_true_point": _rms(place)}


def _frame(
    rig: Rig, scene: Scene, steps: int, lighting: Lighting, sensor: Sensor
) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """Bounds of each point of a frame: from its true place, and from the surface, mm."""
    exact = replace(sensor, noise=0.0, bits=16)
    dark = replace(lighting, speckle=0.0, ghost=0.0, ambient=0.0, directional=0.0, highlight=0.0)
    dimmed = replace(dark, laser_power=lighting.laser_power / _DIMMED)
    ground = _red(render(rig, scene, q={"stage": steps}, lighting=lighting, sensor=exact))
    stripes, rows = [], []
    for part in (1 - _ASIDE, 1 + _ASIDE):
        there = _with_sheet(rig, part)
        backdrop = replace(scene, backdrop=(0.0, 0.0, 0.0))
        stripes.append(
            _DIMMED * _red(render(there, backdrop, q={"stage": steps}, laser=0, lighting=dimmed, sensor=exact))
        )
        rows.append(true_profile(there, scene, {"stage": steps}, lighting=lighting).position)
    seen = true_profile(rig, scene, {"stage": steps}, lighting=lighting)
    sigma = _sigma_px(ground, stripes[0], stripes[1], rows[0], rows[1], lighting.speckle, sensor)
    good = np.flatnonzero(np.isfinite(sigma) & np.isfinite(seen.position))
    return _in_mm(rig, scene, seen, good, sigma[good])


def _sigma_px(
    ground: Float[np.ndarray, "rows columns"],
    before: Float[np.ndarray, "rows columns"],
    after: Float[np.ndarray, "rows columns"],
    row_before: Float[np.ndarray, "columns"],
    row_after: Float[np.ndarray, "columns"],
    contrast: float,
    sensor: Sensor,
) -> Float[np.ndarray, "columns"]:
    """The bound of the stripe's row in each column, px; NaN where there is none."""
    light, row = (before + after) / 2, (row_before + row_after) / 2
    moved = row_after - row_before
    good = (light.max(axis=0) >= _LEAST_LEVEL) & (np.abs(moved) < _FARTHEST_PX) & (moved != 0)
    bound = np.full(len(row), np.nan)
    for column in np.flatnonzero(good):
        first = max(round(row[column]) - _HALF_PX, 0)
        near = slice(first, round(row[column]) + _HALF_PX + 1)
        stripe, by_row = light[near, column], (after - before)[near, column] / moved[column]
        away = first + np.arange(len(stripe)) - row[column]
        J = np.stack([np.ones_like(stripe), stripe, away * by_row, by_row], axis=-1)
        variance = sensor.noise**2 + 1 / 12 + (contrast * stripe) ** 2
        weight = _told((sensor.saturation - ground[near, column] - stripe) / np.sqrt(variance)) / variance
        information = J.T @ (weight[:, None] * J)
        scale = np.sqrt(np.diagonal(information))
        if (scale > 0).all() and np.linalg.cond(information / np.outer(scale, scale)) < 1e12:
            bound[column] = np.sqrt(np.linalg.inv(information / np.outer(scale, scale))[-1, -1]) / scale[-1]
    return bound


def _told(t: Float[np.ndarray, "pixels"]) -> Float[np.ndarray, "pixels"]:
    """Information of a censored normal datum, in parts of a free one's, by its mean's distance from the limit in σ."""
    t = np.clip(t, -30, 30)
    density = np.exp(-0.5 * t**2) / np.sqrt(2 * np.pi)
    return ndtr(t) - t * density + np.exp(2 * np.log(density) - log_ndtr(-t))


def _in_mm(
    rig: Rig, scene: Scene, seen: Profile, columns: np.ndarray, sigma: Float[np.ndarray, "points"]
) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]]:
    """How far each point is from its true place, and from the surface."""
    position, points = seen.position[columns], seen.points[columns]
    # A point moves within the sheet: along its ray, and aside with its pixel.
    before, after = (
        rays / np.asarray(rig.lights[0].inverse_depth(rays))[:, None]
        for rays in (
            pixel_rays(rig.camera, np.stack([columns, position + aside], axis=-1)) for aside in (-_SMALL_PX, _SMALL_PX)
        )
    )
    moved = (after - before) / (2 * _SMALL_PX)
    off = distance(scene, points + _SMALL_PX * moved) / _SMALL_PX
    return sigma * np.linalg.norm(moved, axis=1), sigma * off


def _with_sheet(rig: Rig, part: float) -> Rig:
    sheet = rig.lights[0]
    with float64():
        return as_numpy(replace(rig, lights=(LightPlane.create(part * plane_of(sheet), sheet.name),)))


def _red(image: np.ndarray) -> Float[np.ndarray, "rows columns"]:
    return image[..., 0] / NUMBERS_PER_LEVEL


def _rms(values: Float[np.ndarray, "values"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
