"""The `Calibration` of a solve that ended: covariances of rig and poses, and how each photograph fits.

The pose of a moved board is solved for at the mean of its positions. Here it is brought back to where all axes
stand at 0, with its covariance.
"""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.adjustment import Adjustment, pose_at_0
from jaxscan.calibration.blocks import photographs_in_blocks
from jaxscan.calibration.bundle import Factor
from jaxscan.calibration.observations import InlierMask, Observations, Unused, View
from jaxscan.calibration.result import Calibration, PhotographFit
from jaxscan.calibration.rounds import Refined
from jaxscan.precision import as_numpy
from jaxscan.rig import Covariance, Motion, Positions, Rig
from jaxscan.rig.rig import parameter_names, with_normal_numbers
from jaxscan.robust import NORMAL_MAD

_POSE = tuple(f"board.{part}.{i}" for part in ("rotation", "translation") for i in range(3))


def assemble(
    refined: Refined,
    free: Bool[Array, "shared"],
    observations: Observations,
    held: set[str],
    unused: Unused,
    factors: tuple[Factor, ...],
) -> Calibration:
    """The result of the last rounds, in the order of the observations that took part; inside a `float64` block."""
    solved = refined.system.rig
    adjustment = Adjustment(
        start=refined.system,
        free=free,
        groups=refined.groups,
        factors=factors,
        noise=refined.solved_with,
        counts=(len(observations.views), len(observations.sequences)),
    )
    adjustment = as_numpy(adjustment)
    system = as_numpy(adjustment.finished(adjustment.start))
    rig, (n_views, n_sequences) = system.rig, adjustment.counts
    names = parameter_names(rig)
    at = [i for i, name in enumerate(names) if name not in held]
    joint = tuple(_at_0(refined, group, solved, free) for group in range(len(refined.groups)))
    # Without the boards' own bends.
    joint = tuple(matrix[:, : len(free) + len(_POSE), : len(free) + len(_POSE)] for matrix in joint)
    covariance = with_normal_numbers(refined.precision.covariance, solved, free)[np.ix_(at, at)]
    fits = _photograph_fits(observations, refined)
    fits, moved_fits = fits[:n_views], fits[n_views:]
    unused = unused.and_then(rejected_points((*fits, *moved_fits)))
    corners = np.concatenate([fit.corner_errors[fit.corner_kept] for fit in (*fits, *moved_fits)])
    stripe = np.concatenate([fit.stripe_errors[fit.stripe_kept] for fit in (*fits, *moved_fits)])
    return Calibration(
        rig=rig,
        system=system,
        observations=observations,
        covariance=Covariance(tuple(names[i] for i in at), covariance),
        board_covariances=_with_poses(joint[0][:n_views], names, at),
        moved_covariances=_with_poses(joint[1][:n_sequences], names, at) if n_sequences else (),
        shape_covariance=_of_shape(refined, len(names)),
        bend_sigma_mm=None if refined.noise.bend is None else float(refined.noise.bend),
        corner_sigma_px=float(refined.noise.corner),
        stripe_sigma_px=refined.stripe_sigma if stripe.size else None,
        stripe_correlation=refined.stripe_correlation if stripe.size else None,
        stripe_sigma_ratio=_sigma_ratio(observations.photographs(), (*fits, *moved_fits)),
        corner_rms_px=float(np.sqrt((corners**2).sum(axis=1).mean())),
        stripe_rms_px=float(np.sqrt((stripe**2).mean())) if stripe.size else None,
        fits=fits,
        moved_fits=moved_fits,
        left_out=unused.left_out,
        rejected=unused.rejected,
        notes=observations.notes,
        warnings=(),
        kept=_kept(observations, refined),
        adjustment=adjustment,
        solves=refined.solves,
        settled=refined.settled,
        steps=int(refined.outcome.steps),
    )


def _of_shape(refined: Refined, leaves: int) -> Covariance | None:
    """The covariance of the board's shape, which follows that of the rig's first `leaves` parameters."""
    names = tuple(refined.system.shared_names()[leaves:])
    return Covariance(names, refined.precision.covariance[leaves:, leaves:]) if names else None


def _with_poses(joint: Float[np.ndarray, "blocks n n"], names: list[str], at: list[int]) -> tuple[Covariance, ...]:
    """The covariance of the free rig parameters and the pose, for each board of a group."""
    kept = np.array([*at, *range(joint.shape[1] - len(_POSE), joint.shape[1])])
    return tuple(Covariance((*(names[i] for i in at), *_POSE), matrix[np.ix_(kept, kept)]) for matrix in joint)


