"""`refine_by_gauge`: scans of objects of known shape correct the light planes and the stage of a rig.

Unknown are the rig and where each gauge stood. The stripe points of their scans give residuals in detector pixels
(`gauge_residuals`). What the boards had to say of the rig comes in either as they left it, the rig's own mean and
covariance as a prior; or, with a finished calibration, as its corners and stripes themselves, in one solve. Of a part
that is not trusted (a laser that was pushed) the prior is very wide, and the photographs are not used.

Nearest points of the shapes, outliers, σ and the solve take turns until they stand still.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from typing import Any, Final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float
from scipy.stats import chi2

from jaxscan.calibration.bundle import Prior, solve
from jaxscan.calibration.correlation import integrated_correlation
from jaxscan.calibration.gauge_points import (
    Gauge,
    GaugeScan,
    Level,
    distances,
    errors,
    facing,
    levels_read,
    on_object,
    stripe_points,
)
from jaxscan.calibration.gauge_residuals import GaugePoints
from jaxscan.calibration.residuals import Blocks, Noise
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.uncertainty import Precision, arrow_precision
from jaxscan.errors import InputError, SolveError
from jaxscan.files.rig_file import RigFile
from jaxscan.geometry import Pose
from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.rig import Covariance, Rig, System
from jaxscan.rig.light import light_axes
from jaxscan.rig.line import Line
from jaxscan.rig.rig import held_jacobian, idle_ways, parameter_names, with_normal_numbers
from jaxscan.robust import NORMAL_MAD

# Left out beyond this many σ.
_LIMIT: Final = 4.0
# The first round trusts a point that is off by no more than this: a rig may read a gauge some per cent wrong.
_ROUGHLY_MM, _ROUGHLY_SHARE = 0.3, 0.08
_FEWEST_POINTS = 100
_MAX_ROUNDS = 30
# How well the initial alignment of a gauge determines its pose, radians and mm.
_TURN_TO, _NO_TURN, _SHIFT_TO = 0.1, 1e-6, 10.0
_FIRST_DAMPING = 1e-12
_SETTLED = 0.01
_SMALLEST_SIGMA = 1e-3
_SMALLEST_TOLERANCE = 0.02
# What a gauge can correct, and how well it is known where it is not trusted, as a share of itself: a laser that was
# pushed by some 3 degrees.
_CORRECTED = frozenset({"laser", "stage"})
_NOT_TRUSTED = 0.05
# Where all agree the rig moves further than is said in this part of all cases; a gauge that fits less well by this
# factor than before is another.
_BY_CHANCE, _WORSE = 1e-4, 1.2
# A level is off beyond this many times what chance makes of its mean, and beyond this part of a point's error.
_SURE, _OF_A_POINT = 6.0, 0.5


@dataclass(frozen=True)
class GaugeReading:
    """How one gauge reads by the refined rig.

    Attributes:
        pose: T_cam_gauge at motor step 0.
        points: how many stripe points took part.
        rejected: how many were seen on the gauge's surroundings, at grazing angles, or beyond 4 σ.
        stripe_sigma_px: σ of a stripe point, from the residuals.
        correlation: how many neighbouring points are worth one.
        rms_before_mm: RMS distance of the points that took part from the gauge's surface, by the rig as it was,
            with the gauge aligned as well as possible.
        rms_after_mm: the same by the refined rig.
        levels: how level faces read by the refined rig; none of other shapes.
    """

    pose: Pose
    points: int
    rejected: int
    stripe_sigma_px: float
    correlation: float
    rms_before_mm: float
    rms_after_mm: float
    levels: tuple[Level, ...] = ()

    def is_off(self, level: Level) -> bool:
        """Whether a level reads another height than it has, beyond chance and by more than a point's error is."""
        off = abs(level.read_mm - level.known_mm)
        chance = _SURE * self.rms_after_mm * (self.correlation / max(level.points, 1)) ** 0.5
        return off > max(chance, _OF_A_POINT * self.rms_after_mm)


