from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings, read_image, write_image
from jaxscan.images.stripes.tracks import gather_passage, passage_windows
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import reconstruct, spacetime
from jaxscan.reconstruction.frames import Frames
from jaxscan.reconstruction.overlapping import overlapping
from jaxscan.reconstruction.spacetime import Geometry, carried, spacetime_profiles
from jaxscan.reconstruction.spacetime_geometry import spacetime_geometry
from jaxscan.reconstruction.triangulate import FramePoses
from jaxscan.rig import Camera, LightPlane, Linear, Rig

ROWS, COLUMNS, FRAMES = 96, 40, 40
DEPTH, SHEET_MM, STEP = 300.0, 0.8, 200
OMEGA, PER_STEP = np.array([0.0, -0.005, 1 / 300]), np.array([0.0, 0.0025, 0.0])
# Frames to either side that are looked at.
HALF = 12
GREY = StripeSettings("grey")


@pytest.fixture(scope="module")
def rig():
    with float64():
        camera = Camera.create((COLUMNS, ROWS), np.array([600.0, 600.0]), np.array([20.0, 48.0]))
        stage = Linear.create(PER_STEP)
        return as_numpy(Rig(camera, (LightPlane.create(OMEGA),), stage))


def photograph(step, dark_beyond=np.inf, fine=15):
    """A wall that faces the camera and moves up and down with the stage, a tenth as bright beyond a line on it."""
    v = (np.arange(ROWS * fine) + 0.5) / fine - 0.5
    y = DEPTH * (v - 48.0) / 600.0
    d = (OMEGA[1] * y + OMEGA[2] * DEPTH - 1) / np.linalg.norm(OMEGA)
    light = np.exp(-0.5 * (d / SHEET_MM) ** 2) * np.where(y - step * PER_STEP[1] > dark_beyond, 0.1, 1.0)
    levels = 500 + 40000 * light.reshape(ROWS, fine).mean(axis=1)[:, None]
    return levels + 100 * np.random.default_rng(abs(step)).standard_normal((ROWS, COLUMNS))


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    """The line of the wall passes the sheet, which meets it at y = 0, half-way."""
    folder = tmp_path_factory.mktemp("scan")
    paths, steps = [], tuple(STEP * i for i in range(FRAMES))
    for i, step in enumerate(steps):
        paths.append(folder / f"{i}.png")
        image = photograph(step, dark_beyond=-PER_STEP[1] * STEP * FRAMES / 2)
        write_image(paths[-1], np.rint(image).astype(np.uint16))
    return Scan(folder / "scan.toml", GREY, tuple(paths), axes={"stage": steps})


def test_a_track_is_where_the_camera_sees_what_the_stage_carries(rig):
    geometry = Geometry.create(rig, GREY, "stage", STEP, {})
    q, m = np.array([13.0, 60.0]), 3.5
    with float64():
        ray = np.asarray(rig.camera.ray(jnp.asarray(q)))
        expected = rig.camera.project(jnp.asarray(ray / (OMEGA @ ray) + m * STEP * PER_STEP))
    got = carried(geometry, *(jnp.full((1, 1), x, jnp.float32) for x in q), jnp.asarray(m))
    np.testing.assert_allclose(np.ravel(got), expected, atol=1e-4)


def test_the_passage_is_as_long_as_the_sheet_is_thick(rig, scan):
    _, sigma = spacetime_geometry(rig, scan)
    expected = SHEET_MM * np.linalg.norm(OMEGA) / abs(OMEGA @ PER_STEP) / STEP
    np.testing.assert_allclose(sigma, expected, rtol=0.15)


@pytest.fixture(scope="module")
def images(rig, scan):
    return [reconstruct(rig, scan, detector="gravity", spacetime=spacetime) for spacetime in (False, True)]


def test_a_border_of_reflectance_does_not_bend_the_surface(images):
    assert images[1].valid[HALF:-HALF].all()
    assert not images[1].valid[:HALF].any()
    assert not images[1].valid[-HALF:].any()
    spatial, spacetime = (np.sqrt(np.nanmean((image.points[16:24, :, 2] - DEPTH) ** 2)) for image in images)
    assert spatial > 0.5
    assert spacetime < 0.2 * spatial


def test_each_frame_has_the_points_that_cross_the_sheet_at_its_time(images, scan):
    image = images[1]
    assert image.steps.tolist() == list(scan.axes["stage"])
    # Of the border itself, half-way, the bright side is seen a little sooner.
    away = np.r_[HALF:16, 24 : FRAMES - HALF]
    crossing = -image.steps[away] * PER_STEP[1]
    np.testing.assert_allclose(np.median(image.points[away, :, 1], axis=1), crossing, atol=0.05)
    np.testing.assert_allclose(image.points[away[:4], :, 2], DEPTH, atol=0.15)


@pytest.fixture(scope="module")
def frames(scan):
    return np.stack([read_image(path) for path in scan.frames])


def points_of(rig, settings, frames, steps, sigma, dark=None):
    """The points of frames that come seven at a time."""
    geometry = Geometry.create(rig, settings, "stage", STEP, {})
    own = dark is not None and dark.shape == frames.shape
    batches = [
        Frames(frames[i : i + 7], dark[i : i + 7] if own else dark, np.asarray(steps[i : i + 7])[:, None])
        for i in range(0, len(frames), 7)
    ]

    def frames_at(positions):
        return FramePoses.create(rig.motion, {"stage": positions[:, 0]}, len(positions))

    found = spacetime_profiles(geometry, sigma, settings, batches, "gravity", "strongest", frames_at)
    return np.concatenate([x.points for x in found])


