"""Where the middle of a sheet of light lies in the stripe that it makes on a curved surface.

A sheet has a thickness, σ = s mm. At a distance d from its middle it lights the surface with exp(−d² / 2 s²), which is
seen at the row v(d) of an image column, with a radiance E(d) besides. Where v bends or E changes, the middle of the
light is not at v(0). To first order, the centre of gravity of the stripe is off by

    s² (v′ (ln E)′ + 3/2 v″),        derivatives by d.

A lens's blur, σ = b px, adds what it brings from the columns u beside, of light L = E |v′| in all:

    b² (v_u (ln L)_u + ½ v_uu)

In a column whose core is full, position is read off the ends of the core, ± e px from its middle. Of the third moment
3 v′² v″ s⁴ that a bent surface gives the stripe, of variance w², these have more than the centre of gravity:

    ½ v″ s² (v′² s² / w²) (e² / w² − 3)

A matt surface has E ∝ cos i, with i the angle between its normal and the direction to the laser. v′, v″ and i are read
off the frames before and behind: what they saw of the surface lies beside the sheet in this frame. Without this a ball
of 10 mm before a sheet of s = 0.25 mm lies 0.02 mm too deep, and one of 5 mm 0.04 mm.

Assumed: the laser stands where `laser_place` has it, and surfaces are matt and smooth over some millimetres. Where
neighbours are not of one smooth piece with what a frame sees, they are not asked; and a stripe is moved as far as what
its neighbours show is more than their noise.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain
from typing import Final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxscan.images.stripes.batch import FRAMES_AT_ONCE
from jaxscan.images.stripes.bell import FWHM
from jaxscan.images.stripes.stripe import Stripe
from jaxscan.kept_programs import compiled
from jaxscan.precision import as_numpy
from jaxscan.reconstruction.range_image import RangeImage
from jaxscan.reconstruction.triangulate import FramePoses, Kernel, of_frames, triangulate_stripes
from jaxscan.rig import Camera, Light, Motion, Positions, Rig
from jaxscan.rig.light import distance, laser_place, light_at, nameless
from jaxscan.rig.projection import pixel_rays

Lines = Float[Array, "frames lines"]
Points = Float[Array, "frames lines 3"]
# A range image, and the stripes that it was made of.
Looked = tuple[RangeImage, Stripe]

# The near neighbours are further from the sheet than half of this multiple of s, and the far ones twice as far: nearer
# frames show their own noise.
_APART: Final = 5.0
# No more frames than this lie between, however fine the steps are.
_MOST_FRAMES: Final = 64
# A neighbour's say grows with the square of its distance, up to this multiple of s.
_FARTHEST: Final = 10.0
# Neighbours are of one piece if their rows for each mm are alike up to this multiple.
_ALIKE: Final = 1.4
# Light more oblique than this tells nothing, cosine.
_LEAST_COSINE: Final = 0.15
# What columns up to this number away show is averaged, if the stripe goes on to them: px of it for each column.
_TOGETHER, _GOES_ON = 5, 2.0
# Fewer columns than this tell nothing.
_FEWEST: Final = 3
# Of a shift this multiple of its variance is taken to be noise.
_NOISE: Final = 2.0
# The middle is moved by this part of the stripe's σ at the most: beyond, the first order is not enough.
_MOST: Final = 0.25
# Columns so far away show how a stripe bends.
_ASKED: Final = 3
# A stripe that bends more has an edge there, px per column squared.
_MOST_BENT: Final = 0.07
_PIXEL_VARIANCE: Final = 1 / 12
_TINY: Final = 1e-12
# Rays in either direction of the image at which the object's motion is looked at.
_GRID: Final = 9


class ThickSheet(eqx.Module):
    """A sheet of light with its thickness, as the camera sees it.

    Attributes:
        camera: which sees it.
        light: the sheet's middle; or a stack for frames in each of which it stands elsewhere, numbers (frames, 1).
        laser: where it stands, camera frame, mm.
        sigma_mm: s.
        columns: whether lines are columns of the image.
    """

    camera: Camera
    light: Light
    laser: Float[Array, "3"]
    sigma_mm: Float[Array, ""]
    columns: bool = eqx.field(static=True)

    @staticmethod
    def create(rig: Rig, laser: str, sigma_mm: float, columns: bool) -> "ThickSheet":
        """One of a rig's lasers, in float32."""
        light = rig.light(laser)
        given = (rig.camera, nameless(light), laser_place(light), np.asarray(sigma_mm))
        return ThickSheet(*jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), given), columns=columns)

    def with_lights(self, lights: Light) -> "ThickSheet":
        """The same where the light stands elsewhere in each frame: a stack of lights."""
        return eqx.tree_at(lambda sheet: sheet.light, self, of_frames(lights, 1))