@dataclass(frozen=True)
class GaugeFit:
    """A rig refined by gauges.

    Attributes:
        rig: the refined rig.
        covariance: of its parameters; one that neither the boards nor a gauge know anything of was held.
        gauges: gauge by gauge.
        from_prior_in_sigma: how far the rig moved from what was known of it, in standard deviations.
        by_chance_in_sigma: where gauges and boards agree, it moves by more than this in one of ten thousand.
    """

    rig: Rig
    covariance: Covariance
    gauges: tuple[GaugeReading, ...]
    from_prior_in_sigma: float
    by_chance_in_sigma: float

    @property
    def contradictions(self) -> tuple[str, ...]:
        """What gauges and boards do not agree in, sentences without their full stops; none where they agree."""
        found = []
        if self.from_prior_in_sigma > self.by_chance_in_sigma:
            found.append(
                f"The gauge contradicts what was known of the rig, which would have moved by "
                f"{self.from_prior_in_sigma:.1f} standard deviations, {self.by_chance_in_sigma:.1f} at most by chance. "
                "Check the gauge's dimensions, and what has moved since the calibration (--trust)"
            )
        for gauge in self.gauges:
            if gauge.rms_after_mm > _WORSE * gauge.rms_before_mm:
                found.append(
                    "The gauge does not have the stated shape: its points are "
                    f"{gauge.rms_after_mm:.3f} mm RMS from its surface, and were {gauge.rms_before_mm:.3f} mm from it "
                    "before the rig was refined. Check its dimensions"
                )
            found += [
                f"No point lies on the gauge's level of {level.known_mm:g} mm: check its dimensions, and what "
                "else stood there"
                for level in gauge.levels
                if not level.points
            ]
            if off := [level for level in gauge.levels if gauge.is_off(level)]:
                read = ", ".join(f"{level.known_mm:g} reads {level.read_mm:.3f}" for level in off)
                found.append(f"Levels of the gauge do not fit together: {read} mm. Check its dimensions")
        return tuple(found)

    def rig_file(self, fit: dict[str, Any] | None = None, warnings: Sequence[str] = ()) -> RigFile:
        """What `write_rig` writes.

        Args:
            fit: what else the earlier fit had to say.
            warnings: what else the rig must not be used without knowing, beside the contradictions.
        """
        words = {
            "gauge_points": [gauge.points for gauge in self.gauges],
            "gauge_rms_mm": [gauge.rms_after_mm for gauge in self.gauges],
            "gauge_sigma_px": [gauge.stripe_sigma_px for gauge in self.gauges],
        }
        fit = fit or {}
        said = [*fit.get("warnings", ()), *self.contradictions, *warnings]
        return RigFile(self.rig, self.covariance, {**fit, **words, **({"warnings": said} if said else {})})


def refine_by_gauge(
    known: RigFile | Calibration, gauges: Sequence[Gauge], trust: Sequence[str] = ("stage",)
) -> GaugeFit:
    """Refine a rig so that scanned objects have the shapes that they are known to have.

    Args:
        known: a rig, with its covariance where there is one; without it, what is trusted is held. Or a calibration,
            whose photographs then take part in the solve themselves, at its inliers, weights and σ.
        gauges: one gauge in several places, or several.
        trust: parts of the rig whose values hold as well as their covariance says: "laser", those that lit the gauges,
            and "stage". Of the others the known values are only a rough start.

    Raises:
        InputError: a shape is not found in its scan, or too few points lie on it.
        SolveError: no minimum was reached.
    """
    if unknown := set(trust) - _CORRECTED:
        raise InputError(f'trust names {", ".join(sorted(unknown))}: a gauge corrects "laser" and "stage"')
    if moved := light_axes(known.rig.lights):
        raise InputError(
            f"the light of this rig is moved by {', '.join(moved)}: a gauge corrects lights that stand "
            "still; calibrate again with boards"
        )
    with float64():
        boards = _boards(known, gauges, _CORRECTED - set(trust))
        rig = boards.system.rig
        seen = stripe_points(gauges, rig)
        seen = _laid_in(gauges, rig, seen)
        first = System(rig, (*boards.system.poses, seen.laid), boards.system.shape)
        # The gauges are aligned first, with the rig as it is.
        laid = _fit(gauges, seen, first, boards, jnp.zeros_like(boards.free))
        fitted = _fit(gauges, seen, laid.system, boards, boards.free)
        refined = fitted.system.rig
        names = parameter_names(rig)
        known_of = np.array(boards.free)[: len(names)]
        for way in idle_ways(rig):
            # A number that says nothing of its own is known as soon as the others of its way are.
            known_of[way != 0] |= known_of[way != 0].any()
        at = np.flatnonzero(known_of)
        matrix = with_normal_numbers(fitted.precision.covariance, refined, boards.free)
        covariance = Covariance(tuple(names[i] for i in at), matrix[np.ix_(at, at)])
        shift = np.asarray(boards.prior_all.root) @ (
            np.asarray(ravel_pytree(refined)[0]) - np.asarray(boards.prior_all.mean)
        )
        return GaugeFit(
            rig=as_numpy(refined.normal()),
            covariance=covariance,
            gauges=_readings(gauges, seen, laid, fitted),
            from_prior_in_sigma=float(np.linalg.norm(shift)),
            by_chance_in_sigma=float(np.sqrt(chi2.isf(_BY_CHANCE, len(shift)))),
        )