def test_points_do_not_depend_on_the_batches(rig, scan, frames, images):
    _, sigma = spacetime_geometry(rig, scan)
    np.testing.assert_array_equal(points_of(rig, GREY, frames, scan.axes["stage"], sigma), images[1].points)


def test_a_scan_of_another_length_compiles_nothing(rig, scan, frames, images):
    """Neither the last batch of a scan nor a shorter scan has shapes of its own."""
    _, sigma = spacetime_geometry(rig, scan)
    whole = (carried, spacetime._track, spacetime._points, gather_passage, passage_windows)
    jitted = [getattr(each, "jitted", each) for each in whole]
    before = [each._cache_size() for each in jitted]
    count = FRAMES - 3
    points = points_of(rig, GREY, frames[:count], scan.axes["stage"][:count], sigma)
    assert [each._cache_size() for each in jitted] == before
    np.testing.assert_array_equal(points[HALF : count - HALF], images[1].points[HALF : count - HALF])


def test_lines_that_are_rows(rig, scan, frames, images):
    """The scan turned over its diagonal, its rig likewise."""
    with float64():
        camera = Camera.create((ROWS, COLUMNS), np.array([600.0, 600.0]), np.array([48.0, 20.0]))
        turned = as_numpy(Rig(camera, (LightPlane.create(OMEGA[[1, 0, 2]]),), Linear.create(PER_STEP[[1, 0, 2]])))
    _, sigma = spacetime_geometry(rig, scan)
    rows = StripeSettings("grey", columns=False)
    points = points_of(turned, rows, np.ascontiguousarray(frames.swapaxes(1, 2)), scan.axes["stage"], sigma)
    np.testing.assert_allclose(points[..., [1, 0, 2]], images[1].points, atol=1e-3)


@pytest.mark.parametrize("photographs", [1, FRAMES])
def test_a_red_laser_beside_a_lamp(rig, scan, frames, images, photographs):
    """A lamp twice as bright as the stripe, as orange as lamps are, stands beside it and over some of its lines."""
    _, sigma = spacetime_geometry(rig, scan)
    v, u = np.mgrid[:ROWS, :COLUMNS]
    lamp = 40000 * np.exp(-0.5 * (((v - 52) / 8) ** 2 + ((u - 30) / 6) ** 2))
    dark = np.rint(lamp[..., None] * (1.0, 0.7, 0.4)).astype(np.uint16)
    lit = dark + (frames[..., None] * np.array([0.5, 0.05, 0.02])).astype(np.uint16)
    grounds = np.broadcast_to(dark, (photographs, *dark.shape))
    points = points_of(rig, StripeSettings("red"), lit, scan.axes["stage"], sigma, grounds)
    seen = np.isfinite(points[HALF:-HALF, :, 2])
    assert seen.all()
    # The lamp has one colour and no noise: rounding decides by which weights it cancels.
    np.testing.assert_allclose(points[HALF:-HALF], images[1].points[HALF:-HALF], atol=0.025)


@pytest.mark.parametrize("size", [1, 3, 10])
def test_overlapping_batches_have_every_frame_once_and_its_neighbours(size):
    frames, steps = np.arange(10, dtype=np.uint8)[:, None, None], np.arange(10)
    dark = np.zeros((1, 1, 1), np.uint8)
    batches = [Frames(frames[i : i + size], dark, steps[i : i + size, None]) for i in range(0, 10, size)]
    inner = []
    for batch in overlapping(batches, 2, 1, 4):
        steps_here = batch.positions[:, 0]
        some = steps_here[batch.inner]
        inner += some.tolist()
        assert {some[0] - 1, some[0] - 2, some[-1] + 1} & set(range(10)) <= set(steps_here.tolist())
        np.testing.assert_array_equal(batch.images[: len(steps_here), 0, 0], steps_here)
        assert len(batch.images) == 2 + 4 + 1
        # Of frames that come one at a time nothing tells whether the background is that of all.
        assert len(batch.backgrounds) == (1 if size > 1 else 7)
    assert inner == list(range(10))


@pytest.mark.parametrize(
    ("steps", "says"),
    [
        (tuple(STEP * i + (i == 5) for i in range(FRAMES)), "equally many motor steps apart"),
        ((0,) * FRAMES, "one axis, here move none"),
        (tuple(10 * STEP * i for i in range(FRAMES)), r"scan in steps of at most \d+ in place of 2000"),
        (tuple(range(FRAMES)), r"list every \d+th frame"),
    ],
)
def test_steps_that_are_unfit_are_refused_in_words(rig, scan, steps, says):
    with pytest.raises(InputError, match=says):
        spacetime_geometry(rig, replace(scan, axes={"stage": steps}))


def test_too_few_frames_and_a_rig_without_a_stage_are_refused(rig, scan):
    with pytest.raises(InputError, match="12 frames: spacetime analysis looks at"):
        spacetime_geometry(rig, replace(scan, frames=scan.frames[14:26], axes={"stage": scan.axes["stage"][14:26]}))
    with pytest.raises(InputError, match='has no axis "stage"'):
        spacetime_geometry(Rig(rig.camera, rig.lights), scan)


def test_a_scan_without_a_stripe_is_refused(rig, scan, tmp_path):
    path = tmp_path / "black.png"
    write_image(path, np.zeros((ROWS, COLUMNS), np.uint16))
    with pytest.raises(InputError, match="no stripe"):
        spacetime_geometry(rig, replace(scan, frames=(path,) * FRAMES, path=Path("scan.toml")))
