"""Poses obey the axioms of a group, and the plane of a board is the one that its points lie on."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.geometry import Pose, dual_plane

POSES = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1e-7, 0.0, -1e-7, 1.0, 2.0, 3.0],
        [0.3, -0.2, 0.9, 10.0, -20.0, 340.0],
        [np.pi, 0.0, 0.0, 5.0, 0.0, 300.0],
        [0.0, -2.0, 2.0, -1.0, 1.0, 250.0],
    ]
)
POINT = np.array([3.0, -4.0, 5.0])


def test_inverse_undoes(x64):
    def there_and_back(vector):
        T = Pose.from_vector(vector)
        both = T @ T.inverse()
        return T.inverse().apply(T.apply(jnp.asarray(POINT))), both.matrix(), both.translation

    back, R, t = jax.jit(jax.vmap(there_and_back))(jnp.asarray(POSES))
    np.testing.assert_allclose(back, np.broadcast_to(POINT, back.shape), atol=1e-11)
    np.testing.assert_allclose(R, np.broadcast_to(np.eye(3), R.shape), atol=1e-9)
    np.testing.assert_allclose(t, 0, atol=1e-9)


def test_composition_is_application_in_turn(x64):
    def both(a, b):
        A, B, x = Pose.from_vector(a), Pose.from_vector(b), jnp.asarray(POINT)
        return (A @ B).apply(x), A.apply(B.apply(x))

    pairs = jnp.asarray(POSES[np.mgrid[:5, :5].reshape(2, -1)])
    at_once, in_turn = jax.jit(jax.vmap(both))(*pairs)
    np.testing.assert_allclose(at_once, in_turn, atol=1e-9)


def test_vector_round_trip(x64):
    np.testing.assert_array_equal(Pose.from_vector(jnp.asarray(POSES)).as_vector(), POSES)


def test_dual_plane_holds_the_boards_points(x64):
    def on_plane(vector, xy):
        T = Pose.from_vector(vector)
        return dual_plane(T) @ T.apply(jnp.append(xy, 0.0))

    for xy in ([0.0, 0.0], [100.0, -30.0]):
        value = jax.jit(jax.vmap(on_plane, in_axes=(0, None)))(jnp.asarray(POSES[2:]), jnp.asarray(xy))
        np.testing.assert_allclose(value, 1, atol=1e-12)
