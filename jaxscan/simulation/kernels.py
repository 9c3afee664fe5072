"""The compiled parts of the renderer. Scenes, poses and light are arguments: one compilation serves all photographs.

A pixel is split into 3 × 3 fine cells. First one ray is cast through the middle of every cell: `depth_of`, `key_of`,
`shade`, `glance`, `paint`. `coarse` finds the cells beside an edge or near the sheet of laser light. They are cast
again with 25 rays each, 225 to a pixel: `spray`, the same kernels, `shine` and `illuminate` for the laser, `merge`. The
25 form a lattice of rank one, in which all have different columns and rows, so that an edge along either axis is placed
to 1/75 px rather than 1/15; it is shifted from cell to cell, which spreads what is left evenly. `gather` blurs and
averages each pixel, `develop` adds the noise. The laser's light is kept apart up to there where it has speckle or a
ghost, which it has in the pixels.

Each kernel has one output, as a rule: on a CPU XLA has no fusion of several outputs, and a chain of kernels is four to
twenty times as fast as one that computes all.

The brightness of a point is

    albedo · (lamp · (ambient + directional · max(0, n · l)) + power · colour · p(d) · max(0, n · s) · lit)
    + lamp · highlight · exp(−(1 − n · h) / γ²)

with d = (ω · X − 1) / |ω| the distance from the sheet, p(d) = Σ w exp(−(d − a)² / 2 σ²) its profile, s the direction to
the laser, lit = 0 where a body stands between the two, l the direction to the lamp, h halfway between those to the lamp
and to the camera, and γ the scatter of a glossy surface's slopes. The second line is of glossy bodies alone
(J. F. Blinn 1977).
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxscan.kept_programs import compiled
from jaxscan.rig import Light as SheetOfLight
from jaxscan.simulation.scene import Scene
from jaxscan.simulation.vector import Rays, Vec, dot, scale, subtract, vec

# Fine cells along a pixel's side.
FINE = 3
# Cells that are refined at once.
CHUNK = 8192
# A shadow ray looks for bodies no nearer to its two ends than this, mm.
_SHADOW_MARGIN_MM = 0.02
# Depths of neighbouring cells that differ by more than this part have an edge between them, or a steep surface.
_DEPTH_JUMP = 0.003

_LATTICE = (np.stack([np.arange(25), 7 * np.arange(25) % 25], axis=-1) + 0.5) / 25


class Light(NamedTuple):
    """Lighting as the kernels take it: numbers in one precision.

    Attributes:
        ambient: grey levels.
        directional: grey levels.
        direction: unit vector towards the directional light.
        colour: red, green, blue of both, in parts.
        highlight: grey levels.
        scatter: of a glossy surface's slopes, standard deviation, radians.
    """

    ambient: Any
    directional: Any
    direction: Any
    colour: Any
    highlight: Any
    scatter: Any


class Sight(NamedTuple):
    """Rays of the camera.

    Attributes:
        x: of their directions.
        y: too.
        z: too; None where it is 1.
    """

    x: Any
    y: Any
    z: Any = None


class Sheet(NamedTuple):
    """One laser that is on.

    Attributes:
        omega: dual plane, 1/mm; of a sheet that is not flat the one that touches it.
        source: mm.
        power: red, green, blue in grey levels.
        bells: of its profile: height, place in mm, standard deviation in mm.
        reach: its light is zero beyond this distance, mm.
        surface: of a sheet that is not flat.
        fan: distance from the source at which it has its power, mm; None where it has it everywhere.
    """

    omega: Any
    source: Any
    power: Any
    bells: Any
    reach: Any
    surface: SheetOfLight | None = None
    fan: Any = None


@compiled()
def depth_of(scene: Scene, ray: Sight) -> Float[Array, "*rays"]:
    """Range at which the camera's rays meet the scene, in their length: of (x, y, 1) the depth; infinite for none."""
    return scene.trace(camera_rays(ray))[0]


@compiled()
def key_of(scene: Scene, ray: Sight) -> Int[Array, "*rays"]:
    """Body and patch that they meet."""
    return scene.trace(camera_rays(ray))[1]


@compiled()
def depth_and_key_of(scene: Scene, ray: Sight) -> tuple[Float[Array, "*rays"], Int[Array, "*rays"]]:
    """Both."""
    return scene.trace(camera_rays(ray))


@compiled()
def shade(scene: Scene, light: Light, ray: Sight, depth: Any, key: Any) -> Float[Array, "*rays"]:
    """Brightness of a white body without the laser (grey levels)."""
    normal = scene.normal(_point(ray, depth, key), key)
    return light.ambient + light.directional * jnp.maximum(dot(normal, vec(light.direction)), 0)


@compiled()
def glance(scene: Scene, light: Light, ray: Sight, depth: Any, key: Any) -> Float[Array, "*rays"]:
    """Brightness of the lamp's reflection in glossy bodies (grey levels)."""
    point, to_lamp = _point(ray, depth, key), vec(light.direction)
    half = subtract(to_lamp, scale(point, 1 / jnp.sqrt(dot(point, point))))
    normal = scene.normal(point, key)
    off = 1 - dot(normal, half) / jnp.sqrt(dot(half, half))
    seen = scene.glossy(key) & (dot(normal, to_lamp) > 0)
    return jnp.where(seen, light.highlight * jnp.exp(-off / light.scatter**2), 0.0)


