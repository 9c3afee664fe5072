import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.images.exposures import merge_exposures

TIMES = (0.01, 0.04, 0.16)
# Numbers of 16 bits for what one of 8 bits is worth in the shortest exposure.
SCALE = 64878 / 252


def exposed(irradiance, times=TIMES, noise=0.0, dtype=np.uint8, most=255, seed=0):
    """Photographs by a linear sensor; an irradiance of 100 reads 1 in the shortest exposure."""
    random = np.random.default_rng(seed)
    levels = [t * irradiance + noise * random.standard_normal(irradiance.shape) for t in times]
    return np.stack([np.rint(level).clip(0, most).astype(dtype) for level in levels])


def test_numbers_are_in_proportion_to_the_light_from_the_longest_exposures_level_to_the_shortest_full_one():
    irradiance = np.geomspace(6.25, 25000, 400)[None].repeat(30, axis=0)
    merged, dark = merge_exposures(exposed(irradiance), TIMES)
    assert dark is None
    assert merged.dtype == np.uint16
    # Rounded to a number of the longest exposure in which the pixel is not full.
    step = np.where(irradiance * 0.16 < 250, 1 / 16, np.where(irradiance * 0.04 < 250, 1 / 4, 1))
    off = np.asarray(merged) / SCALE - irradiance / 100
    assert (np.abs(off) < 0.51 * step + 0.01).all()


@pytest.mark.parametrize("colour", [False, True])
def test_what_is_full_in_every_exposure_is_full_and_nothing_else_is(colour):
    irradiance = np.full((40, 60, 3) if colour else (40, 60), 4000.0)
    irradiance[10:14] = 24000.0
    irradiance[20:24] = 26000.0
    merged = np.asarray(merge_exposures(exposed(irradiance, noise=1.0), TIMES)[0])
    assert (merged[20:24] == 65535).all()
    assert (np.delete(merged, slice(20, 24), axis=0) < 0.99 * 65535).all()


def test_the_order_of_exposures_is_of_no_account_and_equal_ones_are_averaged():
    irradiance = np.random.default_rng(1).uniform(0, 30000, (40, 60))
    frames = exposed(irradiance, noise=2.0)
    merged = np.asarray(merge_exposures(frames, TIMES)[0])
    np.testing.assert_array_equal(merged, merge_exposures(frames[::-1], TIMES[::-1])[0])
    same = exposed(np.full((60, 80), 9000.0), (0.01,) * 4, noise=6.0)
    averaged = np.asarray(merge_exposures(same, (0.01,) * 4)[0]) / SCALE
    np.testing.assert_allclose(averaged, same.mean(axis=0), atol=0.01)


def test_the_noise_is_that_of_the_best_weights():
    frames = exposed(np.full((200, 200), 800.0), noise=2.0)
    merged = np.asarray(merge_exposures(frames, TIMES)[0]) / SCALE
    best = 0.01 * np.sqrt((2.0**2 + 1 / 12) / np.sum(np.square(TIMES)))
    np.testing.assert_allclose(merged.std(), best, rtol=0.03)
    np.testing.assert_allclose(merged.mean(), 8.0, rtol=2e-3)


def test_noise_that_is_cut_off_at_black_does_not_brighten_the_dark():
    dim = np.full((200, 200), 60.0)
    merged = np.asarray(merge_exposures(exposed(dim, noise=2.0), TIMES)[0]) / SCALE
    np.testing.assert_allclose(merged.mean(), 0.6, rtol=5e-3)


def test_a_sensor_of_twelve_bits_in_sixteen():
    irradiance = np.geomspace(100, 500000, 300)[None].repeat(30, axis=0)
    frames = exposed(irradiance, dtype=np.uint16, most=4095)
    merged = np.asarray(merge_exposures(frames, TIMES)[0])
    full = irradiance * 0.01 > 4100
    assert (merged[full] == 65535).all()
    clear = irradiance * 0.01 < 4000
    np.testing.assert_allclose(merged[clear] / (64878 / 4054), irradiance[clear] / 100, rtol=0.03, atol=0.1)


def test_the_background_comes_in_the_same_scale_and_is_never_full():
    dark = np.full((48, 64), 500.0)
    dark[5:8] = 40000.0
    light = dark.copy()
    light[30:33] += 9000.0
    merged, ground = (
        np.asarray(x).astype(int) for x in merge_exposures(exposed(light), TIMES, exposed(dark)) if x is not None
    )
    np.testing.assert_allclose((merged - ground)[30:33] / SCALE, 90, rtol=0.01)
    assert (merged - ground)[5:8].min() >= 0
    assert (merged[5:8] == 65535).all()


