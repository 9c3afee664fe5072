"""Poses obey the axioms of a group, by NumPy and by JAX, one by one and in stacks, also where they are delicate."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.geometry import Pose, dual_plane, matrix_to_vector, vector_to_matrix

POSES = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1e-12, 0.0, 0.0, 0.0, 1.0, 0.0],
        [1e-7, 0.0, -1e-7, 1.0, 2.0, 3.0],
        [0.3, -0.2, 0.9, 10.0, -20.0, 340.0],
        [np.pi, 0.0, 0.0, 5.0, 0.0, 300.0],
        [0.0, -np.pi / np.sqrt(2), np.pi / np.sqrt(2), 0.0, 7.0, 300.0],
        [0.0, -2.0, 2.0, -1.0, 1.0, 250.0],
    ]
)
POINTS = np.array([[3.0, -4.0, 5.0], [0.0, 0.0, 0.0], [-100.0, 20.0, 350.0]])
STACK = Pose.from_vector(POSES)
# They go into a jit as arguments: JAX 0.10 remembers the precision of a NumPy constant when x64 is switched off again.


def on_jax(tree):
    return jax.tree.map(jnp.asarray, tree)


def everything(A, B, points):
    """What the methods give for two stacks of poses."""
    return (
        A.matrix(),
        A.apply(points),
        A.apply(points[0]),
        A.inverse().as_vector(),
        (A @ B).matrix(),
        (A @ B).translation,
        Pose.about(A.rotation, B.translation, A.translation).translation,
    )


def test_numpy_stays_numpy_and_agrees_with_jax(x64):
    by_numpy = everything(STACK, Pose.from_vector(POSES[::-1]), POINTS)
    by_jax = jax.jit(everything)(*on_jax((STACK, Pose.from_vector(POSES[::-1]), POINTS)))
    for ours, theirs in zip(by_numpy, by_jax, strict=True):
        assert type(ours) is np.ndarray
        assert isinstance(theirs, jax.Array)
        assert ours.dtype == theirs.dtype == np.float64
        np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-12)


def test_without_x64_numpy_keeps_its_digits():
    assert jnp.zeros(()).dtype == jnp.float32
    by_jax = jax.jit(everything)(*on_jax((STACK, STACK, POINTS)))
    for of_numpy, of_jax in zip(everything(STACK, STACK, POINTS), by_jax, strict=True):
        assert of_numpy.dtype == np.float64
        assert of_jax.dtype == jnp.float32
        np.testing.assert_allclose(of_numpy, of_jax, rtol=1e-4, atol=2e-3)


def test_arrays_of_both_kinds_go_together():
    """Without x64 too, after NumPy's float64 has gone through JAX with it."""
    for x64 in (True, False):
        with jax.enable_x64(x64):
            for moved in (
                STACK.apply(jnp.asarray(POINTS)),
                on_jax(STACK).apply(POINTS),
                (on_jax(STACK) @ STACK).rotation,
            ):
                assert isinstance(moved, jax.Array)
                assert moved.dtype == jnp.zeros(()).dtype


def test_float32_stays_float32():
    for T in (Pose.from_vector(POSES.astype(np.float32)), on_jax(STACK)):
        for found in (T.matrix(), (T @ T).as_vector(), T.inverse().as_vector(), T.apply(POINTS.astype(np.float32))):
            assert found.dtype == np.float32
        np.testing.assert_allclose((T @ T.inverse()).rotation, 0, atol=2e-6)


def test_a_stack_is_its_poses():
    A, B = STACK, Pose.from_vector(POSES[::-1])
    stacked = everything(A, B, POINTS)
    by_outer = (Pose.from_vector(POSES[:, None]) @ B).as_vector()
    many = np.random.default_rng(0).normal(size=(len(POSES), 4, 3))
    moved = A.apply(many)
    assert by_outer.shape == (7, 7, 6)
    assert moved.shape == (7, 4, 3)
    assert A.apply(many[:, :1]).shape == (7, 1, 3)
    one = Pose.from_vector(POSES[3])
    assert one.apply(many).shape == (7, 4, 3)
    for k in range(len(POSES)):
        a, b = Pose.from_vector(POSES[k]), Pose.from_vector(POSES[-1 - k])
        for whole, single in zip(stacked, everything(a, b, POINTS), strict=True):
            np.testing.assert_allclose(whole[k], single, atol=1e-12)
        np.testing.assert_allclose(by_outer[3, k], (one @ b).as_vector(), atol=1e-12)
        np.testing.assert_allclose(moved[k], a.apply(many[k]), atol=1e-12)


