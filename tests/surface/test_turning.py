"""The surface of an object that was turned once all around."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.reconstruction import RangeImage
from jaxscan.simulation import rig_2003
from jaxscan.simulation.drawn import drawn_scan
from jaxscan.simulation.shapes import figure
from jaxscan.surface.clean import clean, patches
from jaxscan.surface.floor import find_floor, stands_on
from jaxscan.surface.holes import fill_holes
from jaxscan.surface.links import links, sampling
from jaxscan.surface.normals import normals
from jaxscan.surface.plateaus import plateaus
from jaxscan.surface.side import error_direction
from jaxscan.surface.triangles import grid_surface

TURN = rig_2003.STEPS_PER_TURN


@pytest.fixture(scope="module")
def turning():
    """The true points of the figure, 50 frames, 64 steps of 3200 apart."""
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(3), 3)
    q = {axis: np.array(steps) for axis, steps in rig_2003.turning_axes(64).items()}
    return drawn_scan(rig, rig_2003.scan_scene(rig, figure(rig_2003.OBJECT_Y)), q, 0.05)


def test_points_are_those_of_the_object(turning):
    valid = turning.image.valid
    assert valid.sum() > 5000
    off = np.linalg.norm(turning.image.points[valid] - turning.points[valid], axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.15


def test_the_last_frame_is_joined_to_the_first(turning):
    image = turning.image
    frames, columns = image.valid.shape
    surface = grid_surface(image)
    frame = surface.place[surface.triangles] // columns
    seam = (frame == 0).any(axis=1) & (frame == frames - 1).any(axis=1)
    inside = (frame == 20).any(axis=1) & (frame == 21).any(axis=1)
    assert seam.sum() > 0.5 * inside.sum() > 100
    # One place has one vertex, whichever frame it is reached from.
    assert len(np.unique(surface.place)) == len(surface.place)
    half = image[:25, :]
    assert half.closed() is half
    there = grid_surface(half)
    apart = np.abs(np.diff(there.place[there.triangles] // columns, axis=1)).max()
    assert apart == 1


def test_a_stripes_error_moves_a_point_within_the_sheet_as_it_stood(turning):
    image = turning.image
    e = error_direction(image)[image.valid]
    at = image.from_camera()
    frame = np.nonzero(image.valid)[0]
    seen = np.einsum("pji,pj->pi", at.matrix()[frame], e)
    normal = np.array([float(x) for x in image.sheets[0].plane])
    assert np.abs(seen @ normal).max() < 1e-6 * np.linalg.norm(normal) * 1e3
    np.testing.assert_allclose(np.linalg.norm(e, axis=1), 1)


def test_the_platform_is_its_floor(turning):
    floor = find_floor(turning.image)
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(3), 3)
    up = rig_2003.platform(rig)[0][:, 2]
    assert floor.up @ up > np.cos(np.radians(0.5))


def rolled(image: RangeImage, first: int, around: int = TURN) -> RangeImage:
    """The same scan begun at another frame; the frames that now come last are a full turn further on, or not."""
    order = (np.arange(len(image.valid)) + first) % len(image.valid)
    each = {name: getattr(image, name)[order] for name in ("points", "pixels", "strength", "sigma", "sigma_pixel")}
    positions = {axis: np.asarray(steps)[order] for axis, steps in image.positions.items()}
    positions["turntable"] = positions["turntable"] + np.where(order < first, around, 0)
    return replace(image, **each, valid=image.valid[order], positions=positions)


def with_faults(image: RangeImage) -> RangeImage:
    """Weak points beside their surface at both ends of the turn, glints and a hole across its seam."""
    points, strength, valid = image.points.copy(), image.strength.copy(), image.valid.copy()
    middle = int(np.median(np.flatnonzero(valid[0])))
    for frames, columns in (((0, 1, 2), 40), ((-1, 20), 60)):
        for frame in frames:
            seen = np.flatnonzero(valid[frame])
            weak = seen[columns : columns + 3]
            strength[frame, weak] *= 0.4
            points[frame, weak] += np.float32([0, 0, -1.0])
    valid[[0, 1, -1, 22], middle : middle + 4] = False
    dark = np.argwhere(~valid[[0, -1]].any(axis=0))[:2, 0]
    for frame in (0, -1):
        points[frame, dark], strength[frame, dark], valid[frame, dark] = image.points[valid][0] - 30, 200.0, True
    points[~valid] = np.nan
    return replace(image, points=points, strength=strength, valid=valid)


@pytest.mark.parametrize("around", [TURN, 0])
@pytest.mark.parametrize("first", [1, 7, 49])
def test_it_does_not_matter_which_frame_comes_first(turning, first, around):
    image = with_faults(turning.image)
    other = rolled(image, first, around)

    def same(of_one, of_other) -> None:
        np.testing.assert_allclose(of_other, np.roll(of_one, -first, axis=0), atol=1e-4)

    one, two = sampling(image), sampling(other)
    np.testing.assert_allclose(
        (two.across_mm, two.along_mm, two.noise_mm, two.step), (one.across_mm, one.along_mm, one.noise_mm, one.step)
    )
    linked, there = links(image), links(other)
    same(linked.across, there.across)
    same(linked.along, there.along)
    assert linked.along.shape == image.valid.shape
    assert linked.along[-1].any()
    same(normals(image, linked), normals(other, there))
    cleaned, again = clean(image), clean(other)
    assert all(count > 0 for count in cleaned.counts().values())
    same(cleaned.removed, again.removed)
    label, label_there = np.roll(patches(image, linked), -first, axis=0), patches(other, there)
    pairs = np.unique(np.stack([label.ravel(), label_there.ravel()]), axis=1)
    assert len(pairs[0]) == len(np.unique(pairs[0])) == len(np.unique(pairs[1]))
    filled, filled_there = fill_holes(image, 5.0), fill_holes(other, 5.0)
    assert filled.valid[[0, -1]].sum() > image.valid[[0, -1]].sum()
    same(filled.valid, filled_there.valid)
    same(filled.points, filled_there.points)
    floor = find_floor(cleaned.image)
    same(stands_on(cleaned.image, floor), stands_on(again.image, floor))
    surface, surface_there = grid_surface(cleaned.image), grid_surface(again.image)
    corners, corners_there = (
        np.unique(np.sort(np.round(1e3 * s.vertices[s.triangles].sum(axis=1)), axis=1), axis=0)
        for s in (surface, surface_there)
    )
    np.testing.assert_array_equal(corners, corners_there)
    heights, heights_there = (
        sorted(one.height_mm for one in plateaus(which.image, floor)) for which in (cleaned, again)
    )
    np.testing.assert_allclose(heights_there, heights, atol=1e-6)


def test_a_floor_does_not_depend_on_the_first_frame(turning):
    one, other = (find_floor(image) for image in (turning.image, rolled(turning.image, 7)))
    assert abs(other.up @ one.up) > np.cos(1e-4)
    assert abs(one.height(other.frame.translation)) < 0.1 * one.sigma_mm


def test_a_turn_that_does_not_close_has_two_ends(turning):
    image = turning.image
    part = image[:25, :]
    assert len(part.gaps()) == 24
    assert links(part).along.shape[0] == 24
    # There and back again is no turn.
    back = RangeImage.joined([part, part[::-1, :]])
    assert len(back.gaps()) == 49
    # A turn and a half, a turn that lacks a frame, and two turns.
    assert len(RangeImage.joined([image, part]).gaps()) == 74
    assert len(image[:-1, :].gaps()) == 48
    assert len(RangeImage.joined([image, image]).gaps()) == 100
    still = replace(image, positions={axis: np.zeros(50, int) for axis in image.positions})
    assert still.full_turn is None
    assert len(still.gaps()) == 49
