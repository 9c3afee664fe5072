"""Photographs of a scene through a rig, by ray casting.

Nothing that the estimators assume is put in by hand: there is no drawn stripe and no projected corner, only rays
through the camera's own inverse, the bodies that they meet, and a sheet of light with a thickness.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt

from jaxscan.axis_details import is_detail
from jaxscan.errors import InputError
from jaxscan.images.decode import NUMBERS_PER_LEVEL
from jaxscan.precision import as_numpy
from jaxscan.rig import Camera, LightPlane, Positions, Rig
from jaxscan.rig import Light as SheetOfLight
from jaxscan.rig.chart import FLAT
from jaxscan.rig.light import light_axes, nameless
from jaxscan.rig.projection import pixel_rays
from jaxscan.simulation import kernels
from jaxscan.simulation.kernels import CHUNK, FINE, Light, Sheet, Sight
from jaxscan.simulation.laser_profiles import bells
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.mosaic import through_mosaic
from jaxscan.simulation.scene import Scene
from jaxscan.simulation.speckle import speckle

# A camera's rays take 22 MB at 640 × 480.
_CAMERAS_KEPT = 4
# Rows of pixels whose light is gathered at once.
_BAND = 48
# Beyond this number of standard deviations a sheet is dark: e^(−18) of 2000 grey levels.
_SHEET_WIDTHS = 6.0


def render(
    rig: Rig,
    scene: Scene | Sequence[Scene],
    *,
    q: Positions | None = None,
    laser: int | None = None,
    lighting: Lighting | None = None,
    sensor: Sensor | None = None,
    seed: int | Sequence[int] = 0,
) -> UInt[np.ndarray, "rows columns 3"]:
    """A photograph of a scene.

    Args:
        rig: the true one.
        scene: as it stands with all axes at 0; several of one thing that moves, at even times of the exposure: the
            photograph has the mean of their light.
        q: positions of the axes, motor steps; the bodies on the stage are where the rig's motion has carried them.
        laser: which of the rig's lasers is on (an index), or None for none.
        lighting: what lights the scene.
        sensor: how the light becomes numbers.
        seed: of noise and speckle; the same seed gives the same photograph, bit for bit, on the same machine.

    Returns:
        Red, green and blue, uint8 or uint16 as the sensor has it.

    Raises:
        InputError: the rig has no such laser, or no axis of that name.
    """
    lighting, sensor = lighting or Lighting(), sensor or Sensor()
    random = np.random.default_rng(seed)
    moments = [carried(rig, each, q or {}) for each in ([scene] if isinstance(scene, Scene) else scene)]
    light, lit = _light(lighting), rig.with_lights_at(q or {})
    sheet = None if laser is None else sheet_of(lit, laser, lighting)
    grainy = sheet is not None and lighting.speckle > 0
    ray = fine_rays(rig.camera)
    apart = grainy or (sheet is not None and lighting.ghost > 0)
    weights = kernels.spread(sensor.blur_px)
    level, laser_level = None, None
    for each in moments:
        fine, laser_fine = _survey_and_refine(each.cast(np.float32), light, sheet, ray, apart=apart)
        level, laser_level = _with_light(level, fine, weights), _with_light(laser_level, laser_fine, weights)
    level, laser_level = (None if part is None else part / np.float32(len(moments)) for part in (level, laser_level))
    rows, columns = rig.camera.image_size[::-1]
    noise = sensor.noise * random.standard_normal((rows, columns, 3), np.float32)
    grain = None
    if sheet is not None and grainy:
        along, across = lighting.speckle_length_px
        down_columns = abs(sheet.omega[0]) > abs(sheet.omega[1])
        length = (along, across) if down_columns else (across, along)
        grain = speckle(random, (rows, columns), lighting.speckle, length)
    numbers = 1 if sensor.bits == 8 else NUMBERS_PER_LEVEL
    levels = tuple(np.float32(number) for number in (sensor.gain, sensor.saturation, numbers, lighting.ghost))
    image = np.asarray(kernels.develop(level, laser_level, grain, noise, levels))
    image = image.astype(np.uint8 if sensor.bits == 8 else np.uint16)
    return through_mosaic(image) if sensor.mosaic else image


def carried(rig: Rig, scene: Scene, q: Positions) -> Scene:
    """The scene after the axes have moved their load.

    Raises:
        InputError: the rig has no axis of that name, although it does not stand at 0.
    """
    q = {axis: steps for axis, steps in q.items() if axis not in light_axes(rig.lights)}
    if not any(q.values()):
        return scene
    for axis in q:
        if not is_detail(axis):
            rig.axis(axis)
    return scene.carried(as_numpy(rig.pose({axis: np.float64(steps) for axis, steps in q.items()})))


def sheet_of(rig: Rig, laser: int, lighting: Lighting, dtype: type = np.float32) -> Sheet:
    """One of the rig's lasers, switched on.

    Raises:
        InputError: there is no such laser.
    """
    if not 0 <= laser < len(rig.lights):
        raise InputError(f"laser = {laser}: the rig has {len(rig.lights)} lasers, counted from 0")
    light = rig.lights[laser]
    omega = plane_of(light)
    power = lighting.laser_power * np.asarray(lighting.laser_colour)
    profile = bells(lighting.laser_profile) * [1.0, lighting.sheet_sigma_mm, lighting.sheet_sigma_mm]
    reach = (np.abs(profile[:, 1]) + _SHEET_WIDTHS * profile[:, 2]).max()
    values = (omega, lighting.source(omega), power, profile, reach)
    surface = None
    if not isinstance(light, LightPlane):
        surface = jax.tree.map(lambda leaf: np.asarray(leaf, dtype), nameless(light))
    fan = None if lighting.laser_fan_mm is None else np.asarray(lighting.laser_fan_mm, dtype)
    return Sheet(*(np.asarray(value, dtype) for value in values), surface=surface, fan=fan)


def fine_rays(camera: Camera) -> Sight:
    """The rays through the centre of every fine cell, float32; kept for the cameras used last."""
    leaves, structure = jax.tree.flatten(camera)
    return _fine_rays(tuple(float(leaf) for leaf in leaves), structure)


@lru_cache(maxsize=_CAMERAS_KEPT)
def _fine_rays(leaves: tuple[float, ...], structure: Any) -> Sight:
    columns, rows = jax.tree.unflatten(structure, leaves).image_size
    u, v = ((np.arange(FINE * n) + 0.5) / FINE - 0.5 for n in (columns, rows))
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    camera = jax.tree.unflatten(structure, leaves)
    return sight_of(camera, pixel_rays(camera, pixels).astype(np.float32).reshape(len(v), len(u), 3))


def sight_of(camera: Camera, rays: Float[np.ndarray, "*rays 3"]) -> Sight:
    """A camera's rays for the kernels."""
    given = rays[..., :2] if camera.chart is FLAT else rays
    return Sight(*(jnp.asarray(part) for part in np.moveaxis(given, -1, 0)))


