"""The arrow's linear algebra against the same in dense matrices."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.calibration.block_arrow import Arrow, Jacobian, NormalEquations, jacobian_columns
from jaxscan.calibration.uncertainty import arrow_precision

N, SIZES = 5, ((7, 3), (2, 6))


def random_problem(seed=0):
    rng = np.random.default_rng(seed)
    shared = rng.normal(size=(4, N)) * 10.0 ** rng.uniform(-3, 3, N)
    groups = [rng.normal(size=(b, 30, N + d)) * np.append(10.0 ** rng.uniform(-3, 3, N), np.ones(d)) for b, d in SIZES]
    residual = Arrow(jnp.asarray(rng.normal(size=4)), tuple(jnp.asarray(rng.normal(size=g.shape[:2])) for g in groups))
    return Jacobian(jnp.asarray(shared), tuple(map(jnp.asarray, groups))), residual


def dense(jacobian, residual):
    rows, r = [np.asarray(jacobian.shared)], [np.asarray(residual.shared)]
    width = N + sum(b * d for b, d in SIZES)
    rows = [np.pad(rows[0], ((0, 0), (0, width - N)))]
    at = N
    for J, e in zip(jacobian.blocks, residual.blocks, strict=True):
        d = J.shape[2] - N
        for b in range(len(J)):
            row = np.zeros((J.shape[1], width))
            row[:, :N], row[:, at : at + d] = J[b, :, :N], J[b, :, N:]
            rows.append(row)
            r.append(np.asarray(e[b]))
            at += d
    return np.concatenate(rows), np.concatenate(r)


def flat(arrow):
    return np.concatenate([np.asarray(arrow.shared), *(np.asarray(block).ravel() for block in arrow.blocks)])


def test_step_is_the_dense_one(x64):
    jacobian, residual = random_problem()
    J, r = dense(jacobian, residual)
    normal = NormalEquations.create(residual, jacobian)
    damped_step = jax.jit(lambda normal, damping: normal.damped(damping, normal.diagonal()).step())
    for damping in (0.0, 1e-3, 10.0):
        A = J.T @ J
        expected = -np.linalg.solve(A + damping * np.diag(np.diag(A)), J.T @ r)
        step = flat(damped_step(normal, jnp.asarray(damping)))
        np.testing.assert_allclose(step, expected, rtol=1e-9)


def test_undamped_step_and_covariance_are_the_dense_ones(x64):
    jacobian, residual = random_problem(1)
    J, r = dense(jacobian, residual)
    inverse = np.linalg.inv(J.T @ J)
    normal = NormalEquations.create(residual, jacobian)
    step, fall = normal.determined_step()
    np.testing.assert_allclose(flat(step), -inverse @ (J.T @ r), rtol=1e-9)
    np.testing.assert_allclose(fall, (J.T @ r) @ inverse @ (J.T @ r), rtol=1e-9)
    precision = arrow_precision(jacobian)
    np.testing.assert_allclose(precision.covariance, inverse[:N, :N], rtol=1e-8)
    leverage = np.einsum("ij,jk,ik->i", J, inverse, J)[4:]
    np.testing.assert_allclose(np.concatenate([np.ravel(h) for h in precision.leverage]), leverage, rtol=1e-8)
    own = precision.blocks[1][1][N:, N:]
    np.testing.assert_allclose(own, inverse[-6:, -6:], rtol=1e-8)


def test_a_direction_without_data_is_seen(x64):
    jacobian, residual = random_problem(2)
    twice = jax.tree.map(lambda J: J.at[..., 1].set(2 * J[..., 0]), jacobian)
    assert arrow_precision(twice).eigenvalues[0] < 1e-12
    step, fall = NormalEquations.create(residual, twice).determined_step()
    assert np.isfinite(flat(step)).all()
    assert np.isfinite(float(fall))


def test_columns_are_the_jacobian(x64):
    like = Arrow(jnp.array([0.3, -0.2]), (jnp.arange(6.0).reshape(2, 3), jnp.ones((4, 1))))

    def residual(y):
        a, (p, q) = y.shared, y.blocks
        first = jnp.stack([jnp.sin(p * a[0]).sum(1), p[:, 0] * p[:, 2] * a[1]], axis=1)
        return Arrow(a * a[::-1], (first, jnp.broadcast_to(q * a[0], (4, 3))))

    columns = jax.jit(lambda y: jacobian_columns(jax.linearize(residual, y)[1], y))(like)
    whole = jax.jit(jax.jacfwd(residual))(like)
    np.testing.assert_allclose(columns.shared, whole.shared.shared)
    for g in (0, 1):
        np.testing.assert_allclose(columns.blocks[g][..., :2], whole.blocks[g].shared)
        for b in range(len(like.blocks[g])):
            np.testing.assert_allclose(columns.blocks[g][b, :, 2:], whole.blocks[g].blocks[g][b, :, b])
