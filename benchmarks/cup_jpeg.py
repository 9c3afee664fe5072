"""Photographs of the simulated cup kept as JPEG: error of the stripe's place, and predicted σ over it.

The photographs are those of `frame_sigma`, of 8 bits in colour, with speckle and without. A row is a quality and a
resolution of colours. Its error is the RMS over points no closer than some columns to an edge of depth, and within half
a pixel of the truth; what is further off is counted apart. Beside it stands that of the plain centre of gravity. σ over
the error is 1 / RMS of error / σ over points within 4 σ: of all points, and of the frame with the least and the most.
"""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
import simplejpeg
from jaxtyping import Bool, Float, UInt

from benchmarks.frame_sigma import HIGH, LOW, SPECKLES, at_edges, developed, draw, frame_ratios, ratio
from benchmarks.metric import Metric
from jaxscan.images import Stripe, StripeSettings, detect_stripe
from jaxscan.simulation import rig_2003
from jaxscan.simulation.shapes import cup

# Quality, and which pixels keep a colour of their own.
_ROWS: Final = (
    (98, "444"),
    (95, "444"),
    (95, "422"),
    (90, "444"),
    (90, "422"),
    (90, "420"),
    (85, "444"),
    (85, "422"),
    (75, "444"),
    (75, "420"),
    (60, "444"),
    (60, "420"),
)
_QUICK: Final = ((90, "444"), (90, "420"))
_FAR_PX: Final = 0.5
# The goal of the error over that of the centre of gravity.
_GOAL: Final = 1.0
_RED: Final = StripeSettings("red")

Photographs = UInt[np.ndarray, "frames rows columns 3"]


def measure(quick: bool) -> list[Metric]:
    """Every second photograph in all rows; in the short form every twelfth in two of them."""
    rig, metrics = rig_2003.simulated_rig(0), []
    scene = rig_2003.scan_scene(rig, cup(rig_2003.OBJECT_Y))
    for speckle in SPECKLES:
        lighting = replace(rig_2003.SCAN_LIGHTING, speckle=speckle)
        photographs, truth = draw(rig, scene, lighting, 12 if quick else 2)
        photographs, asked = developed(photographs, "colour"), ~at_edges(truth)
        print(f"  speckle {speckle:g}: RMS px, of gravity, quotient; σ over the error, of frames; further off, %")
        for quality, kind in _QUICK if quick else _ROWS:
            kept = as_jpeg(photographs, quality, kind)
            own, by_gravity = beside_gravity(kept, truth, asked)
            rms, other = (rms_of(off) for off, _ in (own, by_gravity))
            off = own[0] / own[1]
            frames, far = frame_ratios(off), far_percent(own[0])
            print(
                f"    {quality} {kind}   {rms:.4f} {other:.4f} {rms / other:.2f}   {ratio(off):.2f}, "
                f"{frames.min():.2f} to {frames.max():.2f}   {far:.2f}",
                flush=True,
            )
            name = f"cup_jpeg.speckle_{speckle:g}.{quality}_{kind}"
            metrics += [
                Metric(f"{name}.rms", rms, "px", "lower", None, 0.1),
                Metric(f"{name}.over_gravity", rms / other, "", "lower", _GOAL, 0.1),
                Metric(f"{name}.sigma_at_least", ratio(off), "", "higher", LOW, 0.1),
                Metric(f"{name}.sigma_at_most", ratio(off), "", "lower", HIGH, 0.1),
                Metric(f"{name}.sigma_least_frame", frames.min(), ""),
                Metric(f"{name}.sigma_most_frame", frames.max(), ""),
            ]
    return metrics


def as_jpeg(photographs: Photographs, quality: int, kind: str) -> Photographs:
    """The photographs as they are read from JPEGs."""
    return np.stack(
        [
            simplejpeg.decode_jpeg(simplejpeg.encode_jpeg(np.ascontiguousarray(each), quality, "RGB", kind))
            for each in photographs
        ]
    )


def beside_gravity(
    photographs: Photographs,
    truth: Float[np.ndarray, "frames columns"],
    asked: Bool[np.ndarray, "frames columns"],
    settings: StripeSettings = _RED,
) -> tuple[tuple[Float[np.ndarray, "frames columns"], Float[np.ndarray, "frames columns"]], ...]:
    """Error and σ of the default detector's points, and of those of the centre of gravity."""
    return tuple(
        errors(detect_stripe(photographs, settings, detector=name), truth, asked) for name in ("likelihood", "gravity")
    )


class Against(NamedTuple):
    """The default detector's points against those of the centre of gravity.

    Attributes:
        rms: of their errors within half a pixel, px.
        other: the same of the centre of gravity's.
        sigma: their σ over the error.
        far: which part of them is further off, %.
        far_other: the same of the centre of gravity's.
    """

    rms: float
    other: float
    sigma: float
    far: float
    far_other: float

    @staticmethod
    def create(
        photographs: Photographs,
        truth: Float[np.ndarray, "frames columns"],
        asked: Bool[np.ndarray, "frames columns"],
        settings: StripeSettings = _RED,
    ) -> "Against":
        """Of photographs whose stripe is known, where it is asked."""
        (off, sigma), (off_other, _) = beside_gravity(photographs, truth, asked, settings)
        return Against(rms_of(off), rms_of(off_other), ratio(off / sigma), far_percent(off), far_percent(off_other))

    def metrics(self, name: str, goal: float | None) -> list[Metric]:
        """The error, its quotient, whose goal may be given, and σ; no quotient where gravity has no point so near."""
        quotient = Metric(f"{name}.over_gravity", self.rms / self.other, "", "lower", goal, 0.1)
        return [
            Metric(f"{name}.rms", self.rms, "px", "lower", None, 0.1),
            *([quotient] if np.isfinite(self.other) else []),
            Metric(f"{name}.sigma", self.sigma, ""),
        ]


def errors(
    stripe: Stripe, truth: Float[np.ndarray, "frames columns"], asked: Bool[np.ndarray, "frames columns"]
) -> tuple[Float[np.ndarray, "frames columns"], Float[np.ndarray, "frames columns"]]:
    """Error and σ of each point that is asked for, px; NaN elsewhere."""
    known = np.asarray(stripe.valid) & asked
    off = np.asarray(stripe.position, np.float64) - truth
    return np.where(known, off, np.nan), np.where(known, np.asarray(stripe.sigma, np.float64), np.nan)


def rms_of(off: Float[np.ndarray, "frames columns"]) -> float:
    """Of the errors that are no more than half a pixel, px; NaN of none."""
    with np.errstate(invalid="ignore"):
        near = off[np.abs(off) < _FAR_PX]
    return float(np.sqrt(np.mean(near**2))) if len(near) else np.nan


def far_percent(off: Float[np.ndarray, "frames columns"]) -> float:
    """Which part of the errors is more than half a pixel, %."""
    return float(100 * np.mean(np.abs(off[np.isfinite(off)]) > _FAR_PX))
