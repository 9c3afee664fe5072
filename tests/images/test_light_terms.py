import numpy as np
import pytest

from benchmarks.frame_sigma import developed, draw, on_a_bench
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.light import Light
from jaxscan.images.stripe_settings import CHANNELS
from jaxscan.simulation.rig_2003 import simulated_rig

ROWS, COLUMNS = 96, 1600


def photograph(color, read=2.0, gain=0.0, speckle=0.0, peak=180.0):
    """A stripe of σ 2 px whose noise is known."""
    random = np.random.default_rng(0)
    centre = 48 + random.uniform(-0.5, 0.5, COLUMNS)
    light = peak * np.exp(-0.5 * ((np.arange(ROWS)[:, None] - centre) / 2) ** 2)
    if speckle:
        light = light * random.gamma(speckle**-2, speckle**2, light.shape)
    if gain:
        light = gain * random.poisson(light / gain)
    levels = np.full((ROWS, COLUMNS, 3), 40.0)
    levels[..., CHANNELS["red" if color == "grey" else color][0]] += light
    levels += read * random.standard_normal(levels.shape)
    shown = np.rint(levels.clip(0, 255)).astype(np.uint8)
    return shown[..., 0] if color == "grey" else shown


@pytest.mark.parametrize("color", ["grey", "red"])
def test_what_is_said_of_the_light_is_what_it_was(color):
    light = Light.of([detect_stripe(photograph(color, gain=0.8), StripeSettings(color)).light])
    assert light is not None
    assert light.read_noise == pytest.approx(2.0, rel=0.1)
    assert light.gain == pytest.approx(0.8, rel=0.3)
    assert light.saturation == 252
    light = Light.of([detect_stripe(photograph(color, speckle=0.2, peak=120), StripeSettings(color)).light])
    assert light is not None
    assert light.speckle_contrast == pytest.approx(0.2, rel=0.15)
    assert "speckle contrast 0." in light.in_words()


def test_speckle_of_a_short_stripe_that_is_burnt_out_here_and_there():
    """Too few lines were looked at, and in some frames no speckle was seen: errors half as large again."""
    random, frames = np.random.default_rng(1), 16
    centre = 48 + 3 * np.sin(np.arange(640) / 40) + random.uniform(-0.5, 0.5, 640)
    away = np.arange(ROWS)[:, None] - centre
    light = np.where(np.abs(np.arange(640) - 320) < 130, 260 * np.exp(-0.5 * (away / 0.85) ** 2), 0.0)
    light = light * random.gamma(25.0, 0.04, (frames, *light.shape))
    levels = np.full((frames, ROWS, 640, 3), 60.0)
    levels[..., 0] += light
    levels += 2 * random.standard_normal(levels.shape)
    found = detect_stripe(np.rint(levels.clip(0, 255)).astype(np.uint8), StripeSettings("red"))
    assert found.valid[:, 200:440].mean() > 0.99
    np.testing.assert_allclose(found.light[:, 2], 0.2, atol=0.06)
    off = np.where(found.valid, found.position - centre, np.nan)
    errors = np.sqrt(np.nanmean(off**2, axis=1))
    np.testing.assert_allclose(errors, np.median(errors), rtol=0.2)


@pytest.mark.parametrize(("peak", "width", "ambient"), [(260, 0.85, 60), (200, 0.85, 100)])
def test_speckle_of_a_short_stripe_in_luma_on_a_bright_scene(peak, width, ambient):
    """Lines of the bright scene were looked at, where there is no stripe: no speckle was seen, and σ was a third."""
    random, frames = np.random.default_rng(1), 16
    centre = 48 + 3 * np.sin(np.arange(640) / 40) + random.uniform(-0.5, 0.5, 640)
    away = np.arange(ROWS)[:, None] - centre
    light = np.where(np.abs(np.arange(640) - 320) < 130, peak * np.exp(-0.5 * (away / width) ** 2), 0.0)
    levels = np.full((frames, ROWS, 640, 3), float(ambient))
    levels[..., 0] += light * random.gamma(25.0, 0.04, (frames, *light.shape))
    levels += 2 * random.standard_normal(levels.shape)
    found = detect_stripe(np.rint(levels.clip(0, 255)).astype(np.uint8), StripeSettings("grey"))
    np.testing.assert_allclose(found.light[:, 2], 0.2, atol=0.09)
    off = np.where(found.valid, np.abs(found.position - centre), np.nan)
    ratios = np.nanmedian(found.sigma, axis=1) / (1.4826 * np.nanmedian(off, axis=1))
    assert ratios.min() > 0.6
    assert ratios.max() < 1.3


def test_a_photograph_without_a_stripe_says_nothing():
    dark = detect_stripe(np.full((ROWS, 64), 40, np.uint8), StripeSettings("grey"))
    assert np.isnan(dark.light).all()
    assert Light.of([dark.light]) is None
    assert Light.of([]) is None


@pytest.mark.parametrize("color", ["red", "green"])
def test_a_photograph_in_light_of_another_colour_says_nothing(color):
    """There the response is below zero, and no line seemed to have a stripe: an IndexError."""
    shown = np.random.default_rng(0).integers(0, 4, (ROWS, 200, 3), np.uint8) + np.array([5, 5, 110], np.uint8)
    found = detect_stripe(shown, StripeSettings(color))
    assert not found.valid.any()
    assert np.isnan(found.light).all()


def test_in_words():
    assert Light(2.0, 0.0, 0.0, 252.0).in_words() == (
        "read noise 2 grey levels, shot noise too little to be seen, no speckle seen, full from 252 on"
    )


def test_speckle_that_few_pixels_show():
    """Of a narrow stripe that is burnt out along two thirds, frames were read as free of speckle: σ a fifth of that."""
    rig = simulated_rig(0)
    photographs, truth = draw(rig, *on_a_bench(rig), every=23)
    found = detect_stripe(developed(photographs, "colour"), StripeSettings("red"))
    assert found.light[:, 2].min() > 0.13
    assert found.light[:, 2].max() < 0.27
    known = found.valid & np.isfinite(truth)
    off = np.abs(found.position - truth)[known] / found.sigma[known]
    assert (off < 2).mean() > 0.93
    assert (off < 3).mean() > 0.98


@pytest.mark.parametrize("dark", [0.2, 0.27, 0.35])
def test_speckle_of_a_narrow_stripe_that_is_burnt_out_but_for_dark_squares(dark):
    """Lines that were not full alone were asked, where a quarter was none, and showed nothing: 3 frames of 37."""
    random, frames, columns = np.random.default_rng(2), 16, 640
    centre = 48 + 3 * np.sin(np.arange(columns) / 40)
    away = np.arange(ROWS)[:, None] - centre
    height = np.where(np.arange(columns) % 40 < 40 * dark, 45.0, 300.0)
    light = height * np.exp(-0.5 * (away / 0.75) ** 2) * random.gamma(25.0, 0.04, (frames, ROWS, columns))
    levels = np.full((frames, ROWS, columns, 3), 55.0)
    levels[..., 0] += light
    levels += 2 * random.standard_normal(levels.shape)
    found = detect_stripe(np.rint(levels.clip(0, 255)).astype(np.uint8), StripeSettings("red"))
    contrast, gain = found.light[:, 2], found.light[:, 1]
    assert 0.17 < np.median(contrast) < 0.23
    assert (contrast < 0.03).sum() <= 1
    assert (gain < 0.2).all()
    in_sigma = ((found.position - centre) / found.sigma)[found.valid]
    assert 0.9 < np.sqrt((in_sigma**2).mean()) < 1.15
