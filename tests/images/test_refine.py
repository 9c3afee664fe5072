import numpy as np
import pytest

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


@pytest.mark.parametrize("angles", [(0.1, 1.7), (0.7, 2.0), (-0.4, 1.3)])
def test_a_saddle_is_found_from_half_a_pixel_away(angles):
    centre = np.array([20.2, 19.7])
    image = saddle_image(centre, angles, 1.0)
    found = fit_saddles(
        image,
        centre[None] + [[0.5, -0.4]],
        (direction(angles[0]), direction(angles[1])),
        (np.zeros(1),) * 2,
        np.array([9.0]),
    )
    np.testing.assert_allclose(found[0], centre, atol=0.012)


def test_a_known_bend_does_not_pull_the_corner():
    centre, angles, bend = np.array([20.1, 20.3]), (0.1, 1.6), 0.004
    image = saddle_image(centre, angles, 1.0, bend)
    directions = (direction(angles[0]), direction(angles[1]))
    known, ignored = (
        fit_saddles(image, centre[None], directions, (np.array([k]), np.zeros(1)), np.array([12.0]))[0] - centre
        for k in (bend, 0.0)
    )
    assert np.linalg.norm(known) < 0.02
    assert np.linalg.norm(ignored) > 0.04


def test_sixteen_bits_give_the_same_corner():
    centre, angles = np.array([20.2, 19.9]), (0.3, 1.8)
    image = saddle_image(centre, angles, 0.8)
    directions = (direction(angles[0]), direction(angles[1]))
    both = [fit_saddles(image * g, centre[None], directions, (np.zeros(1),) * 2, np.array([8.0])) for g in (1, 250)]
    np.testing.assert_allclose(*both, atol=1e-3)


def test_where_nothing_is_to_be_seen_a_corner_is_lost_and_not_invented():
    assert np.isnan(refine_corners(np.full((200, 200), 90, np.uint8), grid())).all()


def test_missing_corners_stay_missing():
    corners = grid()
    corners[2, 3] = np.nan
    noise = np.random.default_rng(0).integers(0, 255, (200, 200), np.uint8)
    assert np.isnan(refine_corners(noise, corners)[2, 3]).all()


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
