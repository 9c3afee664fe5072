"""What an ideal camera sees of the sheet: in every image column the exact place of the sheet's middle, and its point.

Along a column the surface that the camera sees crosses the sheet where g(v) = ω · X(v) − 1 changes sign. Sign changes
are looked for between the rows of the fine grid and then halved in float64 until nothing is left; a change of sign at
an outline, where g jumps, is thrown away. What is left counts where the laser reaches it. If a column has several, the
brightest is taken.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.kept_programs import compiled
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, Positions, Rig
from jaxscan.rig.projection import pixel_rays
from jaxscan.simulation import kernels
from jaxscan.simulation.kernels import FINE, Sheet, Sight, camera_rays
from jaxscan.simulation.light import Lighting
from jaxscan.simulation.render import carried, sheet_of, sight_of, trace
from jaxscan.simulation.scene import Scene

# Candidates are refined in multiples of this many, so that frames share a compilation.
_BUCKET = 2048
_HALVINGS = 45
# A sign change at which g is still larger than this is an outline, mm.
_ON_SHEET_MM = 1e-6
# Brackets are widened by this part of a cell: the rows that found them are in float32.
_WIDER = 0.05
_CAMERAS_KEPT = 4

Ends = tuple[Float[Array, "brackets"], Float[Array, "brackets"]]


class Profile(NamedTuple):
    """The middle of the sheet as an ideal camera sees it; NaN where it sees none.

    Attributes:
        position: row v of each image column (or column u of each row), px.
        points: object frame, mm.
    """

    position: Float[np.ndarray, "lines"]
    points: Float[np.ndarray, "lines 3"]


def true_profile(
    rig: Rig,
    scene: Scene,
    q: Positions | None = None,
    *,
    laser: int = 0,
    columns: bool = True,
    lighting: Lighting | None = None,
) -> Profile:
    """The true profile of one photograph.

    Args:
        rig: the true one.
        scene: as it stands with all axes at 0.
        q: positions of the axes, motor steps.
        laser: which of the rig's lasers is on (an index).
        columns: one point for each image column; else one for each row.
        lighting: where the laser stands.

    Raises:
        InputError: the rig has no such laser, or no axis of that name.
    """
    lighting = lighting or Lighting()
    q = {axis: np.float64(steps) for axis, steps in (q or {}).items()}
    here, lit = carried(rig, scene, q), rig.with_lights_at(q)
    back = as_numpy(rig.pose(q)).inverse()
    ray = _line_rays(rig.camera, columns)
    n_lines = ray.x.shape[1]
    coarse = here.cast(np.float32)
    depth = kernels.depth_of(coarse, ray)
    g = np.asarray(kernels.sheet_distance(sheet_of(lit, laser, lighting), ray, depth))
    fine_row, line = np.nonzero((g[:-1] < 0) != (g[1:] < 0))
    profile = Profile(np.full(n_lines, np.nan), np.full((n_lines, 3), np.nan))
    if not len(line):
        return profile
    low, high = fine_row - _WIDER, fine_row + 1 + _WIDER
    along = np.stack([low, (low + high) / 2, high])
    position = (along + 0.5) / FINE - 0.5
    lines = np.broadcast_to(line, position.shape)
    pixels = np.stack([lines, position] if columns else [position, lines], axis=-1)
    rays = pixel_rays(rig.camera, pixels)
    size = -(-len(line) // _BUCKET) * _BUCKET
    rays = np.pad(rays, ((0, 0), (0, size - len(line)), (0, 0)), mode="edge")
    before = np.pad(g[fine_row, line] < 0, (0, size - len(line)))
    with float64():
        seen = sight_of(rig.camera, rays)
        found = _halve(here.cast(np.float64), sheet_of(lit, laser, lighting, np.float64), seen, before)
    s, point, brightness = (array[: len(line)] for array in found)
    rows = position[0] + s * (position[2] - position[0])
    order = np.argsort(brightness)
    order = order[(brightness > 0)[order] & (rows >= -0.5)[order] & (rows < ray.x.shape[0] / FINE - 0.5)[order]]
    # The last of those that are written to one place stays: the brightest.
    profile.position[line[order]] = rows[order]
    profile.points[line[order]] = back.apply(point[order])
    return profile


def _halve(
    scene: Scene, sheet: Sheet, rays: Sight, before: Bool[np.ndarray, "brackets"]
) -> tuple[Float[np.ndarray, "brackets"], Float[np.ndarray, "brackets 3"], Float[np.ndarray, "brackets"]]:
    """Where in each bracket the surface crosses the sheet.

    Args:
        scene: displaced.
        sheet: the laser.
        rays: of the bracket's start, middle and end; between them rays go along a parabola.
        before: whether g < 0 at the start.

    Returns:
        The place in the bracket (0 to 1), the point in the camera frame, and how brightly the laser lights it; 0 for
        an outline.
    """
    if scene.on_host:
        low, high = np.zeros(len(before)), np.ones(len(before))
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            ray = _ray_at(rays, middle)
            depth = np.asarray(kernels.depth_of(scene, ray))
            low, high = map(np.asarray, _closer(sheet, ray, depth, before, (low, high)))
        s = (low + high) / 2
    else:
        s = _halved(scene, sheet, rays, before)
    ray = Sight(*(None if part is None else np.asarray(part) for part in _ray_at(rays, s)))
    depth, key = (np.asarray(array) for array in trace(scene, ray))
    brightness = np.asarray(kernels.shine(scene, sheet, ray, depth, key))
    # Nothing is met infinitely far away, also where the sheet runs along a ray.
    with np.errstate(invalid="ignore"):
        on_sheet = np.abs(kernels.sheet_distance(sheet, ray, depth)) < _ON_SHEET_MM
    points = np.stack([np.asarray(part) for part in camera_rays(ray).at(jnp.asarray(depth))], axis=-1)
    return np.asarray(s), points, np.where(on_sheet, brightness, 0)


@compiled()
def _halved(scene: Scene, sheet: Sheet, rays: Sight, before: Bool[Array, "brackets"]) -> Float[Array, "brackets"]:
    """The place in each bracket, by as many halvings as leave nothing of it: one program for all of them."""

    def once(_: int, ends: Ends) -> Ends:
        ray = _ray_at(rays, (ends[0] + ends[1]) / 2)
        return _closer(sheet, ray, kernels.depth_of(scene, ray), before, ends)

    nothing = jnp.zeros(before.shape, rays.x.dtype)
    low, high = jax.lax.fori_loop(0, _HALVINGS, once, (nothing, nothing + 1))
    return (low + high) / 2


@compiled()
def _ray_at(rays: Sight, s: Float[Array, "brackets"]) -> Sight:
    """The rays at a place between each bracket's start (0) and end (1)."""
    weights = jnp.stack([2 * (s - 0.5) * (s - 1), -4 * s * (s - 1), 2 * s * (s - 0.5)])
    return Sight(*(None if part is None else (weights * part).sum(axis=0) for part in rays))


