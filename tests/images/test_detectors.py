"""Every detector through the one interface: its error against the bound, its σ, full pixels, candidates, colours."""

import argparse
import typing

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from jaxscan.cli.detector_options import add_choice_argument, add_detector_argument
from jaxscan.detectors import CHOICES, DETECTORS, Choice
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripes.candidates import choose

GREY, ROWS, COLUMNS = StripeSettings("grey"), 64, 800
CENTRE = 32 + 4 * np.sin(np.arange(COLUMNS) / 40) + np.random.default_rng(1).uniform(-0.5, 0.5, COLUMNS)
HEIGHT = 20000.0
# RMS error over the Cramér-Rao bound at σ = 1.5 px; the method of 2003 rounds to whole rows whatever the noise.
LIMITS = {"likelihood": 1.1, "gravity": 1.15, "derivative": 1.15, "ridge": 1.15, "gaussian": 1.4, "parabola": 1.4}


def photograph(s=1.5, height=HEIGHT, noise=0.0, full=65535.0, shot=0.0, seed=0):
    """Exact pixel areas of a Gaussian stripe in 16 bits."""
    edges = (np.arange(ROWS + 1)[:, None] - 0.5 - CENTRE) / s
    levels = height * s * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)
    random = np.random.default_rng(seed).standard_normal(levels.shape)
    levels = levels + 2000 + np.sqrt(noise**2 + shot * levels) * random
    return np.rint(levels.clip(0, full) * 65535 / full).astype(np.uint16)


def errors(image, detector):
    stripe = detect_stripe(image, GREY, detector=detector)
    valid = np.asarray(stripe.valid[0])
    assert valid.mean() > 0.99
    error = (np.asarray(stripe.position[0], np.float64) - CENTRE)[valid]
    return np.sqrt(np.mean(error**2)), np.sqrt(np.mean(np.asarray(stripe.sigma[0], np.float64)[valid] ** 2)), error


def test_names_are_those_of_the_types():
    assert tuple(CHOICES) == typing.get_args(Choice)


@pytest.mark.parametrize("detector", LIMITS)
def test_error_is_near_the_bound_and_predicted(detector):
    noise, s = HEIGHT / 30, 1.5
    bound = noise / HEIGHT * np.sqrt(2 * s / np.sqrt(np.pi))
    rms, predicted, error = errors(photograph(s, noise=noise), detector)
    assert rms < LIMITS[detector] * bound
    assert abs(error.mean()) < 4 * rms / np.sqrt(len(error))
    assert predicted == pytest.approx(rms, rel=0.1 if detector == "likelihood" else 0.25)


def test_photon_noise_is_found_and_weighed():
    rms, predicted, _ = errors(photograph(noise=100.0, shot=20.0), "likelihood")
    assert predicted == pytest.approx(rms, rel=0.12)
    assert rms < errors(photograph(noise=100.0, shot=20.0), "gravity")[0]


@pytest.mark.parametrize("contrast", [0.1, 0.2])
def test_speckle_is_found_and_weighed(contrast):
    """The light of each pixel times a gamma variable: neither an edge of reflectance nor the sensor's noise."""
    random, noise = np.random.default_rng(2), 200.0
    light = photograph().astype(np.float64) - 2000
    lit = 2000 + light * random.gamma(contrast**-2, contrast**2, light.shape)
    image = np.rint(lit + noise * random.standard_normal(lit.shape)).clip(0, 65535).astype(np.uint16)
    rms, predicted, _ = errors(image, "likelihood")
    variance = noise**2 + (contrast * light) ** 2
    assert rms < 1.15 * bound_with(variance)
    assert predicted == pytest.approx(rms, rel=0.12)
    assert rms < 0.8 * errors(image, "gravity")[0]