LightOf = Callable[[Positions], tuple[ThickSheet, Kernel]]


def frames_apart(rig: Rig, laser: str, sigma_mm: float, q: Mapping[str, Int[np.ndarray, "2"]]) -> int:
    """How many frames apart those are that show the surface beside the sheet; 0 where none do.

    Args:
        rig: the rig.
        laser: which of its lasers.
        sigma_mm: how thick its sheet is.
        q: positions of the rig's axes at two frames, one after the other.
    """
    at = [{axis: np.float64(steps[i]) for axis, steps in q.items()} for i in (0, 1)]
    (light, next_light), (columns, rows) = (light_at(rig.light(laser), each) for each in at), rig.camera.image_size
    u, v = (np.linspace(0.0, size - 1.0, _GRID) for size in (columns, rows))
    rays = pixel_rays(rig.camera, np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    w = np.asarray(light.inverse_depth(rays))
    X = rays[w > 0] / w[w > 0, None]
    now, then = (as_numpy(rig.pose(each)) for each in at)
    moved = distance(next_light, then.apply(now.inverse().apply(X)))
    step = float(np.median(np.abs(moved))) if len(X) else 0.0
    near = np.ceil(_APART / 2 * sigma_mm / step) if step > 0 else np.inf
    return 2 * int(near) if near <= _MOST_FRAMES / 2 else 0


def middles(found: Iterable[Looked], apart: int, light_of: LightOf, motion: Motion) -> Iterator[Looked]:
    """Range images with their points where the middle of the sheet met the surface, and their stripes as they were.

    Args:
        found: frames in their order, in batches of any size.
        apart: how many frames before and behind a frame are looked at, as `frames_apart` gives it.
        light_of: the light as it stands in frames at these positions, and what triangulates in it.
        motion: of the object.
    """
    held: list[Looked] = []
    done = 0
    for batch in chain(found, (None,)):
        if batch is not None:
            held.append(batch)
        elif not held:
            return
        image, stripe = RangeImage.joined([each for each, _ in held]), Stripe.joined([each for _, each in held])
        ready = len(image.valid) - (0 if batch is None else apart)
        while done < ready and (batch is None or ready - done >= FRAMES_AT_ONCE):
            here = slice(done, min(done + FRAMES_AT_ONCE, ready))
            yield _middles_of(image, stripe, here, apart, light_of, motion), stripe[here]
            done = here.stop
        kept = slice(max(done - apart, 0), None)
        held, done = [(image[kept, :], stripe[kept])], min(done, apart)


def _middles_of(
    image: RangeImage, stripe: Stripe, here: slice, apart: int, light_of: LightOf, motion: Motion
) -> RangeImage:
    """Some frames of a range image, with their points in the sheet's middle; arrays keep one size."""
    count, size = here.stop - here.start, FRAMES_AT_ONCE
    own = image[here, :]

    def filled(values: np.ndarray, *firsts: int) -> Array:
        """Those from each of these frames on; NaN where there is no frame."""
        out = np.full((len(firsts), size, *values.shape[1:]), np.nan, np.float32)
        for i, first in enumerate(firsts):
            start, stop = max(first, 0), min(first + count, len(values))
            if start < stop:
                out[i, start - first : stop - first] = values[start:stop]
        return jnp.asarray(out)

    q = {axis: np.pad(steps, (0, size - count), mode="edge") for axis, steps in own.positions.items()}
    frames = FramePoses.create(motion, q, size)
    sheet, kernel = light_of(q)
    core = np.where(stripe.burnt, stripe.breadth / 2, np.float32(0.0))
    seen = Seen(*(filled(x, here.start)[0] for x in (image.pixels, stripe.width / FWHM, core)))
    beside = filled(image.points, *(here.start + by for by in (-apart, -apart // 2, apart // 2, apart)))
    off = off_middle(sheet, frames, seen, filled(image.points, here.start)[0], beside)
    position = np.asarray(seen.position - off)
    points = triangulate_stripes(kernel, frames, position, sheet.columns)[:count]
    points = np.where(own.valid[..., None], points, np.float32(np.nan))
    return replace(own, pixels=position[:count], points=points)


class Seen(eqx.Module):
    """What the stripes of some frames are like.

    Attributes:
        position: px.
        bell: standard deviation of the profile, px.
        core: half of what is seen of a burnt-out stripe, px; 0 of others.
    """

    position: Lines
    bell: Lines
    core: Lines


@compiled()
def off_middle(
    sheet: ThickSheet, frames: FramePoses, stripe: Seen, here: Points, beside: Float[Array, "beside frames lines 3"]
) -> Lines:
    """How far each stripe's centre is from where the middle of the sheet is seen, px; 0 where it cannot be told.

    Args:
        sheet: the sheet.
        frames: the poses of these frames.
        stripe: what these frames show.
        here: the points that they show, object frame, mm.
        beside: what frames before and behind each have seen in the same lines, far and near, near and far; NaN for
            nothing.
    """

    def to_camera(points: Points) -> Points:
        return jnp.einsum("fji,flj->fli", frames.A, points - frames.b[:, None])

    here = to_camera(here)
    sides = [_Side.of(sheet, stripe.position, here, to_camera(points)) for points in beside]
    d, rate, ln_light = (
        jnp.stack([getattr(side, name) for side in sides]) for name in ("distance", "rate", "ln_light")
    )
    known = jnp.isfinite(d + rate + ln_light)
    nearest = jnp.where(known[1:-1], rate[1:-1], 0.0).sum(0) / known[1:-1].sum(0)
    ratio = rate / nearest[None]
    alike = (ratio > 1 / _ALIKE) & (ratio < _ALIKE)
    weight = jnp.where(known & alike, d**2 / (1 + (d / (_FARTHEST * sheet.sigma_mm)) ** 4), 0.0)
    first, half_second = _line(weight, d, rate)
    # What lies half-way there.
    ln_light, by_light = _line(weight, d / 2, ln_light)
    s2, w2 = sheet.sigma_mm**2, stripe.bell**2
    seen2 = jnp.minimum((first * sheet.sigma_mm) ** 2 / w2, 1.0)
    by_ends = jnp.where(stripe.core > 0, seen2 * (stripe.core**2 / w2 - 3), 0.0)
    off = s2 * (first * by_light + half_second * (3 + jnp.maximum(by_ends, 0.0)))
    by_blur, blur = _by_blur(stripe, first * sheet.sigma_mm, ln_light)
    off += by_blur
    most = _MOST * jnp.maximum(sheet.sigma_mm * jnp.abs(first), blur)
    off, variance = _shared(stripe.position, jnp.clip(off, -most, most), jnp.isfinite(off))
    # As far as it is more than its own noise.
    return off * jnp.maximum(1 - _NOISE * variance / jnp.maximum(off**2, _TINY), 0.0)


def _line(weight: Array, x: Array, y: Array) -> tuple[Lines, Lines]:
    """Value at x = 0 and slope of a straight line through weighted points; NaN through fewer than two."""
    total = weight.sum(0)
    x_mean, y_mean = ((weight * jnp.where(weight > 0, z, 0.0)).sum(0) / total for z in (x, y))
    off = jnp.where(weight > 0, x - x_mean[None], 0.0)
    slope = (weight * off * jnp.where(weight > 0, y, 0.0)).sum(0) / (weight * off**2).sum(0)
    slope = jnp.where((weight > 0).sum(0) > 1, slope, jnp.nan)
    return y_mean - slope * x_mean, slope


def _by_blur(stripe: Seen, covered: Lines, ln_light: Lines) -> tuple[Lines, Lines]:
    """How far the blur across lines moves each stripe's centre, px, and that blur's standard deviation.

    Args:
        stripe: what is seen.
        covered: standard deviation of what the sheet's thickness covers, px.
        ln_light: ln E.
    """
    (slope, bend), (by_light, _) = (
        _differences(x, _ASKED) for x in (stripe.position, ln_light + jnp.log(jnp.abs(covered)))
    )
    blur2 = jnp.maximum(stripe.bell**2 - covered**2, 0.0) / (1 + slope**2) + _PIXEL_VARIANCE
    off = blur2 * (slope * by_light + 0.5 * bend)
    # At the ends of a stripe its bend is not known, and what jumps does not bend.
    return jnp.where(jnp.abs(bend) < _MOST_BENT, jnp.nan_to_num(off), 0.0), jnp.nan_to_num(jnp.sqrt(blur2))


def _differences(values: Lines, k: int) -> tuple[Lines, Lines]:
    """First and second derivative from line to line, by those k lines away; NaN where these have nothing."""
    padded = jnp.pad(values, ((0, 0), (k, k)), constant_values=jnp.nan)
    left, right = padded[:, : -2 * k], padded[:, 2 * k :]
    return (right - left) / (2 * k), (right - 2 * values + left) / k**2


class _Side(eqx.Module):
    """What one neighbour shows of the surface beside the sheet.

    Attributes:
        distance: from the sheet's middle, mm.
        rate: how far the image of the surface moves in its line for each mm of that, px.
        ln_light: ln of the cosine of the light's angle half-way; NaN of light too oblique.
    """

    distance: Lines
    rate: Lines
    ln_light: Lines

    @staticmethod
    def of(sheet: ThickSheet, position: Lines, here: Points, there: Points) -> "_Side":
        """From what the frame sees, and what its neighbour has seen, both in the camera's frame now."""
        uv = jax.vmap(jax.vmap(sheet.camera.project))(there)
        along, across = (uv[..., 0], uv[..., 1]) if sheet.columns else (uv[..., 1], uv[..., 0])
        # The motion carries what was seen in a line into another one.
        lines = jnp.arange(position.shape[1], dtype=position.dtype)[None]
        across = across - (along - lines) * _differences(across, 1)[0] / _differences(along, 1)[0]
        d = distance(sheet.light, there)
        normal = jnp.cross(there - here, _along(here) + _along(there))
        to_laser = sheet.laser[None, None] - (here + there) / 2
        cosine = jnp.abs((normal * to_laser).sum(-1)) / (
            jnp.linalg.norm(normal, axis=-1) * jnp.linalg.norm(to_laser, axis=-1)
        )
        ln_light = jnp.where(cosine > _LEAST_COSINE, jnp.log(cosine), jnp.nan)
        return _Side(d, (across - position) / d, ln_light)


def _along(points: Points) -> Points:
    """The first derivative of points from line to line."""
    return jnp.stack([_differences(points[..., i], 1)[0] for i in range(3)], axis=-1)


def _shared(position: Lines, values: Lines, known: Bool[Array, "frames lines"]) -> tuple[Lines, Lines]:
    """The mean of lines that are near, as far as the stripe goes on to them, and its variance by their scatter."""
    pad, width = ((0, 0), (_TOGETHER, _TOGETHER)), position.shape[1]
    at, value, there = (jnp.pad(x, pad) for x in (position, jnp.where(known, values, 0.0), known))
    count = total = squares = jnp.zeros_like(position)
    for j in range(2 * _TOGETHER + 1):
        some = slice(j, j + width)
        near = jnp.abs(at[:, some] - position) <= _GOES_ON * max(abs(j - _TOGETHER), 1)
        taken = jnp.where(there[:, some] & near, 1.0, 0.0)
        count, total, squares = count + taken, total + taken * value[:, some], squares + taken * value[:, some] ** 2
    mean = total / jnp.maximum(count, 1.0)
    scatter = jnp.maximum(squares - count * mean**2, 0.0) / jnp.maximum(count - 1, 1.0)
    return mean, jnp.where(count >= _FEWEST, scatter / jnp.maximum(count, 1.0), jnp.inf)
