"""Derivatives through a minimum against the dense Hessian, on a small problem whose residuals are far from zero."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from jax.flatten_util import ravel_pytree

from jaxscan.calibration.block_arrow import Arrow
from jaxscan.calibration.implicit import BlockArrowSolver, UncheckedAdjoint
from jaxscan.calibration.levenberg_marquardt import BlockArrowLevenbergMarquardt

START = Arrow(jnp.array([0.7, -0.4]), (jnp.full((3, 2), 0.3), jnp.full((2, 1), -0.2)))


def residual(y, theta):
    """Two groups of blocks; at the minimum the second derivatives carry as much as a tenth of the Hessian."""
    a, (p, q) = y.shared, y.blocks
    seen = jnp.sin(jnp.arange(15.0).reshape(3, 5) + theta[0])
    first = jnp.stack(
        [p[:, 0] * jnp.exp(a[0]), p[:, 1] ** 2 + a[1], p[:, 0] * p[:, 1], p.sum(1) - a[0] * a[1], p[:, 0] - a[0]],
        axis=1,
    )
    second = jnp.concatenate([q * a[1], jnp.cos(q) + theta[1], q - theta[2] * a[:1][None]], axis=1)
    return Arrow(a - theta[3:], (first - seen, second))


def minimum(theta, adjoint):
    solver = BlockArrowLevenbergMarquardt()
    start = jax.tree.map(lambda leaf: leaf.astype(theta.dtype), START)
    return optx.least_squares(residual, solver, start, theta, adjoint=adjoint, max_steps=200, throw=False).value


THETA = (0.3, -1.2, 0.8, 0.5, -0.3)


@pytest.mark.parametrize(
    "adjoint",
    [UncheckedAdjoint(), pytest.param(optx.ImplicitAdjoint(BlockArrowSolver()), marks=pytest.mark.long)],
    ids=["unchecked", "checked"],
)
@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_both_modes_are_the_dense_implicit_derivative(x64, derivative, adjoint):
    theta = jnp.asarray(THETA)
    # Whole functions are compiled: one by one their operations would be hundreds of programs.
    y, back = ravel_pytree(jax.jit(lambda theta: minimum(theta, adjoint))(theta))

    def objective(y, theta):
        return 0.5 * sum((leaf**2).sum() for leaf in jax.tree.leaves(residual(back(y), theta)))

    H = np.asarray(jax.jit(jax.jacfwd(jax.grad(objective)))(y, theta))
    mixed = np.asarray(jax.jit(jax.jacfwd(jax.grad(objective), 1))(y, theta))
    assert np.linalg.norm(jax.jit(jax.grad(objective))(y, theta)) < 1e-6
    expected = -np.linalg.solve(H, mixed)
    J = np.asarray(jax.jit(jax.jacfwd(lambda y: ravel_pytree(residual(back(y), theta))[0]))(y))
    gauss_newton = -np.linalg.solve(J.T @ J, mixed)
    # Otherwise this could not tell the Hessian from Gauss and Newton's part of it.
    assert np.abs(gauss_newton - expected).max() > 0.03
    found = jax.jit(derivative(lambda theta: ravel_pytree(minimum(theta, adjoint))[0]))(theta)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