def _light(lighting: Lighting) -> Light:
    direction = np.asarray(lighting.direction, np.float64)
    values = (
        lighting.ambient,
        lighting.directional,
        direction / np.linalg.norm(direction),
        lighting.ambient_colour,
        lighting.highlight,
        np.radians(lighting.highlight_deg),
    )
    return Light(*(np.asarray(value, np.float32) for value in values))


def _survey_and_refine(
    scene: Scene, light: Light, sheet: Sheet | None, ray: Sight, *, apart: bool
) -> tuple[Float[Array, "rgb rows columns"], Float[Array, "rgb rows columns"] | None]:
    """Brightness of every fine cell; with `apart` without the laser's, which comes beside it."""
    depth, key = trace(scene, ray)
    fine = _ambient(scene, light, ray, depth, key)
    laser = jnp.zeros_like(fine) if apart else None
    cells = np.flatnonzero(np.asarray(kernels.coarse(scene, sheet, ray, depth, key))).astype(np.int32)
    # The last list is filled up with a cell that is not there.
    cells = np.pad(cells, (0, -len(cells) % CHUNK), constant_values=ray.x.size)
    for some in cells.reshape(-1, CHUNK):
        within = kernels.spray(ray, some)
        depth, key = trace(scene, within)
        parts = [_ambient(scene, light, within, depth, key)]
        if sheet is not None:
            lit = kernels.illuminate(scene, sheet, kernels.shine(scene, sheet, within, depth, key), key)
            if laser is None:
                parts.append(lit)
            else:
                laser = kernels.merge(laser, some, lit)
        fine = kernels.merge(fine, some, *parts)
    return fine, laser


def _with_light(
    before: Float[np.ndarray, "rows columns rgb"] | None, fine: Array | None, weights: Float[np.ndarray, "taps"]
) -> Float[np.ndarray, "rows columns rgb"] | None:
    """What fell on every pixel before, and what falls on it now; None where there is neither."""
    now = None if fine is None else _gather(fine, weights)
    return now if before is None or now is None else before + now


def _gather(fine: Array, weights: Float[np.ndarray, "taps"]) -> Float[np.ndarray, "rows columns rgb"]:
    """What falls on every pixel; beyond the border the photograph goes on as it ends.

    Band by band, for a band stays in the processor's cache: twice as fast as whole, and what is dark is left out.
    """
    cells, margin = np.asarray(fine), kernels.margin(weights)
    rows, columns = cells.shape[1] // FINE, cells.shape[2] // FINE
    height = min(_BAND, rows)
    light = np.zeros((rows, columns, 3), np.float32)
    for first in range(0, rows, height):
        top = min(first, rows - height)
        low, high = FINE * (top - margin), FINE * (top + height + margin)
        # A view where nothing is beyond the border: most bands of a laser's light are dark, and need no copy.
        whole = low >= 0 and high <= cells.shape[1]
        band = cells[:, low:high] if whole else cells[:, np.arange(low, high).clip(0, cells.shape[1] - 1)]
        if band.any():
            light[top : top + height] = kernels.gather(band, weights)
    return light


def _ambient(scene: Scene, light: Light, ray: Sight, depth: Array, key: Array) -> Float[Array, "rgb *rays"]:
    """Brightness of what rays meet without the laser."""
    level = kernels.shade(scene, light, ray, depth, key)
    shining = light.highlight > 0 and any(body.glossy for body in scene.bodies)
    highlight = kernels.glance(scene, light, ray, depth, key) if shining else None
    return kernels.paint(scene, light, level, highlight, key)


def trace(scene: Scene, ray: Sight) -> tuple[Array, Array]:
    """Range and key of what rays meet.

    Two kernels of one output each are four times as fast as one of two; a call back to the host is made once.
    """
    if scene.on_host:
        return kernels.depth_and_key_of(scene, ray)
    return kernels.depth_of(scene, ray), kernels.key_of(scene, ray)


def plane_of(light: SheetOfLight) -> Float[np.ndarray, "3"]:
    """ω of a flat sheet, 1/mm; of another that of the plane which touches it where it is nearest to the camera."""
    origin = np.zeros(3)
    return np.asarray(light.gradient(origin), np.float64) / -np.float64(light.level(origin))
