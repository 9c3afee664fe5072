import cv2
import jax
import numpy as np
import pytest
import render

from jaxscan.images import Board
from jaxscan.images.refine import distance_from_prediction, neighbour_distance, refine_corners
from jaxscan.images.saddle import fit_saddles


def grid(columns=7, rows=6, pitch=20.0):
    v, u = np.mgrid[:rows, :columns] * pitch + 30
    return np.stack([u, v], axis=-1)


def saddle_image(centre, angles, blur, bend=0.0, size=41):
    """A corner by many samples a pixel of its two edges, the first one bent."""
    many = 25
    v, u = ((np.mgrid[: size * many, : size * many] + 0.5) / many) - 0.5
    sign = np.ones_like(u)
    for angle, kappa in zip(angles, (bend, 0.0), strict=True):
        along = np.cos(angle) * (u - centre[0]) + np.sin(angle) * (v - centre[1])
        across = np.cos(angle) * (v - centre[1]) - np.sin(angle) * (u - centre[0])
        sign *= np.sign(across - kappa / 2 * along**2)
    image = sign.reshape(size, many, size, many).mean(axis=(1, 3))
    k = np.arange(-8, 9)
    kernel = np.exp(-0.5 * (k / blur) ** 2)
    for axis in (0, 1):
        image = np.apply_along_axis(np.convolve, axis, image, kernel / kernel.sum(), mode="same")
    return 100 + 60 * image


def direction(angle):
    return np.array([[np.cos(angle), np.sin(angle)]])


def fit(image, centre, angles, *, start=(0.0, 0.0), bend=0.0, square=30.0, dtype=np.uint16):
    """One corner, with squares so large (px)."""
    return fit_saddles(
        np.rint(image).clip(0, np.iinfo(dtype).max).astype(dtype),
        centre[None] + start,
        (square * direction(angles[0]), square * direction(angles[1])),
        np.array([[bend, 0.0]]),
        0.45,
        np.array([square]),
        12.0,
    )


@pytest.mark.parametrize("angles", [(0.1, 1.7), (0.7, 2.0), (-0.4, 1.3)])
def test_a_saddle_is_found_from_half_a_pixel_away(angles):
    centre = np.array([20.2, 19.7])
    found = fit(100 * saddle_image(centre, angles, 1.0), centre, angles, start=(0.5, -0.4))
    np.testing.assert_allclose(found.pixels[0], centre, atol=0.01)
    # 1/12 px² of the blur is the pixel's own.
    np.testing.assert_allclose(found.blur[0], np.sqrt(1 + 1 / 12), atol=0.02)
    np.testing.assert_allclose(abs(found.contrast[0]), 12000, rtol=0.01)


def test_predicted_sigma_is_the_spread_of_the_errors():
    centre, angles, random = np.array([20.3, 19.8]), (0.2, 1.6), np.random.default_rng(0)
    image = saddle_image(centre, angles, 0.8)
    seen = [fit(image + 4 * random.standard_normal(image.shape), centre, angles) for _ in range(100)]
    errors = np.concatenate([each.pixels - centre for each in seen])
    sigma = np.concatenate([np.sqrt(each.variance) * each.residual[:, None] for each in seen])
    # 200 numbers tell their spread to 5 %.
    assert 0.85 < np.sqrt(np.mean(((errors - errors.mean(axis=0)) / sigma) ** 2)) < 1.15
    np.testing.assert_allclose(np.median([each.residual for each in seen]), 4, rtol=0.05)


def test_a_known_bend_does_not_pull_the_corner():
    centre, angles, bend = np.array([20.1, 20.3]), (0.1, 1.6), 0.004
    image = 100 * saddle_image(centre, angles, 1.0, bend)
    found = [fit(image, centre, angles, bend=k) for k in (bend, 0.0)]
    known, ignored = (np.linalg.norm(each.pixels[0] - centre) for each in found)
    assert known < 0.01
    assert ignored > 0.04
    predicted = found[1].pixels[0] + found[1].by_bends[0] @ [bend, 0.0]
    np.testing.assert_allclose(predicted, found[0].pixels[0], atol=0.03 * ignored)


