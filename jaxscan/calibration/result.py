"""What `calibrate` returns: the rig, its covariance, how every photograph fits, and what was left out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.adjustment import Adjustment
from jaxscan.calibration.blocks import reference_step, reference_turn
from jaxscan.calibration.observations import Kept, Observations, StageSequence, Unused, View
from jaxscan.calibration.on_board import stripe_points_in_space
from jaxscan.calibration.rounds import Refined
from jaxscan.files.rig_file import RigFile
from jaxscan.geometry import Pose
from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.rig import Covariance, Rig, System, Turntable
from jaxscan.rig.covariance import with_nearest_centre
from jaxscan.rig.rig import parameter_names
from jaxscan.rig.system import warp_names
from jaxscan.robust import NORMAL_MAD

# Stripe points so many σ off their light are another light's.
_FAR_OFF = 6.0


@dataclass(frozen=True)
class PhotographFit:
    """How one photograph fits.

    Attributes:
        name: of the photograph.
        corner_errors: predicted minus seen (u, v), pixels; NaN where no corner was seen.
        corner_sigmas: σ of each corner along each axis as it was weighted, pixels.
        corner_kept: which corners took part.
        stripe_pixels: (u, v) of the stripe points that were candidates, pixels.
        stripe_errors: predicted minus seen along the axis of detection, pixels.
        stripe_sigmas: σ of each stripe point by itself, pixels.
        stripe_kept: which of them took part.
    """

    name: str
    corner_errors: Float[np.ndarray, "corners 2"]
    corner_sigmas: Float[np.ndarray, "corners"]
    corner_kept: Bool[np.ndarray, "corners"]
    stripe_pixels: Float[np.ndarray, "points 2"]
    stripe_errors: Float[np.ndarray, "points"]
    stripe_sigmas: Float[np.ndarray, "points"]
    stripe_kept: Bool[np.ndarray, "points"]


@dataclass(frozen=True)
class Calibration:
    """A calibrated rig, how it was reached, and what was left out.

    Attributes:
        rig: camera, light planes, stage, turntable; NumPy float64 leaves.
        system: the same with every board pose.
        observations: what it was found from: the usable photographs, with those stripe points that lie on the board.
        covariance: of the rig's parameters; one that was held is not among them.
        board_covariances: view by view, of the rig's parameters and that board's pose together.
        stage_covariances: the same of the pose of each sequence on stage or turntable at motor step 0.
        warp_covariance: of the board's bulge, `warp.x` and `warp.y` (mm); None where the board was taken to be flat.
        corner_sigma_px: σ of a corner along each axis, from the residuals.
        stripe_sigma_px: σ of a stripe point, from the residuals; None without stripes.
        stripe_correlation: how many neighbouring stripe points are worth one, by the correlation of their errors.
        stripe_sigma_ratio: how far these points scatter in parts of what the detector predicted, where it did.
        corner_rms_px: root mean square distance of the corners that were kept.
        stripe_rms_px: root mean square stripe error of the points that were kept; None without stripes.
        fits: view by view.
        stage_fits: photograph by photograph of the sequences on stage and turntable.
        left_out: photographs and stripes that were not used, and why, in words.
        rejected: how many corners and stripe points of which photograph that was used were not, and why, in words.
        notes: what a reader should know.
        warnings: what the rig must not be used without knowing; `rig_file` carries it on.
        kept: which points of each photograph took part, in the order of `Observations.photographs`; what `calibrate`
            takes as `keep`.
        adjustment: the last least-squares problem, NumPy leaves; what `refit` takes.
        solves: how many solves it took until σ, weights and outliers settled.
        settled: whether they did; otherwise the rounds ended by their number. A solve that reached no minimum is an
            error.
        steps: evaluations of the last solve.
        plain: whether every observation took part with the same weight.
    """

    rig: Rig
    system: System
    observations: Observations
    covariance: Covariance
    board_covariances: tuple[Covariance, ...]
    stage_covariances: tuple[Covariance, ...]
    warp_covariance: Covariance | None
    corner_sigma_px: float
    stripe_sigma_px: float | None
    stripe_correlation: float | None
    stripe_sigma_ratio: float | None
    corner_rms_px: float
    stripe_rms_px: float | None
    fits: tuple[PhotographFit, ...]
    stage_fits: tuple[PhotographFit, ...]
    left_out: tuple[str, ...]
    rejected: tuple[str, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    kept: tuple[Kept, ...]
    adjustment: Adjustment
    solves: int
    settled: bool
    steps: int
    plain: bool = False

    def rig_file(self) -> RigFile:
        """What `write_rig` writes."""
        fit = {
            "corner_rms_px": self.corner_rms_px,
            "corner_sigma_px": self.corner_sigma_px,
            "views": len(self.fits),
            "stage_images": sum(len(s.views) for s in self.observations.stages if s.turns is None),
        }
        if turned := [len(s.views) for s in self.observations.stages if s.turns is not None]:
            fit["turntable_images"] = sum(turned)
        if self.stripe_rms_px is not None:
            fit |= {
                "stripe_rms_px": self.stripe_rms_px,
                "stripe_sigma_px": self.stripe_sigma_px,
                "stripe_correlation": self.stripe_correlation,
            }
        if (depths := self._stripe_depths()) is not None:
            fit["stripe_depths_mm"] = depths
        if self.stripe_sigma_ratio is not None:
            fit["stripe_sigma_ratio"] = self.stripe_sigma_ratio
        if self.warnings:
            fit["warnings"] = list(self.warnings)
        return RigFile(self.rig, self.covariance, fit)

    def stripe_points(self, laser: int) -> Float[np.ndarray, "points 3"]:
        """Where a laser's stripes lie on the boards, camera frame, mm; without those that are far from its light."""
        with float64():
            poses = as_float64(self.system.boards).as_vector()
            X, _ = stripe_points_in_space(self.observations, as_float64(self.rig.camera), poses, laser)
        off = np.abs(X @ np.array([float(w) for w in self.rig.lasers[laser].plane]) - 1)
        return X[off <= _FAR_OFF * NORMAL_MAD * np.median(off)] if len(X) else X

    def _stripe_depths(self) -> list[float] | None:
        """The nearest and the farthest depth of a stripe on a board, along the optical axis, mm."""
        seen = [self.stripe_points(i)[:, 2] for i in range(len(self.rig.lasers))]
        depths = np.concatenate(seen) if seen else np.empty(0)
        return [round(float(depths.min()), 1), round(float(depths.max()), 1)] if depths.size else None


