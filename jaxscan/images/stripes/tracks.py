"""Windows along time: what a point of the surface shows in frame after frame while it passes through the light.

A track is a place in the image for each of several frames, to a fraction of a pixel. The pixels about it are
interpolated, in numbers of 16 bits so that no rounding is added, and stand as windows of the shape that the detectors
take, (groups, window, lines), with the frames along the window. Along the stripe the interpolation is linear, across it
cubic: a linear one blurs by up to half a pixel, and what blurs lets in light from beyond an edge.

Between pixels noise is less: a level Σ w y of pixels y that scatter by v, each by itself, scatters by v Σ w². Those of
different frames are independent of one another.
"""

from math import prod
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt16

from jaxscan.images.decode import NUMBERS_PER_LEVEL
from jaxscan.images.stripes.response import NEUTRAL, Images, channels, numbers, response
from jaxscan.images.stripes.survey import survey_windows
from jaxscan.images.stripes.windows import Places, Sensor, Windows, response_of_lines
from jaxscan.kept_programs import compiled

_MOST = 65535
# Pixels before and after the one that a place is in.
_CUBIC, _LINEAR = (1, 2), (0, 1)
# A neighbour of less weight than this has no say in whether a track is full.
_LEAST_WEIGHT = 0.02


class Tracks(NamedTuple):
    """Where each window looks.

    Attributes:
        frame: which frame, for each place of the window; lines of a group share it.
        u: column, px.
        v: row, px.
    """

    frame: Int[Array, "groups window"]
    u: Float[Array, "groups window lines"]
    v: Float[Array, "groups window lines"]

    def of_one_frame(self) -> "Tracks":
        """The same places, all in the first frame."""
        return self._replace(frame=jnp.zeros_like(self.frame))


class Passage(NamedTuple):
    """What is seen along tracks.

    Attributes:
        levels: interpolated, in numbers of 16 bits.
        greatest: of the pixels that were interpolated, likewise.
        gain: Σ w² over their weights w.
    """

    levels: UInt16[Array, "groups window lines *rgb"]
    greatest: UInt16[Array, "groups window lines *rgb"]
    gain: Float[Array, "groups window lines"]


def number_scale(dtype: np.dtype) -> int:
    """Numbers of a passage for one of the photograph's."""
    return NUMBERS_PER_LEVEL if dtype == np.uint8 else 1


@compiled(static_argnames="columns")
def gather_passage(images: Images, tracks: Tracks, columns: bool) -> Passage:
    """Interpolate the pixels about tracks; beyond the image's edge its last pixels go on.

    Args:
        images: the photographs.
        tracks: where.
        columns: whether the stripe's position is a row, and cubic across.
    """
    rows, width = images.shape[1:3]
    (up, down), (left, right) = _CUBIC if columns else _LINEAR, _LINEAR if columns else _CUBIC
    v, u = jnp.clip(tracks.v, 0, rows - 1), jnp.clip(tracks.u, 0, width - 1)
    row = jnp.clip(jnp.floor(v), up, rows - 1 - down).astype(jnp.int32)
    column = jnp.clip(jnp.floor(u), left, width - 1 - right).astype(jnp.int32)
    frame = jnp.broadcast_to(tracks.frame[..., None], u.shape)
    about = jax.lax.gather(
        images,
        jnp.stack([frame, row - up, column - left], axis=-1),
        jax.lax.GatherDimensionNumbers(
            offset_dims=tuple(range(3, images.ndim + 2)), collapsed_slice_dims=(0,), start_index_map=(0, 1, 2)
        ),
        (1, 1 + up + down, 1 + left + right, *images.shape[3:]),
        mode=jax.lax.GatherScatterMode.PROMISE_IN_BOUNDS,
    )
    weights = _lagrange(v - row, up, down)[..., :, None] * _lagrange(u - column, left, right)[..., None, :]
    gain = (weights**2).sum((3, 4))
    weights = weights.reshape(*weights.shape, *(1,) * (images.ndim - 3))
    numbers = about.astype(jnp.float32) * number_scale(images.dtype)
    levels = jnp.clip((weights * numbers).sum((3, 4)), 0, _MOST)
    greatest = jnp.where(jnp.abs(weights) > _LEAST_WEIGHT, numbers, 0.0).max((3, 4))
    return Passage(jnp.rint(levels).astype(jnp.uint16), greatest.astype(jnp.uint16), gain)


def _lagrange(t: Float[Array, "*any"], before: int, after: int) -> Float[Array, "*any pixels"]:
    """Weights of the pixels from −before to after for a place t between 0 and 1: Π (t − m) / (j − m) over m ≠ j.

    What they pass through four pixels is right to the third order. R. Keys's cubic (1981) is smoother and right to the
    second, and moves a stripe 1.5 px wide (σ) by up to 0.01 px where every frame sees it at a quarter of a pixel.
    """
    pixels = range(-before, after + 1)
    return jnp.stack([prod(((t - m) / (j - m) for m in pixels if m != j), start=jnp.ones_like(t)) for j in pixels], -1)


def survey_passage(
    lit: Passage, dark: Passage | None, some: Int[Array, "groups some"], ambient: Int[Array, "groups"], color: str
) -> Sensor:
    """What some lines of each group show of the sensor, as `survey` has it: the numbers are interpolated ones."""

    def of(passage: Passage) -> UInt16[Array, "groups window some *rgb"]:
        index = some[:, None]
        index = index[..., None] if passage.levels.ndim == 4 else index
        return jnp.take_along_axis(passage.levels, index, axis=2)

    gain = jnp.take_along_axis(lit.gain, some[:, None], axis=2)
    background = None if dark is None else of(dark)
    return survey_windows(of(lit), background, ambient, color, gain, interpolated=np.array(True))


@compiled(static_argnames="color")
def passage_windows(
    lit: Passage, dark: Passage | None, sensor: Sensor, frame: Places, first: Places, color: str
) -> Windows:
    """The response along tracks.

    Args:
        lit: what the photographs show.
        dark: what those without laser show.
        sensor: of each group, as a survey of these windows gives it.
        frame: of each window, whose sensor.
        first: where each window begins.
        color: of the laser, or grey.
    """
    here = sensor.of(frame)
    levels = channels(lit.levels, None if dark is None else dark.levels, color)
    full = numbers(lit.greatest, color) >= here.full.astype(lit.greatest.dtype)
    r, own = response_of_lines(levels, full, here)
    return Windows(
        r,
        None if color == "grey" else response(levels, NEUTRAL, here.ambient),
        full,
        first,
        lit.gain,
        own=own,
    )
