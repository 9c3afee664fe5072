"""σ of a stripe by how much its centres scatter along it."""

import numpy as np
import pytest

from jaxscan.images.stripes.by_scatter import agreed, beyond_usual, sigma_by_scatter

FRAMES, LINES, BLOCK = 6, 640, 8
SAID, WIDTH = 0.01, 1.8


def scattered(error: float, seed: int = 0) -> np.ndarray:
    """Errors that are alike within a block, px."""
    of_blocks = np.random.default_rng(seed).standard_normal((FRAMES, LINES // BLOCK))
    return error * np.repeat(of_blocks, BLOCK, axis=1)


def told(
    position: np.ndarray, said: np.ndarray | float = SAID, smooth: bool = True, burnt: np.ndarray | bool = False
) -> np.ndarray:
    position = position.astype(np.float32)
    sigma = np.where(np.isfinite(position), said, np.nan).astype(np.float32)
    burnt = np.broadcast_to(burnt, position.shape)
    return sigma_by_scatter(sigma, position, np.full_like(position, WIDTH), burnt, np.full(len(position), smooth))


x = np.arange(LINES)
SURFACES = {
    "slope": 100 + 0.05 * x,
    "round": 100 + 60 * np.sqrt(1 - ((x - LINES / 2) / LINES) ** 2),
    "folds": 100 + 0.5 * np.abs(x % 160 - 80),
    "steps": 100 + 0.03 * x + 9 * (x // 200),
}


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("error", [0.02, 0.1])
def test_what_blocks_have_in_common_is_in_sigma(surface, error):
    off = scattered(error)
    actual = np.sqrt(np.mean(off**2))
    assert 0.85 < np.sqrt(np.mean(told(SURFACES[surface] + off) ** 2)) / actual < 1.18


def test_it_can_be_less_than_was_said():
    assert np.median(told(SURFACES["slope"] + scattered(0.02), 0.08)) == pytest.approx(0.02, rel=0.2)


def test_lines_that_are_missing_are_no_scatter():
    position = SURFACES["slope"] + scattered(0.05)
    position[:, 90:200], position[:, ::37] = np.nan, np.nan
    sigma = told(position)
    assert np.array_equal(np.isfinite(sigma), np.isfinite(position))
    assert np.nanmedian(sigma) == pytest.approx(0.05, rel=0.25)


@pytest.mark.parametrize(("power", "rel"), [(0.0, 0.25), (0.5, 0.25), (1.0, 0.25), (1.5, 0.45)])
def test_which_lines_are_better_is_read_from_them(power, rel):
    """A stripe that is dim in every second stretch, where pixels say that it is known four times worse."""
    dim = x // 80 % 2 == 1
    said = np.where(dim, 0.04, 0.01)
    actual = 0.02 * (said / 0.01) ** power
    off = actual * scattered(1)
    sigma = told(SURFACES["slope"] + off, np.broadcast_to(said, off.shape))
    for kind in (dim, ~dim):
        assert np.median(sigma[:, kind]) == pytest.approx(np.sqrt(np.mean(off[:, kind] ** 2)), rel=rel)


def test_of_a_few_lines_that_are_worse_half_of_it_is_kept():
    said = np.where(x % 160 == 0, 0.04, 0.01)
    sigma = told(SURFACES["slope"] + scattered(0.05), np.broadcast_to(said, (FRAMES, LINES)))
    np.testing.assert_allclose(sigma[:, 0] / sigma[:, 1], 2, rtol=0.2)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_burnt_out_lines_have_a_scatter_of_their_own(share):
    burnt = x < share * LINES
    actual = np.where(burnt, 0.02, 0.06)
    sigma = told(SURFACES["slope"] + actual * scattered(1), burnt=burnt)
    for kind in (burnt, ~burnt):
        assert np.median(sigma[:, kind]) == pytest.approx(np.median(actual[kind]), rel=0.2)


def test_a_few_burnt_out_lines_have_that_of_all():
    burnt = x < 60
    position = SURFACES["slope"] + np.where(burnt, 0.02, 0.06) * scattered(1)
    np.testing.assert_array_equal(told(position, burnt=burnt)[:, burnt], told(position)[:, burnt])


def test_a_level_stripe_has_no_less_than_was_said():
    """Its blocks all have the same error, which they do not show."""
    np.testing.assert_allclose(told(100 + scattered(1e-4)), SAID, rtol=1e-5)


@pytest.mark.parametrize(("smooth", "by"), [(True, 1.8), (False, 1.0)])
@pytest.mark.parametrize("kind", ["short", "rough", "narrow image", "nothing"])
def test_without_enough_lines_or_on_a_rough_surface_the_usual_factor_holds(kind, smooth, by):
    position = SURFACES["slope"] + scattered(1.0 if kind == "rough" else 0.05)
    if kind == "short":
        position[:, 60:] = np.nan
    if kind == "narrow image":
        position = position[:, :30]
    if kind == "nothing":
        position[:] = np.nan
    sigma = told(position, smooth=smooth)
    np.testing.assert_allclose(sigma, np.where(np.isfinite(position), by * SAID, np.nan), rtol=1e-5)


def test_frames_do_not_depend_on_each_other():
    position = np.stack([SURFACES["slope"] + scattered(e)[0] for e in (0.02, 0.1)])
    np.testing.assert_array_equal(told(position)[1:], told(position[1:]))


def test_what_most_lines_are_widened_by_is_left_out():
    sigma = np.full((2, 100), 0.03, np.float32)
    sigma[:, 7] = np.nan
    widened = np.hypot(sigma, np.float32(0.04))
    widened[:, :10] = np.hypot(sigma[:, :10], np.float32(0.5))
    found = beyond_usual(sigma, widened)
    np.testing.assert_allclose(found[:, 10:], 0.03, rtol=1e-5)
    np.testing.assert_allclose(found[:, :7], np.sqrt(0.03**2 + 0.5**2 - 0.04**2), rtol=1e-5)
    assert np.isnan(found[:, 7]).all()


def test_an_error_that_changes_with_the_place_in_a_pixel_is_in_sigma():
    """Over distances along which the stripe hardly moves it is alike."""
    surface = 100 + 0.015 * x + 8 * np.sin(x / 150)
    off = 0.15 * np.sin(np.pi * surface) + 0.02 * np.random.default_rng(0).standard_normal((FRAMES, LINES))
    position = (surface + off).astype(np.float32)
    sigma = np.full_like(position, SAID)
    args = np.full_like(position, WIDTH), np.zeros(position.shape, bool), np.zeros(FRAMES, bool)
    actual = np.sqrt(np.mean(off**2))
    assert np.median(sigma_by_scatter(sigma, position, *args, least_apart=2, moving=True)) == pytest.approx(
        actual, rel=0.3
    )
    assert np.median(sigma_by_scatter(sigma, position, *args)) < 0.5 * actual


@pytest.mark.parametrize("grained", [False, True])
@pytest.mark.parametrize("actual", [0.9, 1.0, 1.15])
def test_pixels_and_scatter_together_are_nearer_than_pixels_alone(actual, grained):
    """Of a frame's σ that is off by some percent, most is put right; what is the surface's own adds nothing."""
    noise = 0.03 * np.random.default_rng(1).standard_normal((FRAMES, LINES))
    said, grains = np.full((FRAMES, LINES), 0.03, np.float32), np.full(FRAMES, grained)
    found = agreed(said, (SURFACES["round"] + actual * noise).astype(np.float32), grains)
    assert np.sqrt(np.mean((found / (actual * 0.03) - 1) ** 2)) < 0.07
    rough = agreed(said, (SURFACES["round"] + 5 * noise).astype(np.float32), grains)
    np.testing.assert_array_equal(rough, said)
    few = said.copy()
    few[:, 12:] = np.nan
    np.testing.assert_allclose(
        agreed(few, SURFACES["slope"] + noise.astype(np.float32), grains)[:, :12], 0.03, rtol=0.1
    )


def test_grains_that_neighbours_share_do_not_make_sigma_smaller():
    random = np.random.default_rng(2)
    grains = np.repeat(random.standard_normal((FRAMES, LINES // 4)), 4, axis=1)
    position, said = (SURFACES["slope"] + 0.03 * grains).astype(np.float32), np.full((FRAMES, LINES), 0.03, np.float32)
    assert np.median(agreed(said, position, np.ones(FRAMES, bool))) == pytest.approx(0.03, rel=0.1)
    assert np.median(agreed(said, position, np.zeros(FRAMES, bool))) < 0.03


def test_pixels_without_noise_say_nothing():
    """σ of a grey stripe that was drawn without noise is 0 by the centre of gravity."""
    position, none = (SURFACES["slope"] + scattered(0.02)).astype(np.float32), np.zeros((FRAMES, LINES), np.float32)
    none[:, 3] = np.nan
    np.testing.assert_array_equal(agreed(none, position, np.zeros(FRAMES, bool)), none)
    assert np.nanmedian(told(position, 0.0)) == pytest.approx(0.02, rel=0.2)
