"""Points and pixels in arrays of any shape, and one sentence where the shape is wrong."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import config as checks

from jaxscan.errors import InputError
from jaxscan.rig import Camera, LightPlane, Linear, Rig

RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def rig() -> Rig:
    camera = Camera.create((640, 480), (700.0, 690.0), (310.0, 228.0), "radial1", [-0.13])
    return Rig(camera, (LightPlane.create([0.0, -0.005, 0.003]),), Linear.create([0.0, 0.0009, -0.0004]))


@pytest.mark.parametrize("shape", [(5,), pytest.param((4, 1), marks=pytest.mark.long), (2, 3), (0,)])
def test_an_array_is_its_points_one_by_one(rig: Rig, shape: tuple[int, ...]) -> None:
    points = RNG.uniform([-60, -40, 250], [60, 40, 400], (*shape, 3)).astype(np.float32)
    pixels = rig.camera.project(points)
    assert pixels.shape == (*shape, 2)
    rays, steps = rig.camera.ray(pixels), RNG.integers(0, 70000, shape)
    found = rig.triangulate(pixels, {"stage": steps})
    assert rays.shape == found.shape == (*shape, 3)
    for i in np.ndindex(*shape):
        np.testing.assert_allclose(pixels[i], rig.camera.project(jnp.asarray(points[i])), rtol=1e-6)
        np.testing.assert_allclose(rays[i], rig.camera.ray(pixels[i]), rtol=1e-5, atol=1e-7)
        one = rig.triangulate(pixels[i], {"stage": float(steps[i])})
        np.testing.assert_allclose(found[i], one, rtol=1e-5, atol=1e-3)


def test_one_position_holds_for_all_pixels(rig: Rig) -> None:
    pixels = RNG.uniform([100, 250], [500, 400], (7, 2)).astype(np.float32)
    each = rig.triangulate(pixels, {"stage": np.full(7, 2000.0)})
    np.testing.assert_allclose(rig.triangulate(pixels, {"stage": 2000.0}), each, rtol=1e-6)


def test_corners_as_opencv_has_them(rig: Rig) -> None:
    corners = RNG.uniform(100, 400, (54, 1, 2)).astype(np.float32)
    np.testing.assert_array_equal(rig.camera.ray(corners)[:, 0], rig.camera.ray(corners[:, 0]))


def test_it_is_compiled_and_differentiated(rig: Rig) -> None:
    pixels = jnp.asarray(RNG.uniform([100, 250], [500, 400], (6, 2)), jnp.float32)

    def height(pixels: jax.Array) -> jax.Array:
        return rig.triangulate(pixels, {"stage": 0.0})[:, 2].sum()

    whole = jax.jit(jax.grad(height))(pixels)
    single = jax.vmap(jax.grad(lambda pixel: rig.triangulate(pixel, {"stage": 0.0})[2]))(pixels)
    np.testing.assert_allclose(whole, single, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda rig: rig.camera.project(np.zeros((3, 54))), r"Camera\.project takes points x, y, z, .*\(3, 54\)"),
        (lambda rig: rig.camera.ray(np.zeros((5, 3))), r"Camera\.ray takes pixels u, v, .*\(5, 3\)"),
        (lambda rig: rig.triangulate(np.zeros((2, 9)), {"stage": 0}), r"Rig\.triangulate takes .*\(2, 9\)"),
        (lambda rig: rig.triangulate(np.zeros((9, 2)), {"stage": np.zeros(4)}), r'axis "stage" .*\(4,\).*\(9, 2\)'),
    ],
)
def test_a_wrong_shape_is_named(rig: Rig, call, said: str) -> None:
    with pytest.raises(InputError, match=said):
        call(rig)


def test_lists_are_arrays(rig: Rig) -> None:
    for found, array in (
        (rig.camera.ray([320.0, 240.0]), rig.camera.ray(jnp.array([320.0, 240.0]))),
        (rig.camera.project((0, 0, 350)), rig.camera.project(jnp.array([0.0, 0.0, 350.0]))),
        (rig.triangulate([[320.0, 240.0]], {"stage": 9}), rig.triangulate(np.array([[320.0, 240.0]]), {"stage": 9})),
    ):
        np.testing.assert_array_equal(found, array)


@pytest.mark.parametrize(("q", "words"), [({"stge": 4000}, 'there is no axis "stge"'), (4000, "4000 are no positions")])
def test_positions_of_no_axis_are_refused(rig: Rig, q: object, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A misspelt axis gave the point of step 0."""
    # As of a user: otherwise the annotation itself refuses what is no mapping.
    monkeypatch.setattr(checks, "jaxtyping_disable", True)
    with pytest.raises(InputError, match=f"{words}.*stage"):
        rig.triangulate([320.0, 240.0], q)  # pyright: ignore[reportArgumentType]


def test_axes_beside_the_rigs_own_may_be_named(rig: Rig) -> None:
    np.testing.assert_array_equal(
        rig.triangulate([320.0, 240.0], {"stage": 9.0, "turntable": 5.0}),
        rig.triangulate([320.0, 240.0], {"stage": 9.0}),
    )