def test_neither_the_cameras_curve_nor_its_limit_moves_the_corner():
    centre, angles = np.array([20.2, 19.9]), (0.3, 1.8)
    image = saddle_image(centre, angles, 0.8)
    for levels in (60000 * (image / 160) ** 0.45, image * 500):
        np.testing.assert_allclose(fit(levels, centre, angles).pixels[0], centre, atol=0.01)


def test_a_bright_stripe_is_left_out_and_costs_certainty():
    centre, angles = np.array([20.2, 19.9]), (0.3, 1.8)
    image = saddle_image(centre, angles, 0.8)
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    stripe = 1500 * np.exp(-0.5 * ((u - v - 6) / 1.5) ** 2)
    clean, crossed = (fit(levels, centre, angles, dtype=np.uint8) for levels in (image, image + stripe))
    np.testing.assert_allclose(crossed.pixels[0], centre, atol=0.03)
    assert crossed.share[0] < 0.9 * clean.share[0]
    assert (crossed.variance > clean.variance).all()


def test_one_wild_corner_is_left_out(board_image):
    image, truth = board_image
    # A bar ends on the corner: what is there looks like one, a few pixels off.
    image = image.copy()
    u, v = np.rint(truth[2, 3]).astype(int)
    image[v - 9 : v + 3, u - 9 : u + 9] = 120
    corners, sigma = refine_corners(image, truth)
    assert np.isnan(sigma[2, 3]) or np.linalg.norm(corners[2, 3] - truth[2, 3]) < 0.3
    others = np.ones(sigma.shape, bool)
    others[1:4, 2:5] = False
    np.testing.assert_allclose(corners[others], truth[others], atol=0.05)
    assert np.isfinite(sigma[others]).all()


@pytest.fixture(scope="module")
def board_image():
    """Seven by six corners in perspective, and where they are."""
    board = Board.checkerboard((7, 6), 10.0)
    extent = [[-10, -10], [70, -10], [70, 60], [-10, 60]]
    H = render.homography(extent, [[42, 35], [325, 50], [310, 252], [28, 230]])
    image = render.photograph(render.checkerboard((7, 6), 10.0), H, (280, 350), blur=0.8, noise=1)
    return np.rint(image).clip(0, 255).astype(np.uint8), render.project(H, board.points()).reshape(6, 7, 2)


@pytest.fixture(scope="module")
def paper():
    """A board of 9 x 6 corners, 24 px apart: its reflectance, its rows as they cross each pixel, and the corners."""
    board, shape = Board.checkerboard((9, 6), 10.0), (230, 320)
    extent = [[-10, -10], [90, -10], [90, 60], [-10, 60]]
    H = render.homography(extent, [[42, 25], [282, 52], [270, 215], [30, 193]])
    v, u = np.mgrid[: shape[0], : shape[1]]
    inverse = np.linalg.inv(H)
    rows = (inverse[1, 0] * u + inverse[1, 1] * v + inverse[1, 2]) / (
        inverse[2, 0] * u + inverse[2, 1] * v + inverse[2, 2]
    )
    reflectance = render.photograph(render.checkerboard((9, 6), 10.0), H, shape, dark=0.12, light=0.85)
    return reflectance, rows / 10, render.project(H, board.points()).reshape(6, 9, 2)


def burnt(paper, row, beside_px, core_px, power):
    """Its photograph with a stripe that is burnt out so wide on the light squares, beside a row of corners."""
    reflectance, rows, _ = paper
    sigma = core_px / 2 / np.sqrt(2 * np.log(power / (255 / 0.85 - 150)))
    light = 150 + power * np.exp(-0.5 * ((24 * (rows - row) - beside_px) / sigma) ** 2)
    image = cv2.GaussianBlur(reflectance * light, (0, 0), 0.7)
    image += 2 * np.random.default_rng(row + core_px).standard_normal(image.shape)
    return np.rint(image).clip(0, 255).astype(np.uint8)