def assemble(
    refined: Refined, free: Bool[Array, "shared"], observations: Observations, held: set[str], unused: Unused
) -> Calibration:
    """The result of the last rounds, in the order of the observations that took part; inside a `float64` block."""
    shared = refined.estimate.shared[0]
    adjustment = Adjustment(
        estimate=refined.estimate,
        free=free,
        groups=refined.groups,
        noise=refined.solved_with,
        reference=jnp.asarray([reference_step(stage) for stage in observations.stages]),
        counts=(len(observations.views), len(observations.stages)),
        turned=jnp.asarray([reference_turn(stage) for stage in observations.stages])
        if shared.turntable is not None
        else None,
    )
    system = adjustment.system(refined.estimate)
    rig, (n_views, n_stages) = system.rig, adjustment.counts
    names = parameter_names(rig)
    at = [i for i, name in enumerate(names) if name not in held]
    joint = tuple(with_nearest_centre(np.asarray(blocks), shared, free) for blocks in refined.precision.blocks)
    covariance = with_nearest_centre(np.asarray(refined.precision.covariance), shared, free)[np.ix_(at, at)]
    fits = _photograph_fits(observations.views, refined, 0, len(observations.board.points()))
    stage_fits = sum(
        (
            _stage_fits(stage.views, refined, i, len(observations.board.points()))
            for i, stage in enumerate(observations.stages)
        ),
        (),
    )
    unused = unused.and_then(_rejected((*fits, *stage_fits)))
    corners = np.concatenate([fit.corner_errors[fit.corner_kept] for fit in (*fits, *stage_fits)])
    stripe = np.concatenate([fit.stripe_errors[fit.stripe_kept] for fit in fits])
    return Calibration(
        rig=as_numpy(rig),
        system=as_numpy(system),
        observations=observations,
        covariance=Covariance(tuple(names[i] for i in at), covariance),
        board_covariances=_with_poses(joint[0][:n_views], names, at),
        stage_covariances=tuple(
            _at_step_0(covariance, stage, rig, refined.estimate.poses[1][i])
            for i, (covariance, stage) in enumerate(
                zip(_with_poses(joint[1][:n_stages], names, at) if n_stages else (), observations.stages, strict=True)
            )
        ),
        warp_covariance=_of_warp(refined, len(names)),
        corner_sigma_px=float(refined.noise.corner),
        stripe_sigma_px=refined.stripe_sigma if stripe.size else None,
        stripe_correlation=refined.stripe_correlation if stripe.size else None,
        stripe_sigma_ratio=_sigma_ratio(observations.views, fits),
        corner_rms_px=float(np.sqrt((corners**2).sum(axis=1).mean())),
        stripe_rms_px=float(np.sqrt((stripe**2).mean())) if stripe.size else None,
        fits=fits,
        stage_fits=stage_fits,
        left_out=unused.left_out,
        rejected=unused.rejected,
        notes=observations.notes,
        warnings=(),
        kept=_kept(observations, refined),
        adjustment=as_numpy(adjustment),
        solves=refined.solves,
        settled=refined.settled,
        steps=int(refined.outcome.steps),
    )


