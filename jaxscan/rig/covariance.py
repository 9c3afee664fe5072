"""The covariance of a rig's parameters, and of whatever is computed from a rig.

A function f of the parameters θ has, to first order, the covariance J Σ Jᵀ with J = ∂f/∂θ.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Float64

from jaxscan.precision import as_float64, float64
from jaxscan.rig.projection import project_points
from jaxscan.rig.rig import Rig, parameter_names


@dataclass(frozen=True)
class Covariance:
    """The covariance of parameters.

    Attributes:
        names: the parameters, by `parameter_names`; one that was held is not among them. Those of a board's pose may
            follow, `board.rotation.0` … `board.translation.2`.
        matrix: their covariance, in the parameters' own units.
    """

    names: tuple[str, ...]
    matrix: Float64[np.ndarray, "parameters parameters"]

    def __repr__(self) -> str:
        which = f", {self.names[0]} to {self.names[-1]}" if self.names else ""
        return f"Covariance({len(self.names)} parameters{which})"

    def sigma(self, name: str) -> float | None:
        """The standard deviation of one parameter, None where it was held."""
        if name not in self.names:
            return None
        i = self.names.index(name)
        return math.sqrt(max(self.matrix[i, i], 0.0))

    def among(self, names: Sequence[str]) -> Float64[np.ndarray, "some some"] | None:
        """That of some parameters in this order, None where one was held."""
        if not set(names) <= set(self.names):
            return None
        at = [self.names.index(name) for name in names]
        return self.matrix[np.ix_(at, at)]

    def of_leaves(self, rig: Rig) -> Float64[np.ndarray, "leaves leaves"]:
        """The covariance of all leaves of the rig in their order; zero for those that were held."""
        leaves = parameter_names(rig)
        known = [i for i, name in enumerate(self.names) if name in leaves]
        at = [leaves.index(self.names[i]) for i in known]
        full = np.zeros((len(leaves), len(leaves)))
        full[np.ix_(at, at)] = self.matrix[np.ix_(known, known)]
        return full

    def of(self, rig: Rig, function: Callable[[Rig], Float[Array, "*out"]]) -> Float64[np.ndarray, "size size"]:
        """The covariance of what a function computes from the rig, in its ravelled order.

        Args:
            rig: where to linearise: the rig that the covariance belongs to.
            function: any differentiable function of a rig.
        """
        with float64():
            theta, unravel = ravel_pytree(as_float64(rig))
            J = np.asarray(jax.jacfwd(lambda theta: jnp.ravel(function(unravel(theta))))(theta))
        return J @ self.of_leaves(rig) @ J.T

    def of_projected(self, rig: Rig, points: Float[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 2 2"]:
        """The covariance of the pixels (u, v) at which the rig's camera sees points of its frame (mm), px²."""
        J = projection_jacobian(rig, points)
        return J @ self.of_leaves(rig) @ np.swapaxes(J, 1, 2)


def projection_jacobian(rig: Rig, points: Float[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 2 leaves"]:
    """How the pixels (u, v) at which the rig's camera sees points of its frame (mm) move with the rig's leaves."""
    of_camera = project_points(rig.camera, points).by_camera
    # The camera's leaves are the rig's first.
    J = np.zeros((*of_camera.shape[:2], len(parameter_names(rig))))
    J[..., : of_camera.shape[2]] = of_camera
    return J
