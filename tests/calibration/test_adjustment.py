"""`refit` is the calibration again, and its derivatives are those of calibrating again."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration import refit
from jaxscan.calibration.bundle import solve
from jaxscan.errors import InputError
from tests.calibration import synthetic

PIXEL, STEPS = (300.0, 200.0), 4000.0


@jax.jit
def depth(rig):
    """Of a triangulated pixel, mm."""
    return rig.triangulate(jnp.asarray(PIXEL), {"stage": jnp.asarray(STEPS)})[2]


def height(adjustment):
    """That of the rig that is found again; compiled by itself, for operation by operation it is a hundred programs."""
    return depth(refit(adjustment).rig)


def settled_height(adjustment):
    """The same, the solve begun once more where it ended: differences need digits that no σ needs."""
    once = solve(adjustment.start, adjustment.free, adjustment.groups, adjustment.noise)
    return height(replace(adjustment, start=once.system))


@pytest.fixture(scope="module")
def adjustment(calibration):
    """The session's, with leaves of JAX."""
    with jax.enable_x64(True):
        return jax.tree.map(jnp.asarray, calibration.adjustment)


@pytest.fixture(scope="module")
def held(adjustment):
    """The same with the principal point held."""
    return replace(adjustment, free=adjustment.free.at[2:4].set(False))


@pytest.fixture(scope="module")
def gradient(held):
    with jax.enable_x64(True):
        # Compiled as a whole it would be compiled in each run: what may raise an error is not kept.
        return eqx.filter_grad(height)(held)


def test_refit_is_the_calibration(x64, calibration):
    again = refit(calibration.adjustment)
    sigma = dict(zip(calibration.covariance.names, np.sqrt(np.diagonal(calibration.covariance.matrix)), strict=True))
    for a, b, s in zip(jax.tree.leaves(again.rig), jax.tree.leaves(calibration.rig), sigma.values(), strict=True):
        assert abs(float(a) - float(b)) < 1e-5 * s
    np.testing.assert_allclose(again.boards.translation, calibration.system.boards.translation, atol=1e-6)
    np.testing.assert_allclose(again.moved.translation, calibration.system.moved.translation, atol=1e-6)


def moved_corner(a, by):
    return replace(a, groups=(replace(a.groups[0], corners=_add(a.groups[0].corners, (2, 0, 7, 1), by)), a.groups[1]))


def moved_stage_corner(a, by):
    return replace(a, groups=(a.groups[0], replace(a.groups[1], corners=_add(a.groups[1].corners, (0, 1, 6, 0), by))))


def moved_stripe(a, by):
    return replace(a, groups=(replace(a.groups[0], stripe=_add(a.groups[0].stripe, (3, 0, 320, 1), by)), a.groups[1]))


def reweighted(a, by):
    return replace(a, groups=(replace(a.groups[0], weights=_add(a.groups[0].weights, (4, 0, 11), by)), a.groups[1]))


def scaled_board(a, by):
    return a.with_board((1 + by) * synthetic.BOARD.points())


def moved_principal_point(a, by):
    return eqx.tree_at(lambda a: a.start.rig.camera.principal[1], a, replace_fn=lambda v: v + by)


def wider_stripe_noise(a, by):
    return replace(a, noise=replace(a.noise, stripe=a.noise.stripe + by))


def _add(array, at, by):
    return jnp.asarray(array).at[at].add(by)


@pytest.mark.parametrize(
    ("change", "step"),
    [
        (moved_corner, 0.1),
        (moved_stage_corner, 0.1),
        (moved_stripe, 0.1),
        (reweighted, 0.02),
        (scaled_board, 1e-3),
        (moved_principal_point, 0.1),
        (wider_stripe_noise, 3e-4),
    ],
)
def test_gradients_are_central_differences_of_solving_again(x64, held, gradient, change, step):
    numbers, rest = eqx.partition(held, eqx.is_inexact_array)
    _, direction = jax.jvp(
        lambda by: eqx.filter(change(eqx.combine(numbers, rest), by), eqx.is_inexact_array), (0.0,), (1.0,)
    )
    slope = sum(jax.tree.leaves(jax.tree.map(lambda g, d: (g * d).sum(), gradient, direction)))
    at = {k: float(settled_height(change(held, k * step))) for k in (-2, -1, 1, 2)}
    # Central differences of the fourth order.
    numeric = (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * step)
    assert abs(slope) > 1e-6
    assert float(slope) == pytest.approx(numeric, rel=1e-7), (slope, numeric)


def test_what_is_masked_has_no_gradient(calibration, gradient):
    views = calibration.adjustment.groups[0]
    assert not views.stripe_used.all()
    assert (np.asarray(gradient.groups[0].stripe)[~views.stripe_used] == 0).all()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


def test_without_x64_it_says_what_to_do(calibration):
    with pytest.raises(InputError, match="jax_enable_x64"):
        refit(calibration.adjustment)
    with pytest.raises(InputError, match="jax_enable_x64"):
        eqx.filter_grad(height)(calibration.adjustment)


def test_no_minimum_is_an_error(x64, adjustment):
    nowhere = replace(adjustment.start, poses=tuple(poses * jnp.nan for poses in adjustment.start.poses))
    with pytest.raises(RuntimeError, match="did not reach a minimum"):
        refit(replace(adjustment, start=nowhere))
