"""Spans against the solids' own height functions, which do not use them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.precision import float64
from jaxscan.simulation.cone import Cone
from jaxscan.simulation.solids import Box, Cylinder, Difference, HalfSpace, Intersection, Solid, Sphere
from jaxscan.simulation.vector import Rays, Vec

AXIS = np.array([0.2, -0.4, -0.9]) / np.linalg.norm([0.2, -0.4, -0.9])
TURN = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]
BALL = Sphere(np.array([1.0, -2.0, 50.0]), 9.0)
BOX = Box(np.array([1.0, 2.0, 52.0]), TURN, np.array([7.0, 5.0, 3.0]))
CYLINDER = Cylinder(np.array([0.0, 0.0, 55.0]), AXIS, 8.0, 12.0)
POT = Difference(CYLINDER, Cylinder(CYLINDER.base + 2 * AXIS, AXIS, 6.0, 12.0))
HALF_RING = Difference(
    Intersection(Cylinder(np.array([0.0, -3.0, 50.0]), np.array([0.0, 1.0, 0.0]), 9.0, 6.0), HalfSpace(AXIS, -40.0)),
    Cylinder(np.array([0.0, -9.0, 50.0]), np.array([0.0, 1.0, 0.0]), 5.0, 20.0),
)
# Steeper than the rays that meet it, less steep than they are, and with a tip that the rays come from behind.
CONES = {
    "cone": Cone(np.array([0.0, 0.0, 58.0]), AXIS, 9.0, 3.0, 8.0),
    "slender cone": Cone(np.array([-9.0, 2.0, 55.0]), np.array([0.96, 0.28, 0.0]), 6.0, 2.0, 20.0),
    "blunt cone": Cone(np.array([1.0, 1.0, 58.0]), np.array([0.0, 0.0, -1.0]), 10.0, 0.0, 4.0),
    "funnel": Cone(np.array([0.0, 0.0, 48.0]), -AXIS, 1.0, 9.0, 8.0),
}
SOLIDS = {"ball": BALL, "box": BOX, "cylinder": CYLINDER, "pot": POT, "half ring": HALF_RING, **CONES}


def camera_rays(n: int, dtype: type = np.float64) -> np.ndarray:
    xy = np.random.default_rng(1).uniform(-0.25, 0.25, (n, 2))
    return np.column_stack([xy, np.ones(n)]).astype(dtype)


def to_rays(directions: np.ndarray) -> Rays:
    zero = jnp.zeros_like(directions[:, 0])
    return Rays(Vec(zero, zero, zero), Vec(*(jnp.asarray(directions[:, i]) for i in range(3))))


@jax.jit
def meet(solid: Solid, rays: Rays) -> tuple[jax.Array, jax.Array]:
    return solid.meet(rays)


@jax.jit
def gradient(solid: Solid, x: Vec) -> jax.Array:
    by_x, by_y, by_z = (
        (solid.height(x._replace(**{c: getattr(x, c) + 1e-6})) - solid.height(x)) / 1e-6 for c in ("x", "y", "z")
    )
    return jnp.stack([by_x, by_y, by_z], axis=-1)


def marched(solid: Solid, directions: np.ndarray) -> np.ndarray:
    """The first t at which the height changes sign, by small steps and bisection."""
    rays = to_rays(directions)
    height = jax.jit(lambda t: solid.height(rays.at(t)))
    steps = np.linspace(30, 70, 2001)
    inside = np.asarray(jax.jit(jax.vmap(lambda t: solid.height(rays.at(t))))(steps)) <= 0
    enters = ~inside[:-1] & inside[1:]
    first = np.argmax(enters, axis=0)
    low = np.where(enters.any(axis=0), steps[first], np.nan)
    high = low + steps[1] - steps[0]
    for _ in range(40):
        middle = (low + high) / 2
        outside = np.asarray(height(jnp.asarray(middle))) > 0
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    return low


@pytest.mark.parametrize("name", SOLIDS)
def test_first_meeting(name: str) -> None:
    directions = camera_rays(500)
    with float64():
        t, _ = meet(SOLIDS[name], to_rays(directions))
        expected = marched(SOLIDS[name], directions)
    met = np.isfinite(expected)
    assert 30 < met.sum() < 500
    np.testing.assert_allclose(np.asarray(t)[met], expected[met], atol=1e-9)
    # A ray that only grazes the solid can slip between two steps.
    assert np.isfinite(np.asarray(t)[~met]).mean() < 0.01


@pytest.mark.parametrize("name", SOLIDS)
def test_float32_is_good_to_a_hundredth_of_a_micrometre(name: str) -> None:
    solid = SOLIDS[name]
    directions = camera_rays(500, np.float32)
    single = np.asarray(meet(jax.tree.map(np.float32, solid), to_rays(directions))[0])
    with float64():
        double = np.asarray(meet(solid, to_rays(directions.astype(np.float64)))[0])
    both = np.isfinite(single) & np.isfinite(double)
    assert (np.isfinite(single) != np.isfinite(double)).mean() < 0.005
    error = np.abs(single[both] - double[both])
    assert np.median(error) < 1e-5
    assert np.quantile(error, 0.99) < 5e-4


@pytest.mark.parametrize("name", SOLIDS)
def test_normal_is_the_gradient_of_height(name: str) -> None:
    solid = SOLIDS[name]
    with float64():
        rays = to_rays(camera_rays(500))
        t, patch = meet(solid, rays)
        met = np.isfinite(np.asarray(t))
        x = rays.at(jnp.where(met, t, 1.0))
        normal = np.stack(jax.jit(type(solid).normal_at)(solid, x, patch), axis=-1)[met]
        expected = np.asarray(gradient(solid, x))[met]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-9)
    assert (np.abs(normal - expected).max(axis=1) < 1e-4).mean() > 0.99


def test_moved_solid_is_met_like_moved_rays() -> None:
    R, shift = TURN * np.sign(np.linalg.det(TURN)), np.array([1.0, -4.0, 3.0])
    directions = camera_rays(500)
    with float64():
        for solid in SOLIDS.values():
            origin = np.broadcast_to(-R.T @ shift, directions.shape)
            local = Rays(Vec(*map(jnp.asarray, origin.T)), Vec(*map(jnp.asarray, (directions @ R).T)))
            np.testing.assert_allclose(
                meet(solid.moved(R, shift), to_rays(directions))[0], meet(solid, local)[0], rtol=1e-9
            )


def test_a_cone_of_one_radius_is_a_cylinder() -> None:
    same = Cone(CYLINDER.base, AXIS, CYLINDER.radius, CYLINDER.radius, CYLINDER.length)
    with float64():
        rays = to_rays(camera_rays(500))
        np.testing.assert_allclose(meet(same, rays)[0], meet(CYLINDER, rays)[0], rtol=1e-12)


def test_the_other_nappe_of_a_cone_is_not_there() -> None:
    """A line through the tip, and lines that are parallel to the side."""
    tip = Cone(np.array([0.0, 0.0, 50.0]), np.array([0.0, 0.0, -1.0]), 5.0, 0.0, 5.0)
    with float64():
        ahead = to_rays(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))
        np.testing.assert_allclose(meet(tip, ahead)[0], [45.0, np.inf])
        side = Vec(jnp.asarray([1.0, 1.0]), jnp.zeros(2), jnp.asarray([1.0, -1.0]))
        start = Vec(jnp.asarray([-4.0, -9.0]), jnp.zeros(2), jnp.asarray([43.0, 53.0]))
        # Along x = z - 47 the left side, x = 45 - z, is met at z = 46; along x = 44 - z nothing is.
        np.testing.assert_allclose(meet(tip, Rays(start, side))[0], [3.0, np.inf], atol=1e-9)


def test_rays_along_axes_and_faces() -> None:
    upright = Cylinder(np.array([0.0, 0.0, 40.0]), np.array([0.0, 0.0, 1.0]), 5.0, 10.0)
    cube = Box(np.array([0.0, 0.0, 50.0]), np.eye(3), np.full(3, 5.0))
    with float64():
        ahead = to_rays(np.array([[0.0, 0.0, 1.0]]))
        assert float(meet(upright, ahead)[0][0]) == pytest.approx(40)
        assert float(meet(cube, ahead)[0][0]) == pytest.approx(45)
        aside = Rays(Vec(*(jnp.asarray([c]) for c in (6.0, 0.0, 0.0))), ahead.direction)
        assert np.isinf(meet(cube, aside)[0][0])


def test_a_ray_that_is_not_a_number_meets_nothing() -> None:
    for solid in SOLIDS.values():
        t, _ = meet(solid, to_rays(np.array([[np.nan, 0.0, 1.0]], np.float32)))
        assert np.isinf(t[0])


def test_blocks_between_its_ends_only() -> None:
    def blocked(length: float) -> bool:
        rays = to_rays(np.array([[0.0, 0.0, length]]))
        return bool(BALL.blocks(rays, jnp.asarray([1e-6]))[0])

    assert not blocked(30.0)
    assert blocked(60.0)
    # From a point of its own surface outwards it is not in the way, inwards it is.
    with float64():
        t = BALL.meet(to_rays(np.array([[0.0, 0.0, 1.0]])))[0]
        start = Vec(jnp.zeros(1), jnp.zeros(1), t)
        for direction, expected in ((-1.0, False), (1.0, True)):
            rays = Rays(start, Vec(jnp.zeros(1), jnp.zeros(1), jnp.asarray([50.0 * direction])))
            assert bool(BALL.blocks(rays, jnp.asarray([1e-4]))[0]) is expected
