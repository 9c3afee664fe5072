"""A sharp stripe in a JPEG: the error of the blocks that it crosses."""

import numpy as np
import pytest
import simplejpeg
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


def sloping(s, seed, noise, ambient=40, size=(176, 640)):
    """A photograph of a bent, sloping stripe, and where it is."""
    random = np.random.default_rng(seed)
    rows, columns = size
    centre = rows / 2 + 0.06 * (np.arange(columns) - columns / 2) + 3 * np.sin(np.arange(columns) / 40)
    light = 180 * s * np.sqrt(2 * np.pi) * np.diff(ndtr((np.arange(rows + 1)[:, None] - 0.5 - centre) / s), axis=0)
    levels = ambient + light[..., None] * (1.0, 0.06, 0.03) + noise * random.standard_normal((*light.shape, 3))
    return np.rint(levels.clip(0, 255)).astype(np.uint8), centre


@pytest.mark.parametrize("columns", [True, False])
@pytest.mark.parametrize("ambient", [6, 40])
@pytest.mark.parametrize("noise", [0.0, 0.2, 0.7])
def test_blocks_tell_a_jpeg_without_noise(noise, ambient, columns):
    """Nothing is left beside the stripe, but its own blocks are on the lattice of a quality."""
    raw, centre = sloping(0.74, 1, noise, ambient)
    peak, how = np.rint(centre).astype(int), StripeSettings("red", columns=columns)

    def known(photograph):
        return has_blocks(photograph if columns else np.swapaxes(photograph, 0, 1), how, peak)

    for quality in (90, 80, 60):
        kept = raw if columns else np.ascontiguousarray(np.swapaxes(raw, 0, 1))
        decoded = simplejpeg.decode_jpeg(simplejpeg.encode_jpeg(kept, quality, "RGB", "444"))
        assert has_blocks(decoded, how, peak)
    for photograph in (raw, raw // 4 * 4, gaussian_filter(raw.astype(float), (0.6, 0.6, 0)).round().astype(np.uint8)):
        assert not known(photograph)


@pytest.mark.parametrize("s", [0.74, 2.0])
@pytest.mark.parametrize(("quality", "kind"), [(90, "444"), (90, "420"), (75, "444"), (75, "420")])
def test_sigma_is_that_of_the_error(s, quality, kind):
    drawn = [sloping(s, seed, 1.5) for seed in range(6)]
    kept = [simplejpeg.decode_jpeg(simplejpeg.encode_jpeg(x, quality, "RGB", kind)) for x, _ in drawn]
    stripe = detect_stripe(np.stack(kept), StripeSettings("red"))
    off = (stripe.position - np.stack([centre for _, centre in drawn])) / stripe.sigma
    assert 0.8 < 1 / np.sqrt(np.nanmean(off**2)) < 1.25


@pytest.mark.parametrize(
    ("s", "peak", "kind", "most"),
    [(0.74, 350, "422", 1.0), (1.5, 600, "444", 0.9), (2.0, 600, "422", 0.95), (2.0, 600, "grey", 0.9)],
)
def test_a_burnt_out_stripe_is_found_too(s, peak, kind, most):
    """Pixels of its core that are read a little below full are no sign that the stripe ends there.

    It was two to five times as far off, and up to three times as far as its centre of gravity.
    """
    random = np.random.default_rng(0)
    centre = 56 + 6 * np.sin(np.arange(640) / 40)
    edges = (np.arange(113)[:, None] - 0.5 - centre) / s
    light = peak * s * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)
    levels = 40 + light[..., None] * (1.0, 0.06, 0.03) + 2 * random.standard_normal((*light.shape, 3))
    photograph = np.rint(levels.clip(0, 255)).astype(np.uint8)
    if kind == "grey":
        photograph = jpeg(photograph[..., :1].repeat(3, axis=2), "444")[..., 0].copy()
    else:
        photograph = jpeg(photograph, kind)
    off = {}
    for name in ("likelihood", "gravity"):
        found = detect_stripe(photograph, StripeSettings("grey" if kind == "grey" else "red"), detector=name)
        assert found.burnt.mean() > 0.9
        off[name] = np.sqrt(np.nanmean((found.position - centre) ** 2))
    assert off["likelihood"] < min(0.05, most * off["gravity"])


def test_a_photograph_that_is_no_jpeg_is_not_smoothed():
    """Its place and σ are the same whatever else is in the batch, and widths are those of stripes, not of windows."""
    photograph, _ = faces("red", 0.8, 180)
    alone = detect_stripe(photograph, StripeSettings("red"))
    both = detect_stripe(np.stack([photograph, jpeg(photograph, "444")]), StripeSettings("red"))
    np.testing.assert_allclose(alone.position[0], both.position[0], atol=1e-4)
    np.testing.assert_allclose(alone.sigma[0], both.sigma[0], rtol=1e-4)
    np.testing.assert_allclose(np.nanmedian(both.width, axis=1), 2.355 * 0.8, rtol=0.1)


def test_a_burnt_out_stripe_is_somewhere_between_its_flanks():
    """Of a few lines no pixel says where: their σ was up to 1e20 px, and warnings of numbers that overflow."""
    random = np.random.default_rng(0)
    rows, columns, s = 176, 640, 0.74
    centre = rows / 2 + random.uniform(-4, 4, (8, 1, 1)) * np.ones(columns)
    edges = (np.arange(rows + 1)[:, None] - 0.5 - centre) / s
    light = 600 * s * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=1) * random.gamma(25, 1 / 25, (8, rows, columns))
    levels = 40 + light[..., None] * (1.0, 0.06, 0.03) + 1.5 * random.standard_normal((*light.shape, 3))
    drawn = np.rint(levels.clip(0, 255)).astype(np.uint8)
    found = detect_stripe(
        np.stack([simplejpeg.decode_jpeg(simplejpeg.encode_jpeg(each, 75, "RGB", "444")) for each in drawn]),
        StripeSettings("red"),
    )
    assert found.valid.mean() > 0.99
    assert found.sigma[found.valid].max() < 2
