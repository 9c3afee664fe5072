"""Speckle whose grains are as large as the stripe: seen along it."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr
from scipy.stats import gamma

from jaxscan.images import StripeSettings, detect_stripe, read_image

ROWS, COLUMNS, GROUND, HEIGHT, TOP = 64, 640, 12000.0, 20000.0, 65535
GREY = StripeSettings("grey")


def photograph(s, contrast, grain, burnt=1.0, seed=0, noise=200.0, texture=0.0, uneven=0.5):
    """A stripe of this σ (px), its light times gamma variables correlated over `grain` pixels in both directions."""
    random = np.random.default_rng(seed)
    centre = ROWS / 2 + 4 * np.sin(np.arange(COLUMNS) / 40) + random.uniform(-uneven, uneven, COLUMNS)
    edges = (np.arange(ROWS + 1)[:, None] - 0.5 - centre) / s
    light = burnt * HEIGHT * s * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)
    if contrast:
        field = random.standard_normal(light.shape)
        field = gaussian_filter(field, grain / np.sqrt(2), mode="wrap") if grain else field
        k = contrast**-2
        light *= gamma.ppf(ndtr(field / field.std()), k, scale=1 / k)
    # A surface that is now brighter, now darker, over many lines.
    light *= np.exp(texture * np.sin(np.arange(COLUMNS) / 12))
    image = (GROUND + light + noise * random.standard_normal(light.shape)).clip(
        0, TOP if burnt == 1 else GROUND + HEIGHT
    )
    return np.rint(image * (1 if burnt == 1 else TOP / (GROUND + HEIGHT))).astype(np.uint16), centre


def found(image, centre):
    """RMS error (px), RMS σ over it, and the speckle's contrast."""
    stripe = detect_stripe(image, GREY)
    assert stripe.valid.mean() > 0.98
    rms = np.sqrt(np.nanmean((stripe.position[0] - centre) ** 2))
    return rms, np.sqrt(np.nanmean(stripe.sigma[0] ** 2)) / rms, stripe.light[0, 2]


@pytest.mark.parametrize(("s", "grain"), [(0.7, 1.0), (0.7, 2.0), (1.5, 2.0), (3.0, 2.0)])
def test_grains_as_large_as_the_stripe_count_in_sigma(s, grain):
    """They leave nothing in their own line: σ was a fifth to a tenth of the error."""
    _, ratio, contrast = found(*photograph(s, 0.2, grain))
    assert contrast == pytest.approx(0.2, abs=0.05)
    assert 0.75 < ratio < 1.3


def test_grains_are_weighed():
    """Weights that knew nothing of them left half as large an error again."""
    errors = [found(*photograph(1.5, 0.2, 2.0, seed=seed))[0] for seed in range(3)]
    assert max(errors) < 0.24


@pytest.mark.parametrize(("core", "s", "grain"), [(5, 1.25, 1.0), (7, 1.75, 2.0), (3, 1.0, 2.0)])
def test_grains_of_a_stripe_that_is_burnt_out(core, s, grain):
    """Its flanks alone are seen."""
    _, ratio, _ = found(*photograph(s, 0.2, grain, burnt=np.exp((core / 2) ** 2 / (2 * s * s)), uneven=0.0))
    assert 0.7 < ratio < 1.5


@pytest.mark.parametrize("contrast", [0.0, 0.2])
def test_a_surface_that_changes_over_many_lines_has_no_grains(contrast):
    even, textured = (found(*photograph(1.5, contrast, 0.0, texture=by)) for by in (0.0, 0.4))
    assert textured[2] == pytest.approx(even[2], abs=0.03)
    assert 0.85 < textured[1] < 1.2


@pytest.mark.parametrize(("core", "s", "grain"), [(5, 1.67, 0.0), (9, 3.0, 0.0)])
def test_flanks_widen_nothing_where_the_noise_tells_all(core, s, grain):
    _, ratio, _ = found(*photograph(s, 0.2, grain, burnt=np.exp((core / 2) ** 2 / (2 * s * s))))
    assert 0.85 < ratio < 1.15


@pytest.mark.parametrize(("core", "s", "contrast"), [(3, 0.7, 0.4), (4, 0.9, 0.2), (5, 0.9, 0.4)])
def test_a_narrow_stripe_that_is_burnt_out_shows_its_scatter_from_line_to_line(core, s, contrast):
    """σ was a tenth to a fifth of the error: the flanks are too steep for their speckle to be read."""
    _, ratio, _ = found(*photograph(s, contrast, 0.0, burnt=np.exp((core / 2) ** 2 / (2 * s * s)), uneven=0.0))
    assert 0.75 < ratio < 1.3


def test_flanks_tell_the_scatter_of_a_real_stripe(data):
    """Burnt out white, with a halo: of the points 24 % were within 1 σ."""
    frames = np.stack([read_image(path) for path in sorted((data / "stage-flat" / "frames").glob("*.jpg"))])
    stripe = detect_stripe(frames, StripeSettings("red", columns=False))
    within = []
    for position, sigma in zip(np.asarray(stripe.position, np.float64), stripe.sigma, strict=True):
        row = np.flatnonzero(np.isfinite(position))
        off = position[row] - np.polyval(np.polyfit(row, position[row], 1), row)
        within.append((np.abs(off) < sigma[row]).mean())
    assert np.median(within) > 0.5