@dataclass(frozen=True)
class _Boards:
    """What the boards contribute to the solve of the rig: a prior, or photographs.

    Attributes:
        system: the rig, and the poses of the photographs' boards.
        free: which shared parameters are refined.
        groups: the photographs.
        noise: their σ.
        prior: what is known without them.
        prior_all: all that is known without the gauges, by photographs or otherwise.
    """

    system: System
    free: Bool[Array, "shared"]
    groups: tuple[Blocks, ...]
    noise: Noise
    prior: Prior
    prior_all: Prior


def _boards(known: RigFile | Calibration, gauges: Sequence[Gauge], free: Set[str]) -> _Boards:
    content = known if isinstance(known, RigFile) else known.rig_file()
    rig = as_float64(content.rig)
    lit = {rig.lights.index(rig.light(gauge.scan.laser)) for gauge in gauges} if "laser" in free else set()
    stems = [f"lights.{i}." for i in sorted(lit)]
    line = f"motion.stage.{Line.of_the_line}."
    # Its direction alone: how it differs from a line is as the photographs determined it.
    stems += [line] if "stage" in free else []
    roughly, wide = _roughly(rig, stems)
    known_well, free_leaves = _trusted(content, wide)
    mean = jnp.asarray([float(leaf) for leaf in jax.tree.leaves(rig)])
    prior_all = Prior(mean, jnp.asarray(np.concatenate([roughly, known_well])))
    if isinstance(known, RigFile):
        unit = Noise.create()
        return _Boards(System(rig, ()), jnp.asarray(free_leaves), (), unit, prior_all, prior_all)
    adjustment = jax.tree.map(jnp.asarray, known.adjustment)
    pushed = jnp.asarray([i in lit for i in range(len(rig.lights))])
    groups = tuple(
        replace(
            group,
            corner_used=group.corner_used & (not group.q or "stage" not in free),
            stripe_used=group.stripe_used & ~pushed[group.stripe_light] & (not group.q or "stage" not in free),
        )
        for group in adjustment.groups
    )
    corner, stripe = known.corner_sigma_px, (known.stripe_sigma_px or 1.0) * (known.stripe_correlation or 1.0) ** 0.5
    noise = adjustment.noise.of(corner, stripe)
    if "stage" in free:
        # The other axes are known through where the stage stood: no photograph of them is used, and they are held.
        others = [n.startswith("motion.") and not n.startswith(line) for n in parameter_names(rig)]
        free_leaves[np.array(others)] = False
    # The calibration's own solution, but for the numbers of the rig that say nothing of their own.
    system = System(rig, adjustment.start.poses, adjustment.start.shape)
    # The board's shape, which follows the rig, is determined by the photographs.
    terms = len(jax.tree.leaves(system.shape))
    prior = Prior(jnp.pad(mean, (0, terms)), jnp.pad(jnp.asarray(roughly), ((0, 0), (0, terms))))
    free_leaves = np.pad(free_leaves, (0, terms), constant_values=True)
    return _Boards(system, jnp.asarray(free_leaves), groups, noise, prior, prior_all)


