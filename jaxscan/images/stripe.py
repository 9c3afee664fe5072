"""Where the laser stripe is: one position for each image column (or row), to a fraction of a pixel.

`coarse` reduces the images to a peak for each block of rows and chooses among them; `measure` gathers a window about
the peak and takes the centre of gravity there. They are compiled apart, for in one piece a compiler on a CPU computes
each step again for every use of it in the next. Where the window was too narrow for the stripe, in few columns as a
rule, these are measured again with a wide one.

There is a stripe where the peak stands above its background by so many times the frame's noise, with both its flanks.
"""

from dataclasses import dataclass
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float32, Int

from jaxscan.errors import InputError
from jaxscan.images.coarse import choose_peaks, coarse_peaks
from jaxscan.images.decode import to_grey
from jaxscan.images.measure import frame_noise, gather_windows, measure
from jaxscan.images.response import CHANNELS, COLORS

# Half windows, px: the wide one holds stripes up to some 60 px wide.
_NARROW, _WIDE = 12, 40
# Smoothed as it is, the greatest of a thousand rows of noise stands out by two or three σ.
_LEAST_SIGNAL = 5.0
_LEAST_STRENGTH = 10.0
# Of the frame's M + N, below the part of the frame that a burnt-out stripe may take; told from every so many pixels.
_AMBIENT_QUANTILE = 0.97
_EVERY = 16
# Columns measured again come in so many at a time, or a power of four more, so that few sizes are compiled.
_LEAST_BUCKET = 256
# A stripe point has so many others within so many lines to either side, off by no more than so much and a steep slope.
_LEAST_COMPANY, _COMPANY_WITHIN = 2, 4
_COMPANY_PX, _STEEPEST = 2.0, 4.0


@dataclass(frozen=True)
class StripeSettings:
    """How the stripe is looked for: the `[laser]` section of a session or scan.

    Attributes:
        color: of the laser; grey for a monochrome camera.
        columns: one point for each image column (True) or for each row (False).
        name: which laser of several this is.
    """

    color: Literal["red", "green", "blue", "grey"] = "red"
    columns: bool = True
    name: str = ""

    def __post_init__(self) -> None:
        """Refuse what cannot be meant."""
        if self.color not in COLORS:
            raise InputError(f'color = "{self.color}": use one of {", ".join(COLORS)}')
        if not isinstance(self.columns, bool):
            raise InputError(f"columns = {self.columns}: write true (a point for each column) or false (for each row)")


class Stripe(eqx.Module):
    """The stripe in a batch of frames, one entry for each image column (or for each row, as the settings say).

    Attributes:
        position: its centre, the row v of each column (the column u of each row), px; NaN where it is not valid.
        strength: its peak, smoothed over five pixels, above the local background: grey levels of 2 L − (M + N), L the
            laser's channel, or of the intensity.
        width: full width at half the height, px; NaN where it is not valid.
        valid: whether there is a stripe, with both flanks on the image and with company in the neighbouring lines.
    """

    position: Float32[Array, "frames lines"]
    strength: Float32[Array, "frames lines"]
    width: Float32[Array, "frames lines"]
    valid: Bool[Array, "frames lines"]


