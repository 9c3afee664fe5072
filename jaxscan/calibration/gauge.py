"""`refine_by_gauge`: an object of known shape, scanned, puts right the light plane and the stage of a rig.

Unknown are the rig and where the gauge stood. The stripe points of its scan give residuals in detector pixels
(`gauge_residuals`). What the boards had to say of the rig comes in as they left it: either the rig's own mean and
covariance, as a prior, or, with an adjustment of a finished calibration, its corners and stripes themselves, in one
solve. Of a part that is doubted (a laser that was pushed) the prior is all but forgotten.

Nearest points of the shape, outliers, σ and the solve take turns until they stand still.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, Real

from jaxscan.calibration.blocks import bucket
from jaxscan.calibration.bundle import Estimate, Prior, solve
from jaxscan.calibration.correlation import integrated_correlation
from jaxscan.calibration.gauge_residuals import GaugePoints, gauge_errors, point_of_object
from jaxscan.calibration.gauge_shapes import Shape
from jaxscan.calibration.residuals import Noise
from jaxscan.calibration.uncertainty import precision
from jaxscan.errors import InputError, SolveError
from jaxscan.files.rig_file import RigFile
from jaxscan.geometry import Pose, matrix_to_vector
from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.rig import Covariance, Rig
from jaxscan.rig.rig import parameter_names

# Left out beyond this many σ.
_LIMIT: Final = 4.0
# The first round believes a point that is off by no more than this: a rig may read a gauge some per cent wrong.
_ROUGHLY_MM, _ROUGHLY_SHARE = 0.3, 0.08
# A surface seen at less than this angle to the way the stripe moves on it says nothing of where it is.
_GRAZING = np.sin(np.radians(12.0))
_FEWEST_POINTS = 100
_MAX_ROUNDS = 30
# How far a pose is known by where the gauge was laid in, radians and mm.
_TURN_TO, _NO_TURN, _SHIFT_TO = 0.1, 1e-6, 10.0
_FIRST_DAMPING = 1e-12
_SETTLED = 0.01
_SMALLEST_SIGMA = 1e-3
_SMALLEST_TOLERANCE = 0.02
# A nearest point that is further to the side than this is on an edge, mm.
_ASIDE_MM = 1e-3
_NORMAL_MAD = 1.4826
# A doubted part is known to this share of itself: a laser pushed by some 3 degrees.
_DOUBT = 0.05


@dataclass(frozen=True)
class GaugeScan:
    """The stripe in the frames of a scan of a gauge.

    Attributes:
        pixels: where it was seen: v for each image column, or u for each row; NaN for none.
        steps: motor step count of each frame.
        columns: whether v was measured, or u.
        laser: the laser's name, "" for the only one.
    """

    pixels: Float[np.ndarray, "frames columns"]
    steps: Real[np.ndarray, "frames"]
    columns: bool = True
    laser: str = ""


@dataclass(frozen=True)
class GaugeFit:
    """A rig refined by a gauge.

    Attributes:
        rig: the refined rig.
        covariance: of its parameters; one that neither the prior nor the gauge knows anything of was held.
        pose: T_cam_gauge at motor step 0.
        points: how many stripe points took part.
        rejected: how many were seen on the gauge's surroundings, at grazing angles, or beyond 4 σ.
        stripe_sigma_px: σ of a stripe point, from the residuals.
        correlation: how many neighbouring points are worth one.
        rms_before_mm: RMS distance of the points that took part from the gauge's surface, by the rig as it was, the
            gauge laid in as well as it went.
        rms_after_mm: the same by the refined rig.
        from_prior_in_sigma: how far the rig moved from what was known of it, in standard deviations: much more than
            the root of the number of its parameters says that gauge and boards contradict each other.
    """

    rig: Rig
    covariance: Covariance
    pose: Pose
    points: int
    rejected: int
    stripe_sigma_px: float
    correlation: float
    rms_before_mm: float
    rms_after_mm: float
    from_prior_in_sigma: float

    def rig_file(self, fit: dict[str, object] | None = None) -> RigFile:
        """What `write_rig` writes; what else the earlier fit had to say goes along."""
        words = {"gauge_points": self.points, "gauge_rms_mm": self.rms_after_mm, "gauge_sigma_px": self.stripe_sigma_px}
        return RigFile(self.rig, self.covariance, {**(fit or {}), **words})


def refine_by_gauge(content: RigFile, scan: GaugeScan, shape: Shape, doubt: Sequence[str] = ("laser",)) -> GaugeFit:
    """Refine a rig so that a scanned object has the shape that it is known to have.

    Args:
        content: the rig, with its covariance where there is one; without it, what is not doubted is held.
        scan: the stripe on the gauge.
        shape: the object.
        doubt: parts of the rig, "laser" and "stage", whose values are hardly to be trusted.

    Raises:
        InputError: the shape is not found in the scan, or too few points lie on it.
        SolveError: no minimum was reached.
    """
    index = [laser.name for laser in content.rig.lasers].index(content.rig.laser(scan.laser).name)
    with float64():
        rig = as_float64(content.rig)
        prior, free = _prior(content, scan, doubt)
        seen = _seen(scan, index)
        points, _ = _on_object(rig, seen)
        cloud = np.asarray(points)[np.asarray(seen.used[0])]
        if len(cloud) < _FEWEST_POINTS:
            raise InputError(
                f"{len(cloud)} stripe points in the scan of the gauge: at least {_FEWEST_POINTS} are needed"
            )
        R, t = shape.stand(cloud)
        pose = jnp.concatenate([matrix_to_vector(jnp.asarray(R)), jnp.asarray(t)])[None]
        # Next to nothing beside what a scan tells, but a ball has no turn that it could tell.
        laid_to = jnp.array([[_TURN_TO if shape.turns else _NO_TURN] * 3 + [_SHIFT_TO] * 3])
        seen = eqx.tree_at(lambda s: (s.laid, s.laid_to), seen, (pose, laid_to))
        first = Estimate((rig, None), (pose,))
        # The gauge is laid in first, with the rig as it is.
        laid = _fit(shape, seen, first, jnp.zeros_like(free), prior)
        fitted = _fit(shape, seen, laid.estimate, free, prior)
        found = precision(fitted.estimate, free, (fitted.scan,), _unit(), prior)
        names, at = parameter_names(rig), np.flatnonzero(free)
        covariance = Covariance(tuple(names[i] for i in at), np.asarray(found.covariance)[np.ix_(at, at)])
        used = np.asarray(fitted.scan.used[0])
        before, after = (_distances(shape, fit.estimate, seen)[used] for fit in (laid, fitted))
        refined = fitted.estimate.shared[0]
        shift = np.asarray(prior.root) @ (np.asarray(ravel_pytree(refined)[0]) - np.asarray(prior.mean))
        return GaugeFit(
            rig=as_numpy(refined),
            covariance=covariance,
            pose=as_numpy(Pose.from_vector(fitted.estimate.poses[0][0])),
            points=int(used.sum()),
            rejected=len(cloud) - int(used.sum()),
            stripe_sigma_px=fitted.sigma,
            correlation=fitted.correlation,
            rms_before_mm=float(np.sqrt((before**2).mean())),
            rms_after_mm=float(np.sqrt((after**2).mean())),
            from_prior_in_sigma=float(np.linalg.norm(shift)),
        )


def _unit() -> Noise:
    """σ of 1: a gauge's points carry their own weights."""
    return Noise(jnp.ones(()), jnp.ones(()), jnp.zeros(()))