def bound_with(variance, s=1.5):
    """Cramér and Rao's, for pixels of known variance; background, height and width unknown."""

    def profile(centre, s):
        edges = (np.arange(ROWS + 1)[:, None] - 0.5 - centre) / s
        return HEIGHT * s * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)

    h = 1e-4
    by_s = (profile(CENTRE, s + h) - profile(CENTRE, s - h)) / (2 * h)
    by_centre = (profile(CENTRE + h, s) - profile(CENTRE - h, s)) / (2 * h)
    J = np.stack([np.ones_like(by_s), profile(CENTRE, s) / HEIGHT, by_s, by_centre], axis=-1)
    information = np.einsum("kni,kn,knj->nij", J, 1 / variance, J)
    return np.sqrt(np.linalg.inv(information)[:, 3, 3].mean())


def test_a_full_core_is_a_bound_not_a_level():
    # Five pixels of the core are full.
    image = photograph(1.5, height=HEIGHT * np.exp(2.5**2 / (2 * 1.5**2)), noise=200.0, full=22000.0)
    rms, predicted, error = errors(image, "likelihood")
    assert rms < 0.02
    assert abs(error.mean()) < 0.003
    assert rms < errors(image, "gravity")[0]
    assert predicted == pytest.approx(rms, rel=0.4)


def test_an_edge_of_reflectance_along_the_stripe_is_seen():
    s, fine = 1.5, 20
    edge = CENTRE + np.linspace(-s, s, COLUMNS)
    v = (np.arange(ROWS * fine) + 0.5)[:, None] / fine - 0.5
    light = np.exp(-0.5 * ((v - CENTRE) / s) ** 2)
    # Elsewhere in the photograph the stripe is whole.
    edged = np.arange(COLUMNS) % 100 < 30
    light = np.where(edged & (v > edge), 0.1, 1.0) * light
    levels = 2000 + HEIGHT * light.reshape(ROWS, fine, COLUMNS).mean(axis=1)
    levels += HEIGHT / 100 * np.random.default_rng(3).standard_normal(levels.shape)
    image = np.rint(levels.clip(0)).astype(np.uint16)
    own, gravity = (
        np.asarray(detect_stripe(image, GREY, detector=name).position[0], np.float64) - CENTRE
        for name in ("likelihood", "gravity")
    )
    assert np.isfinite(own).all()
    assert np.sqrt(np.mean(own[edged] ** 2)) < 0.4 * np.sqrt(np.mean(gravity[edged] ** 2))
    assert np.sqrt(np.mean(own[~edged] ** 2)) < 0.03


def test_where_every_line_has_an_edge_it_is_not_taken_for_noise():
    """Where noise was read off lines with an edge, there was a third more error."""
    s, fine, columns = 1.5, 20, 4000
    centre = ROWS / 2 + np.random.default_rng(3).uniform(-0.5, 0.5, columns)
    v = (np.arange(ROWS * fine) + 0.5)[:, None] / fine - 0.5
    light = np.exp(-0.5 * ((v - centre) / s) ** 2) * np.where(v - centre > np.linspace(-3, 3, columns), 0.1, 1.0)
    levels = 2000 + HEIGHT * light.reshape(ROWS, fine, columns).mean(axis=1)
    levels += HEIGHT / 100 * np.random.default_rng(4).standard_normal(levels.shape)
    image = np.rint(levels.clip(0)).astype(np.uint16)
    own, gravity = (detect_stripe(image, GREY, detector=name) for name in ("likelihood", "gravity"))
    assert own.valid.all()
    rms, classical = (np.sqrt(np.nanmean((found.position[0] - centre) ** 2)) for found in (own, gravity))
    assert rms < 0.21 * classical


def test_a_narrow_burnt_stripe_has_no_bias_over_the_pixel():
    # As the scans of the simulated rig have it: two or three full pixels, and flanks of one.
    image = photograph(0.78, height=3.5 * HEIGHT, noise=200.0, full=22000.0)
    _, _, error = errors(image, "likelihood")
    _, _, gravity = errors(image, "gravity")
    wave = np.exp(2j * np.pi * CENTRE)
    assert abs((error * wave).mean()) < 0.01
    assert abs((gravity * wave).mean()) > 0.015