def test_a_burnt_out_stripe_along_a_row_of_corners_moves_none_beyond_its_sigma(paper):
    """At the board's end a whole row was up to 5 px off, with a σ of 0.05 px: no neighbour told.

    A broad line, 7 px beside the row, moved it by 0.4 px, 12 σ: its long flank is a gradient of light to the model.
    """
    truth, errors = paper[2], []
    for row in (2, 5):
        for core_px, power in ((5, 1500), (9, 6000), (13, 400)):
            for beside_px in (-9, -7, 1, 4, 7, 8):
                corners, sigma = refine_corners(burnt(paper, row, beside_px, core_px, power), truth)
                errors.append(np.linalg.norm(corners - truth, axis=-1)[row] / sigma[row])
                far = np.abs(np.arange(6) - row) > 1
                assert np.isfinite(sigma[far]).all()
    kept = np.concatenate(errors)[np.isfinite(np.concatenate(errors))]
    assert kept.max(initial=0) < 6
    assert np.sqrt(np.mean(kept**2)) < 2


def test_burnt_out_paper_and_a_stripe_that_leaves_both_edges_cost_few_corners(paper):
    reflectance, _, truth = paper
    random = np.random.default_rng(0)
    blurred = cv2.GaussianBlur(reflectance, (0, 0), 0.7)
    v, u = np.mgrid[: blurred.shape[0], : blurred.shape[1]]
    across = 400 * np.exp(-0.5 * ((u - v - 40) / 1.5) ** 2)
    for light, least in ((150, 1.0), (330, 1.0), (150 + across, 0.85)):
        image = blurred * light + 2 * random.standard_normal(blurred.shape)
        corners, sigma = refine_corners(np.rint(image).clip(0, 255).astype(np.uint8), truth)
        kept = np.isfinite(sigma)
        assert kept.mean() >= least
        assert np.nanmax(np.linalg.norm(corners - truth, axis=-1) / sigma) < 5


def test_a_wide_angle_lens_moves_no_corner():
    lens = render.Barrel(focal=140.0, k1=-0.25, k2=0.06, centre=(176.3, 137.8))
    H = render.homography([[0, 0], [80, 0], [80, 50], [0, 50]], [[45, 5], [370, 20], [330, 230], [55, 265]])
    truth = lens.bend(render.project(H, Board.checkerboard((9, 6), 10.0).points()))
    image = render.photograph(render.checkerboard((9, 6), 10.0), H, (280, 350), blur=0.7, lens=lens)
    corners, sigma = refine_corners(np.rint(256 * image).astype(np.uint16), truth.reshape(6, 9, 2))
    assert np.isfinite(sigma).all()
    # The renderer's eighty samples a pixel leave about 0.005 px.
    assert np.linalg.norm(corners.reshape(-1, 2) - truth, axis=1).max() < 0.025


def test_where_nothing_is_to_be_seen_a_corner_is_lost_and_not_invented():
    assert all(np.isnan(each).all() for each in refine_corners(np.full((200, 200), 90, np.uint8), grid()))


def test_missing_corners_stay_missing():
    corners = grid()
    corners[2, 3] = np.nan
    noise = np.random.default_rng(0).integers(0, 255, (200, 200), np.uint8)
    assert all(np.isnan(each[2, 3]).all() for each in refine_corners(noise, corners))


def test_neighbours():
    corners = grid()
    np.testing.assert_allclose(neighbour_distance(corners), 20)
    np.testing.assert_allclose(distance_from_prediction(corners), 0, atol=1e-12)
    corners[2, 3] += [6.0, 0]
    away = distance_from_prediction(corners)
    assert np.unravel_index(np.argmax(away), away.shape) == (2, 3)
    np.testing.assert_allclose(away[2, 3], 6)
    away[2, 3] = 0
    assert away.max() < 3.1
    corners[:] = np.nan
    assert np.isnan(distance_from_prediction(corners)).all()


def test_corners_are_the_same_in_float64_mode(x64):
    centre, angles = np.array([20.2, 19.7]), (0.1, 1.7)
    image = saddle_image(centre, angles, 1.0)
    found = fit(100 * image, centre, angles, start=(0.5, -0.4))
    with jax.enable_x64(False):
        np.testing.assert_array_equal(found.pixels, fit(100 * image, centre, angles, start=(0.5, -0.4)).pixels)