def detect_stripe(
    images: np.ndarray | Array,
    settings: StripeSettings,
    background: np.ndarray | Array | None = None,
) -> Stripe:
    """Find the laser stripe in one photograph or in a batch of them.

    Args:
        images: (rows, columns) grey, (rows, columns, 3) RGB, or a batch of either with the frames first; 8 or 16 bits.
        settings: the laser's colour, and whether there is one point for each column or for each row.
        background: the scene with the laser off: one image for all frames, or one for each.

    Raises:
        InputError: shapes, depths or colour do not go together.
    """
    frames = _batch(images, settings, "the image")
    dark = None if background is None else _batch(background, settings, "the background")
    if dark is not None:
        _check_background(frames, dark)
    color, columns = settings.color, settings.columns
    length = frames.shape[1 if columns else 2]
    narrow, wide = (min(half, (length - 1) // 2) for half in (_NARROW, _WIDE))
    ambient = jnp.asarray(_ambient(np.asarray(frames), None if dark is None else np.asarray(dark), color))
    # Without a copy where the array is aligned to 64 bytes; nothing of it is kept.
    frames, dark = jax.device_put((frames, dark))
    peak = choose_peaks(coarse_peaks(frames, dark, ambient, color, columns), length, columns)
    frame, line = np.indices(peak.shape, np.int32)
    windows, first = gather_windows(frames, dark, ambient, frame, line, peak, color, columns, narrow)
    measured = measure(windows, first)
    least = np.maximum(_LEAST_SIGNAL * np.asarray(frame_noise(windows)), _LEAST_STRENGTH)[:, None]
    # A window inside a burnt-out stripe sees no background, but it sees one end of it.
    again = np.nonzero(np.asarray(measured.cramped) & (np.asarray(measured.relief) > least))
    if again[0].size and wide > narrow:
        at = _padded(again[0], again[1], np.asarray(peak)[again])
        better = measure(*gather_windows(frames, dark, ambient, *at, color, columns, wide))
        measured = jax.tree.map(lambda old, new: _replaced(old, again, new), measured, better)
    valid = np.asarray(measured.whole & (measured.strength > least))
    valid = valid & _in_a_line(np.where(valid, np.asarray(measured.position), np.nan))
    return Stripe(
        position=jnp.where(valid, measured.position, jnp.nan),
        strength=jnp.asarray(measured.strength),
        width=jnp.where(valid, measured.width, jnp.nan),
        valid=jnp.asarray(valid),
    )


def _in_a_line(position: Float32[np.ndarray, "frames lines"]) -> Bool[np.ndarray, "frames lines"]:
    """Whether a point has company: a stripe is a line, and noise that stands out somewhere stands alone.

    Neighbours count that lie no further off than a stripe as steep as any would.
    """
    company = np.zeros(position.shape, np.int8)
    for apart in range(1, min(_COMPANY_WITHIN, position.shape[1] - 1) + 1):
        with np.errstate(invalid="ignore"):
            near = np.abs(position[:, apart:] - position[:, :-apart]) <= _COMPANY_PX + _STEEPEST * apart
        company[:, apart:] += near
        company[:, :-apart] += near
    return company >= _LEAST_COMPANY


def _ambient(frames: np.ndarray, dark: np.ndarray | None, color: str) -> Int[np.ndarray, "frames"]:
    """The level of the other two channels without laser, in each frame."""
    if color == "grey":
        return np.zeros(len(frames), np.int32)
    some = (slice(None), slice(None, None, _EVERY), slice(None, None, _EVERY))
    others = sum(frames[(*some, i)].astype(np.int32) for i in CHANNELS[color][1:])
    if dark is not None:
        others = others - sum(dark[(*some, i)].astype(np.int32) for i in CHANNELS[color][1:])
    flat = np.reshape(others, (len(frames), -1))
    rank = int(_AMBIENT_QUANTILE * (flat.shape[1] - 1))
    return np.partition(flat, rank, axis=1)[:, rank].astype(np.int32)


def _padded(
    frame: Int[np.ndarray, "some"], line: Int[np.ndarray, "some"], peak: Int[np.ndarray, "some"]
) -> list[Int[np.ndarray, "1 bucket"]]:
    """Indices repeated up to the next bucket, so that each number of columns does not compile anew."""
    bucket = _LEAST_BUCKET
    while bucket < len(frame):
        bucket *= 4
    return [np.resize(index, (1, bucket)).astype(np.int32) for index in (frame, line, peak)]


def _replaced(old: Array, at: tuple[np.ndarray, ...], new: Array) -> np.ndarray:
    values = np.array(old)
    values[at] = np.asarray(new)[0, : at[0].size]
    return values


def _batch(images: np.ndarray | Array, settings: StripeSettings, what: str) -> np.ndarray | Array:
    """The images as (frames, rows, columns) or (frames, rows, columns, 3), checked."""
    if images.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{what} has pixels of {images.dtype}: give 8 or 16 bit integers")
    coloured = images.ndim >= 3 and images.shape[-1] == 3
    if images.ndim - coloured not in (2, 3) or 0 in images.shape:
        raise InputError(
            f"{what} has the shape {images.shape}: give (rows, columns) or (rows, columns, 3), or a batch of either"
        )
    frames = images if images.ndim - coloured == 3 else images[None]
    if settings.color == "grey" and coloured:
        # A grey camera's photographs may have been saved with three channels.
        frames = np.stack([to_grey(np.asarray(frame)) for frame in frames])
    elif not coloured and settings.color != "grey":
        raise InputError(f'{what} is grey, and the laser\'s colour {settings.color}: write color = "grey"')
    length = frames.shape[1 if settings.columns else 2]
    if length <= 2 * _NARROW:
        raise InputError(
            f"{what} has {length} {'rows' if settings.columns else 'columns'}: a stripe needs {2 * _NARROW + 1}"
        )
    return frames


def _check_background(frames: np.ndarray | Array, dark: np.ndarray | Array) -> None:
    if dark.dtype != frames.dtype or dark.shape[1:] != frames.shape[1:] or len(dark) not in (1, len(frames)):
        raise InputError(
            f"the background is {dark.dtype} of shape {dark.shape}, the frames {frames.dtype} of shape {frames.shape}: "
            "take it with the same camera settings, one image for all frames or one for each"
        )