@compiled()
def paint(
    scene: Scene,
    light: Light,
    level: Float[Array, "*rays"],
    highlight: Float[Array, "*rays"] | None,
    key: Int[Array, "*rays"],
) -> Float[Array, "rgb *rays"]:
    """Brightness of what was met, without the laser, and the backdrop where nothing was (grey levels)."""
    backdrop, colour = (jnp.asarray(of).reshape((3,) + (1,) * key.ndim) for of in (scene.backdrop, light.colour))
    reflected = level[None] * scene.albedo(key) + (0.0 if highlight is None else highlight[None])
    return jnp.where(key[None] >= 0, colour * reflected, backdrop)


@compiled()
def shine(scene: Scene, sheet: Sheet, ray: Sight, depth: Any, key: Any) -> Any:
    """Brightness of a white body by the laser alone, as a part of the laser's power."""
    point = _point(ray, depth, key)
    to_source = subtract(vec(sheet.source), point)
    distance = jnp.sqrt(dot(to_source, to_source))
    facing = jnp.maximum(dot(scene.normal(point, key), to_source), 0) / distance
    lit = (key >= 0) & ~scene.blocks(Rays(point, to_source), _SHADOW_MARGIN_MM / distance)
    d = sheet_distance(sheet, ray, depth)
    profile = jnp.zeros_like(d)
    # A few bells, written out: one loop over the rays.
    for height, place, sigma in jnp.asarray(sheet.bells):
        profile = profile + height * jnp.exp(-0.5 * ((d - place) / sigma) ** 2)
    spread_out = 1.0 if sheet.fan is None else sheet.fan / distance
    return jnp.where(lit, facing * spread_out * profile, 0.0)


@compiled()
def coarse(
    scene: Scene,
    sheet: Sheet | None,
    ray: Sight,
    depth: Any,
    key: Any,
) -> Bool[Array, "rows columns"]:
    """Which cells one ray does not do for: those beside an edge, and those near the sheet."""
    smooth, z = scene.smooth(key), jnp.where(key >= 0, depth, 1e6)
    d = None if sheet is None else sheet_distance(sheet, ray, depth)

    def differ(a: Any, b: Any) -> Any:
        edge = (smooth[a] != smooth[b]) | (jnp.abs(z[a] - z[b]) > _DEPTH_JUMP * z[a])
        # A sheet that is thin for the cells passes between their middles.
        return edge if d is None else edge | ((d[a] < 0) != (d[b] < 0))

    down = jnp.pad(differ(np.s_[:-1], np.s_[1:]), ((1, 1), (0, 0)))
    right = jnp.pad(differ(np.s_[:, :-1], np.s_[:, 1:]), ((0, 0), (1, 1)))
    mask = down[:-1] | down[1:] | right[:, :-1] | right[:, 1:]
    return mask if sheet is None or d is None else mask | (jnp.abs(d) < sheet.reach)