def test_a_shining_rim_is_no_stripe():
    # Where there is no texture the other channels' weights are near none, and do not take neutral light away.
    levels = np.full((240, COLUMNS, 3), 20.0) + np.random.default_rng(4).normal(0, 2, (240, COLUMNS, 3))
    v = np.arange(240)[:, None]
    levels[..., 0] += np.where(np.arange(COLUMNS) < 600, 120 * np.exp(-0.5 * ((v - 100.3) / 1.5) ** 2), 0.0)
    # Light enough elsewhere that the rim is no brighter than what is lit without a laser.
    levels[200:] += 60
    levels[:, 600:] += 30 * np.exp(-0.5 * ((v - 150.3) / 1.5) ** 2)[..., None]
    valid = np.asarray(detect_stripe(np.rint(levels).astype(np.uint8), StripeSettings("red")).valid[0])
    assert valid[:600].all()
    assert valid[600:].mean() < 0.02


@pytest.mark.parametrize("detector", DETECTORS)
@pytest.mark.parametrize("level", [0, 255])
def test_nothing_is_found_in_an_empty_photograph(detector, level):
    stripe = detect_stripe(np.full((64, COLUMNS), level, np.uint8), GREY, detector=detector)
    assert not np.asarray(stripe.valid).any()
    assert all(np.isnan(np.asarray(x)).all() for x in (stripe.position, stripe.sigma, stripe.width))


def test_the_method_of_2003_gives_whole_rows():
    stripe = detect_stripe(photograph(height=40000.0), GREY, detector="threshold")
    np.testing.assert_array_equal(np.asarray(stripe.position) % 1, 0)
    assert 0.2 < np.std(np.asarray(stripe.position[0]) - CENTRE) < 0.5


def test_of_two_stripes_the_rule_decides():
    levels = np.zeros((160, COLUMNS))
    v = np.arange(160)[:, None]
    levels += 100 * np.exp(-0.5 * ((v - 40.3) / 1.5) ** 2) + 200 * np.exp(-0.5 * ((v - 120.6) / 1.5) ** 2)
    # For some columns a reflection outshines it.
    levels[:, 300:310] += 220 * np.exp(-0.5 * ((v - 40.3) / 1.5) ** 2)
    image = np.rint(levels.clip(0, 255)).astype(np.uint8)
    found = {
        rule: np.asarray(detect_stripe(image, GREY, detector="gravity", choice=rule).position[0]) for rule in CHOICES
    }
    np.testing.assert_allclose(found["first"], 40.3, atol=0.05)
    np.testing.assert_allclose(found["last"], 120.6, atol=0.05)
    np.testing.assert_allclose(found["continuous"], 120.6, atol=0.05)
    assert (found["strongest"][300:310] < 41).all()


def test_the_path_with_the_greatest_sum_is_found():
    random = np.random.default_rng(3)
    rows, strength = random.integers(0, 60, (1, 5, 3)), random.uniform(0.3, 1, (1, 5, 3)).astype(np.float32)
    grid = np.stack(np.meshgrid(*[np.arange(3)] * 5, indexing="ij"), -1).reshape(-1, 5)
    line = np.arange(5)
    path = rows[0, line, grid]
    score = strength[0, line, grid].sum(1) - np.minimum(np.abs(np.diff(path, axis=1)) / 12, 4).sum(1)
    np.testing.assert_array_equal(choose(rows, strength, "continuous")[0], path[score.argmax()])