def test_a_stack_is_its_poses_on_jax_too(x64):
    def outer(vectors, points):
        A, B = Pose.from_vector(vectors[:, None]), Pose.from_vector(vectors)
        return (A @ B).as_vector(), B.apply(points)

    points = np.random.default_rng(0).normal(size=(len(POSES), 4, 3))
    for by_jax, by_numpy in zip(jax.jit(outer)(*on_jax((POSES, points))), outer(POSES, points), strict=True):
        np.testing.assert_allclose(by_jax, by_numpy, atol=1e-12)


def test_inverse_undoes():
    for T in (STACK @ STACK.inverse(), STACK.inverse() @ STACK):
        np.testing.assert_allclose(T.rotation, 0, atol=1e-15)
        np.testing.assert_allclose(T.translation, 0, atol=1e-12)
    np.testing.assert_allclose(STACK.inverse().apply(STACK.apply(POINTS)), [POINTS] * len(POSES), atol=1e-12)


def test_composition_is_application_in_turn():
    A = Pose.from_vector(POSES[:, None])
    np.testing.assert_allclose((A @ STACK).apply(POINTS), A.apply(STACK.apply(POINTS)), atol=1e-12)


def test_identity_and_turns_about_a_place():
    still = Pose.identity()
    np.testing.assert_array_equal(still.apply(POINTS), POINTS)
    np.testing.assert_array_equal((still @ STACK).translation, STACK.translation)
    centre, shift = np.array([3.0, -12.0, 300.0]), np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(Pose.about(STACK.rotation, centre).apply(centre), [centre] * len(POSES), atol=1e-12)
    moved = Pose.about(STACK.rotation[4], centre, shift).apply(POINTS)
    np.testing.assert_allclose(moved, (POINTS - centre) @ STACK.matrix()[4].T + centre + shift, atol=1e-12)


def test_vectors_and_matrices_come_back(x64):
    np.testing.assert_array_equal(STACK.as_vector(), POSES)
    back = Pose.from_matrix(STACK.matrix(), STACK.translation)
    # At π the axis and its opposite are the same rotation.
    off = np.minimum(np.abs(back.rotation - STACK.rotation), np.abs(back.rotation + STACK.rotation)).max(axis=1)
    assert off.max() < 1e-12
    np.testing.assert_allclose(matrix_to_vector(vector_to_matrix(POSES[1, :3])), POSES[1, :3], rtol=1e-12)


def test_derivatives_hold_at_no_turn_and_at_half_a_turn(x64):
    """Derivatives of a motion, its inverse and T @ U agree with finite differences that NumPy takes."""
    given = Pose.from_vector(np.array([0.2, 0.1, -0.3, 4.0, 5.0, 6.0])), POINTS

    def moved(vector, other, points):
        T = Pose.from_vector(vector)
        both = T @ other
        return T.apply(points), T.inverse().apply(points), both.matrix(), both.translation

    forward = jax.jit(jax.vmap(jax.jacfwd(moved), (0, None, None)))(*on_jax((POSES, *given)))
    h = 1e-6
    for k, vector in enumerate(POSES):
        ends = [(moved(vector + h * e, *given), moved(vector - h * e, *given)) for e in np.eye(6)]
        for part, found in enumerate(forward):
            numeric = np.stack([(plus[part] - minus[part]) / (2 * h) for plus, minus in ends], axis=-1)
            np.testing.assert_allclose(found[k], numeric, rtol=1e-6, atol=1e-6)


def test_shapes_that_do_not_go_together_are_refused():
    with pytest.raises(TypeError, match=r"rotation|translation"):
        Pose(np.zeros(3), np.zeros(4))
    with pytest.raises(TypeError, match=r"rotation|translation"):
        Pose(np.zeros((2, 3)), np.zeros((3, 3)))
    with pytest.raises(ValueError, match="broadcast"):
        STACK.apply(np.zeros((6, 2, 3)))


def test_dual_plane_holds_the_boards_points(x64):
    def on_plane(vector, xy):
        T = Pose.from_vector(vector)
        return dual_plane(T) @ T.apply(jnp.append(xy, 0.0))

    for xy in ([0.0, 0.0], [100.0, -30.0]):
        value = jax.jit(jax.vmap(on_plane, in_axes=(0, None)))(jnp.asarray(POSES[3:]), jnp.asarray(xy))
        np.testing.assert_allclose(value, 1, atol=1e-12)
