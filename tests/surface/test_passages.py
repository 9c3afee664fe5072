"""What a full turn shows twice is one surface, up to the axis."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import trimesh

from jaxscan.cli.main import main
from jaxscan.files.ply_read import read_ply_file
from jaxscan.geometry import Pose
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import RangeImage, write_points
from jaxscan.reconstruction.point_sigma import ray_jacobian
from jaxscan.rig import Fixed, Rig, Rotary
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003
from jaxscan.simulation.distance import distance
from jaxscan.simulation.drawn import drawn_scan, noisy_scan
from jaxscan.simulation.scene import Body, Scene
from jaxscan.simulation.shapes import box, floor, grey
from jaxscan.simulation.solids import Sphere
from jaxscan.surface.clean import clean
from jaxscan.surface.floor import find_floor
from jaxscan.surface.fused import fused
from jaxscan.surface.links import sampling
from jaxscan.surface.passages import passages
from jaxscan.surface.plateaus import plateaus
from jaxscan.surface.resample import resample
from jaxscan.surface.triangles import facing_away, grid_layers, grid_surface

TURN = rig_2003.STEPS_PER_TURN
NOISE_PX = 0.05


def rig_with_its_axis_in_the_sheet() -> Rig:
    """With a turntable and no stage; the axis goes through the origin of the platform."""
    rig = rig_2003.simulated_rig(3)
    R, origin = rig_2003.platform(rig)
    normal = np.array([float(leaf) for leaf in rig.lights[0].plane])
    normal /= np.linalg.norm(normal)
    axis = R[:, 2] - (R[:, 2] @ normal) * normal
    axis /= np.linalg.norm(axis)
    with float64():
        return as_numpy(Rig(rig.camera, rig.lights, Rotary.create(2 * np.pi / TURN * axis, origin)))


@pytest.fixture(scope="module")
def dome():
    """A ball of 50 mm, its middle 35 mm under the platform and 8 mm off the axis, which lies in the sheet."""
    rig = rig_with_its_axis_in_the_sheet()
    origin, axis = rig_2003.platform(rig_2003.simulated_rig(3))[1], rig.axis("turntable").direction()
    normal = np.array([float(leaf) for leaf in rig.lights[0].plane])
    normal /= np.linalg.norm(normal)
    ball = Sphere(origin - 35.0 * axis + 8.0 * np.cross(axis, normal), 50.0)
    scene = Scene((Body(ball, grey(0.6)),))
    image = drawn_scan(rig, scene, {"turntable": np.arange(0, TURN, 32)}, NOISE_PX).image
    off_axis = np.linalg.norm(np.cross(image.points - origin, axis), axis=-1)
    return image.where(off_axis < 22.0), scene, lambda points: np.linalg.norm(np.cross(points - origin, axis), axis=-1)


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def layers_along(mesh: trimesh.Trimesh, points: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
    """How many triangles a piece of each line goes through: Möller and Trumbore, all with all."""
    a, b, c = np.asarray(mesh.vertices)[np.asarray(mesh.faces)].swapaxes(0, 1)
    count = []
    for origin, d in zip(points, directions, strict=True):
        p = np.cross(d, c - a)
        det = ((b - a) * p).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = ((origin - a) * p).sum(axis=1) / det
            q = np.cross(origin - a, b - a)
            v, t = (q @ d) / det, ((c - a) * q).sum(axis=1) / det
        count.append(int(((u >= 0) & (v >= 0) & (u + v <= 1) & (np.abs(t) < reach)).sum()))
    return np.array(count)


def test_each_point_is_of_one_passage(dome):
    image, _, off_axis = dome
    parts = passages(image)
    assert len(parts) == 2
    np.testing.assert_array_equal(parts[0] | parts[1], image.valid)
    assert not (parts[0] & parts[1]).any()
    # The sheet holds the axis, so that in each frame the passages are its two sides.
    for part in parts:
        column = np.argwhere(part & (off_axis(image.points) > 2.0))[:, 1]
        assert np.ptp(column) < 0.6 * np.ptp(np.argwhere(image.valid)[:, 1])
    half = image[:50, :]
    assert len(passages(half)) == 1
    assert len(passages(image[:60, :])) == 2
    further = {"turntable": image.positions["turntable"] + TURN}
    assert len(passages(RangeImage.joined([image, replace(image, positions=further)]))) == 4
    assert len(passages(replace(image, sheets=()))) == len(passages(replace(image, motion=Fixed()))) == 1


def test_layers_of_the_grid_are_not_joined_and_face_the_camera(dome):
    image, _, _ = dome
    surface = grid_surface(image)
    assert facing_away(surface, image) < 0.005
    first = passages(image)[0].ravel()[surface.place[surface.triangles]]
    assert (first.all(axis=1) | ~first.any(axis=1)).all()
    assert len(np.unique(surface.cells)) >= len(surface.cells) / 2
    triangles, quads = surface.faces()
    assert len(triangles) + 2 * len(quads) == len(surface.triangles)


def test_a_full_turn_is_one_surface_up_to_its_axis(dome):
    image, scene, off_axis = dome
    image = clean(image).image
    found = fused(image)
    mesh, spacing = found.mesh, max(sampling(image).across_mm, sampling(image).along_mm)
    off = distance(scene, np.asarray(mesh.vertices))
    points = distance(scene, image.points[image.valid].astype(np.float64))
    # Averaged, and nowhere far off.
    assert rms(off) < 0.6 * rms(points)
    assert off.max() < 4 * rms(points)
    assert mesh.body_count == 1
    assert found.sides.mean() > 1.8
    # A single layer.
    inner = off_axis(np.asarray(mesh.triangles_center)) < 18.0
    some = np.random.default_rng(0).permutation(np.flatnonzero(inner))[:300]
    weights = np.random.default_rng(1).dirichlet(np.ones(3), len(some))
    at = np.einsum("ni,nik->nk", weights, mesh.triangles[some])
    assert (layers_along(mesh, at, np.asarray(mesh.face_normals)[some], 2.0) == 1).all()
    # No hole about the axis.
    edges, count = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    border = off_axis(np.asarray(mesh.vertices)[edges[count == 1]])
    assert border.min() > 20.0
    assert np.abs(off_axis(np.asarray(mesh.vertices))).min() < spacing
    # No needles there.
    near = off_axis(np.asarray(mesh.triangles_center)) < 5.0
    assert near.sum() > 50
    sides = np.linalg.norm(mesh.triangles - np.roll(mesh.triangles, 1, axis=1), axis=2)[near]
    assert sides.max() < 2.5 * spacing
    assert np.degrees(mesh.face_angles[near]).min() > 10.0
    doubled = grid_layers(image)
    assert len(doubled) == 2


def test_sigma_of_a_fused_surface_has_what_the_rig_is_wrong_by(dome):
    """The rig's principal point is off by its σ each way; averages leave that error, and reduce the noise."""
    image, scene, off_axis = dome
    image = image.where(off_axis(image.points) < 9.0)
    rig = rig_with_its_axis_in_the_sheet()
    names = parameter_names(rig)
    off = np.zeros(len(names))
    off[names.index("camera.principal.0")], off[names.index("camera.principal.1")] = 0.2, -0.2
    leaves, tree = jax.tree.flatten(rig)
    wrong = as_numpy(jax.tree.unflatten(tree, list(np.array(leaves, float) + off)))
    frame, column = np.nonzero(image.valid)
    pixels = np.stack([column, image.pixels[image.valid]], axis=1).astype(np.float64)
    each = {axis: np.asarray(steps)[frame] for axis, steps in image.positions.items()}
    by_rig = np.zeros(image.valid.shape, np.float32)
    by_rig[image.valid] = np.linalg.norm(ray_jacobian(rig, "", pixels, each, True)[0] * off, axis=1)
    seen = noisy_scan(wrong, np.where(image.valid, image.pixels, np.nan), image.positions, 0.0)
    sigma = {"sigma_pixel": image.sigma_pixel, "sigma": np.hypot(image.sigma_pixel, by_rig)}
    found, ball = fused(clean(replace(seen, **sigma)).image), scene.bodies[0].shape
    error = np.linalg.norm(found.mesh.vertices - ball.centre, axis=1) - ball.radius
    assert 0.7 < rms(error / found.sigma) < 1.3
    assert rms(error / found.sigma_pixel) > 3