def striped(bright: float = 16000.0) -> np.ndarray:
    """A dim scene with a stripe that is full in the longer exposures, and flanks."""
    irradiance = np.full((320, 320), 20.0)
    irradiance[100:140] += bright * np.exp(-0.5 * (np.arange(-20, 20) / 6) ** 2)[:, None]
    return irradiance


@pytest.mark.parametrize("black", [6, 30])
@pytest.mark.parametrize("background", [False, True])
def test_a_black_level_is_no_light(black, background):
    """Of the merged photograph only that part is left which noise needs, the same everywhere."""

    def at(irradiance):
        lit = exposed(irradiance, noise=1.0).astype(int) + black
        return lit.clip(0, 255).astype(np.uint8)

    light, dim = striped(), striped(0.0)
    merged, dark = merge_exposures(at(light), TIMES, at(dim) if background else None)
    expected = light / 100 + black / 16
    usual = np.abs(np.asarray(merged)[100:140] / SCALE - expected[100:140]).mean(axis=1)
    assert (usual < 0.06 * expected[100:140, 0]).all()
    np.testing.assert_allclose(np.asarray(merged)[:90].mean() / SCALE, 0.2 + black / 16, atol=0.03)
    if dark is not None:
        np.testing.assert_allclose(np.asarray(dark).mean() / SCALE, 0.2 + black / 16, atol=0.03)


def test_a_black_level_excuses_neither_wrong_times_nor_a_gamma():
    frames = exposed(striped(), (0.01, 0.04), noise=1.0)
    with pytest.raises(InputError, match="exposed 16 times as long"):
        merge_exposures(frames + np.uint8(20), (0.01, 0.16))
    curved = np.rint(255 * (frames / 255) ** 0.45).astype(np.uint8) // 2 + np.uint8(20)
    with pytest.raises(InputError, match="no gamma"):
        merge_exposures(curved, (0.01, 0.04))


FLAT = np.full((2, 80, 80), 50, np.uint8)


@pytest.mark.parametrize(
    ("frames", "times", "says"),
    [
        (FLAT, (0.1,), "1 exposure times for 2 frames"),
        (FLAT, (0.1, 0.0), "longer than 0"),
        (FLAT, (0.1, float("nan")), "longer than 0"),
        (FLAT.astype(np.float32), (0.1, 0.2), "float32"),
        (FLAT, (0.1, 0.4), r"is 1 times as bright \(50 and 50 grey levels .*no gamma.* its black level"),
    ],
)
def test_bad_exposures_are_refused_in_words(frames, times, says):
    with pytest.raises(InputError, match=says):
        merge_exposures(frames, times)


def test_a_gamma_curve_is_refused():
    irradiance = np.random.default_rng(2).uniform(100, 25000, (320, 320))
    frames = exposed(irradiance)
    curved = np.rint(255 * (frames / 255) ** (1 / 2.2)).astype(np.uint8)
    with pytest.raises(InputError, match="no gamma"):
        merge_exposures(curved, TIMES)


@pytest.mark.parametrize(("true", "stated"), [(4, 16), (4, 2), (16, 4), (2, 3)])
@pytest.mark.parametrize("rows", [4, 320])
def test_exposure_times_that_are_not_the_true_ones_are_refused(true, stated, rows):
    """A thin stripe on black, too: few pixels are bright."""
    irradiance = np.full((320, 320), 20.0)
    irradiance[:rows] = np.exp(np.random.default_rng(3).uniform(np.log(500), np.log(20000), (rows, 320)))
    frames = exposed(irradiance, (0.01, 0.01 * true), noise=1.0)
    merge_exposures(frames, (0.01, 0.01 * true))
    with pytest.raises(InputError, match=f"exposed {stated} times as long as another of its step is"):
        merge_exposures(frames, (0.01, 0.01 * stated))


def test_backgrounds_are_one_for_each_frame():
    for dark in (FLAT[:1], FLAT.astype(np.uint16)):
        with pytest.raises(InputError, match="one background for each frame"):
            merge_exposures(FLAT, (0.1, 0.1), dark)