@compiled()
def _closer(sheet: Sheet, ray: Sight, depth: Any, before: Bool[Array, "brackets"], ends: Ends) -> Ends:
    """The half of each bracket in which g changes sign, by the ray in its middle and how far that goes."""
    low, high = ends
    middle = (low + high) / 2
    first = (kernels.sheet_distance(sheet, ray, depth) < 0) == before
    return jnp.where(first, middle, low), jnp.where(first, high, middle)


def _line_rays(camera: Camera, columns: bool) -> Sight:
    """Rays along the middle of each image column at the rows of the fine grid (or the other way round)."""
    leaves, structure = jax.tree.flatten(as_numpy(camera))
    return _kept_line_rays(tuple(float(leaf) for leaf in leaves), structure, columns)


@lru_cache(maxsize=_CAMERAS_KEPT)
def _kept_line_rays(leaves: tuple[float, ...], structure: Any, columns: bool) -> Sight:
    camera = jax.tree.unflatten(structure, leaves)
    u, v = (np.arange(n, dtype=float) for n in camera.image_size)
    fine_u, fine_v = ((np.arange(FINE * n) + 0.5) / FINE - 0.5 for n in camera.image_size)
    pixels = np.stack(np.meshgrid(u, fine_v) if columns else np.meshgrid(fine_u, v), axis=-1)
    if not columns:
        pixels = np.swapaxes(pixels, 0, 1)
    return sight_of(camera, pixel_rays(camera, pixels).astype(np.float32))