def test_the_commands_say_what_they_make_of_a_turn(dome, tmp_path, capsys):
    image, _, _ = dome
    write_points(tmp_path / "dome.npz", image)
    write_points(tmp_path / "few.npz", image[::12, :])
    write_points(tmp_path / "half.npz", image[:50, :])
    write_points(tmp_path / "still.npz", replace(image, positions={"turntable": np.zeros(len(image.valid), int)}))

    def run(*words: str) -> tuple[int, str]:
        code = main([word if word.startswith("-") or "." not in word else str(tmp_path / word) for word in words])
        captured = capsys.readouterr()
        return code, captured.out + captured.err

    keep = ("--floor", "keep", "-o", "dome.ply")
    code, said = run("mesh", "dome.npz", *keep)
    assert code == 0
    assert "fused      of 2 passages through the light, 2.0 on each vertex" in said
    assert "folded" not in said
    assert {"sigma", "sigma_pixel"} <= set(read_ply_file(tmp_path / "dome.ply").elements["vertex"].columns)
    assert "of which the pixel's part is 0.0" in run("inspect", "dome.ply")[1]
    code, said = run("mesh", "dome.npz", *keep, "--method", "grid", "--quads")
    assert code == 0
    assert "layers     2: the scan has shown the object as often" in said
    for words, says in (
        (("--quads",), "dome.npz: --quads: the scan has shown the object 2 times"),
        (("--method", "delaunay"), "dome.npz: --method delaunay: the scan has shown the object 2 times"),
    ):
        code, said = run("mesh", "dome.npz", *keep, *words)
        assert code == 2
        assert says in said
    assert (
        "the frames are 43.2 degrees of a turn apart" in run("mesh", "few.npz", *keep, "--raw", "--method", "grid")[1]
    )
    assert "all 100 frames are of one place, turntable 0" in run("mesh", "still.npz", *keep)[1]
    assert "turn       once all around, or more: the last frame is beside the first" in run("inspect", "dome.npz")[1]
    assert "all around" not in run("inspect", "half.npz")[1]


