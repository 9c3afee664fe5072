"""A scan on several axes in turn is one scan of one object: its sweeps are layers of one surface."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.reconstruction import RangeImage, write_points
from jaxscan.reconstruction.turns import sweeps_of
from jaxscan.simulation import rig_2003
from jaxscan.simulation.distance import distance
from jaxscan.simulation.drawn import drawn_scan
from jaxscan.simulation.scene import Body
from jaxscan.simulation.shapes import grey
from jaxscan.simulation.solids import Sphere
from jaxscan.surface.clean import clean, patches
from jaxscan.surface.floor import find_floor, stands_on
from jaxscan.surface.fused import fused
from jaxscan.surface.holes import fill_holes
from jaxscan.surface.links import links, sampling
from jaxscan.surface.passages import passages
from jaxscan.surface.plateaus import plateaus
from jaxscan.surface.triangles import facing_away, grid_layers, grid_surface

TURN = rig_2003.STEPS_PER_TURN
UNDER = rig_2003.turning_axes(TURN)["stage"][0]
AROUND = np.arange(0, TURN, 64)
ALONG = np.arange(UNDER - 20_000, UNDER + 20_000, 1000)


def positions(stage, turntable) -> dict[str, np.ndarray]:
    return {"stage": np.asarray(stage), "turntable": np.asarray(turntable)}


# Turned, shifted, turned on; along the stage, half a turn, back along it; both at once.
MIXTURES = {
    "turned twice": positions(np.repeat([UNDER, UNDER + 5000], len(AROUND)), np.tile(AROUND, 2)),
    "along and back": positions(np.concatenate([ALONG, ALONG[::-1]]), np.repeat([0, TURN // 2], len(ALONG))),
    "helix": positions(UNDER - 4000 + 100 * np.arange(80), 64 * np.arange(80)),
}


@cache
def scanned(name: str):
    """A ball of 30 mm that lies half under the platform, 5 mm beside the axis."""
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(3), 3)
    ball = Body(Sphere(np.array([5.0, rig_2003.OBJECT_Y, 0.0]), 15.0), grey(0.6))
    scene = rig_2003.scan_scene(rig, (ball,))
    image = drawn_scan(rig, scene, MIXTURES[name], 0.05).image
    return image, rig_2003.scan_scene(rig, rig_2003.turned_on(rig, (ball,), 0))


@pytest.fixture(scope="module", params=list(MIXTURES))
def mixture(request):
    return request.param, *scanned(request.param)


@pytest.mark.parametrize(
    ("stage", "turntable", "ends"),
    [
        ([5] * 5 + [6] * 5, [0, 1, 2, 3, 4] * 2, [5, 10]),
        ([5] * 5 + [6] * 5, [0, 1, 2, 3, 4, 4, 5, 6, 7, 8], [5, 10]),
        ([0, 1, 2, 3, 3, 2, 1, 0], [0, 0, 0, 0, 9, 9, 9, 9], [4, 8]),
        # The stage is photographed on its way, too.
        ([0, 0, 0, 0, 0, 1, 2, 3, 3, 3, 3, 3], [0, 1, 2, 3, 4, 4, 4, 4, 5, 6, 7, 8], [5, 7, 12]),
        ([0, 0, 0, 0, 0, 1, 1, 1], [0, 1, 1, 2, 3, 0, 1, 2], [5, 8]),
        (range(8), range(8), [8]),
        ([0, 0, 1, 1], [0, 1, 0, 1], [2, 4]),
        ([7], [7], [1]),
        ([7, 7], [7, 7], [2]),
    ],
)
def test_along_a_sweep_the_same_axes_move(stage, turntable, ends):
    assert [some.stop for some in sweeps_of(positions(list(stage), list(turntable)))] == ends


def test_its_layers_are_those_of_its_sweeps(mixture):
    name, image, _ = mixture
    frames = {"turned twice": [50, 50], "along and back": [40, 40], "helix": [80]}[name]
    assert [len(sweep.valid) for sweep in image.sweeps()] == frames
    parts = passages(image)
    assert len(parts) == {"turned twice": 4, "along and back": 2, "helix": 4}[name]
    np.testing.assert_array_equal(np.any(parts, axis=0), image.valid)
    assert np.sum(parts, axis=0).max() == 1
    surface = grid_surface(image)
    assert facing_away(surface, image) < 0.02
    np.testing.assert_array_equal(surface.vertices, image.points.reshape(-1, 3)[surface.place])
    sweep = np.repeat(np.arange(len(frames)), frames)[surface.place[surface.triangles] // image.valid.shape[1]]
    assert (sweep == sweep[:, :1]).all()


def test_each_turn_of_it_closes():
    image, _ = scanned("turned twice")
    columns = image.valid.shape[1]
    for first in (0, 50):
        seam = 0
        for layer in grid_layers(image):
            frame = layer.place[layer.triangles] // columns
            seam += int(((frame == first).any(axis=1) & (frame == first + 49).any(axis=1)).sum())
        assert seam > 100


def test_cleaning_floor_holes_and_areas(mixture):
    name, image, _ = mixture
    linked = links(image)
    assert linked.along.shape == (len(image.valid) - 1, image.valid.shape[1])
    if name != "helix":
        half = len(image.valid) // 2
        assert not linked.along[half - 1].any()
        label = patches(image, linked)
        one, other = (label[part][image.valid[part]] for part in (slice(half), slice(half, None)))
        assert len(np.intersect1d(one, other)) == 0
    cleaned = clean(image)
    assert cleaned.image.valid.sum() > 0.9 * image.valid.sum()
    floor = find_floor(cleaned.image)
    kept = stands_on(cleaned.image, floor)
    assert 0.02 < kept.sum() / image.valid.sum() < 0.9
    # A hole is filled in its own sweep, and nothing between two.
    inside = np.all([image.valid[k : k + 20, 1:-1] for k in (4, 5, 6)], axis=0)
    inside &= image.valid[5:25, 2:] & image.valid[5:25, :-2]
    frame, column = np.argwhere(inside)[0] + [5, 1]
    valid = image.valid.copy()
    valid[frame, column] = False
    points = np.where(valid[..., None], image.points, np.float32(np.nan))
    filled = fill_holes(replace(image, points=points, valid=valid), 100.0)
    assert filled.valid[frame, column]
    assert plateaus(image, floor) == ()


def test_the_surface_is_that_of_the_object(mixture):
    _, image, scene = mixture
    image = clean(image).image
    image = image.where(stands_on(image, find_floor(image)))
    points = distance(scene, image.points[image.valid].astype(np.float64))
    found = fused(image)
    off = distance(scene, np.asarray(found.mesh.vertices))
    assert np.sqrt(np.mean(off**2)) < np.sqrt(np.mean(points**2))
    assert found.sides.mean() > 1.3


def test_the_command_makes_one_surface_of_it(mixture, tmp_path, capsys):
    name, image, _ = mixture
    write_points(tmp_path / "ball.npz", image)
    assert main(["mesh", str(tmp_path / "ball.npz"), "-o", str(tmp_path / "ball.stl")]) == 0
    said = capsys.readouterr().out
    assert f"fused      of {4 if name != 'along and back' else 2} passages" in said
    assert main(["inspect", str(tmp_path / "ball.npz")]) == 0
    assert ("sweeps     2: in each the same axes move" in capsys.readouterr().out) == (name != "helix")


def test_frames_between_which_now_this_axis_moves_now_that_have_no_neighbours():
    image, _ = scanned("helix")
    some = image[:4, :]
    apart = replace(some, positions=positions([0, 1, 1, 5], [0, 0, 3, 3]))
    assert [len(sweep.valid) for sweep in apart.sweeps()] == [2, 2]
    assert sampling(apart).along_mm > 0
    alone = RangeImage.joined([apart[:1, :], replace(some[:1, :], positions=positions([2], [2]))])
    assert [len(sweep.valid) for sweep in alone.sweeps()] == [2]
