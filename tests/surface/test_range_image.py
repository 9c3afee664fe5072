"""The range image itself: saved without loss, cut, thinned, looked at, and laid on a grid of millimetres."""

import dataclasses

import jax
import numpy as np
import pytest
from scenes import ball, block, grid, seen

from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.reconstruction import RangeImage, read_range_image, write_points
from jaxscan.rig import Fixed
from jaxscan.surface import views
from jaxscan.surface.floor import find_floor
from jaxscan.surface.links import links, sampling
from jaxscan.surface.normals import incidence, normals
from jaxscan.surface.resample import resample


def test_saved_and_loaded_without_loss(tmp_path):
    image = ball(noise=0.01)
    write_points(tmp_path / "a.npz", image)
    read = read_range_image(tmp_path / "a.npz")
    for field in dataclasses.fields(RangeImage):
        a, b = getattr(read, field.name), getattr(image, field.name)
        assert jax.tree.structure(a) == jax.tree.structure(b)
        for one, other in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
            np.testing.assert_array_equal(one, other)


def test_mask_crop_and_decimation():
    image = block()
    some = image.where(image.points[..., 0] > 0)
    assert some.valid.sum() == (image.points[..., 0] > 0).sum()
    assert np.isnan(some.points[~some.valid]).all()
    low, high = [-3.0, -20.0, 290.0], [3.0, -4.0, 310.0]
    box = image.cropped(low, high)
    inside = ((image.points >= low) & (image.points <= high)).all(axis=-1)
    assert box.valid.sum() == inside.sum()
    assert box.valid[[0, -1]].any(axis=1).all()
    assert box.valid[:, [0, -1]].any(axis=0).all()
    thin = image[::3, 1::2]
    np.testing.assert_array_equal(thin.points, image.points[::3, 1::2])
    np.testing.assert_array_equal(thin.steps, image.steps[::3])
    with pytest.raises(InputError, match="no point lies in the box"):
        image.cropped([0.0, 0.0, 0.0], [1.0, 1.0, 1.0])


def test_spacing_and_noise_from_the_data():
    how = sampling(seen(np.zeros((60, 120)), noise=0.03))
    assert how.across_mm == pytest.approx(0.2, rel=0.05)
    assert how.along_mm == pytest.approx(0.4, rel=0.05)
    assert how.noise_mm == pytest.approx(0.03, rel=0.1)
    unknown = dataclasses.replace(block(noise=0.03), sigma_pixel=np.full((60, 120), np.nan, np.float32))
    assert sampling(unknown).noise_mm == pytest.approx(0.03, rel=0.1)


def test_a_depth_edge_cuts_and_a_slope_does_not():
    x, _ = grid()
    for rise in (0.0, 0.5, 2.0, 4.0):
        image = seen(rise * x, noise=0.01)
        linked = links(image)
        assert linked.across.all()
        assert linked.along.all()
    for jump in (0.6, 1.0, 5.0):
        for rise in (0.0, 1.0):
            image = seen(rise * x + np.where(x >= 0, jump, 0.0), noise=0.01)
            linked = links(image)
            cut = ~linked.across
            np.testing.assert_array_equal(np.unique(np.nonzero(cut)[1]), [59])
            assert cut[:, 59].all()
            assert linked.along.all()


def test_frames_that_are_missing_are_no_neighbours():
    image = seen(np.zeros((20, 30)))
    later = {"stage": np.where(np.arange(20) < 10, image.steps, image.steps + 4000)}
    apart = dataclasses.replace(image, positions=later)
    np.testing.assert_array_equal(links(apart).along.all(axis=1), np.arange(19) != 9)


def test_normals_face_the_camera_that_moved():
    x, y = grid(80, 60)
    image = seen(0.7 * x + 0.3 * y)
    # The camera looks down; heights grow toward it, y of the object frame runs against the frames.
    expected = np.array([-0.7, 0.3, -1.0]) / np.linalg.norm([-0.7, 0.3, -1.0])
    np.testing.assert_allclose(normals(image, links(image)), np.broadcast_to(expected, (80, 60, 3)), atol=1e-3)
    angle = np.degrees(incidence(image, links(image)))[:, 30]
    # Each frame was seen from above it, so that all are seen alike.
    assert np.ptp(angle) < 6.0
    still = dataclasses.replace(image, motion=Fixed())
    assert np.ptp(np.degrees(incidence(still, links(still)))[:, 30]) < 6.0


def test_views():
    image = block(noise=0.0)
    assert float(np.nanmax(views.depth(image))) == pytest.approx(300.0, abs=1e-3)
    height = views.height(image, find_floor(image))
    assert set(np.unique(np.round(height, 2))) == {-0.0, 5.0}
    bright = views.shaded(image)
    assert np.nanmin(bright) >= 0
    assert np.nanmax(bright) <= 1
    np.testing.assert_array_equal(views.sigma(image), image.sigma)
    np.testing.assert_array_equal(views.strength(image), image.strength)


def test_a_regular_grid_of_a_tilted_plane():
    x, y = grid()
    image = seen(0.3 * x - 0.2 * y)
    frame = Pose(np.array([np.pi, 0.0, 0.0]), np.array([0.0, 0.0, 300.0]))
    even = resample(image, 0.25, frame)
    local = frame.inverse().apply(even.points[even.valid])
    np.testing.assert_allclose(local[:, :2] / 0.25, np.round(local[:, :2] / 0.25), atol=1e-3)
    np.testing.assert_allclose(local[:, 2], 0.3 * local[:, 0] - 0.2 * (local[:, 1] - 12.0), atol=1e-3)
    assert even.valid.mean() > 0.95
    np.testing.assert_allclose(even.sigma[even.valid], 0.05, rtol=1e-5)
    for spacing in (0.0, -1.0, 1e-6, 1e-9):
        with pytest.raises(InputError, match="a grid of"):
            resample(image, spacing, frame)


def test_a_regular_grid_has_no_points_over_a_depth_edge():
    image = block(noise=0.0)
    floor = find_floor(image)
    even = resample(image, 0.1, floor.frame)
    height = floor.height(even.points[even.valid].astype(np.float64))
    assert np.minimum(np.abs(height), np.abs(height - 5)).max() < 1e-2


def test_one_frame_has_no_surface():
    with pytest.raises(InputError, match="at least two frames, and there is one"):
        links(block()[:1, :])
    with pytest.raises(InputError, match="no point has neighbours"):
        links(block().where(np.zeros((60, 120), bool)))