@dataclass(frozen=True)
class _Fitted:
    """Where rounds of nearest points and solves ended."""

    estimate: Estimate
    scan: GaugePoints
    sigma: float
    correlation: float


def _fit(shape: Shape, seen: GaugePoints, estimate: Estimate, free: Bool[Array, "shared"], prior: Prior) -> _Fitted:
    """Nearest points, outliers, σ and the solve in turn.

    Which points are believed is decided in mm at first, so that a rig that reads everything some per cent wrong is not
    left with the few points that happen to fit. While the rig is held that tolerance stays, for the misfit does too;
    else it halves from round to round, until 4 σ decide.
    """
    sigma, tau, errors = 0.0, 1.0, np.zeros(seen.used.shape[1])
    used = np.zeros(len(errors), bool)
    tolerance = _ROUGHLY_MM + _ROUGHLY_SHARE * shape.size
    held = not bool(free.any())
    for _ in range(_MAX_ROUNDS):
        scan = _facing(shape, estimate, seen)
        before, slopes = (np.asarray(a[0]) for a in _errors(estimate, scan))
        near = np.abs(before * slopes) <= tolerance
        if not held:
            near |= np.abs(before) <= _LIMIT * sigma
        good = np.asarray(scan.used[0]) & near
        if good.sum() < _FEWEST_POINTS:
            raise InputError(
                f"{int(good.sum())} stripe points of the scan lie on the gauge: at least {_FEWEST_POINTS} are needed; "
                "check its dimensions (mm), and that it is the object that was scanned"
            )
        weight = 1 / (max(sigma, _robust_sigma(before[good])) * tau**0.5)
        scan = eqx.tree_at(
            lambda s: (s.used, s.weights), scan, (jnp.asarray(good)[None], jnp.full(scan.weights.shape, weight))
        )
        outcome = solve(estimate, free, (scan,), _unit(), prior, _FIRST_DAMPING)
        estimate = outcome.estimate
        after = np.asarray(_errors(estimate, scan)[0][0])
        change = float(np.sqrt(np.mean((after - errors)[good] ** 2)))
        turned = int((good != used).sum())
        sigma, errors, used = _robust_sigma(after[good]), after, good
        tau = integrated_correlation(*_by_frame(after, good, seen))
        settled = change <= _SETTLED * sigma and turned <= _SETTLED * good.sum()
        # While points still change sides it does no harm if a solve runs out of steps on its way.
        decided = held or tolerance <= _SMALLEST_TOLERANCE
        if settled and decided and outcome.result == optx.RESULTS.successful:
            return _Fitted(estimate, scan, sigma, tau)
        tolerance = tolerance if held else tolerance / 2
    raise SolveError(
        f"the rig did not settle on the gauge within {_MAX_ROUNDS} rounds: check the gauge's dimensions (mm), and that "
        "it is the object that was scanned"
    )