@compiled()
def spray(ray: Sight, cells: Int[Array, "cells"]) -> Sight:
    """25 rays through each of a list of cells (indices into the flattened grid).

    Within a cell rays are linear in the pixel: the lens bends them by less than 1e-5 px over a sixth of a pixel.
    """
    rows, columns = ray.x.shape
    row, column = jnp.minimum(cells // columns, rows - 1), cells % columns
    r, c = jnp.clip(row, 1, rows - 2), jnp.clip(column, 1, columns - 2)
    # Shifts from a low-discrepancy sequence in two dimensions (M. Roberts 2018): even over neighbouring cells.
    shift_u = jnp.mod(row * 0.7548776662 + column * 0.5698402910, 1.0)[:, None]
    shift_v = jnp.mod(row * 0.5698402910 + column * 0.7548776662, 1.0)[:, None]
    lattice = jnp.asarray(_LATTICE, ray.x.dtype)
    du = jnp.mod(lattice[None, :, 0] + shift_u, 1.0) - 0.5
    dv = jnp.mod(lattice[None, :, 1] + shift_v, 1.0) - 0.5

    def linear(a: Any) -> Any:
        along_u, along_v = (a[r, c + 1] - a[r, c - 1]) / 2, (a[r + 1, c] - a[r - 1, c]) / 2
        return a[row, column][:, None] + along_u[:, None] * du + along_v[:, None] * dv

    return Sight(*(None if part is None else linear(part) for part in ray))


@compiled()
def illuminate(
    scene: Scene, sheet: Sheet, laser: Float[Array, "*rays"], key: Int[Array, "*rays"]
) -> Float[Array, "rgb *rays"]:
    """Brightness of what was met by the laser alone, which is given for a white body (grey levels)."""
    return scene.albedo(key) * laser[None] * jnp.asarray(sheet.power).reshape((3,) + (1,) * key.ndim)


@partial(jax.jit, donate_argnums=0)
def merge(
    fine: Float[Array, "rgb rows columns"], cells: Int[Array, "cells"], *parts: Float[Array, "rgb cells rays"]
) -> Float[Array, "rgb rows columns"]:
    """Put the mean brightness of the rays of some cells in the cells' places; `fine` is used up.

    Args:
        fine: brightness of every cell.
        cells: their indices; those past the end of the grid are left out.
        parts: of their rays' brightness.
    """
    colour = sum(part.mean(-1) for part in parts)
    return fine.reshape(3, -1).at[:, cells].set(colour, mode="drop").reshape(fine.shape)


def sheet_distance(sheet: Sheet, ray: Sight, depth: Any) -> Any:
    """Distance of a point of a ray from the sheet (mm, signed)."""
    omega = vec(sheet.omega)
    if sheet.surface is None:
        inverse_depth = omega.x * ray.x + omega.y * ray.y + (omega.z if ray.z is None else omega.z * ray.z)
    else:
        inverse_depth = sheet.surface.inverse_depth(jnp.stack(camera_rays(ray).direction, axis=-1))
    return (depth * inverse_depth - 1) / jnp.sqrt(dot(omega, omega))


def camera_rays(ray: Sight) -> Rays:
    """The camera's rays; along (x, y, 1) t is the depth."""
    zero = jnp.zeros((), ray.x.dtype)
    return Rays(Vec(zero, zero, zero), Vec(ray.x, ray.y, jnp.ones_like(ray.x) if ray.z is None else ray.z))


def _point(ray: Sight, depth: Any, key: Any) -> Vec:
    """What the rays meet; some point of the ray where they meet nothing."""
    return camera_rays(ray).at(jnp.where(key >= 0, depth, 1.0))


@compiled()
def gather(
    fine: Float[Array, "rgb rows columns"], weights: Float[Array, "taps"]
) -> Float[Array, "pixel_rows pixel_columns rgb"]:
    """Blur, and average over each pixel of a band of the photograph.

    Args:
        fine: brightness of the fine cells of the band, and of `margin` pixels above and below it.
        weights: point spread and pixel together, on the grid of the cells (`spread`).
    """
    across = [(0, 0), (0, 0), (FINE * margin(weights),) * 2]
    return jnp.moveaxis(_reduce(_reduce(jnp.pad(fine, across, mode="edge"), weights, 1), weights, 2), 0, -1)


def margin(weights: Any) -> int:
    """How many pixels away light still reaches a pixel."""
    return -(-(weights.shape[0] // 2 - 1) // FINE)


@compiled()
def develop(
    light: Float[Array, "pixel_rows pixel_columns rgb"],
    laser: Float[Array, "pixel_rows pixel_columns rgb"] | None,
    grain: Float[Array, "pixel_rows pixel_columns"] | None,
    noise: Float[Array, "pixel_rows pixel_columns rgb"],
    sensor: Any,
) -> Any:
    """Give the laser its speckle and its ghost, amplify, add noise, cut off and round.

    Args:
        light: what falls on every pixel.
        laser: what of the laser's light is to be added to it, if any.
        grain: factors of that (`speckle`), if any.
        noise: grey levels.
        sensor: gain, saturation, numbers for each grey level, and the part of the laser's light that is in the ghost.
    """
    gain, saturation, numbers, ghost = sensor
    if laser is not None:
        laser = laser if grain is None else laser * grain[..., None]
        light = light + laser + ghost * laser[::-1, ::-1]
    level = jnp.clip(light * gain + noise, 0, saturation)
    return jnp.round(level * numbers).astype(jnp.uint16)


def _reduce(padded: Float[Array, "..."], weights: Float[Array, "taps"], axis: int) -> Float[Array, "..."]:
    """Weighted sums about the centre of every pixel along one axis, which has a margin at both ends."""
    reach, before = weights.shape[0] // 2, margin(weights)
    pixels = padded.shape[axis] // FINE - 2 * before
    shape = (*padded.shape[:axis], pixels + 2 * before, FINE, *padded.shape[axis + 1 :])
    split = padded.reshape(shape)
    total = jnp.zeros((), padded.dtype)
    for tap in range(weights.shape[0]):
        # The centre of pixel k is cell 3 (k + before) + 1 of the padded axis.
        cell = FINE * before + 1 + tap - reach
        part = jax.lax.slice_in_dim(split, cell // FINE, cell // FINE + pixels, axis=axis)
        total = total + weights[tap] * jax.lax.index_in_dim(part, cell % FINE, axis + 1, keepdims=False)
    return total


def spread(blur_px: float) -> Float[np.ndarray, "taps"]:
    """Weights of the cells about a pixel's centre: a Gaussian over the cells, then the mean of the pixel's three."""
    sigma = FINE * blur_px
    reach = int(np.ceil(4.5 * sigma))
    at = np.arange(-reach, reach + 1)
    gauss = np.exp(-0.5 * (at / sigma) ** 2) if sigma > 0 else np.ones(1)
    weights = np.convolve(gauss / gauss.sum(), np.full(FINE, 1 / FINE))
    return weights.astype(np.float32)