def _of_warp(refined: Refined, leaves: int) -> Covariance | None:
    """The covariance of the board's bulge, which stands behind that of so many leaves of the rig."""
    names = warp_names(refined.estimate.shared[1])
    return Covariance(names, np.asarray(refined.precision.covariance)[leaves:, leaves:]) if names else None


_POSE = tuple(f"board.{part}.{i}" for part in ("rotation", "translation") for i in range(3))


def _with_poses(joint: Float[np.ndarray, "blocks n n"], names: list[str], at: list[int]) -> tuple[Covariance, ...]:
    """The covariance of the free rig parameters and the pose, for each board of a group."""
    kept = np.array([*at, *range(joint.shape[1] - len(_POSE), joint.shape[1])])
    return tuple(Covariance((*(names[i] for i in at), *_POSE), matrix[np.ix_(kept, kept)]) for matrix in joint)


def _at_step_0(covariance: Covariance, sequence: StageSequence, rig: Rig, pose: Float[Array, "6"]) -> Covariance:
    """From the pose at a sequence's mean step to that at step 0: t₀ = t − mean · per_step, or turned back."""
    J = np.eye(len(covariance.names))
    if rig.turntable is not None and sequence.turns is not None:
        names = [*(name for name in covariance.names if name.startswith("turntable.")), *_POSE]
        at = [covariance.names.index(name) for name in names]
        J[np.ix_(at[-len(_POSE) :], at)] = _turned_back(rig.turntable, jnp.asarray(reference_turn(sequence)), pose)
    else:
        mean = reference_step(sequence)
        for i in range(3):
            name = f"stage.per_step.{i}"
            if name in covariance.names:
                J[covariance.names.index(f"board.translation.{i}"), covariance.names.index(name)] = -mean
    return Covariance(covariance.names, J @ covariance.matrix @ J.T)


@jax.jit
def _turned_back(turntable: Turntable, steps: Float[Array, ""], pose: Float[Array, "6"]) -> Float[Array, "6 12"]:
    """How a pose, turned back by so many steps, moves with the turntable's six numbers and with the pose."""
    numbers, unravel = ravel_pytree((turntable, pose))

    def back(numbers: Float[Array, "12"]) -> Float[Array, "6"]:
        turntable, pose = unravel(numbers)
        return (turntable.turned(-steps) @ Pose.from_vector(pose)).as_vector()

    return jax.jacfwd(back)(numbers)


def _kept(observations: Observations, refined: Refined) -> tuple[Kept, ...]:
    """What took part in the last solve, photograph by photograph."""
    each = len(observations.board.points())
    boards = [(view,) for view in observations.views], [stage.views for stage in observations.stages]
    kept = []
    for blocks, group in zip(boards, refined.groups, strict=False):
        rows = zip(blocks, np.asarray(group.corner_used), np.asarray(group.stripe_used), strict=False)
        for views, corners, stripe in rows:
            at = 0
            for i, view in enumerate(views):
                stripes = []
                for seen in view.stripes:
                    stripes.append(stripe[at : at + len(seen.pixels)])
                    at += len(seen.pixels)
                kept.append(Kept(corners[i * each : (i + 1) * each], tuple(stripes)))
    return tuple(kept)


