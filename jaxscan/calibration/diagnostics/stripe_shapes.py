"""The distance of each stripe from the light plane along the stripe: what is not noise has a shape.

On a flat board a stripe is a straight line in the light plane. A wrong pose or pitch gives it an offset and a tilt, by
least squares d(t) = a + b t, t from −1 to 1 along the stripe. What its running mean then still does, from peak to
valley, is the bend of the plate, or a lens that is not followed.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.observations import StripePoints
from jaxscan.calibration.on_board import meet_board, pose_of
from jaxscan.calibration.result import Calibration
from jaxscan.rig import Light, MovingLight
from jaxscan.rig.light import distance, stood

_FEWEST_POINTS = 20
# The running mean is over this share of a stripe's points.
_WINDOW = 0.1
# The expected range of ten independent standard normal numbers (L. H. C. Tippett 1925): as many as there are windows.
_RANGE_OF_TEN = 3.08
# What noise gives the square of a running mean with its line, in parts of the noise's square over the window's length:
# a little more than the window's own 1, for the ends, where the window is cut, and the line.
_LEFT_OF_NOISE = 1.5


@dataclass(frozen=True)
class StripeShape:
    """One stripe on one board; rejected points are not in it.

    Attributes:
        name: of the photograph.
        laser: its name, "" for the only one.
        along_px: column (or row) of each point, ascending.
        distance_mm: of each from the light plane; positive on the far side of it from the camera.
        smooth_mm: the running mean of the distance.
        offset_mm: a, with the standard error of independent points.
        offset_error_mm: see `offset_mm`.
        tilt_mm: b, at the ends of the stripe.
        bend_mm: the running mean about the straight line, from peak to valley.
        bend_of_noise_mm: what noise alone gives it, expected.
        crooked_mm: RMS of the running mean about the straight line.
        noise_mm: RMS about the running mean.
        tied_mm: RMS of what neighbours share: of the running mean, less what noise alone gives it.
        depth_mm: median distance of the points from the camera, along its axis.
        sag_mm: of the parabola through the distances: its middle less its ends.
        length_mm: of the stripe on its board.
        position: motor steps of the axis that moves the light; None where none does.
        mm_per_step: by how much the distance of the points grows with each step of that axis, on average.
    """

    name: str
    laser: str
    along_px: Float[np.ndarray, "points"]
    distance_mm: Float[np.ndarray, "points"]
    smooth_mm: Float[np.ndarray, "points"]
    offset_mm: float
    offset_error_mm: float
    tilt_mm: float
    bend_mm: float
    bend_of_noise_mm: float
    crooked_mm: float
    noise_mm: float
    tied_mm: float
    depth_mm: float
    sag_mm: float
    length_mm: float = 0.0
    position: float | None = None
    mm_per_step: float = 0.0

    @property
    def label(self) -> str:
        """The photograph; of a light that moves, which has several stripes in each, with the step."""
        return self.name if self.position is None else f"{self.name} at step {self.position:g}"

    @property
    def off_steps(self) -> float:
        """How many motor steps beyond its position the light would meet the stripe, of a light that moves."""
        return -self.offset_mm / self.mm_per_step

    @property
    def beside_mm(self) -> float:
        """RMS distance of the straight line a + b t from the light plane."""
        return float(np.hypot(self.offset_mm, self.tilt_mm / np.sqrt(3)))


def stripe_shapes(calibration: Calibration) -> tuple[StripeShape, ...]:
    """Every stripe that has enough points, the most bent first."""
    observations, shapes = calibration.observations, []
    poses, fits = calibration.photograph_poses(), (*calibration.fits, *calibration.moved_fits)
    bent = calibration.bent_boards()
    for i, (view, fit) in enumerate(zip(observations.photographs(), fits, strict=True)):
        at = 0
        for stripe in view.stripes:
            seen = np.flatnonzero(np.isfinite(stripe.pixels).all(axis=1))
            kept = seen[fit.stripe_kept[at : at + len(seen)]]
            at += len(seen)
            if len(kept) < _FEWEST_POINTS:
                continue
            pixels = stripe.pixels[kept]
            X = meet_board(calibration.rig.camera, pose_of(poses, i), pixels, bent[i] if bent else None)[0]
            of = calibration.rig.lights[stripe.laser]
            light = stood(of, stripe.position)
            along = pixels[:, 0 if stripe.columns else 1]
            found = shape(view.name, light.name, along, distance(light, X), float(np.median(X[:, 2])))
            shapes.append(replace(found, length_mm=float(np.linalg.norm(np.ptp(X, axis=0))), **_of_axis(of, stripe, X)))
    return tuple(sorted(shapes, key=lambda s: -s.bend_mm))


def _of_axis(light: Light, stripe: StripePoints, X: Float[np.ndarray, "points 3"]) -> dict[str, float]:
    """Where the light stood, and how far a motor step takes it at points of its stripe (camera frame, mm)."""
    if not isinstance(light, MovingLight):
        return {}
    before, behind = (distance(light.at(stripe.position + by), X) for by in (-0.5, 0.5))
    return {"position": stripe.position, "mm_per_step": float((behind - before).mean())}


def shape(
    name: str,
    laser: str,
    along: Float[np.ndarray, "points"],
    off: Float[np.ndarray, "points"],
    depth_mm: float,
) -> StripeShape:
    """The shape of one stripe."""
    order = np.argsort(along)
    along, off = along[order], off[order]
    t = 2 * (along - along[0]) / max(float(np.ptp(along)), 1e-9) - 1
    A = np.stack([np.ones_like(t), t], axis=1)
    line = np.linalg.lstsq(A, off, rcond=None)[0]
    left = off - A @ line
    window = max(5, round(_WINDOW * len(left)))
    whole = np.convolve(left, np.ones(window), "same") / np.convolve(np.ones(len(left)), np.ones(window), "same")
    noise = float(np.sqrt(((left - whole) ** 2).mean()))
    return StripeShape(
        name=name,
        laser=laser,
        along_px=along,
        distance_mm=off,
        smooth_mm=A @ line + whole,
        offset_mm=float(line[0]),
        offset_error_mm=noise / np.sqrt(len(left)),
        tilt_mm=float(line[1]),
        # At the ends the mean is over half a window, and so noisier.
        bend_mm=float(np.ptp(whole[window // 2 : len(whole) - window // 2])),
        bend_of_noise_mm=_RANGE_OF_TEN * noise / np.sqrt(window),
        crooked_mm=float(np.sqrt((whole**2).mean())),
        noise_mm=noise,
        tied_mm=float(np.sqrt(max(((A @ line + whole) ** 2).mean() - _LEFT_OF_NOISE * noise**2 / window, 0.0))),
        depth_mm=depth_mm,
        sag_mm=-float(np.polyfit(t, off, 2)[0]),
    )
