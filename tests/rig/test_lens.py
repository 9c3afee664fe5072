"""Lenses of other kinds than OpenCV's behind the camera: names, derivatives, refusals."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.rig import LENSES, Camera, Lens, Rig, register_lens
from jaxscan.rig.camera import camera_parameters, lens_numbers
from jaxscan.rig.projection import project_points, within_fold
from jaxscan.rig.rig import parameter_names
from tests.other_lenses import Division, Prism, registered

VALUES = {"division": ([-0.2],), "prism": ([0.02], [-0.03])}


@pytest.fixture(autouse=True)
def other_kinds():
    with registered(Division, Prism):
        yield


def camera(lens):
    return Camera.create((640, 480), [697.7, 690.4], [310.3, 228.1], lens, *VALUES[lens])


def test_every_kind_is_a_lens():
    assert all(isinstance(kind.nominal(), Lens) for kind in LENSES.values())
    assert all(kind.nominal().kind == name for name, kind in LENSES.items())


def test_the_numbers_of_a_lens_are_parameters_of_the_camera():
    names = ("camera.focal.0", "camera.focal.1", "camera.principal.0", "camera.principal.1")
    assert tuple(parameter_names(Rig(camera("prism")))) == (*names, "camera.across.0", "camera.along.0")
    assert camera_parameters("prism") == (*names, "camera.across.0", "camera.along.0")
    assert [lens_numbers(name) for name in ("camera.along.0", "camera.focal.1", "lights.0.plane.2")] == [
        "along",
        None,
        None,
    ]


def test_numbers_by_their_order_or_by_name_and_zeros_for_the_others():
    prism = Camera.create((640, 480), [700.0, 700.0], [320.0, 240.0], "prism", along=[0.5])
    assert (prism.lens.across, prism.lens.along) == ((0.0,), (0.5,))
    assert prism.zero_terms() == ("camera.across.0",)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (([1.0, 2.0], []), "has 1 across and 1 along coefficients; 2 and 0 were given"),
        (([1.0], [1.0], [1.0]), "takes across, along, each once; 3 in this order were given"),
    ],
)
def test_numbers_that_the_lens_does_not_have_are_refused(given, words):
    with pytest.raises(InputError, match=words):
        Camera.create((640, 480), [700.0, 700.0], [320.0, 240.0], "prism", *given)


@pytest.mark.parametrize(("given", "named"), [((), {"radial": [0.1]}), (([0.1],), {"across": [0.1]})])
def test_names_of_numbers_that_the_lens_does_not_have_are_refused(given, named):
    with pytest.raises(
        InputError, match=rf"takes across, along, each once; {len(given)} in .* and {next(iter(named))}"
    ):
        Camera.create((640, 480), [700.0, 700.0], [320.0, 240.0], "prism", *given, **named)


@pytest.mark.parametrize("lens", VALUES)
def test_derivatives_of_the_ray_are_those_of_the_inverse_function(x64, lens):
    leaves, tree = jax.tree.flatten(camera(lens))

    def ray(vector):
        return jax.tree.unflatten(tree, list(vector[2:])).ray(vector[:2])[:2]

    at = jnp.concatenate([jnp.array([31.0, 440.0]), jnp.stack(leaves)])
    forward, reverse = jax.jit(jax.jacfwd(ray))(at), jax.jit(jax.jacrev(ray))(at)
    h = 1e-6 * jnp.maximum(1, jnp.abs(at))
    values = jax.jit(jax.vmap(ray))
    numeric = ((values(at[None] + jnp.diag(h)) - values(at[None] - jnp.diag(h))) / (2 * h[:, None])).T
    np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(forward, numeric, rtol=2e-6, atol=1e-8)
    assert np.abs(forward).min(axis=0).max() > 1e-4


@pytest.mark.parametrize("lens", VALUES)
def test_projection_looks_at_a_lens_as_it_is(x64, lens):
    cam = camera(lens)
    points = np.random.default_rng(1).uniform([-120, -90, 300], [120, 90, 400], (40, 3))
    seen = project_points(cam, points)
    np.testing.assert_allclose(jax.jit(jax.vmap(cam.ray))(jnp.asarray(seen.pixels)), points / points[:, 2:], atol=1e-12)
    assert seen.by_camera.shape == (40, 2, 4 + len(VALUES[lens]))
    np.testing.assert_array_equal(project_points(cam, points, richest=True).by_camera, seen.by_camera)
    assert within_fold(cam, points).all()


def test_numbers_are_not_called_as_the_cameras():
    class Tilted(Division):
        kind = "tilted"
        numbers: ClassVar = {"tilt": 2}

    with pytest.raises(InputError, match=r'"tilted" has numbers called tilt'):
        register_lens(Tilted)
    assert "tilted" not in LENSES