def _photograph_fits(views: Sequence[View], refined: Refined, group: int, each: int) -> tuple[PhotographFit, ...]:
    blocks = refined.groups[group]
    corner, stripe = (np.asarray(x) for x in refined.errors[group])
    corner_kept, stripe_kept = np.asarray(blocks.corner_used), np.asarray(blocks.stripe_used)
    corner_sigmas = _sigmas(float(refined.noise.corner), blocks.weights)
    stripe_sigmas = _sigmas(refined.stripe_sigma, blocks.stripe_weights)
    fits = []
    for i, view in enumerate(views):
        pixels = np.concatenate([s.pixels for s in view.stripes]) if view.stripes else np.zeros((0, 2))
        candidate = np.isfinite(pixels).all(axis=1)
        fits.append(
            PhotographFit(
                name=view.name,
                corner_errors=np.where(view.used()[:, None], corner[i, :each], np.nan),
                corner_sigmas=corner_sigmas[i, :each],
                corner_kept=corner_kept[i, :each],
                stripe_pixels=pixels[candidate],
                stripe_errors=stripe[i, : len(pixels)][candidate],
                stripe_sigmas=stripe_sigmas[i, : len(pixels)][candidate],
                stripe_kept=stripe_kept[i, : len(pixels)][candidate],
            )
        )
    return tuple(fits)


def _sigma_ratio(views: Sequence[View], fits: Sequence[PhotographFit]) -> float | None:
    """How far the stripe points that were kept scatter, in parts of the σ that the detector gave each of them.

    Each error is compared with its own σ, and the median is taken: a few points on dark squares have a σ a hundred
    times as large as the others, and say nothing of these.
    """
    scaled = []
    for view, fit in zip(views, fits, strict=True):
        predicted = [s.sigmas if s.sigmas is not None else np.full(len(s.pixels), np.nan) for s in view.stripes]
        if predicted:
            candidate = np.isfinite(np.concatenate([s.pixels for s in view.stripes])).all(axis=1)
            own = np.concatenate(predicted)[candidate][fit.stripe_kept]
            scaled.append(np.abs(fit.stripe_errors[fit.stripe_kept]) / own)
    known = np.concatenate(scaled) if scaled else np.zeros(0)
    known = known[np.isfinite(known)]
    return NORMAL_MAD * float(np.median(known)) if known.size else None


def _stage_fits(views: Sequence[View], refined: Refined, sequence: int, each: int) -> tuple[PhotographFit, ...]:
    corner = np.asarray(refined.errors[1][0][sequence]).reshape(-1, each, 2)
    blocks = refined.groups[1]
    kept = np.asarray(blocks.corner_used[sequence]).reshape(-1, each)
    sigmas = _sigmas(float(refined.noise.corner), blocks.weights[sequence]).reshape(-1, each)
    none: Any = np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0, bool)
    return tuple(
        PhotographFit(view.name, np.where(view.used()[:, None], corner[i], np.nan), sigmas[i], kept[i], *none)
        for i, view in enumerate(views)
    )


def _sigmas(sigma: float, weights: Float[Array, "*any"]) -> Float[np.ndarray, "*any"]:
    """The σ that weights stand for; infinite where one is zero."""
    relative = np.asarray(weights)
    return np.divide(sigma, relative, out=np.full(relative.shape, np.inf), where=relative > 0)


def _rejected(fits: Sequence[PhotographFit]) -> Unused:
    """What the rounds threw out, photograph by photograph: wholly, or some of its points."""
    unused = Unused()
    for fit in fits:
        seen = np.isfinite(fit.corner_errors).all(axis=1)
        corners = np.flatnonzero(seen & ~fit.corner_kept)
        if corners.size:
            worst = np.nanmax(np.linalg.norm(fit.corner_errors[corners], axis=1))
            some = f" (numbers {', '.join(map(str, corners))}; the worst" if fit.corner_kept.any() else " (the worst"
            line = f"{fit.name}: {corners.size} of {int(seen.sum())} corners rejected{some} {worst:.2f} px off)"
            unused = unused.add(line, wholly=not fit.corner_kept.any())
        points = fit.stripe_kept.size - int(fit.stripe_kept.sum())
        if points:
            line = f"{fit.name}: {points} of {fit.stripe_kept.size} stripe points rejected"
            unused = unused.add(line, wholly=not fit.stripe_kept.any())
    return unused
