"""Colours of a scan's points: from the photograph of each step without the laser, or from beside the stripe."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.scan import Scan, read_scan
from jaxscan.images import StripeSettings, read_image, write_image
from jaxscan.reconstruction import RangeImage, reconstruct
from jaxscan.reconstruction.scan_colours import neighbour_colours, object_stands, own_colours
from jaxscan.rig import Rig
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_scan
from jaxscan.simulation.scene import Body
from jaxscan.simulation.solids import Box, Sphere
from tests.reconstruction.small import small_rig

# Albedos of the things on the platform, and of the platform: well apart, and none more red than a laser can bear.
BALL, BOX, FLOOR = (0.3, 0.8, 0.35), (0.4, 0.4, 0.9), (0.5, 0.5, 0.5)
# Brightness of a white surface that faces the lamp, and of one that does not see it.
LIGHT = replace(rig_2003.SCAN_LIGHTING, ambient=150.0, directional=60.0)
FRAMES, APART = 24, 1500


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> tuple[Rig, Scan]:
    """A green ball and a blue box scanned along the stage, each step with the laser off too."""
    rig = rig_2003.simulated_rig(41)
    bodies = (
        Body(Sphere(np.array([-22.0, 18.0, 14.0]), 14.0), np.array(BALL)),
        Body(Box(np.array([22.0, 18.0, 9.0]), np.eye(3), np.array([14.0, 10.0, 9.0])), np.array(BOX)),
    )
    folder = tmp_path_factory.mktemp("world") / "scan"
    scene = rig_2003.scan_scene(rig, bodies)
    simulate_scan(folder, rig, scene, 41, frames=FRAMES, steps_apart=APART, lighting=LIGHT, laser_off=True)
    return rig, read_scan(folder)


@pytest.fixture(scope="module")
def image(world: tuple[Rig, Scan]) -> RangeImage:
    return reconstruct(*world)


def shares(colours: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Red, green and blue as parts of their sum: what neither shade nor exposure changes."""
    some = colours.any(axis=-1) & np.isfinite(points).all(axis=-1)
    return colours[some] / colours[some].sum(axis=-1, keepdims=True).astype(float)


def of_one_thing(found: np.ndarray) -> np.ndarray:
    """Which of the three each colour is, −1 for none of them."""
    true = np.array([np.array(c) / sum(c) for c in (BALL, BOX, FLOOR)])
    off = np.abs(found[:, None] - true).max(axis=2)
    return np.where(off.min(axis=1) < 0.06, off.argmin(axis=1), -1)


def check(rig: Rig, image: RangeImage, least_known: float, most_odd: float) -> None:
    """Each thing has its own colour: points above the platform are no grey, and those of ball and box apart."""
    assert image.colours is not None
    known = image.colours.any(axis=-1)
    assert known[image.valid].mean() > least_known
    assert not image.colours[~image.valid].any()
    R, origin = rig_2003.platform(rig)
    x, _, z = np.moveaxis((image.points[known].astype(float) - origin) @ R, -1, 0)
    thing = of_one_thing(shares(image.colours, image.points))
    ball, box, floor = (z > 3) & (x < 0), (z > 3) & (x > 0), z < 0.5
    for expected, some in enumerate((ball, box, floor)):
        assert some.sum() > 250
        assert (thing[some] != expected).mean() < most_odd, expected


def test_each_point_has_the_colour_of_its_own_step(world: tuple[Rig, Scan], image: RangeImage) -> None:
    check(world[0], image, 0.999, 0.03)
    # The pixel of the laser-off photograph itself, whatever has moved since.
    i = FRAMES // 2
    dark = read_image(world[1].backgrounds[i]).astype(float)
    columns = np.flatnonzero(image.valid[i])
    v = image.pixels[i, columns]
    top = np.floor(v).astype(int)
    exact = (1 - (v - top))[:, None] * dark[top, columns] + (v - top)[:, None] * dark[top + 1, columns]
    np.testing.assert_allclose(image.colours[i, columns], np.clip(np.round(exact), 1, 255), atol=1)


def test_without_laser_off_photographs_they_come_from_other_steps(world: tuple[Rig, Scan]) -> None:
    rig, scan = world
    alone = replace(scan, backgrounds=())
    found = reconstruct(rig, alone)
    assert found.colours is None
    coloured = replace(found, colours=neighbour_colours(rig, alone, found))
    check(rig, coloured, 0.9, 0.04)
    # Light of the stripe is in none of them: red would be the most of it.
    assert shares(coloured.colours, found.points)[:, 0].max() < 0.45
    # Of the right place: a rig that moves the other way finds other colours.
    backwards = replace(found, positions={"stage": -np.asarray(found.positions["stage"])})
    with pytest.raises(AssertionError):
        check(rig, replace(found, colours=neighbour_colours(rig, alone, backwards)), 0.9, 0.04)


