"""Photographs whose noise neighbouring pixels have in common: σ is widened for it, and others stay as they are."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripes.smoothed import noise_correlation

GREY = StripeSettings("grey")
ROWS, COLUMNS, GROUND, HEIGHT = 160, 640, 40.0, 160.0
CENTRE = ROWS / 2 + 4 * np.sin(np.arange(COLUMNS) / 40)

Filter = Callable[[np.ndarray], np.ndarray]


def photograph(s: float, noise: float, seed: int = 0, speckle: float = 0.0) -> np.ndarray:
    random = np.random.default_rng(seed)
    light = HEIGHT * s * np.sqrt(2 * np.pi) * np.diff(ndtr((np.arange(ROWS + 1)[:, None] - 0.5 - CENTRE) / s), axis=0)
    if speckle:
        light = light * random.gamma(speckle**-2, speckle**2, light.shape)
    return np.rint((GROUND + light + noise * random.standard_normal(light.shape)).clip(0, 255)).astype(np.uint8)


def jpeg(quality: int) -> Filter:
    return lambda image: cv2.imdecode(
        cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_UNCHANGED
    )


def gauss(sigma: float) -> Filter:
    return lambda image: cv2.GaussianBlur(image, (0, 0), sigma)


@pytest.mark.parametrize(
    ("smooth", "correlation"),
    [(lambda image: cv2.blur(image, (3, 3)), 0.64), (gauss(0.7), 0.58), (gauss(1.0), 0.72)],
    ids=["box", "gauss 0.7", "gauss 1.0"],
)
def test_sigma_is_right_where_a_camera_has_smoothed_its_noise(smooth: Filter, correlation: float) -> None:
    photographs = np.stack([smooth(photograph(1.8, 5.0, seed, 0.1 * (seed > 1))) for seed in range(4)])
    stripe = detect_stripe(photographs, GREY)
    np.testing.assert_allclose(stripe.correlation, correlation, atol=0.08)
    assert stripe.valid.all()
    for some in (slice(2), slice(2, 4)):
        error, sigma = (stripe.position[some] - CENTRE), stripe.sigma[some]
        # Before, 0.3 to 0.5.
        assert 0.85 < np.sqrt((sigma**2).mean() / (error**2).mean()) < 1.18


@pytest.mark.parametrize("quality", [80, 90, 95])
def test_a_jpeg_is_not_taken_for_smoothed(quality: int) -> None:
    photographs = np.stack([jpeg(quality)(photograph(1.8, noise)) for noise in (2.0, 4.0, 8.0)])
    assert not detect_stripe(photographs, GREY).correlation.any()


def test_the_mean_of_several_photographs_is_white() -> None:
    mean = np.rint(np.mean([photograph(1.5, 6.0, seed) for seed in range(4)], axis=0)).astype(np.uint8)
    stripe = detect_stripe(mean, GREY)
    assert not stripe.correlation.any()
    error = stripe.position[0] - CENTRE
    assert 0.9 < np.sqrt((stripe.sigma[0] ** 2).mean() / (error**2).mean()) < 1.1


def test_shading_and_patterns_are_no_noise() -> None:
    v, u = np.mgrid[:ROWS, :COLUMNS]
    squares = 30.0 * ((u // 80 + v // 30) % 2) + 25 * np.cos(u / 60) + 25 * np.cos(v / 40)
    image = np.rint(photograph(1.5, 2.0).astype(float) / 2 + squares + 30).clip(0, 255).astype(np.uint8)
    peak = np.rint(CENTRE).astype(int)
    assert noise_correlation(image, None, GREY, (1.0, 1.0), peak) is None


def test_noise_that_is_cut_off_or_less_than_rounding_tells_nothing() -> None:
    peak = np.rint(CENTRE).astype(int)
    black = gauss(1.0)(np.maximum(photograph(1.5, 3.0).astype(int) - int(GROUND), 0).astype(np.uint8))
    assert noise_correlation(np.where(black < 4, 0, black).astype(np.uint8), None, GREY, (1.0, 1.0), peak) is None
    assert noise_correlation(gauss(1.0)(photograph(1.5, 0.2)), None, GREY, (1.0, 1.0), peak) is None


def test_rows_are_looked_at_as_columns_are() -> None:
    image = gauss(1.0)(photograph(1.8, 5.0))
    columns = detect_stripe(image, GREY)
    rows = detect_stripe(np.ascontiguousarray(image.T), StripeSettings("grey", columns=False))
    np.testing.assert_allclose(rows.correlation, columns.correlation, atol=1e-5)
    np.testing.assert_allclose(rows.sigma, columns.sigma, rtol=1e-3)