def test_a_grid_from_above_is_the_mean_of_the_layers(dome):
    image, scene, off_axis = dome
    up = Pose.from_matrix(rig_2003.platform(rig_2003.simulated_rig(3))[0], np.zeros(3))
    nodes = resample(image, 1.0, up)
    one = resample(image.where(passages(image)[0]), 1.0, up)
    there = nodes.valid & (off_axis(np.nan_to_num(nodes.points)) < 18)
    off = rms(distance(scene, nodes.points[there].astype(np.float64)))
    alone = distance(scene, one.points[one.valid & (off_axis(np.nan_to_num(one.points)) < 18)].astype(np.float64))
    assert off < 0.85 * rms(alone)
    assert np.median(nodes.sigma_pixel[there]) == pytest.approx(np.nanmedian(one.sigma_pixel) / np.sqrt(2), rel=0.05)
    # The higher of two would stand above the surface.
    ball = scene.bodies[0].shape
    height = np.linalg.norm(nodes.points[there] - np.asarray(ball.centre), axis=1) - 50.0
    assert abs(height.mean()) < 0.2 * off


def test_a_level_piece_has_its_area_once():
    """The top of a box under the axis, seen at two passages and more densely near the axis."""
    rig = rig_with_its_axis_in_the_sheet()
    R, origin = rig_2003.platform(rig_2003.simulated_rig(3))
    bodies = (box(0.0, (30.0, 24.0, 5.0)), floor((-40.0, -40.0), (40.0, 40.0)))
    scene = Scene(tuple(body.moved(R, origin) for body in bodies))
    image = drawn_scan(rig, scene, {"turntable": np.arange(0, TURN, 32)}, NOISE_PX).image
    image = clean(image).image
    found = plateaus(image, find_floor(image))
    assert len(found) == 1
    assert found[0].height_mm == pytest.approx(5.0, abs=0.02)
    assert found[0].area_mm2 == pytest.approx(30 * 24, rel=0.1)
