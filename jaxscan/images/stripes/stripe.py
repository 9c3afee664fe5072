"""What is known of the stripe in a batch of frames."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Float32, Int8


@dataclass(frozen=True)
class Stripe:
    """The stripe in a batch of frames, one entry for each image column (or for each row, as the settings say).

    Attributes:
        position: its centre, the row v of each column (the column u of each row), px; NaN where it is not valid.
        sigma: the predicted standard deviation of the position, px; NaN where it is not valid.
        strength: its peak, smoothed over five pixels, above the local background: grey levels of 2 L − (M + N), L the
            laser's channel, or of the intensity.
        width: full width at half the height, px; NaN where it is not valid.
        breadth: of what is seen, full at half height, px: of a burnt-out stripe that of its full pixels and more.
        valid: whether there is a stripe, with both flanks in the image, and supported by the neighbouring lines.
        verdict: what was made of the line, a `Verdict`.
        burnt: whether some pixel near the line's stripe is full.
        light: read noise, gain, speckle contrast and saturation of each frame (`images.light`); NaN without a stripe.
        odd: in which frames the stripe's cross-section is not bell-shaped, all along it.
        correlation: of the noise of neighbouring pixels of each frame's lines; 0 where it is white, or not seen.
        mosaic: in which frames only the pixels count that saw the laser's colour themselves (`mosaic`).
        full: share of each frame's pixels whose laser channel is full.
        surroundings: level of some pixels of each frame, of the channels that are not the laser's: grey levels of an
            8-bit photograph.
    """

    position: Float32[np.ndarray, "frames lines"]
    sigma: Float32[np.ndarray, "frames lines"]
    strength: Float32[np.ndarray, "frames lines"]
    width: Float32[np.ndarray, "frames lines"]
    breadth: Float32[np.ndarray, "frames lines"]
    valid: Bool[np.ndarray, "frames lines"]
    verdict: Int8[np.ndarray, "frames lines"]
    burnt: Bool[np.ndarray, "frames lines"]
    light: Float32[np.ndarray, "frames 4"]
    odd: Bool[np.ndarray, "frames"]
    correlation: Float32[np.ndarray, "frames"]
    mosaic: Bool[np.ndarray, "frames"]
    full: Float32[np.ndarray, "frames"]
    surroundings: Float32[np.ndarray, "frames some_rows some_columns"]

    def __getitem__(self, some: slice | np.ndarray) -> "Stripe":
        """Some of the frames; by their numbers, in any order."""
        return Stripe(*(getattr(self, f.name)[some] for f in fields(self)))

    def black(self) -> Float[np.ndarray, "frames"]:
        """Which part of each frame's `surroundings` is 0."""
        return (self.surroundings == 0).mean(axis=(1, 2))

    @staticmethod
    def joined(parts: "Sequence[Stripe]") -> "Stripe":
        """The frames of several, in their order."""
        return Stripe(*(np.concatenate([getattr(s, f.name) for s in parts]) for f in fields(Stripe)))


def u_and_v(
    position: Float[np.ndarray, "*frames lines"], columns: bool
) -> tuple[Float[np.ndarray, "*frames lines"], Float[np.ndarray, "*frames lines"]]:
    """The pixels (u, v) of a stripe's positions, whose lines are columns, or else rows."""
    line = np.broadcast_to(np.arange(position.shape[-1], dtype=np.float32), position.shape)
    return (line, position) if columns else (position, line)