def _at_0(refined: Refined, group: int, rig: Rig, free: Bool[Array, "shared"]) -> Float[np.ndarray, "blocks n n"]:
    """The covariance of what is shared and of each block's pose, that of a moved board with all axes at 0."""
    blocks, joint = refined.groups[group], refined.precision.blocks[group]
    if blocks.q:
        # By the rig as it was solved, whose surplus numbers were held: their rows are no covariance yet.
        known = np.concatenate([np.asarray(free, float), np.ones(joint.shape[-1] - len(free))])
        joint = joint * known[:, None] * known
        J = np.broadcast_to(np.eye(joint.shape[-1]), joint.shape).copy()
        motion = [i for i, name in enumerate(parameter_names(rig)) if name.startswith("motion.")]
        pose = slice(len(free), len(free) + len(_POSE))
        by = [*motion, *range(pose.start, pose.stop)]
        sigma = np.sqrt(np.diagonal(joint, axis1=1, axis2=2))[:, by]
        poses, reference = np.asarray(refined.system.poses[group])[:, :6], as_numpy(blocks.reference)
        J[:, pose, by] = _moved_back(as_numpy(rig.motion), poses, reference, sigma)
        joint = J @ joint @ J.swapaxes(-1, -2)
    return with_normal_numbers(joint, rig, free)


def _moved_back(
    motion: Motion,
    poses: Float[np.ndarray, "blocks 6"],
    reference: Positions,
    sigma: Float[np.ndarray, "blocks n"],
) -> Float[np.ndarray, "blocks 6 n"]:
    """How poses brought back to where all axes stand at 0 move with the motion's numbers and with themselves.

    By differences over ±σ of each, which spares compiling derivatives; where σ is 0 nothing is asked, and 0 is given.
    """
    numbers, structure = jax.tree.flatten(motion)
    moved = np.zeros((*poses.shape, sigma.shape[1]))
    for b, (pose, own) in enumerate(zip(poses, sigma, strict=True)):
        there = {axis: np.asarray(steps[b]) for axis, steps in reference.items()}
        at = np.concatenate([numbers, pose])
        for i in np.flatnonzero(own > 0):
            ends = []
            for step in (own[i], -own[i]):
                off = at.copy()
                off[i] += step
                one = jax.tree.unflatten(structure, [np.asarray(number) for number in off[: len(numbers)]])
                ends.append(pose_at_0(one, off[len(numbers) :], there))
            moved[b, :, i] = _difference(*ends) / (2 * own[i])
    return moved


def _difference(one: Float[np.ndarray, "6"], other: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
    """Of two poses that are near each other, whose rotation vectors may stand on either side of half a turn."""
    way = one - other
    if (angle := float(np.linalg.norm(other[:3]))) and float(np.linalg.norm(way[:3])) > np.pi:
        way[:3] += 2 * np.pi / angle * other[:3]
    return way


def _kept(observations: Observations, refined: Refined) -> tuple[InlierMask, ...]:
    """What took part in the last solve, photograph by photograph."""
    masks = [(np.asarray(group.corner_used), np.asarray(group.stripe_used)) for group in refined.groups]
    kept = []
    for view, group, i, k in photographs_in_blocks(observations):
        corners, stripe = (mask[i, k] for mask in masks[group])
        ends = np.cumsum([len(seen.pixels) for seen in view.stripes])
        kept.append(InlierMask(corners, tuple(np.split(stripe[: ends[-1]], ends[:-1])) if view.stripes else ()))
    return tuple(kept)


def _photograph_fits(observations: Observations, refined: Refined) -> tuple[PhotographFit, ...]:
    arrays = []
    for blocks, (corner, stripe) in zip(refined.groups, refined.errors, strict=True):
        corner_sigmas = _sigmas(float(refined.noise.corner), blocks.weights)
        stripe_sigmas = _sigmas(refined.stripe_sigma, blocks.stripe_weights)
        kept = np.asarray(blocks.corner_used), np.asarray(blocks.stripe_used)
        arrays.append((np.asarray(corner), corner_sigmas, kept[0], np.asarray(stripe), stripe_sigmas, kept[1]))
    fits = []
    for view, group, i, k in photographs_in_blocks(observations):
        corner, corner_sigmas, corner_kept, stripe, stripe_sigmas, stripe_kept = (x[i, k] for x in arrays[group])
        pixels = np.concatenate([s.pixels for s in view.stripes]) if view.stripes else np.zeros((0, 2))
        candidate = np.isfinite(pixels).all(axis=1)
        n = len(pixels)
        fits.append(
            PhotographFit(
                name=view.name,
                corner_errors=np.where(view.used()[:, None], corner, np.nan),
                corner_sigmas=corner_sigmas,
                corner_kept=corner_kept,
                stripe_pixels=pixels[candidate],
                stripe_errors=stripe[:n][candidate],
                stripe_sigmas=stripe_sigmas[:n][candidate],
                stripe_kept=stripe_kept[:n][candidate],
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


def _sigmas(sigma: float, weights: Float[Array, "*any"]) -> Float[np.ndarray, "*any"]:
    """The σ that weights stand for; infinite where one is zero."""
    relative = np.asarray(weights)
    return np.divide(sigma, relative, out=np.full(relative.shape, np.inf), where=relative > 0)


def rejected_points(fits: Sequence[PhotographFit]) -> Unused:
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
