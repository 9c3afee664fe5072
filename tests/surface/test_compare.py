"""Distances from meshes and clouds with their sign, the rigid fit, steps and flatness."""

import warnings

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.surface.colours import diverging
from jaxscan.surface.compare import compare, region
from jaxscan.surface.fit import rigid_fit_to
from jaxscan.surface.reference import CloudReference, MeshReference, signed_distance


@pytest.fixture(scope="module")
def thing() -> trimesh.Trimesh:
    """A thing without any symmetry, 300 mm in front of the camera."""
    parts = [
        trimesh.creation.box((40, 30, 10)),
        trimesh.creation.box((10, 12, 20), trimesh.transformations.translation_matrix((10, 5, -12))),
        trimesh.creation.box((6, 8, 8), trimesh.transformations.translation_matrix((-12, 9, -8))),
    ]
    mesh = trimesh.util.concatenate(parts)
    mesh.apply_translation([0, 0, 300])
    return mesh


def scanned(mesh: trimesh.Trimesh, count: int = 3000, noise: float = 0.02) -> np.ndarray:
    """Points on what of it faces the camera."""
    rng = np.random.default_rng(3)
    points, face = trimesh.sample.sample_surface(mesh, 4 * count, seed=3)
    outside = np.abs(points - [0, 0, 300]).max(axis=1) < 99
    seen = (mesh.face_normals[face] * -points).sum(axis=1) > 0
    points = points[seen & outside][:count]
    return points + noise * rng.normal(size=points.shape)


def test_signed_distance_from_a_box_in_closed_form():
    half = np.array([3.0, 2.0, 1.0])
    points = np.random.default_rng(0).uniform(-5, 5, (4000, 3))
    q = np.abs(points) - half
    exact = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    box = trimesh.creation.box(2 * half)
    np.testing.assert_allclose(signed_distance(MeshReference(box), points), exact, atol=1e-9)
    box.invert()
    turned = MeshReference(box)
    assert turned.inside_out
    np.testing.assert_allclose(signed_distance(turned, points), exact, atol=1e-9)


def test_signed_distance_from_the_points_of_a_ball():
    directions = trimesh.creation.icosphere(subdivisions=5).vertices
    # The part of the ball that is seen from the origin.
    directions = directions[directions[:, 2] < -0.2]
    reference = CloudReference(20 * directions + [0, 0, 300])
    inner = directions[directions[:, 2] < -0.5]
    for r in (19.0, 19.9, 20.5, 23.0):
        np.testing.assert_allclose(signed_distance(reference, r * inner + [0, 0, 300]), r - 20, atol=0.02)


def test_figures_and_what_is_beyond():
    plate = MeshReference(trimesh.creation.box((10, 10, 1)))
    points = np.array([[x, 0.0, 0.5 + d] for x, d in ((0, 0.1), (1, -0.1), (2, 0.3), (3, 4.0))])
    figures = compare(points, plate, within_mm=1.0).figures()
    assert figures["points"] == 3
    assert figures["points_beyond"] == 1
    assert figures["mean_mm"] == pytest.approx(0.1)
    assert figures["rms_mm"] == pytest.approx(np.sqrt(0.11 / 3))
    assert figures["median_mm"] == pytest.approx(0.1)
    assert figures["largest_mm"] == pytest.approx(0.3)
    with pytest.raises(InputError, match=r"no point is within 0\.01 mm"):
        compare(points[2:], plate, within_mm=0.01)
    with pytest.raises(InputError, match="cloud and reference lie apart"):
        compare(points + 100, plate)


def test_what_is_far_off_is_counted_and_stays_in_the_other_figures():
    plate = MeshReference(trimesh.creation.box((100, 100, 1)))
    off = np.array([0.1, -0.1] * 20 + [0.99, 1.01, 4.0])
    figures = compare(np.stack([np.arange(43.0) - 21, np.zeros(43), 0.5 + off], axis=1), plate).figures()
    assert figures["far_mm"] == pytest.approx(1.0)
    assert figures["points_far"] == 2
    assert figures["points"] == 43
    assert figures["rms_without_far_mm"] == pytest.approx(np.sqrt((0.4 + 0.99**2) / 41), rel=1e-6)
    assert figures["rms_mm"] == pytest.approx(np.sqrt((off**2).mean()))
    # More than half of the points on the surface itself are no measure of what is far.
    exact = compare(np.array([[0, 0, 0.5], [1, 0, 0.5], [2, 0, 0.7]]), plate).figures()
    assert exact["points_far"] == 0
    assert exact["rms_without_far_mm"] == exact["rms_mm"]