def test_warm_texture_cancels_with_weights_of_its_own():
    random = np.random.default_rng(0)
    # Under warm light texture is not neutral: 2 R − G − B of it is 0.7 of its red.
    texture = np.kron(random.uniform(20, 90, (16, 200)), np.ones((4, 4)))[..., None] * [1.0, 0.75, 0.55]
    edges = (np.arange(ROWS + 1)[:, None] - 0.5 - CENTRE) / 1.5
    red = 120 * 1.5 * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)
    image = texture + random.standard_normal(texture.shape)
    image[..., 0] += red
    image = np.rint(image.clip(0, 255)).astype(np.uint8)
    fixed = 2 * image[..., 0].astype(int) - image[..., 1] - image[..., 2] + 200
    own, plain = (
        np.asarray(detect_stripe(i, s, detector="gravity").position[0]) - CENTRE
        for i, s in ((image, StripeSettings("red")), (fixed.clip(0).astype(np.uint16), GREY))
    )
    assert np.sqrt(np.nanmean(own**2)) < 0.5 * np.sqrt(np.nanmean(plain**2))


def test_help_teaches():
    parser = argparse.ArgumentParser()
    add_detector_argument(parser)
    add_choice_argument(parser)
    text = " ".join(parser.format_help().split())
    assert all(f"{name} ({words})" in text for names in (DETECTORS, CHOICES) for name, words in names.items())


def red_stripe(brightness):
    """A red stripe across a photograph of 480 rows, as bright as that in each column."""
    v = np.arange(480)[:, None]
    light = brightness * np.exp(-0.5 * ((v - 240.4 - 0.05 * np.arange(len(brightness))) / 1.5) ** 2)
    noise = np.random.default_rng(0).normal(0, 2, (*light.shape, 3))
    return np.rint(40 + light[..., None] * (1.0, 0.1, 0.05) + noise).clip(0, 255).astype(np.uint8)


def test_what_a_jpeg_adds_beyond_a_stripes_end_is_no_stripe():
    image = red_stripe(np.where(np.arange(640) % 160 < 100, 180.0, 0.0))
    jpeg = cv2.imdecode(cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])[1], 1)[..., ::-1]
    column = np.flatnonzero(detect_stripe(jpeg, StripeSettings("red")).valid[0]) % 160
    assert (column < 104).all()
    assert (column < 100).mean() > 0.98


@pytest.mark.parametrize(("quality", "rms_px"), [(None, 0.05), (80, 0.3)])
def test_a_stripe_is_found_that_is_burnt_out_wider_than_a_narrow_window(quality, rms_px):
    # Its core grows to 30 pixels, half of them white: a narrow window there sees noise alone, or one side.
    centre = 240.4 - 0.05 * np.arange(640)
    off = (np.arange(480)[:, None] - centre) / np.linspace(1.5, 7, 640)
    light = np.linspace(150, 3000, 640) * np.exp(-0.5 * off**2)
    noise = np.random.default_rng(0).normal(0, 2, (480, 640, 3))
    image = np.rint(20 + light[..., None] * (1.0, 0.3, 0.25) + noise).clip(0, 255).astype(np.uint8)
    if quality is not None:
        image = cv2.imdecode(cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 1)
        image = image[..., ::-1]
    stripe = detect_stripe(image, StripeSettings("red"))
    error = np.asarray(stripe.position[0]) - centre
    assert stripe.valid[0].mean() > 0.99
    assert np.sqrt(np.nanmean(error**2)) < rms_px


def test_a_dark_surface_beside_a_bright_one_is_seen_to_its_end():
    column = np.arange(640)
    image = red_stripe(np.where(column < 300, 200.0, np.where(column < 400, 19.0, 0.0)))
    valid = detect_stripe(image, StripeSettings("red")).valid[0]
    assert valid[:300].mean() > 0.98
    assert valid[302:398].mean() > 0.9
    assert not valid[402:].any()


def test_two_glints_are_no_line():
    image = np.full((480, 640), 20, np.uint8)
    image[200:203, 100] = image[201:204, 103] = 90
    assert not detect_stripe(image, GREY).valid.any()
