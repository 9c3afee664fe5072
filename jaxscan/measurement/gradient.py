"""How a measured dimension follows what the scanner was calibrated from: every corner and stripe pixel.

A dimension h moves with the rig by b = ∂h/∂θ (`MeasuredDimension.by_rig`), and the rig with the calibration's data d by
the implicit derivative of its minimum (`refit`). So ∂h/∂d = bᵀ ∂θ*/∂d, by one reverse pass. With σ of each pixel the
squares (σ ∂h/∂d)² say which photograph's noise is in the dimension; `narrowed` says which one more of them would make
it narrower.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxscan.calibration import Calibration, View, refit
from jaxscan.calibration.adjustment import Adjustment
from jaxscan.calibration.blocks import photographs_in_blocks
from jaxscan.calibration.next_pose import predict
from jaxscan.errors import InputError
from jaxscan.measurement.measure import MeasuredDimension
from jaxscan.precision import as_jax, float64
from jaxscan.rig.rig import parameter_names


@dataclass(frozen=True)
class DimensionGradient:
    """The derivatives of a dimension; mm (degrees, mm³) for each unit of what it is taken by.

    Attributes:
        by_rig: by each of the rig's leaves, in the order of their names.
        corners: of each photograph, by its corners' pixels (u, v); 0 for those that took no part.
        stripes: of each photograph, by its stripe points' pixels (u, v), as the calibration lists them.
    """

    by_rig: Float[np.ndarray, "leaves"]
    corners: Mapping[str, Float[np.ndarray, "corners 2"]]
    stripes: Mapping[str, Float[np.ndarray, "points 2"]]


def dimension_gradient(calibration: Calibration, dimension: MeasuredDimension) -> DimensionGradient:
    """The derivative of a dimension by the corners and stripes of the photographs that its rig was calibrated from.

    Args:
        calibration: whose rig the scan was reconstructed and measured with.
        dimension: by `measure`, of a range image and with this rig.

    Raises:
        InputError: it has no derivative, or was measured with a rig of other parameters.
    """
    b = _by_rig(calibration, dimension)

    with float64():
        gradient = _gradient(as_jax(calibration.adjustment), jnp.asarray(b))
        groups = [(np.asarray(group.corners), np.asarray(group.stripe)) for group in gradient.groups]
    corners, stripes = {}, {}
    for view, group, block, k in photographs_in_blocks(calibration.observations):
        corners[called(view)] = groups[group][0][block, k, : len(view.corners)]
        count = sum(len(stripe.pixels) for stripe in view.stripes)
        stripes[called(view)] = groups[group][1][block, k, :count]
    return DimensionGradient(b, corners, stripes)


# Not compiled as a whole: JAX keeps no program that may raise an error, and its parts are kept.
@eqx.filter_grad
def _gradient(adjustment: Adjustment, b: Float[Array, "leaves"]) -> Float[Array, ""]:
    return b @ ravel_pytree(refit(adjustment).rig)[0]


def narrowed(calibration: Calibration, dimension: MeasuredDimension) -> dict[str, float]:
    """The rig's part of a dimension's σ if one photograph of the views were taken again, by its name.

    The smallest is that of the photograph that narrows it most. Where none of them does, `next_pose.suggest` with
    `by_rig` as what is wanted looks for a pose that does.

    Raises:
        InputError: as `dimension_gradient`.
    """
    b = _by_rig(calibration, dimension)
    found = {}
    for i, view in enumerate(calibration.observations.views):
        pose = jax.tree.map(lambda leaf, i=i: leaf[i : i + 1], calibration.system.boards)
        sigma = predict(calibration, pose).of_leaves(calibration.rig)
        found[called(view)] = float(np.sqrt(max(b @ sigma @ b, 0.0)))
    return found


def called(view: View) -> str:
    """A photograph's name, with that of its session where there are several."""
    return f"{view.session}/{view.name}" if view.session else view.name


def _by_rig(calibration: Calibration, dimension: MeasuredDimension) -> Float[np.ndarray, "leaves"]:
    names = parameter_names(calibration.rig)
    if not dimension.by_rig:
        why = dimension.problem or "it is a form, or was measured without a rig"
        raise InputError(f"{dimension.dimension.name}: has no derivative by the rig ({why}): measure a range image")
    if set(dimension.by_rig) != set(names):
        raise InputError(
            f"{dimension.dimension.name}: was measured with a rig of {len(dimension.by_rig)} parameters, and this "
            f"calibration has {len(names)}: give the calibration whose rig it was"
        )
    return np.array([dimension.by_rig[name] for name in names])