def _robust_sigma(errors: Float[np.ndarray, "points"]) -> float:
    """From the median of absolute errors while outliers are many, from the mean of squares once they are few."""
    return max(_NORMAL_MAD * float(np.median(np.abs(errors))), _SMALLEST_SIGMA)


def _by_frame(
    errors: Float[np.ndarray, "points"], used: Bool[np.ndarray, "points"], seen: GaugePoints
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The errors frame by frame, in the order of the stripe."""
    ends = np.flatnonzero(np.diff(np.asarray(seen.steps[0]))) + 1
    return np.split(errors, ends), np.split(used, ends)


def _prior(content: RigFile, scan: GaugeScan, doubt: Sequence[str]) -> tuple[Prior, Bool[Array, "leaves"]]:
    """What is known of the rig beforehand, and which of its leaves are not held."""
    unknown = set(doubt) - {"laser", "stage"}
    if unknown:
        raise InputError(f'doubt names {", ".join(sorted(unknown))}: a gauge can put right "laser" and "stage"')
    rig = content.rig
    names = parameter_names(rig)
    mean = np.array([float(leaf) for leaf in jax.tree.leaves(rig)])
    laser = f"laser.{scan.laser}.plane." if scan.laser and len(rig.lasers) > 1 else "laser.plane."
    stems = {"laser": laser, "stage": "stage.per_step."}
    rows, free = [], np.zeros(len(names), bool)
    for part in doubt:
        at = [i for i, name in enumerate(names) if name.startswith(stems[part])]
        root = np.zeros((len(at), len(names)))
        root[range(len(at)), at] = 1 / (_DOUBT * np.linalg.norm(mean[at]))
        rows.append(root)
        free[at] = True
    if content.covariance is not None:
        full = content.covariance.of_leaves(rig)
        at = np.flatnonzero((np.diagonal(full) > 0) & ~free)
        scale = np.sqrt(np.diagonal(full)[at])
        L = np.linalg.cholesky(full[np.ix_(at, at)] / np.outer(scale, scale))
        root = np.zeros((len(at), len(names)))
        root[:, at] = np.linalg.inv(L) / scale
        rows.append(root)
        free[at] = True
    return Prior(jnp.asarray(mean), jnp.asarray(np.concatenate(rows))), jnp.asarray(free)


def _seen(scan: GaugeScan, laser: int) -> GaugePoints:
    """All stripe points of the scan as one padded block, with nothing known yet of where they lie on the gauge."""
    index = np.broadcast_to(np.arange(scan.pixels.shape[1], dtype=float), scan.pixels.shape)
    pixels = np.stack([index, scan.pixels] if scan.columns else [scan.pixels, index], axis=-1)
    steps = np.broadcast_to(np.asarray(scan.steps, float)[:, None], scan.pixels.shape)
    n = scan.pixels.size
    padding = bucket(n) - n

    def flat(values: np.ndarray, fill: float) -> Array:
        flattened = values.reshape(n, *values.shape[2:])
        return jnp.asarray(np.pad(flattened, [(0, padding)] + [(0, 0)] * (flattened.ndim - 1), constant_values=fill))[
            None
        ]

    size = n + padding
    return GaugePoints(
        stripe=flat(pixels, np.nan),
        columns=jnp.full((1, size), scan.columns),
        steps=flat(steps, 0.0),
        laser=jnp.full((1, size), laser, jnp.int32),
        surface=jnp.zeros((1, size, 3)),
        normals=jnp.zeros((1, size, 3)).at[..., 2].set(1.0),
        used=flat(np.isfinite(scan.pixels), 0.0).astype(bool),
        weights=jnp.ones((1, size)),
        laid=jnp.zeros((1, 6)),
        laid_to=jnp.ones((1, 6)),
    )


def _facing(shape: Shape, estimate: Estimate, seen: GaugePoints) -> GaugePoints:
    """The points with the nearest ones of the shape and the normals there; those are used that can tell of them.

    A point whose nearest one is on an edge is off to the side of the shape; a face turned from the camera is not what
    was seen; and where the surface lies nearly along the way on which the stripe moves, it may be anywhere on it.
    """
    rig = estimate.shared[0]
    points, along = (np.asarray(a) for a in _on_object(rig, seen))
    local, at = _in_gauge(estimate, points, seen)
    on, normals, useful = np.array(seen.surface[0]), np.array(seen.normals[0]), np.zeros(len(points), bool)
    on[at], normals[at] = shape.nearest(local)
    away, m = local - on[at], normals[at]
    aside = np.linalg.norm(away - (away * m).sum(axis=1, keepdims=True) * m, axis=1)
    facing = m @ np.asarray(Pose.from_vector(estimate.poses[-1][0]).matrix()).T
    ray = points[at]
    if rig.stage is not None:
        ray = ray + np.asarray(rig.stage.displacement(seen.steps[0]))[at]
    moving = along[at]
    slope = np.abs((facing * moving).sum(axis=1)) / np.linalg.norm(moving, axis=1)
    useful[at] = (aside <= _ASIDE_MM) & ((facing * ray).sum(axis=1) < 0) & (slope >= _GRAZING)
    return eqx.tree_at(
        lambda s: (s.surface, s.normals, s.used),
        seen,
        (jnp.asarray(on)[None], jnp.asarray(normals)[None], jnp.asarray(useful)[None]),
    )


def _distances(shape: Shape, estimate: Estimate, seen: GaugePoints) -> Float[np.ndarray, "points"]:
    """From the surface, mm; NaN where there is no stripe."""
    local, at = _in_gauge(estimate, np.asarray(_on_object(estimate.shared[0], seen)[0]), seen)
    on, _ = shape.nearest(local)
    distances = np.full(seen.used.shape[1], np.nan)
    distances[at] = np.linalg.norm(local - on, axis=1)
    return distances


def _in_gauge(
    estimate: Estimate, points: Float[np.ndarray, "points 3"], seen: GaugePoints
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "n"]]:
    """The points where a stripe is, in the gauge's frame (mm), and which they are."""
    T = Pose.from_vector(estimate.poses[-1][0])
    at = np.flatnonzero(np.asarray(seen.used[0]) & np.isfinite(points).all(axis=1))
    return (points[at] - np.asarray(T.translation)) @ np.asarray(T.matrix()), at


@eqx.filter_jit
def _on_object(rig: Rig, seen: GaugePoints) -> tuple[Float[Array, "points 3"], Float[Array, "points 3"]]:
    """The points of the object frame, mm, and how they move with the stripe, mm a pixel."""
    omegas = jnp.stack([laser.omega for laser in rig.lasers])[seen.laser[0]]
    return jax.vmap(lambda *each: point_of_object(rig, *each))(omegas, seen.stripe[0], seen.columns[0], seen.steps[0])


@eqx.filter_jit
def _errors(estimate: Estimate, scan: GaugePoints) -> tuple[Float[Array, "1 points"], Float[Array, "1 points"]]:
    rig = estimate.shared[0]
    return jax.vmap(lambda pose, scan: gauge_errors(rig, pose, scan))(estimate.poses[-1], scan)
