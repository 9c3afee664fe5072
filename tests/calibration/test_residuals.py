"""The stripe's residual is the distance in rows that it says it is, and its derivative is whole."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.calibration import residuals
from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.residuals import Noise, _tamed, stripe_error
from jaxscan.geometry import Pose, dual_plane
from jaxscan.rig import Camera, LightPlane, Rig, System
from tests.calibration import synthetic


def true_rig():
    camera = Camera.create(synthetic.IMAGE_SIZE, synthetic.FOCAL, synthetic.PRINCIPAL, "radial1", [synthetic.K1])
    return Rig(camera, (LightPlane.create(synthetic.OMEGA),))


def error_at(rig, beta, pixel, columns):
    axis = jnp.where(columns, jnp.array([0.0, 1.0]), jnp.array([1.0, 0.0]))
    return stripe_error(rig.lights[0], beta, *rig.camera.ray_and_change(pixel, axis))


def test_stripe_error_is_the_shift_in_rows_and_in_columns(x64):
    R, t = synthetic.board_pose(np.random.default_rng(3))
    beta = dual_plane(Pose.from_matrix(jnp.asarray(R), jnp.asarray(t)))
    error = jax.jit(jax.vmap(lambda p, c: error_at(true_rig(), beta, p, c), (0, None)))
    for columns in (True, False):
        pixels = synthetic.stripe_on(R, t, columns)
        pixels = pixels[np.isfinite(pixels).all(axis=1)][::20]
        np.testing.assert_allclose(error(jnp.asarray(pixels), columns), 0, atol=1e-5)
        for shift in (1e-3, 0.5):
            moved = pixels + shift * np.array([0.0, 1.0] if columns else [1.0, 0.0])
            # Beyond the first order the lens bends: a thousandth of the shift.
            np.testing.assert_allclose(error(jnp.asarray(moved), columns), -shift, atol=1e-5 + 2e-3 * shift)


def test_stripe_error_is_differentiated_whole(x64):
    R, t = synthetic.board_pose(np.random.default_rng(3))
    pixel = jnp.asarray(synthetic.stripe_on(R, t, True)[300] + [0.0, 2.0])
    leaves, tree = jax.tree.flatten((true_rig(), Pose.from_matrix(jnp.asarray(R), jnp.asarray(t)).as_vector()))
    sizes = np.cumsum([leaf.size for leaf in leaves])[:-1]

    @jax.jit
    def error(x):
        parts = [p.reshape(leaf.shape) for p, leaf in zip(jnp.split(x, sizes), leaves, strict=True)]
        rig, pose = jax.tree.unflatten(tree, parts)
        beta = dual_plane(Pose.from_vector(pose))
        return error_at(rig, beta, pixel, jnp.array(True))

    x = jnp.concatenate([leaf.ravel() for leaf in leaves])
    h = 1e-6 * np.maximum(np.abs(x), 1e-4)
    numeric = [(error(x + e) - error(x - e)) / (2 * e.sum()) for e in np.diag(h)]
    np.testing.assert_allclose(jax.jit(jax.grad(error))(x), numeric, rtol=1e-5, atol=1e-6)


def test_masked_entries_are_not_read(x64):
    with_values = synthetic.observations(seed=1, n_views=3, n_stage=0)
    block = jax.tree.map(lambda leaf: leaf[0], view_blocks(with_values))
    mask = dict(
        corner_used=block.corner_used.at[0, :7].set(False),
        stripe_used=block.stripe_used & (jnp.arange(block.stripe_used.size) > 300)[None],
    )
    pose = jnp.array([0.1, 0.2, 0.0, -60.0, -40.0, 340.0])
    noise = Noise(jnp.array(0.05), jnp.array(0.1), jnp.array(0.0))

    def cost(pose, block):
        alone = jax.tree.map(lambda leaf: leaf[None], block)
        return (alone.residuals(System(true_rig(), ()), pose[None], noise) ** 2).sum()

    kept = replace(block, **mask)
    spoilt = replace(kept, corners=kept.corners.at[0, :7].set(jnp.nan), stripe=kept.stripe.at[0, :301].set(jnp.nan))
    value = jax.jit(jax.value_and_grad(cost))
    for a, b in zip(value(pose, kept), value(pose, spoilt), strict=True):
        np.testing.assert_array_equal(a, b)
        assert np.isfinite(a).all()
    alone = jax.tree.map(lambda leaf: leaf[None], spoilt)
    corner, stripe = jax.jit(lambda pose: alone.errors(System(true_rig(), ()), pose))(pose[None])
    assert (np.asarray(corner[0, 0, :7]) == 0).all()
    assert (np.asarray(stripe[0, 0, :301]) == 0).all()


def test_robust_loss_is_square_then_straight(x64):
    r = jnp.array([1e-4, 0.01, 100.0, 1e4])
    loss = (r * _tamed(r**2)) ** 2
    np.testing.assert_allclose(loss, 2 * (np.sqrt(1 + r**2) - 1), rtol=1e-6)


def test_corners_and_stripes_are_both_trusted_less_where_they_are_far_off(x64):
    views = view_blocks(synthetic.observations(seed=1, n_views=3, n_stage=0))
    poses = jnp.tile(jnp.array([0.1, 0.2, 0.0, -60.0, -40.0, 340.0]), (len(views.points), 1))
    one = jnp.ones(())
    residuals_of = jax.jit(lambda views, noise: views.residuals(System(true_rig(), ()), poses, noise))

    def of(robustness):
        found = residuals_of(views, Noise(one, one, robustness * one))
        corners = 2 * views.weights[0].size
        n = len(found)
        return np.asarray(found[:, :corners]).reshape(n, -1, 2), np.asarray(found[:, corners:])

    (corner, stripe), (tamed_corner, tamed_stripe) = of(0.0), of(1.0)
    # A weight is one over σ.
    half = replace(views, weights=0.5 * views.weights, stripe_weights=0.5 * views.stripe_weights)
    lighter = np.asarray(residuals_of(half, Noise(one, one, 0 * one)))
    np.testing.assert_allclose(lighter[:, -stripe.shape[1] :], 0.5 * stripe, rtol=1e-12)
    np.testing.assert_allclose(lighter[:, : -stripe.shape[1]].reshape(corner.shape), 0.5 * corner, rtol=1e-12)
    square = (corner**2).sum(axis=-1)
    assert square.max() > 100
    assert np.abs(stripe).max() > 10
    np.testing.assert_allclose((tamed_corner**2).sum(axis=-1), 2 * (np.sqrt(1 + square) - 1), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(tamed_stripe**2, 2 * (np.sqrt(1 + stripe**2) - 1), rtol=1e-6, atol=1e-12)


def test_a_stripe_that_takes_no_part_is_not_computed(x64, monkeypatch):
    computed, real = [], residuals.stripe_errors

    def stripe_errors(system, pose, stands, block):
        jax.debug.callback(lambda: computed.append(1))
        return real(system, pose, stands, block)

    monkeypatch.setattr(residuals, "stripe_errors", stripe_errors)
    views = view_blocks(synthetic.observations(seed=1, n_views=3, n_stage=0))
    poses = jnp.tile(jnp.array([0.1, 0.2, 0.0, -60.0, -40.0, 340.0]), (len(views.points), 1))
    one = jnp.ones(())
    of_group = jax.jit(lambda group: group.residuals(System(true_rig(), ()), poses, Noise(one, one, one)))
    masked = replace(views, stripe_used=jnp.zeros_like(views.stripe_used))
    assert (of_group(masked)[:, -views.stripe_used.shape[2] :] == 0).all()
    jax.effects_barrier()
    assert not computed
    assert (of_group(views)[:3, -views.stripe_used.shape[2] :] != 0).any()
    jax.effects_barrier()
    assert computed