def _roughly(rig: Rig, stems: Sequence[str]) -> tuple[Float[np.ndarray, "rows leaves"], Bool[np.ndarray, "leaves"]]:
    """The root of the precision of what is not trusted, the leaves whose names begin so; and which these are."""
    names = parameter_names(rig)
    values = np.array([float(leaf) for leaf in jax.tree.leaves(rig)])
    precisions = np.zeros(len(names))
    for stem in stems:
        at = [i for i, name in enumerate(names) if name.startswith(stem)]
        precisions[at] = 1 / (_NOT_TRUSTED * np.linalg.norm(values[at])) if at else 0.0
    return np.diag(precisions)[precisions > 0], precisions > 0


def _trusted(
    content: RigFile, wide: Bool[np.ndarray, "leaves"]
) -> tuple[Float[np.ndarray, "rows leaves"], Bool[np.ndarray, "leaves"]]:
    """The root of the precision of all else, by the rig's covariance; and what of the rig is not held."""
    if content.covariance is None:
        return np.zeros((0, len(wide))), wide
    full = content.covariance.of_leaves(content.rig)
    J = held_jacobian(content.rig)
    full = J @ full @ J.T
    at = np.flatnonzero((np.diagonal(full) > 0) & ~wide)
    scale = np.sqrt(np.diagonal(full)[at])
    L = np.linalg.cholesky(full[np.ix_(at, at)] / np.outer(scale, scale))
    root = np.zeros((len(at), len(wide)))
    root[:, at] = np.linalg.inv(L) / scale
    return root, wide | (np.diagonal(full) > 0)


def _laid_in(gauges: Sequence[Gauge], rig: Rig, seen: GaugePoints) -> GaugePoints:
    """The points with the pose in which each gauge, roughly, is found among them."""
    points = np.asarray(on_object(rig, seen)[0])
    poses = []
    for gauge, cloud in zip(
        gauges, (p[used] for p, used in zip(points, np.asarray(seen.used), strict=True)), strict=True
    ):
        if len(cloud) < _FEWEST_POINTS:
            raise InputError(
                f"{len(cloud)} stripe points in the scan of the gauge: at least {_FEWEST_POINTS} are needed"
            )
        poses.append(gauge.shape.stand(cloud).as_vector())
    # Almost nothing beside the information of a scan; but a scan of a ball does not determine its rotation.
    known_to = [[_TURN_TO if gauge.shape.turns else _NO_TURN] * 3 + [_SHIFT_TO] * 3 for gauge in gauges]
    return eqx.tree_at(lambda s: (s.laid, s.laid_to), seen, (jnp.asarray(np.stack(poses)), jnp.array(known_to)))


@dataclass(frozen=True)
class _Fitted:
    """Where rounds of nearest points and solves ended, the information of the last, and σ and τ of each scan."""

    system: System
    scans: GaugePoints
    precision: Precision
    sigma: Float[np.ndarray, "scans"]
    correlation: Float[np.ndarray, "scans"]