def test_the_rigid_fit_finds_its_way_from_anywhere(thing):
    points = scanned(thing)
    T = Pose(np.array([0.9, -1.7, 0.6]), np.array([80.0, -40.0, 120.0]))
    found = compare(T.apply(points), MeshReference(thing), fit=True)
    assert found.motion is not None
    there_and_back = found.motion @ T
    assert np.degrees(np.linalg.norm(there_and_back.rotation)) < 0.02
    assert np.linalg.norm(there_and_back.apply(np.array([0.0, 0.0, 300.0])) - [0, 0, 300]) < 0.01
    assert found.figures()["rms_mm"] == pytest.approx(0.02, rel=0.1)


def test_outliers_do_not_pull(thing):
    points = scanned(thing)
    stray = points[:400] + np.random.default_rng(1).uniform(-30, 30, (400, 3))
    T = rigid_fit_to(MeshReference(thing), np.concatenate([points, stray]))
    assert np.degrees(np.linalg.norm(T.rotation)) < 0.05
    assert np.linalg.norm(T.apply(np.array([0.0, 0.0, 300.0])) - [0, 0, 300]) < 0.02


def test_a_mirrored_reference_is_not_fitted(thing):
    mirrored = thing.copy()
    mirrored.apply_transform(np.diag([-1.0, 1.0, 1.0, 1.0]))
    with pytest.raises(InputError, match="the mirror image fits better"):
        compare(scanned(thing), MeshReference(mirrored), fit=True)


def test_steps_and_flatness():
    rng = np.random.default_rng(5)
    base = np.column_stack([rng.uniform(-5, 5, (3000, 2)), 300 + 0.01 * rng.normal(size=3000)])
    top = np.column_stack([rng.uniform(15, 25, (3000, 2)), 292.5 + 0.01 * rng.normal(size=3000)])
    tilt = Rotation.from_rotvec([0.1, 0.2, 0.0]).as_matrix()
    cloud = np.concatenate([base, top]) @ tilt.T
    one, two = (region(cloud, tilt @ pick, 4.0) for pick in ([0.0, 0.0, 300.0], [20.0, 20.0, 292.5]))
    assert two.above(one) == pytest.approx(7.5, abs=0.01)
    assert one.above(one) == pytest.approx(0, abs=1e-9)
    assert one.rms_mm == pytest.approx(0.01, rel=0.1)
    assert 0.04 < one.flatness_mm < 0.1
    with pytest.raises(InputError, match=r"0 points lie within 4 mm"):
        region(cloud, [0.0, 0.0, 0.0], 4.0)


def test_colours():
    colours = diverging(np.array([-2.0, -1.0, 0.0, 1.0, np.nan]), 1.0)
    np.testing.assert_array_equal(colours[0], colours[1])
    assert colours[1, 2] > 150 > colours[1, 0]
    assert colours[3, 0] > 150 > colours[3, 2]
    assert len(np.unique(colours[4])) == 1


def test_a_triangle_without_area_is_near_without_a_word():
    """Of a mesh that was scanned some have none: NumPy's warnings came up on the screen."""
    box = trimesh.creation.box((10, 10, 1))
    sliver = np.array([[20.0, 0, 0.5], [30.0, 0, 0.5], [25.0, 0, 0.5]])
    mesh = trimesh.Trimesh(
        np.concatenate([box.vertices, sliver]), np.concatenate([box.faces, [[8, 9, 10]]]), process=False
    )
    points = np.array([[0.0, 0, 1.5], [25.0, 0, 1.5]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        foot, normal = MeshReference(mesh).nearest(points)
    np.testing.assert_allclose(foot, [[0, 0, 0.5], [25.0, 0, 0.5]], atol=1e-9)
    assert np.isfinite(normal).all()
