"""The joint solve of a calibration once more, on a part of its photographs.

What is left out is masked, not removed, so the arrays keep their shapes and nothing compiles anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.blocks import stage_blocks, view_blocks
from jaxscan.calibration.bundle import Estimate
from jaxscan.calibration.residuals import Blocks
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined, refine
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Covariance
from jaxscan.rig.rig import parameter_names


@dataclass(frozen=True)
class Part:
    """Which photographs of a calibration take part.

    Attributes:
        name: how the report calls it.
        views: of its views.
        stage_images: of its photographs on stage and turntable, sequence after sequence.
    """

    name: str
    views: Bool[np.ndarray, "views"]
    stage_images: Bool[np.ndarray, "images"]


@dataclass(frozen=True)
class PartialRig:
    """What a part of the photographs says of the rig.

    Attributes:
        part: which part.
        values: the free parameters, in the order of the covariance's names. Of a turntable's centre one coordinate is
            held, where the calibration's solve held it.
        covariance: of these.
    """

    part: Part
    values: Float[np.ndarray, "parameters"]
    covariance: Covariance


def resolve(calibration: Calibration, part: Part) -> PartialRig | None:
    """The rig from a part of the photographs, with its own σ and outliers; None where no minimum was found.

    It starts at the calibration's own solution, so that it ends in the same valley.
    """
    with float64():
        estimate, groups = problem(calibration)
        names, free = parameter_names(calibration.rig), np.asarray(calibration.adjustment.free)
        each = len(calibration.observations.board.points())
        refined = refine(
            estimate,
            jnp.asarray(calibration.adjustment.free),
            _masked(calibration, groups, part),
            as_float64(calibration.adjustment.noise),
            each,
            reject=not calibration.plain,
            weigh=not calibration.plain,
        )
        return _partial(refined, part, [name for name, one in zip(names, free, strict=False) if one])


def problem(calibration: Calibration) -> tuple[Estimate, tuple[Blocks, ...]]:
    """The solution and all candidates, rejected ones among them, as the solve takes them; inside a `float64` block."""
    observations = calibration.observations
    groups = (view_blocks(observations), *((stage_blocks(observations),) if observations.stages else ()))
    return as_float64(calibration.adjustment.estimate), groups


def _masked(calibration: Calibration, groups: tuple[Blocks, ...], part: Part) -> tuple[Blocks, ...]:
    views = _padded(part.views, len(groups[0].steps))
    masked = [
        replace(
            groups[0],
            corner_used=groups[0].corner_used & views[:, None],
            stripe_used=groups[0].stripe_used & views[:, None],
        )
    ]
    if len(groups) > 1:
        each, used, at = len(calibration.observations.board.points()), np.asarray(groups[1].corner_used).copy(), 0
        for i, stage in enumerate(calibration.observations.stages):
            own = part.stage_images[at : at + len(stage.views)]
            used[i, : len(own) * each] &= np.repeat(own, each)
            at += len(own)
        masked.append(replace(groups[1], corner_used=jnp.asarray(used)))
    return tuple(masked)


def _padded(mask: Bool[np.ndarray, "n"], length: int) -> Bool[Array, "length"]:
    return jnp.asarray(np.pad(mask, (0, length - len(mask))))


def _partial(refined: Refined, part: Part, free: Sequence[str]) -> PartialRig | None:
    rig = refined.estimate.shared[0]
    values, names = np.array([float(leaf) for leaf in jax.tree.leaves(rig)]), parameter_names(rig)
    at = [names.index(name) for name in free]
    matrix = np.asarray(refined.precision.covariance)[np.ix_(at, at)]
    if refined.outcome.result != optx.RESULTS.successful or not np.isfinite(values).all():
        return None
    return PartialRig(part, values[at], Covariance(tuple(free), matrix))