def test_laser_off_photographs_of_neighbouring_steps_have_less_noise(
    world: tuple[Rig, Scan], image: RangeImage
) -> None:
    rig, scan = world
    mean = neighbour_colours(rig, scan, image)
    R, origin = rig_2003.platform(rig)
    floor = image.valid & (((image.points - origin) @ R)[..., 2] < 0.3) & mean.any(axis=-1)
    x = ((image.points - origin) @ R)[..., 0]
    plain = floor & (np.abs(x) > 45) & (np.abs(x) < 70)
    assert plain.sum() > 300
    assert mean[plain].std() < 0.8 * image.colours[plain].std()


def test_one_photograph_for_all_is_a_colour_only_where_nothing_moves(world: tuple[Rig, Scan]) -> None:
    rig, scan = world
    one = replace(scan, backgrounds=scan.backgrounds[:1])
    assert not object_stands(rig, one)
    assert reconstruct(rig, one).colours is None
    still = replace(one, axes={"stage": (0,) * FRAMES})
    assert object_stands(rig, still)
    found = reconstruct(rig, still)
    assert found.colours is not None
    assert found.colours[0][found.valid[0]].any(axis=-1).all()


def test_grey_photographs_and_those_of_16_bits() -> None:
    random = np.random.default_rng(3)
    grey = random.integers(2, 255, (2, 30, 20), np.uint8)
    position = np.full((2, 20), 11.0, np.float32)
    position[0, 4] = np.nan
    found = own_colours(grey, position, columns=True)
    np.testing.assert_array_equal(found[1], np.repeat(grey[1, 11][:, None], 3, axis=1))
    np.testing.assert_array_equal(found[0, 4], 0)
    np.testing.assert_array_equal(own_colours(grey.astype(np.uint16) * 257, position, columns=True), found)
    by_rows = own_colours(grey, np.full((2, 30), 7.0, np.float32), columns=False)
    np.testing.assert_array_equal(by_rows[0, :, 1], grey[0, :, 7])
    # One for all.
    np.testing.assert_array_equal(own_colours(grey[:1], position, columns=True)[1, :, 0], grey[0, 11])
    # Black is a colour, and no lack of one.
    assert own_colours(np.zeros_like(grey), position, columns=True)[1].min() == 1


def test_several_exposures_take_one_that_all_steps_have(world: tuple[Rig, Scan], tmp_path: Path) -> None:
    rig, scan = world
    frames, steps, times = [], [], []
    for i in range(0, FRAMES, 2):
        dim = tmp_path / f"{i:03d}.png"
        write_image(dim, (read_image(scan.frames[i]) // 4).astype(np.uint8))
        frames += [dim, scan.frames[i]]
        steps += 2 * [scan.axes["stage"][i]]
        times += [0.01, 0.04]
    merged = Scan(
        tmp_path / "scan.toml", scan.laser, tuple(frames), axes={"stage": tuple(steps)}, exposures_s=tuple(times)
    )
    found = reconstruct(rig, merged)
    coloured = replace(found, colours=neighbour_colours(rig, merged, found))
    # As bright as in the longer exposure.
    check(rig, coloured, 0.8, 0.05)
    R, origin = rig_2003.platform(rig)
    floor = coloured.colours.any(axis=-1) & (((found.points - origin) @ R)[..., 2] < 0.5)
    assert np.median(coloured.colours[floor]) > 60


def test_a_video_is_refused_by_name(world: tuple[Rig, Scan], image: RangeImage) -> None:
    film = replace(world[1], frames=(), backgrounds=(), video=Path("scan.mp4"))
    with pytest.raises(InputError, match=r"scan.mp4 is a video: save its frames"):
        neighbour_colours(world[0], film, image)


def test_a_rig_whose_motion_is_fixed_stands() -> None:
    rig = small_rig()
    scan = Scan(Path("scan.toml"), axes={"stage": (5, 5, 5)}, laser=StripeSettings())
    assert object_stands(rig, scan)
    assert not object_stands(rig, replace(scan, axes={"stage": (5, 5, 6)}))
