"""The rig: triangulation against its definition, parameter names, and what has no answer."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.rig import Camera, LightPlane, Linear, Rig
from jaxscan.rig.light import meet
from jaxscan.rig.rig import parameter_names


def rig(*lasers):
    camera = Camera.create((640, 480), [697.7, 690.4], [310.3, 228.1], "radial1", [-0.134])
    return Rig(camera, lasers or (LightPlane.create([0.0, -0.00494, 0.00303]),), Linear.create([3e-5, 9.2e-4, -3.9e-4]))


def test_a_point_of_the_sheet_comes_back_through_its_pixel(x64):
    r = rig()
    X = jnp.array([12.0, -5.0, (1 - 0.00494 * 5.0) / 0.00303])
    np.testing.assert_allclose(r.triangulate(r.camera.project(X), {}), X, atol=1e-9)


def test_steps_move_the_point_back(x64):
    r, pixel = rig(), jnp.array([300.0, 100.0])
    moved = r.triangulate(pixel, {}) - r.triangulate(pixel, {"stage": jnp.array(-100000.0)})
    np.testing.assert_allclose(moved, -100000.0 * np.array([3e-5, 9.2e-4, -3.9e-4]), atol=1e-9)


def test_a_ray_along_or_away_from_the_sheet_gives_nan(x64):
    plane = LightPlane.create([0.0, 0.0, 0.004])
    assert np.isnan(meet(plane, jnp.array([1.0, 0.0, 0.0]))).all()
    assert np.isnan(meet(LightPlane.create([0.0, 0.0, -0.004]), jnp.array([0.0, 0.0, 1.0]))).all()


def test_parameter_names_are_those_of_the_file():
    names = parameter_names(rig())
    assert names == [
        *(f"camera.focal.{i}" for i in (0, 1)),
        *(f"camera.principal.{i}" for i in (0, 1)),
        "camera.radial.0",
        *(f"lights.0.plane.{i}" for i in range(3)),
        *(f"motion.stage.per_step.{i}" for i in range(3)),
    ]


def test_one_of_several_lasers_must_be_named():
    two = rig(LightPlane.create([0.0, -0.005, 0.003], "left"), LightPlane.create([0.0, 0.005, 0.003], "right"))
    assert two.light("right").name == "right"
    assert "lights.0.plane.2" in parameter_names(two)
    with pytest.raises(InputError, match="name one"):
        two.light()
    with pytest.raises(InputError, match="no laser"):
        Rig(two.camera).light()


def test_everything_maps_jits_and_differentiates(x64):
    r = rig()
    pixels = jnp.array([[300.0, 100.0], [200.0, 90.0]])
    steps = jnp.array([0.0, 2000.0])
    points = jax.jit(jax.vmap(r.triangulate))(pixels, {"stage": steps})
    assert points.shape == (2, 3)
    height = jax.grad(lambda r: r.triangulate(pixels[1], {"stage": steps[1]})[2])(r)
    assert np.isfinite(jax.tree.leaves(height)).all()


@pytest.mark.parametrize(
    ("per_step", "words"),
    [
        ((3e-5, 9.2e-4, -3.9e-4), "down and towards the camera"),
        ((-1.0, -0.1, 0.1), "to the left"),
        ((1.0, -1.0, 1.0), "to the right and up and away from the camera"),
    ],
)
def test_where_a_stage_goes_in_words(per_step, words):
    assert Linear.create(per_step).way() == words
