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

from jaxscan.errors import InputError
from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.rig import Camera, Rig
from jaxscan.simulation import kernels
from jaxscan.simulation.kernels import CHUNK, FINE, Light, Sheet
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.scene import Scene

# A camera's rays take 22 MB at 640 × 480.
_CAMERAS_KEPT = 4
# Numbers of a 16-bit photograph for one grey level: 65535 / 255.
_FINE_NUMBERS = 257
_RAYS_AT_ONCE = 1 << 13


def render(
    rig: Rig,
    scene: Scene,
    *,
    steps: float = 0,
    laser: int | None = None,
    lighting: Lighting | None = None,
    sensor: Sensor | None = None,
    seed: int | Sequence[int] = 0,
) -> UInt[np.ndarray, "rows columns 3"]:
    """A photograph of a scene.

    Args:
        rig: the true one.
        scene: as it stands at motor step 0.
        steps: motor step count; the bodies on the stage have moved by steps · per_step.
        laser: which of the rig's lasers is on (an index), or None for none.
        lighting: what lights the scene.
        sensor: how the light becomes numbers.
        seed: of noise and speckle; the same seed gives the same photograph, bit for bit, on the same machine.

    Returns:
        Red, green and blue, uint8 or uint16 as the sensor has it.

    Raises:
        InputError: the rig has no such laser, or no stage although steps is not 0.
    """
    lighting, sensor = lighting or Lighting(), sensor or Sensor()
    random = np.random.default_rng(seed)
    scene = at_steps(rig, scene, steps).cast(np.float32)
    light, sheet = _light(lighting), None if laser is None else sheet_of(rig, laser, lighting)
    x, y = fine_rays(rig.camera)
    fine = _survey_and_refine(scene, light, sheet, x, y, _speckle(random, x.shape, lighting) if sheet else None)
    noise = sensor.noise * random.standard_normal((x.shape[0] // FINE, x.shape[1] // FINE, 3), np.float32)
    numbers = 1 if sensor.bits == 8 else _FINE_NUMBERS
    levels = tuple(np.float32(number) for number in (sensor.gain, sensor.saturation, numbers))
    image = kernels.develop(fine, kernels.spread(sensor.blur_px), noise, levels)
    return np.asarray(image).astype(np.uint8 if sensor.bits == 8 else np.uint16)


def at_steps(rig: Rig, scene: Scene, steps: float) -> Scene:
    """The scene after the stage has moved its load.

    Raises:
        InputError: the rig has no stage although steps is not 0.
    """
    if steps == 0:
        return scene
    if rig.stage is None:
        raise InputError(f"steps = {steps}: the rig has no stage: give it one, or render at step 0")
    return scene.displaced(steps * np.asarray([np.float64(c) for c in rig.stage.per_step]))


def sheet_of(rig: Rig, laser: int, lighting: Lighting, dtype: type = np.float32) -> Sheet:
    """One of the rig's lasers, switched on.

    Raises:
        InputError: there is no such laser.
    """
    if not 0 <= laser < len(rig.lasers):
        raise InputError(f"laser = {laser}: the rig has {len(rig.lasers)} lasers, counted from 0")
    plane = rig.lasers[laser]
    omega = np.asarray([np.float64(c) for c in plane.plane])
    power = lighting.laser_power * np.asarray(lighting.laser_colour)
    values = (omega, lighting.source(omega), power, lighting.sheet_sigma_mm)
    return Sheet(*(np.asarray(value, dtype) for value in values))


def fine_rays(camera: Camera) -> tuple[Float[Array, "rows columns"], Float[Array, "rows columns"]]:
    """The rays (x, y, 1) through the centre of every fine cell, float32; kept for the cameras used last."""
    leaves, structure = jax.tree.flatten(camera)
    return _fine_rays(tuple(float(leaf) for leaf in leaves), structure)


@lru_cache(maxsize=_CAMERAS_KEPT)
def _fine_rays(leaves: tuple[float, ...], structure: Any) -> Any:
    columns, rows = jax.tree.unflatten(structure, leaves).image_size
    u, v = ((np.arange(FINE * n) + 0.5) / FINE - 0.5 for n in (columns, rows))
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rays = rays_of(jax.tree.unflatten(structure, leaves), pixels).astype(np.float32)
    return tuple(jnp.asarray(rays[:, i].reshape(len(v), len(u))) for i in (0, 1))


def rays_of(camera: Camera, pixels: Float[np.ndarray, "pixels 2"]) -> Float[np.ndarray, "pixels 3"]:
    """The camera's rays of many pixels, in float64."""
    with float64():
        camera = as_float64(as_numpy(camera))
        filled = np.pad(pixels, ((0, -len(pixels) % _RAYS_AT_ONCE), (0, 0)), mode="edge")
        parts = [_rays(camera, jnp.asarray(part)) for part in filled.reshape(-1, _RAYS_AT_ONCE, 2)]
        return np.concatenate(parts)[: len(pixels)]


@jax.jit
def _rays(camera: Camera, pixels: Float[Array, "pixels 2"]) -> Float[Array, "pixels 3"]:
    return jax.vmap(camera.ray)(pixels)


def _light(lighting: Lighting) -> Light:
    direction = np.asarray(lighting.direction, np.float64)
    values = (lighting.ambient, lighting.directional, direction / np.linalg.norm(direction))
    return Light(*(np.asarray(value, np.float32) for value in values))


def _survey_and_refine(
    scene: Scene, light: Light, sheet: Sheet | None, x: Array, y: Array, speckle: Float[np.ndarray, "cells"] | None
) -> Float[Array, "rgb rows columns"]:
    """Brightness of every fine cell."""
    depth, key = trace(scene, x, y)
    fine = kernels.paint(scene, kernels.shade(scene, light, x, y, depth, key), key)
    cells = np.flatnonzero(np.asarray(kernels.coarse(scene, sheet, x, y, depth, key))).astype(np.int32)
    # The last list is filled up with a cell that is not there.
    cells = np.pad(cells, (0, -len(cells) % CHUNK), constant_values=x.size)
    for some in cells.reshape(-1, CHUNK):
        rays = kernels.spray(x, y, some)
        depth, key = trace(scene, *rays)
        laser = None
        if sheet is not None:
            laser = kernels.shine(scene, sheet, *rays, depth, key)
            if speckle is not None:
                laser = laser * speckle.take(some, mode="clip")[:, None]
        fine = kernels.merge(fine, some, scene, sheet, key, kernels.shade(scene, light, *rays, depth, key), laser)
    return fine


def trace(scene: Scene, x: Array, y: Array) -> tuple[Array, Array]:
    """Depth and key of what rays meet.

    Two kernels of one output each are four times as fast as one of two; a call back to the host is made once.
    """
    if scene.on_host:
        return kernels.depth_and_key_of(scene, x, y)
    return kernels.depth_of(scene, x, y), kernels.key_of(scene, x, y)


def _speckle(
    random: np.random.Generator, shape: tuple[int, ...], lighting: Lighting
) -> Float[np.ndarray, "cells"] | None:
    """Factors on the laser's light in every fine cell, of mean 1.

    A steady part and a fully developed pattern, the squared modulus of a complex Gaussian field (J. W. Goodman,
    *Speckle Phenomena in Optics*, 2007). A field smoothed by a Gaussian of standard deviation s has an intensity whose
    covariance is e^(−r² / 2 s²).
    """
    if lighting.speckle == 0:
        return None
    field = random.standard_normal(shape, np.float32) + 1j * random.standard_normal(shape, np.float32)
    squared = (2 * np.pi * FINE * lighting.speckle_length_px) ** 2 / 2
    smooth = np.exp(-squared * np.fft.fftfreq(shape[0])[:, None] ** 2) * np.exp(
        -squared * np.fft.fftfreq(shape[1]) ** 2
    )
    intensity = np.abs(np.fft.ifft2(np.fft.fft2(field) * smooth)) ** 2 / (2 * np.mean(smooth**2))
    return (1 - lighting.speckle + lighting.speckle * intensity).astype(np.float32).reshape(-1)
