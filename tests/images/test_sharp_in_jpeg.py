"""A sharp stripe in a JPEG: the error of the blocks that it crosses."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripes.blocks import has_blocks
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


@pytest.mark.parametrize("kind", ["444", "422", "420"])
@pytest.mark.parametrize("columns", [True, False])
def test_blocks_tell_a_jpeg(kind, columns):
    raw = np.rint(60 + 2 * np.random.default_rng(0).standard_normal((160, 200, 3))).astype(np.uint8)
    how = StripeSettings("red", columns=columns)
    peak = np.full(200 if columns else 160, 8)
    assert has_blocks(jpeg(raw, kind), how, peak)
    assert has_blocks(jpeg(raw, kind)[..., 1].copy(), StripeSettings("grey", columns=columns), peak)
    for photograph in (raw, gaussian_filter(raw.astype(float), (0.7, 0.7, 0)).round().astype(np.uint8), raw // 60 * 60):
        assert not has_blocks(photograph, how, peak)


def test_a_burnt_out_stripe_is_found_too():
    """Its few free pixels have a JPEG's error, which was taken for speckle: it was five times as far off."""
    random = np.random.default_rng(0)
    centre = 56 + 6 * np.sin(np.arange(640) / 40)
    edges = (np.arange(113)[:, None] - 0.5 - centre) / 0.74
    light = 350 * 0.74 * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)
    levels = 40 + light[..., None] * (1.0, 0.06, 0.03) + 2 * random.standard_normal((*light.shape, 3))
    photograph = jpeg(np.rint(levels.clip(0, 255)).astype(np.uint8), "422")
    off = {}
    for name in ("likelihood", "gravity"):
        found = detect_stripe(photograph, StripeSettings("red"), detector=name)
        off[name] = np.sqrt(np.nanmean((found.position - centre) ** 2))
    assert off["likelihood"] < min(0.05, off["gravity"])


def test_a_photograph_that_is_no_jpeg_is_not_smoothed():
    """Its place and σ are the same whatever else is in the batch, and widths are those of stripes, not of windows."""
    photograph, _ = faces("red", 0.8, 180)
    alone = detect_stripe(photograph, StripeSettings("red"))
    both = detect_stripe(np.stack([photograph, jpeg(photograph, "444")]), StripeSettings("red"))
    np.testing.assert_allclose(alone.position[0], both.position[0], atol=1e-4)
    np.testing.assert_allclose(alone.sigma[0], both.sigma[0], rtol=1e-4)
    np.testing.assert_allclose(np.nanmedian(both.width, axis=1), 2.355 * 0.8, rtol=0.1)
