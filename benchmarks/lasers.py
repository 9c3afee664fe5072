"""Two lasers on one camera, calibrated in one solve from photographs: what both see of a block agrees, within σ?

Each laser scans the block by itself. Face by face, the points of the one have distances from the plane through those of
the other: d = H_a − W H_b, H the heights of points along the plane's normal and W the least-squares plane through the
ones at the places of the others. Both depend on the same camera and stage, so the variance of d is J Σ Jᵀ with J the
derivative of d by the whole rig, and what the pixels of both add.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from benchmarks.gauge import HEIGHTS, faces
from benchmarks.metric import Metric
from jaxscan.calibration import Calibration, calibrate
from jaxscan.calibration.gauge_points import GaugeScan
from jaxscan.calibration.observe import observe
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session
from jaxscan.precision import as_float64, float64
from jaxscan.reconstruction import reconstruct
from jaxscan.rig import Positions, Rig
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_scan, simulate_session
from jaxscan.simulation.shapes import stair

BLOCK_Y = 37.0
# Number of points of a face that take part.
_POINTS = 300


@dataclass(frozen=True)
class FaceDistance:
    """How far points of one laser lie from the plane through those of another, on one face.

    Attributes:
        each: of points, mm.
        sigma: as predicted of each, mm.
        mean_sigma: of their mean, mm.
    """

    each: Float[np.ndarray, "points"]
    sigma: Float[np.ndarray, "points"]
    mean_sigma: float


def measure(quick: bool) -> list[Metric]:
    """Some seeds, or the first."""
    found: list[FaceDistance] = []
    for seed in range(1 if quick else 4):
        rig = rig_2003.simulated_rig(seed, lasers=2)
        with tempfile.TemporaryDirectory() as folder:
            simulate_session(Path(folder) / "session", seed, rig=rig)
            calibration = calibrate(observe(read_session(Path(folder) / "session")))
            scans, on = [], []
            for i, laser in enumerate(rig.lights):
                scene = rig_2003.scan_scene(rig, stair(BLOCK_Y, HEIGHTS))
                truth = simulate_scan(Path(folder) / laser.name, rig, scene, seed, laser=i)
                image = reconstruct(calibration.rig, read_scan(Path(folder) / laser.name))
                scans.append(GaugeScan(image.pixels, image.positions, laser=laser.name))
                on.append(faces(truth.points, rig, HEIGHTS, BLOCK_Y))
        here = [face_distance(calibration, scans, masks) for masks in zip(*on, strict=True)]
        found += here
        print(
            f"  seed {seed}: mean distance and its σ, face by face and on the floor: "
            + "; ".join(f"{f.each.mean():+.4f} ± {f.mean_sigma:.4f}" for f in here),
            flush=True,
        )
    means, sigmas = np.array([f.each.mean() for f in found]), np.array([f.mean_sigma for f in found])
    each, predicted = (np.concatenate(x) for x in zip(*((f.each, f.sigma) for f in found), strict=True))
    return [
        Metric("lasers.distance.rms", _rms(each), "mm", "lower", slack=0.2),
        Metric("lasers.distance.predicted_rms", _rms(predicted), "mm"),
        Metric("lasers.distance.actual_over_predicted", _rms(each) / _rms(predicted), "", "lower", 1.25, slack=0.2),
        Metric("lasers.mean_of_a_face.largest", float(np.abs(means).max()), "mm", "lower", 0.03, slack=0.2),
        Metric("lasers.mean_of_a_face.actual_over_predicted", _rms(means / sigmas), "", "lower", 2.0, slack=0.3),
    ]


def face_distance(
    calibration: Calibration, scans: Sequence[GaugeScan], on: Sequence[Bool[np.ndarray, "frames columns"]]
) -> FaceDistance:
    """Points of the first scan from the plane through those of the second, where both are on one face."""
    seen = tuple(_points_on(scan, mask) for scan, mask in zip(scans, on, strict=True))
    with float64():
        rig = as_float64(calibration.rig)
        (a, along_a), (b, along_b) = (_triangulated(rig, *points) for points in seen)
        a, b, along_a, along_b = (np.asarray(x) for x in (a, b, along_a, along_b))
        axes = np.linalg.svd(b - b.mean(axis=0), full_matrices=False)[2]
        X_a, X_b = (np.column_stack([np.ones(len(p)), (p - b.mean(axis=0)) @ axes[:2].T]) for p in (a, b))
        W, normal = X_a @ np.linalg.pinv(X_b), axes[2]
        J = np.asarray(_distance_by_rig(rig, seen, jnp.asarray(W), jnp.asarray(normal)))
    d = a @ normal - W @ (b @ normal)
    by_rig = J @ calibration.covariance.of_leaves(calibration.rig) @ J.T
    sigma = calibration.stripe_sigma_px or np.nan
    by_pixels_a = (along_a @ normal * sigma) ** 2
    by_pixels_b = W @ np.diag((along_b @ normal * sigma) ** 2) @ W.T
    n, tau = len(d), calibration.stripe_correlation or 1.0
    mean = by_rig.mean() + tau * (by_pixels_a.mean() / n + by_pixels_b.mean())
    return FaceDistance(d, np.sqrt(np.diagonal(by_rig) + by_pixels_a + np.diagonal(by_pixels_b)), float(np.sqrt(mean)))


_Seen = tuple[Float[np.ndarray, "points 2"], dict[str, Float[np.ndarray, "points"]], str]


def _points_on(scan: GaugeScan, on: Bool[np.ndarray, "frames columns"]) -> _Seen:
    """Pixels, positions of the axes and laser of points of a face, evenly over it."""
    frame, column = np.nonzero(on & np.isfinite(scan.pixels))
    some = np.linspace(0, len(frame) - 1, _POINTS).astype(int)
    frame, column = frame[some], column[some]
    pixels = np.column_stack([column, scan.pixels[frame, column]]).astype(np.float64)
    q = {axis: np.asarray(steps, np.float64)[frame] for axis, steps in scan.positions.items()}
    return pixels, q, scan.laser


def _points(
    rig: Rig, pixels: Float[Array | np.ndarray, "points 2"], q: Positions, laser: str
) -> Float[Array, "points 3"]:
    """The points, mm."""
    return jax.vmap(lambda pixel, q: rig.triangulate(pixel, q, laser))(jnp.asarray(pixels), q)


@eqx.filter_jit
def _triangulated(
    rig: Rig, pixels: Float[Array | np.ndarray, "points 2"], q: Positions, laser: str
) -> tuple[Float[Array, "points 3"], Float[Array, "points 3"]]:
    """The points, mm, and how they move with v, mm a pixel."""
    down = jnp.broadcast_to(jnp.array([0.0, 1.0]), pixels.shape)
    return jax.jvp(lambda pixels: _points(rig, pixels, q, laser), (jnp.asarray(pixels),), (down,))


@eqx.filter_jit
def _distance_by_rig(
    rig: Rig, seen: tuple[_Seen, ...], W: Float[Array, "points points"], normal: Float[Array, "3"]
) -> Float[Array, "points leaves"]:
    """∂d/∂ the rig's leaves."""
    theta, unravel = ravel_pytree(rig)

    def distance(theta: Float[Array, "leaves"]) -> Float[Array, "points"]:
        a, b = (_points(unravel(theta), *points) @ normal for points in seen)
        return a - W @ b

    return jax.jacfwd(distance)(theta)


def _rms(values: Float[np.ndarray, "values"]) -> float:
    return float(np.sqrt((values**2).mean()))
