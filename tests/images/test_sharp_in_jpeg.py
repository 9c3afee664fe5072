"""A sharp stripe in a JPEG: the error of the blocks that it crosses."""

import numpy as np
import pytest

from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripes.response import channels, jpeg_noise
from tests.images.test_half_chroma import EDGE, FACES, WIDTH, faces, jpeg


@pytest.mark.parametrize(
    ("color", "kind", "s", "most"),
    [("red", "444", 0.7, 0.02), ("red", "422", 0.7, 0.03), ("blue", "422", 1.0, 0.03)],
)
def test_it_is_found_to_a_few_hundredths_of_a_pixel(color, kind, s, most):
    """It was two to three times as far off."""
    drawn = [faces(color, s, 180, seed=seed) for seed in range(8)]
    photographs = np.stack([jpeg(photograph, kind) for photograph, _ in drawn])
    position = detect_stripe(photographs, StripeSettings(color)).position.astype(np.float64)
    read = np.nanmean(position.reshape(len(drawn), FACES, WIDTH)[..., EDGE:-EDGE], axis=2)
    off = read - np.stack([centre for _, centre in drawn])
    assert np.sqrt(np.mean(off**2)) < most


@pytest.mark.parametrize("color", ["red", "green", "blue"])
def test_noise_of_colours_tells_a_jpeg_from_a_sensor(color):
    random = np.random.default_rng(0)
    raw = np.rint(60 + 2 * random.standard_normal((64, 96, 3))).astype(np.uint8)

    def dull(photograph):
        levels = channels(np.stack([photograph[:24], photograph[24:48]]), None, color)
        return np.asarray(jpeg_noise(levels, color)).all()

    assert not dull(raw)
    assert dull(jpeg(raw, "444"))


def test_a_photograph_that_is_no_jpeg_is_not_smoothed():
    """Its place and σ are the same whatever else is in the batch, and widths are those of stripes, not of windows."""
    photograph, _ = faces("red", 0.8, 180)
    alone = detect_stripe(photograph, StripeSettings("red"))
    both = detect_stripe(np.stack([photograph, jpeg(photograph, "444")]), StripeSettings("red"))
    np.testing.assert_allclose(alone.position[0], both.position[0], atol=1e-4)
    np.testing.assert_allclose(alone.sigma[0], both.sigma[0], rtol=1e-4)
    np.testing.assert_allclose(np.nanmedian(both.width, axis=1), 2.355 * 0.8, rtol=0.1)
