"""Meshes against the solids that they are made from."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxscan.errors import InputError
from jaxscan.precision import float64
from jaxscan.rig import Rig
from jaxscan.simulation.distance import distance
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.render import render
from jaxscan.simulation.scene import Body, Scene
from jaxscan.simulation.shapes import grey, mesh_to_scan
from jaxscan.simulation.solids import Box, Sphere
from jaxscan.simulation.vector import Rays, Vec

pytest.importorskip("embreex", reason="embreex is not installed: the extra mesh-scenes")

from jaxscan.simulation.mesh import Mesh

CENTRE, RADIUS = np.array([5.0, -10.0, 300.0]), 25.0
BOX = trimesh.creation.box((40.0, 30.0, 20.0))
TURN = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
TURN *= np.sign(np.linalg.det(TURN))


@pytest.fixture(scope="module")
def ball() -> Mesh:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    return Mesh.create(mesh).moved(np.eye(3), CENTRE)


def test_box_is_met_like_a_box() -> None:
    shift = np.array([2.0, 3.0, 200.0])
    mesh = Mesh.create(BOX).moved(TURN, shift)
    solid = Box(shift, TURN.T, np.array([20.0, 15.0, 10.0]))
    xy = np.random.default_rng(0).uniform(-0.15, 0.15, (2, 4000))
    with float64():
        zero = jnp.zeros(4000)
        rays = Rays(Vec(zero, zero, zero), Vec(jnp.asarray(xy[0]), jnp.asarray(xy[1]), jnp.ones(4000)))
        (a, patch_a), (b, patch_b) = mesh.meet(rays), solid.meet(rays)
        met = np.isfinite(np.asarray(a)) & np.isfinite(np.asarray(b))
        x = rays.at(jnp.where(met, b, 1.0))
        normals = [np.stack(shape.normal_at(x, p), -1)[met] for shape, p in ((mesh, patch_a), (solid, patch_b))]
    # Embree decides in float32 whether a ray just hits.
    assert (np.isfinite(np.asarray(a)) != np.isfinite(np.asarray(b))).mean() < 1e-3
    np.testing.assert_allclose(np.asarray(a)[met], np.asarray(b)[met], atol=1e-6)
    assert (np.abs(normals[0] - normals[1]).max(1) < 1e-9).mean() > 0.999
    # Six faces of two triangles each: twelve triangles, six smooth parts.
    assert len(set(mesh.triangles.parts.tolist())) == 6


def test_photograph_of_a_ball(rig: Rig, ball: Mesh) -> None:
    def shoot(shape: Mesh | Sphere) -> np.ndarray:
        scene = Scene((Body(shape, grey(0.7)),))
        return render(rig, scene, laser=0, lighting=Lighting(laser_power=150.0), sensor=Sensor(noise=0)).astype(float)

    mesh, solid = shoot(ball), shoot(Sphere(CENTRE, RADIUS))
    assert solid[..., 0].max() > 60
    assert np.abs(mesh - solid).max() < 6
    assert np.abs(mesh - solid).mean() < 0.1


def test_profile_of_a_ball(rig: Rig, ball: Mesh) -> None:
    mesh, solid = (
        true_profile(rig, Scene((Body(shape, grey(0.7)),)), {"stage": 3000}) for shape in (ball, Sphere(CENTRE, RADIUS))
    )
    both = np.isfinite(mesh.position) & np.isfinite(solid.position)
    assert both.sum() > 20
    np.testing.assert_allclose(mesh.position[both], solid.position[both], atol=0.05)


def test_distance_from_a_mesh(ball: Mesh) -> None:
    random = np.random.default_rng(1)
    points = random.uniform(-30, 30, (500, 3))
    scene = Scene((Body(Mesh.create(BOX), grey(0.5)),))
    away = np.abs(points) - [20.0, 15.0, 10.0]
    expected = np.where((away < 0).all(1), -away.max(1), np.linalg.norm(np.maximum(away, 0), axis=1))
    np.testing.assert_allclose(distance(scene, points), expected, atol=1e-9)
    directions = random.standard_normal((300, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    found = distance(Scene((Body(ball, grey(0.5)),)), CENTRE + directions * (RADIUS + 0.5))
    np.testing.assert_allclose(found, 0.5, atol=0.02)


def test_meshes_that_cannot_be_scanned(tmp_path) -> None:
    with pytest.raises(InputError, match="no such file"):
        mesh_to_scan(tmp_path / "none.stl")
    (tmp_path / "text.stl").write_text("this is no mesh")
    with pytest.raises(InputError, match=r"text\.stl"):
        mesh_to_scan(tmp_path / "text.stl")
    trimesh.creation.box((400.0, 300.0, 200.0)).export(tmp_path / "large.stl")
    with pytest.raises(InputError, match="scale it"):
        mesh_to_scan(tmp_path / "large.stl")
    BOX.export(tmp_path / "box.stl")
    assert len(mesh_to_scan(tmp_path / "box.stl").faces) == 12