def _fit(
    gauges: Sequence[Gauge], seen: GaugePoints, system: System, boards: _Boards, free: Bool[Array, "shared"]
) -> _Fitted:
    """Nearest points, outliers, σ and the solve in turn.

    Which points are prior_all is decided in mm at first, so that a rig that reads everything some per cent wrong is not
    left with the few points that happen to fit. While the rig is held that tolerance stays, for the misfit does too;
    else it halves from round to round, until 4 σ decide.
    """
    sigma, tau = np.zeros(len(gauges)), np.ones(len(gauges))
    used, after = np.zeros(seen.used.shape, bool), np.zeros(seen.used.shape)
    tolerance = np.array([_ROUGHLY_MM + _ROUGHLY_SHARE * gauge.shape.size for gauge in gauges])
    held = not bool(free.any())
    for _ in range(_MAX_ROUNDS):
        scans = facing(gauges, system, seen)
        before, slopes = (np.asarray(a) for a in errors(system, scans))
        near = np.abs(before * slopes) <= tolerance[:, None]
        if not held:
            near |= np.abs(before) <= _LIMIT * sigma[:, None]
        good = np.asarray(scans.used) & near
        _enough(good)
        weights = 1 / (np.maximum(sigma, _robust_sigmas(before, good)) * tau**0.5)
        scans = eqx.tree_at(
            lambda s: (s.used, s.weights),
            scans,
            (jnp.asarray(good), jnp.asarray(np.broadcast_to(weights[:, None], good.shape))),
        )
        outcome = solve(system, free, (*boards.groups, scans), boards.noise, boards.prior, _FIRST_DAMPING)
        system, earlier = outcome.system, after
        after = np.asarray(errors(system, scans)[0])
        change = np.sqrt(((after - earlier) ** 2).sum(axis=1, where=good) / good.sum(axis=1))
        sides = (good != used).sum(axis=1)
        sigma, used = _robust_sigmas(after, good), good
        tau = np.array(
            [
                integrated_correlation(*_by_frame(*each, gauges[i].scan))
                for i, each in enumerate(zip(after, good, strict=True))
            ]
        )
        settled = bool(np.all((change <= _SETTLED * sigma) & (sides <= _SETTLED * good.sum(axis=1))))
        # While points still change sides it does no harm if a solve runs out of steps on its way.
        decided = held or bool(np.all(tolerance <= _SMALLEST_TOLERANCE))
        if settled and decided and outcome.result == optx.RESULTS.successful:
            known = arrow_precision(outcome.jacobian)
            return _Fitted(system, scans, known, sigma, tau)
        tolerance = tolerance if held else tolerance / 2
    raise SolveError(
        f"the rig did not settle on the gauge within {_MAX_ROUNDS} rounds: check the gauge's dimensions (mm), and that "
        "it is the object that was scanned"
    )


def _enough(good: Bool[np.ndarray, "scans points"]) -> None:
    for i, count in enumerate(good.sum(axis=1)):
        if count < _FEWEST_POINTS:
            which = f"scan {i + 1}" if len(good) > 1 else "the scan"
            raise InputError(
                f"{int(count)} stripe points of {which} lie on the gauge: at least {_FEWEST_POINTS} are needed; "
                "check its dimensions (mm), and that it is the object that was scanned"
            )


def _robust_sigmas(
    errors: Float[np.ndarray, "scans points"], used: Bool[np.ndarray, "scans points"]
) -> Float[np.ndarray, "scans"]:
    """σ of each scan, from the median of absolute errors, pixels."""
    medians = [float(np.median(np.abs(e[u]))) for e, u in zip(errors, used, strict=True)]
    return np.maximum(NORMAL_MAD * np.array(medians), _SMALLEST_SIGMA)


def _by_frame(
    errors: Float[np.ndarray, "points"], used: Bool[np.ndarray, "points"], scan: GaugeScan
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The errors of a scan frame by frame, in the order of the stripe; padding goes with the last."""
    ends = np.arange(1, len(scan.pixels)) * scan.pixels.shape[1]
    return np.split(errors, ends), np.split(used, ends)


def _readings(gauges: Sequence[Gauge], seen: GaugePoints, laid: _Fitted, fitted: _Fitted) -> tuple[GaugeReading, ...]:
    """How the gauges read."""
    used = np.asarray(fitted.scans.used)
    before, after = (distances(gauges, fit.system, seen) for fit in (laid, fitted))
    return tuple(
        GaugeReading(
            pose=as_numpy(Pose.from_vector(fitted.system.poses[-1][i])),
            points=int(used[i].sum()),
            rejected=int(np.asarray(seen.used[i]).sum()) - int(used[i].sum()),
            stripe_sigma_px=float(fitted.sigma[i]),
            correlation=float(fitted.correlation[i]),
            rms_before_mm=float(np.sqrt((before[i, used[i]] ** 2).mean())),
            rms_after_mm=float(np.sqrt((after[i, used[i]] ** 2).mean())),
            levels=levels_read(gauges[i], fitted.system, fitted.scans, i),
        )
        for i in range(len(gauges))
    )
