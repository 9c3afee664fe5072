"""A sheet of light that turns: its formula, a mirror's, the start of a solve, and its file."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import InputError, ObservabilityError
from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.geometry import vector_to_matrix
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, LightPlane, Rig, SweptSheet
from jaxscan.rig.light import in_the_middle, inverse_depths, light_at, light_axes, stood
from jaxscan.rig.rig import parameter_names

OMEGA = np.array([0.0001, -0.005, 0.003])
PER_STEP = 2e-4 * np.array([1.0, 0.03, -0.02])
POINT = np.array([4.0, -205.0, 12.0])


def sheet(middle: float = 500.0) -> SweptSheet:
    with float64():
        return as_numpy(SweptSheet.about(OMEGA, PER_STEP, POINT, middle))


def plane_of(omega: np.ndarray) -> LightPlane:
    with float64():
        return as_numpy(LightPlane.create(omega))


def points_on(omega: np.ndarray, count: int, random: np.random.Generator) -> np.ndarray:
    """Points before the camera on a plane."""
    X = random.uniform([-80, -60, 280], [80, 60, 420], (count, 3))
    X[:, 1] = (1 - X[:, 0] * omega[0] - X[:, 2] * omega[2]) / omega[1]
    return X


@pytest.mark.parametrize("steps", [-900.0, 0.0, 250.0, 1700.0])
def test_it_turns_about_its_axis(steps):
    X = points_on(OMEGA, 20, np.random.default_rng(0))
    turned = (X - POINT) @ vector_to_matrix((steps - 500.0) * PER_STEP).T + POINT
    plane = sheet().at(steps)
    assert isinstance(plane, LightPlane)
    np.testing.assert_allclose(plane.level(turned), 0.0, atol=1e-13)


def test_its_axis_is_one_line_whichever_point_of_it_is_given():
    other = SweptSheet.about(OMEGA, PER_STEP, POINT + 300.0 * PER_STEP / np.linalg.norm(PER_STEP), 500.0)
    np.testing.assert_allclose(np.array(other.centre), np.array(sheet().centre), rtol=1e-5)


def test_light_from_a_mirror_turns_by_twice_the_mirrors_angle():
    """The plane of a laser that stands still, in a mirror whose surface holds the axis that it turns about."""
    axis = PER_STEP / np.linalg.norm(PER_STEP)
    face = np.cross(axis, [0.0, 0.6, 0.8])
    face /= np.linalg.norm(face)
    laser = points_on(np.array([0.0002, -0.004, 0.001]), 30, np.random.default_rng(1))

    def reflected(angle: float) -> np.ndarray:
        m = vector_to_matrix(angle * axis) @ face
        X = laser - POINT
        X = X - 2 * (X @ m)[:, None] * m + POINT
        return np.linalg.lstsq(X, np.ones(len(X)))[0]

    light = SweptSheet.about(reflected(0.0), 2 * PER_STEP, POINT)
    for steps in (-300.0, 150.0, 400.0):
        found = np.array([float(leaf) for leaf in light.at(steps).plane])
        np.testing.assert_allclose(found, reflected(steps * float(np.linalg.norm(PER_STEP))), rtol=2e-4, atol=2e-8)


def test_a_stack_of_positions_is_a_stack_of_planes():
    steps = np.array([[100.0], [500.0], [800.0]])
    stack = sheet().at(steps)
    X = np.random.default_rng(2).uniform([-50, -50, 300], [50, 50, 400], (3, 7, 3))
    for i in range(3):
        one = sheet().at(steps[i, 0])
        np.testing.assert_allclose(stack.level(X)[i], one.level(X[i]), rtol=1e-12)
        np.testing.assert_allclose(stack.gradient(X)[i], one.gradient(X[i]), rtol=1e-12)


def test_asked_without_a_position_it_stands_in_the_middle():
    light, X = sheet(), np.array([[3.0, 4.0, 350.0]])
    for plane in (light, stood(light, 500.0), in_the_middle(light), light_at(light, {"stage": 3.0})):
        np.testing.assert_allclose(plane.level(X), plane_of(OMEGA).level(X), rtol=1e-12)
    assert light_axes([light, LightPlane.create(OMEGA, "other")]) == ("sweep",)


def test_derivatives_of_the_inverse_depth_are_those_of_differences():
    light, rays = sheet(), np.array([[0.1, -0.05, 1.0], [-0.2, 0.1, 1.0]])
    positions = np.array([900.0, 100.0])
    w, _, by_numbers = inverse_depths(light, rays, positions)
    leaves, structure = jax.tree.flatten(light)
    for k, leaf in enumerate(leaves[:-1]):
        step = 1e-6 * max(abs(float(leaf)), 1e-6)
        ends = []
        for by in (step, -step):
            moved = jax.tree.unflatten(structure, [*leaves[:k], np.asarray(leaf + by), *leaves[k + 1 :]])
            ends.append(moved.at(positions).inverse_depth(rays))
        np.testing.assert_allclose(by_numbers[:, k], (ends[0] - ends[1]) / (2 * step), rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(w, light.at(positions).inverse_depth(rays))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("wrong", [0.0, 0.1])
def test_a_start_is_found_from_points_on_boards(sign, wrong):
    random = np.random.default_rng(3)
    true = as_numpy(SweptSheet.about(OMEGA, sign * PER_STEP, POINT, 500.0))
    steps, points = np.repeat(np.linspace(0.0, 1000.0, 6), 150), []
    for n in np.unique(steps):
        points.append(points_on(np.array(true.at(n).plane), 150, random))
    X = np.concatenate(points) + random.normal(0, 0.05, (900, 3))
    bad = random.uniform(size=900) < wrong
    X[bad] += random.normal(0, 20.0, (int(bad.sum()), 3))
    found = SweptSheet.fitted(X, np.zeros(900, int), "red", steps, "mirror")
    assert (found.name, found.axis, float(found.middle[0])) == ("red", "mirror", 500.0)
    for n in (0.0, 400.0, 1000.0):
        probe = points_on(np.array(true.at(n).plane), 50, random)
        plane = found.at(n)
        off = plane.level(probe) / np.linalg.norm(plane.gradient(probe), axis=1)
        assert np.abs(off).max() < 0.05


def test_what_makes_no_such_light_is_refused():
    random = np.random.default_rng(4)
    X = points_on(OMEGA, 300, random)
    with pytest.raises(ObservabilityError, match="of 2 positions of the sweep"):
        SweptSheet.fitted(X, np.zeros(300, int), "", np.repeat([0.0, 500.0], 150))
    with pytest.raises(ObservabilityError, match="make no sheet of light that turns"):
        SweptSheet.fitted(X, np.zeros(300, int), "", np.repeat([0.0, 500.0, 1000.0], 100))


def test_it_is_written_and_read_back(tmp_path):
    with float64():
        camera = Camera.create((640, 480), [700.0, 700.0], [320.0, 240.0], "none", [])
        rig = as_numpy(Rig(camera, (sheet(),)))
    write_rig(tmp_path / "rig.json", RigFile(rig))
    read = read_rig(tmp_path / "rig.json").rig
    assert read.lights[0].kind == "swept"
    assert read.lights[0].axis == "sweep"
    np.testing.assert_array_equal(jax.tree.leaves(read), jax.tree.leaves(rig))
    assert [name for name in parameter_names(rig) if name.startswith("lights.0.m")] == ["lights.0.middle.0"]
    assert "lights.0.middle.0" in rig.given()


def test_a_pixel_is_triangulated_where_the_light_stood():
    with float64():
        camera = Camera.create((640, 480), [700.0, 700.0], [320.0, 240.0], "none", [])
        rig = Rig(camera, (sheet(),))
        pixels = jnp.array([[300.0, 200.0], [350.0, 300.0]])
        found = rig.triangulate(pixels, {"sweep": jnp.array([300.0, 700.0])})
        for i, n in enumerate((300.0, 700.0)):
            np.testing.assert_allclose(sheet().at(n).level(np.asarray(found[i])), 0.0, atol=1e-12)
    with pytest.raises(InputError, match='moved by the axis "sweep"'):
        rig.triangulate(pixels, {})


def test_one_that_does_not_turn_is_at_fault():
    still = SweptSheet.create(OMEGA, (0.0, 0.0, 0.0), (0.0, 0.0))
    assert still.fault(np.array([[0.0, 0.0, 1.0]]))[0] == "per_step"
    assert sheet().fault(np.array([[0.0, 0.0, 1.0]])) is None
