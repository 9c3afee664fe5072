"""The joint solve of a calibration once more, on a part of its photographs.

What is left out is masked, not removed, so the arrays keep their shapes and nothing compiles again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Bool, Float

from jaxscan.calibration.blocks import sequence_blocks, view_blocks
from jaxscan.calibration.residuals import Blocks
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined, refine
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Covariance, System
from jaxscan.rig.rig import parameter_names


@dataclass(frozen=True)
class Part:
    """Which photographs of a calibration take part.

    Attributes:
        name: how the report calls it.
        views: of its views.
        moved: of its photographs along the axes, sequence after sequence.
    """

    name: str
    views: Bool[np.ndarray, "views"]
    moved: Bool[np.ndarray, "images"]


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
        system, groups = problem(calibration)
        names, free = parameter_names(calibration.rig), np.asarray(calibration.adjustment.free)
        refined = refine(
            system,
            jnp.asarray(calibration.adjustment.free),
            _masked(calibration, groups, part),
            as_float64(calibration.adjustment.noise),
            reject=not calibration.plain,
            weigh=not calibration.plain,
        )
        return _partial(refined, part, [name for name, one in zip(names, free, strict=False) if one])


def problem(calibration: Calibration) -> tuple[System, tuple[Blocks, ...]]:
    """The solution and all candidates, rejected ones among them, as the solve takes them; inside a `float64` block."""
    observations = calibration.observations
    groups = (view_blocks(observations), *((sequence_blocks(observations),) if observations.sequences else ()))
    start = as_float64(calibration.adjustment.start)
    # Without what belongs to other factors than the photographs.
    return replace(start, poses=start.poses[: len(groups)]), groups


def _masked(calibration: Calibration, groups: tuple[Blocks, ...], part: Part) -> tuple[Blocks, ...]:
    parts = [part.views[:, None]]
    if len(groups) > 1:
        counts = [len(sequence.views) for sequence in calibration.observations.sequences]
        own = np.split(part.moved, np.cumsum(counts)[:-1])
        longest = groups[1].corner_used.shape[1]
        parts.append(np.stack([np.pad(each, (0, longest - len(each))) for each in own]))
    masked = []
    for group, used in zip(groups, parts, strict=True):
        mask = jnp.asarray(np.pad(used, ((0, len(group.points) - len(used)), (0, 0))))[..., None]
        masked.append(replace(group, corner_used=group.corner_used & mask, stripe_used=group.stripe_used & mask))
    return tuple(masked)


def _partial(refined: Refined, part: Part, free: Sequence[str]) -> PartialRig | None:
    rig = refined.system.rig
    values, names = np.array([float(leaf) for leaf in jax.tree.leaves(rig)]), parameter_names(rig)
    at = [names.index(name) for name in free]
    matrix = refined.precision.covariance[np.ix_(at, at)]
    if refined.outcome.result != optx.RESULTS.successful or not np.isfinite(values).all():
        return None
    return PartialRig(part, values[at], Covariance(tuple(free), matrix))
