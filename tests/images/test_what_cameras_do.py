"""A stripe as cameras show it: where pixels are full, lenses out of focus, what a JPEG leaves of a broad stripe."""

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.cameras import KINDS
from benchmarks.cup_jpeg import Against
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripes.by_gravity import Scatters, scatters, scatters_more
from jaxscan.images.stripes.cross_section import size_of
from jaxscan.images.stripes.saturation import full_number

SETTINGS, NO_JPEG = StripeSettings("red"), np.zeros(1, bool)


def over_gravity(kind, width, height, speckle):
    """The error over gravity's, and σ over the error."""
    found = Against.create(*KINDS[kind](width, height, speckle))
    return found.rms / found.other, found.sigma


@pytest.mark.parametrize(("kind", "most"), [("uneven pixels", 0.8), ("noise of rows", 0.8), ("full at 200", 0.8)])
def test_pixels_that_are_full_at_different_numbers_are_known_as_full(kind, most):
    """It was 1.3 times as far off as the centre of gravity, for pixels that were full passed for what they showed."""
    over, sigma = over_gravity(kind, 2.0, 600.0, 0.2)
    assert over < most
    assert 0.8 < sigma < 1.4


@pytest.mark.parametrize(("height", "full"), [(600.0, 200), (150.0, 252)])
def test_a_number_at_which_tops_are_cut_off_is_where_pixels_are_full(height, full):
    """Of a stripe that stays below it the greatest number of the photograph's bits counts."""
    photographs, _, _ = KINDS["full at 200"](2.0, height, 0.2)
    light = detect_stripe(photographs, SETTINGS).light
    assert (light[:, 3] <= full).all()
    assert (light[:, 3] > 0.95 * full).all()


@pytest.mark.parametrize("s", [0.8, 2.0, 4.0])
def test_tops_of_one_height_are_not_cut_off(s):
    """A bell has a top too, and drawn ones have it at one height."""
    k = np.arange(25)[None, :, None]
    centre = 12 + np.linspace(-0.5, 0.5, 96)[None, None]
    bells = 20 + 150 * np.exp(-0.5 * ((k - centre) / s) ** 2)
    laser = np.rint(bells + np.random.default_rng(0).standard_normal(bells.shape)).astype(np.int32).clip(0, 255)
    assert np.asarray(full_number(laser.astype(np.uint8), NO_JPEG)) == 252
    # Of a narrow stripe no more than two pixels are cut off, which a bell may have as well.
    cut = full_number(np.minimum(laser, 90).astype(np.uint8), NO_JPEG)
    assert np.asarray(cut) == (252 if s < 1 else 89)


@pytest.mark.parametrize(("width", "height", "speckle", "most"), [(0.8, 170.0, 0.0, 1.02), (0.8, 60.0, 0.2, 1.02)])
def test_a_stripe_out_of_focus_has_a_cross_section_of_its_own(width, height, speckle, most):
    """It was up to twice as far off as the centre of gravity, and what it left was taken for speckle."""
    over, sigma = over_gravity("out of focus, 3 px", width, height, speckle)
    assert over < most
    assert 0.85 < sigma < 1.18


def test_a_stripe_out_of_focus_is_said_to_be_no_bell():
    photographs, _, _ = KINDS["out of focus, 3 px"](0.8, 170.0, 0.0)
    assert detect_stripe(photographs, SETTINGS).odd.all()
    photographs, _, _ = KINDS["as it is"](2.0, 170.0, 0.2)
    assert not detect_stripe(photographs, SETTINGS).odd.any()


def test_the_size_of_a_cross_section_is_that_of_normalised_polynomials():
    assert size_of((jnp.array([24**-0.5]), jnp.array([0.0])))[0] == pytest.approx(1)
    assert size_of((jnp.array([0.0]), jnp.array([720**-0.5])))[0] == pytest.approx(1)


@pytest.mark.parametrize(("width", "height"), [(2.0, 60.0), (3.5, 60.0)])
def test_the_noise_of_a_broad_stripe_in_a_jpeg_is_that_of_its_tails(width, height):
    """Blocks beside it have none left, and its tails would outweigh its flanks: 1.15 to 1.25 times gravity's error.

    Gravity, which does not ask whether it is a JPEG, has weights of each line, by which it is up to 7 % nearer.
    """
    over, _ = over_gravity("… as JPEG 4:4:4", width, height, 0.0)
    assert over < 1.08


@pytest.mark.parametrize(
    ("kind", "width", "height", "speckle"),
    [("out of focus, 4.5 px", 0.8, 600.0, 0.0), ("… in half the size", 1.2, 600.0, 0.0)],
)
def test_where_the_fit_scatters_more_the_centre_of_gravity_is_taken(kind, width, height, speckle):
    """It was 3.2 times as far off, 22 % of points by more than half a pixel; and 1.7 times."""
    photographs, truth, asked = KINDS[kind](width, height, speckle)
    found = Against.create(photographs, truth, asked)
    assert found.rms / found.other < 1.05
    assert found.far == 0
    assert 0.7 < found.sigma < 1.4


def test_a_level_stripe_says_nothing_of_which_is_better():
    """On level faces the centre of gravity of a burnt-out stripe has one error all along, and scatters less."""
    random, none, lines = np.random.default_rng(0), np.zeros(1), np.array([400])
    noise = random.standard_normal((1, 400)).astype(np.float32)
    steps = np.zeros((1, 400), int)
    for slope, more in ((0.0, False), (0.002, False), (0.05, True)):
        surface = 50 + slope * np.arange(400, dtype=np.float32)
        ours, theirs = (scatters(surface + error * noise, steps) for error in (0.03, 0.001))
        assert (ours.number > 0).any() == more
        assert scatters_more(ours, theirs, none, lines).all() == more


def test_an_error_that_changes_with_the_place_in_a_pixel_is_seen_over_long_distances():
    """In neighbours it is alike: there the other one scatters more."""
    x = np.arange(600)
    surface = (100 + 0.015 * x + 8 * np.sin(x / 150))[None]
    noise = 0.02 * np.random.default_rng(0).standard_normal((1, 600))
    locked, noisy = surface + 0.2 * np.sin(np.pi * surface) + 0.7 * noise, surface + noise
    ours, theirs = (scatters(each.astype(np.float32), np.zeros((1, 600), int)) for each in (locked, noisy))
    assert ours.px[0] < theirs.px[0]
    assert scatters_more(ours, theirs, np.zeros(1), np.array([600])).all()
    assert not scatters_more(theirs, ours, np.zeros(1), np.array([600])).any()


def test_few_lines_do_not_overrule_the_fit():
    one, none = Scatters(np.array([[1.0]]), np.array([[100]])), np.zeros(1)
    more, unknown = one._replace(px=np.array([[1.18]])), one._replace(number=np.array([[0]]))
    assert not scatters_more(more, one, none, np.array([100])).any()
    assert scatters_more(more, one, none, np.array([1000])).all()
    assert not scatters_more(more, unknown, none, np.array([1000])).any()
