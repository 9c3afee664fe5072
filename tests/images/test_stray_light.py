"""Light beside a stripe that is none of its own, and stripes that are dim beside bright ones."""

import numpy as np
import pytest
from scipy.ndimage import convolve

from benchmarks.cameras import disc, on_sensor, rounded
from benchmarks.cup_jpeg import errors, far_percent, rms_of
from benchmarks.stray_light import drawn_laser, in_a_room, with_reflection
from benchmarks.video import COLOURS, beside_no_step, texture
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripes.batch import Batch
from jaxscan.images.stripes.cross_section import size_of
from jaxscan.images.stripes.light import Light
from jaxscan.images.stripes.stray_light import mostly
from jaxscan.images.stripes.validity import Verdict

LINES = np.arange(640)


def beyond_half_a_pixel(photographs, truth, asked, color="red"):
    off, _ = errors(detect_stripe(photographs, StripeSettings(color)), truth, asked)
    return far_percent(off), rms_of(off)


@pytest.mark.parametrize(("share", "apart", "most"), [(0.15, 4, 3), (0.15, 5, 3), (0.3, 4, 8), (0.3, 6, 3)])
def test_a_second_reflection_beside_a_stripe_does_not_take_it_away(share, apart, most):
    """Half of the points were more than half a pixel off, and up to nine in ten more than a whole one."""
    far, _ = beyond_half_a_pixel(*with_reflection(1.2, 0.2, share, apart))
    assert far < most


def test_what_a_reflection_leaves_is_not_taken_for_speckle():
    """A contrast of 0.95 was read off frames whose contrast is 0.2, and their other lines were measured with it."""
    within = []
    for share in (0.07, 0.15, 0.3):
        photographs, truth, beside = with_reflection(1.2, 0.2, share, 4)
        stripe = detect_stripe(photographs, StripeSettings("red"))
        np.testing.assert_allclose(stripe.light[:, 2], 0.2, atol=0.04)
        # Lines 12 from a reflection and more, as far as they count.
        near = np.apply_along_axis(np.convolve, 1, beside, np.ones(25), mode="same") > 0
        away = ~near & beside_no_step(len(truth))
        off = (stripe.position - truth)[away]
        assert np.sqrt(np.mean(off**2)) < 0.075
        within.append(np.abs(off) < stripe.sigma[away])
    assert np.mean(within) == pytest.approx(0.683, abs=0.05)


@pytest.mark.parametrize("levels", [15.0, 40.0])
def test_an_edge_beside_the_stripe_is_no_noise_of_the_sensor(levels):
    """A step within the end of a window, where the noise is read, was taken for noise: of 4 levels instead of 1."""
    photographs, *_ = in_a_room(0.2, levels)
    read = detect_stripe(photographs, StripeSettings("grey")).light[:, 0]
    assert read.max() < 1.4


def test_the_edge_of_the_rooms_light_crosses_a_stripe():
    far, rms = beyond_half_a_pixel(*in_a_room(0.2, 15.0), "grey")
    assert far < 3
    assert rms < 0.13


def test_where_there_is_no_other_light_nothing_is_measured_again(monkeypatch):
    photographs, *_ = with_reflection(1.2, 0.2, 0.0, 5)
    before = detect_stripe(photographs, StripeSettings("red"))
    monkeypatch.setattr("jaxscan.images.stripes.detect.without_stray_light", lambda looker, looked, peak: looked)
    after = detect_stripe(photographs, StripeSettings("red"))
    np.testing.assert_array_equal(before.position, after.position)


def test_runs_of_lines_are_taken_whole():
    of = np.array([[1, 1, 1, 0, 1, 1], [1, 1, 0, 0, 1, 0]], bool)
    true = np.array([[1, 1, 0, 0, 0, 1], [1, 0, 0, 0, 1, 0]], bool)
    np.testing.assert_array_equal(of & mostly(true, of), np.array([[1, 1, 1, 0, 0, 0], [0, 0, 0, 0, 1, 0]], bool))


def seen_in_part_dimly(centre, levels):
    """Where a stripe of this centre is found whose second half has a height of `levels`."""
    height = np.where(LINES < 320, 150.0, levels)
    photograph = 3 + height * np.exp(-0.5 * ((np.arange(160)[:, None] - centre) / 1.4) ** 2)
    photograph += 0.4 * np.random.default_rng(0).standard_normal(photograph.shape)
    return detect_stripe(np.rint(photograph.clip(0, 255)).astype(np.uint8), StripeSettings("grey"))


@pytest.mark.parametrize("levels", [6.0, 9.0])
def test_a_dim_part_that_goes_on_from_a_bright_one_is_kept(levels):
    """Nothing below ten grey levels was, and nothing said so; in a frame by itself the same part was."""
    centre = 80 + 0.03 * (LINES - 320) + 8 * np.sin(LINES / 90)
    stripe, dim = seen_in_part_dimly(centre, levels), LINES > 330
    assert stripe.valid[0, dim].mean() > 0.95
    assert np.sqrt(np.mean((stripe.position - centre)[0, dim & stripe.valid[0]] ** 2)) < 0.2


def test_a_dim_line_that_does_not_go_on_from_a_bright_one_is_left_out():
    stripe = seen_in_part_dimly(np.where(LINES < 320, 60, 110) + 5 * np.sin(LINES / 90), 8.0)
    assert not stripe.valid[0, 330:].any()
    assert (stripe.verdict[0, 330:] == Verdict.WEAK).mean() > 0.9


def test_the_lasers_own_cross_section_stays_known():
    """Fewer lines no longer show it, and a frame was measured as a bell: half as much error again."""
    random = np.random.default_rng(1)
    laser, truth = drawn_laser(1.2, 170.0, 0.2, random)
    laser = np.stack([convolve(each, disc(2.0)) for each in laser])
    photographs = rounded(on_sensor(texture(12.0, 3.6)[..., None] + laser[..., None] * COLOURS, random, read=0.5))
    batch = Batch.create(photographs, None, StripeSettings("red"), "likeliest", len(photographs))
    light = Light.create(batch, batch.survey(), fitted=True)
    few = np.broadcast_to(np.arange(truth.shape[1]) % 3 > 0, truth.shape)
    shown = size_of(batch.survey(without=few).shape) > 0
    before, after = (size_of(each.sensor.shape) for each in (light, light.read_again(batch, few)))
    lost = (before > 0) & ~shown
    assert lost.any()
    np.testing.assert_array_equal(after[lost], before[lost])
    assert (after[~lost] != before[~lost]).any()
