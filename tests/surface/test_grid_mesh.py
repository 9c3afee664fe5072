"""Meshes: what they join, what they leave apart, which way they face, and what they are made of."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scenes import ball, block, grid, seen

from jaxscan.errors import InputError
from jaxscan.rig import Camera, Fixed, LightPlane, Rig
from jaxscan.surface.holes import fill_holes
from jaxscan.surface.links import links
from jaxscan.surface.normals import normals
from jaxscan.surface.scattered import delaunay_surface, light_direction, poisson_surface, scattered_normals
from jaxscan.surface.triangles import facing_away, grid_surface


def as_mesh(surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices, surface.triangles, process=False)


def test_a_plane_is_all_triangles_and_faces_the_camera():
    x, y = grid(20, 30)
    surface = grid_surface(seen(0.3 * x + 0.1 * y))
    assert len(surface.triangles) == 2 * 19 * 29
    assert len(surface.vertices) == 600
    mesh = as_mesh(surface)
    assert mesh.is_winding_consistent
    assert (mesh.face_normals[:, 2] < 0).all()
    assert mesh.area == pytest.approx(0.4 * 19 * 0.2 * 29 * np.sqrt(1 + 0.09 + 0.01), rel=1e-4)
    backwards = replace(seen(0.3 * x + 0.1 * y), motion=Fixed())[::-1, :]
    assert (as_mesh(grid_surface(backwards)).face_normals[:, 2] < 0).all()


def test_nothing_crosses_a_depth_edge():
    image = block(high=2.0, noise=0.02)
    surface = grid_surface(image)
    depth = surface.vertices[surface.triangles][..., 2]
    assert np.ptp(depth, axis=1).max() < 0.3
    x, y = grid()
    top = int(((np.abs(x) < 6) & (np.abs(y) < 6)).sum())
    assert (depth.mean(axis=1) < 299).sum() == 2 * (29 - 1) * (59 - 1)
    assert top == 29 * 59


@pytest.mark.parametrize(("corner", "diagonal"), [((1, 1), {1, 2}), ((0, 0), {1, 2}), ((0, 1), {0, 3})])
def test_the_shorter_diagonal(corner, diagonal):
    """Corners are 0 to 3 in reading order; the diagonal that leaves the raised corner out is the shorter one."""
    height = np.zeros((2, 2))
    height[corner] = 0.9
    triangles = grid_surface(seen(height, spacing=(1.0, 1.0))).triangles.tolist()
    assert set(triangles[0]) & set(triangles[1]) == diagonal


def test_a_missing_corner_leaves_one_triangle():
    image = seen(np.zeros((2, 3)))
    image = image.where(np.array([[True, True, True], [True, True, False]]))
    surface = grid_surface(image)
    assert len(surface.triangles) == 3
    triangles, quads = surface.faces()
    assert (len(triangles), len(quads)) == (1, 1)
    corners = surface.vertices[quads[0]]
    across = np.cross(corners[1] - corners[0], corners[2] - corners[1])
    for i in range(4):
        turn = np.cross(corners[(i + 1) % 4] - corners[i], corners[(i + 2) % 4] - corners[(i + 1) % 4])
        assert turn @ across > 0


def test_quadrilaterals_cover_what_the_triangles_cover():
    surface = grid_surface(ball(noise=0.01))
    triangles, quads = surface.faces()
    assert 2 * len(quads) + len(triangles) == len(surface.triangles)
    both = np.concatenate([triangles, quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    mesh = trimesh.Trimesh(surface.vertices, both, process=False)
    assert mesh.is_winding_consistent
    assert mesh.area == pytest.approx(as_mesh(surface).area, rel=1e-3)


def test_a_stage_that_moved_the_other_way_folds_the_surface():
    y = grid(60, 60)[1]
    steep = np.where(y < 0, 3 * (y + 12), 3 * (12 - y))
    right = seen(steep)
    assert facing_away(grid_surface(right), right) == 0
    # A camera that looks along the travel at 45°: points slide along it with their height.
    slide = np.stack([0 * steep, -steep, 0 * steep], axis=-1).astype(np.float32)
    wrong = replace(right, points=right.points + slide)
    assert facing_away(grid_surface(wrong), wrong) > 0.1


def test_holes_are_left_or_filled():
    x, y = grid()
    whole = seen(0.01 * (x**2 - y**2))
    small = np.hypot(x - 2, y) < 1.5
    large = np.hypot(x + 6, y) < 4
    border = x > 11.5
    image = whole.where(~(small | large | border))
    assert len(grid_surface(image).triangles) < len(grid_surface(whole).triangles) - 2 * (small | large).sum()
    filled = fill_holes(image, 4.0)
    np.testing.assert_array_equal(filled.valid, image.valid | small)
    np.testing.assert_array_equal(filled.points[image.valid], image.points[image.valid])
    np.testing.assert_allclose(filled.points[small], whole.points[small], atol=0.02)
    assert grid_surface(filled).triangles.shape[0] > grid_surface(image).triangles.shape[0] + small.sum()
    assert fill_holes(whole, 4.0) is whole
    with pytest.raises(InputError, match="give a size"):
        fill_holes(image, 0.0)


def test_delaunay_along_the_light_where_the_view_from_above_folds():
    """A wall that leans over: from above its points lie under its rim, along the light they do not."""
    s, x = np.meshgrid(np.linspace(0, 20, 60), np.linspace(-10, 10, 80), indexing="ij")
    # Flat, then up and back toward the camera by 30°, lit from behind at 45°.
    y = np.where(s < 10, s, 10 - 0.5 * (s - 10))
    z = np.where(s < 10, 300.0, 300.0 - 0.87 * (s - 10))
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(0)
    order = rng.permutation(len(points))
    direction = np.array([0.0, 1.0, 1.0]) / np.sqrt(2)
    area = 20.0 * 20.0
    lit = trimesh.Trimesh(points[order], delaunay_surface(points[order], direction), process=False)
    assert lit.area == pytest.approx(area, rel=0.02)
    assert lit.is_winding_consistent
    assert (lit.face_normals @ direction < 0).all()
    above = trimesh.Trimesh(points[order], delaunay_surface(points[order], np.array([0.0, 0.0, 1.0])), process=False)
    assert abs(above.area - area) > 0.2 * area


def test_the_light_lies_in_its_plane():
    omega = np.array([0.0, -0.00494, 0.00303])
    camera = Camera.create((640, 480), np.array([700.0, 700.0]), np.array([319.5, 239.5]), "none")
    direction = light_direction(Rig(camera, (LightPlane.create(omega),)))
    assert abs(direction @ omega) < 1e-8
    assert np.linalg.norm(direction) == pytest.approx(1)
    assert direction[2] > 0


def test_delaunay_crosses_no_hole_and_refuses_what_is_no_surface():
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-10, 10, (4000, 2)), np.full(4000, 300.0)])
    points = points[np.hypot(points[:, 0], points[:, 1]) > 4]
    mesh = trimesh.Trimesh(points, delaunay_surface(points), process=False)
    assert mesh.area == pytest.approx(400 - np.pi * 16, rel=0.05)
    line = np.column_stack([np.arange(9.0), np.zeros(9), np.full(9, 300.0)])
    for bad, problem in ((points[:3], "3 points make no surface"), (line, "lie on one line")):
        with pytest.raises(InputError, match=problem):
            delaunay_surface(bad, np.array([0.0, 0.0, 1.0]))
    with pytest.raises(InputError, match=r"no triangle has sides of at most 0\.001 mm"):
        delaunay_surface(points, longest_mm=0.001)


def test_normals_of_scattered_points_and_poisson():
    pytest.importorskip("pymeshlab", reason="the extra poisson is not installed")
    rng = np.random.default_rng(2)
    outwards = rng.normal(size=(4000, 3))
    outwards /= np.linalg.norm(outwards, axis=1)[:, None]
    found = scattered_normals(10 * outwards, np.zeros(3))
    assert np.abs((found * outwards).sum(axis=1)).min() > 0.98
    assert ((found * outwards).sum(axis=1) < 0).all()
    closed = poisson_surface(10 * outwards, -found, depth=5)
    assert closed.is_watertight
    assert closed.volume == pytest.approx(4 / 3 * np.pi * 1000, rel=0.02)
    with pytest.raises(InputError, match="0 points with a normal"):
        poisson_surface(outwards, np.full_like(outwards, np.nan))
    image = ball()
    assert np.isfinite(normals(image, links(image))[image.valid]).all(axis=-1).mean() > 0.99


def test_what_has_no_triangles():
    image = block()
    with pytest.raises(InputError, match="at least two frames"):
        grid_surface(image[:1, :])
    checked = image.where(np.indices(image.valid.shape).sum(axis=0) % 2 == 0)
    with pytest.raises(InputError, match=r"no point has neighbours|no three neighbouring"):
        grid_surface(checked)
