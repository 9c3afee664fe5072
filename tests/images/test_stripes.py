import math
import os
import subprocess
import sys
import warnings

import jax
import numpy as np
import pytest
from scipy import ndimage

from jaxscan.detectors import DETECTORS
from jaxscan.errors import InputError
from jaxscan.images import StripeSettings, detect_stripe, read_image

ERF = np.vectorize(math.erf)
GREY = StripeSettings("grey")
COLUMNS = 160
TILTED = 60 + 0.31 * np.arange(COLUMNS)


def grey_levels(centre, sigma, amplitude, rows=240, ground=20.0, noise=0.0, seed=0):
    """Exact pixel areas of a Gaussian stripe, of unbounded levels."""
    v = np.arange(rows)[:, None]
    edges = [ERF((v + side - centre) / sigma / np.sqrt(2)) for side in (-0.5, 0.5)]
    levels = ground + amplitude * sigma * np.sqrt(np.pi / 2) * (edges[1] - edges[0])
    return levels + noise * np.random.default_rng(seed).standard_normal(levels.shape)


def bytes_of(levels, depth=np.uint8):
    return np.rint(levels).clip(0, np.iinfo(depth).max).astype(depth)


def rms(stripe, centre):
    assert np.asarray(stripe.valid).all()
    return float(np.sqrt(np.mean((np.asarray(stripe.position[0]) - centre) ** 2)))


@pytest.mark.parametrize("sigma", [0.8, 1.5, 3.0, 8.0])
def test_a_smooth_stripe_is_found_to_a_hundredth_of_a_pixel(sigma):
    stripe = detect_stripe(bytes_of(grey_levels(TILTED, sigma, 200)), GREY)
    assert rms(stripe, TILTED) < 0.01
    if sigma > 1:
        np.testing.assert_allclose(stripe.width[0], 2.355 * sigma, rtol=0.1)
        np.testing.assert_allclose(stripe.strength[0], 200, rtol=0.3)


@pytest.mark.parametrize("sigma", [1.0, 2.5])
def test_noise_moves_it_by_little_more_than_it_must(sigma):
    noise, amplitude = 4.0, 200
    # Cramer and Rao for the centre of a Gaussian sampled once a pixel.
    bound = noise / amplitude * np.sqrt(2 * sigma / np.sqrt(np.pi))
    stripe = detect_stripe(bytes_of(grey_levels(TILTED, sigma, amplitude, noise=noise)), GREY)
    assert rms(stripe, TILTED) < 1.5 * bound


@pytest.mark.parametrize(("sigma", "amplitude"), [(1.0, 600), (3.0, 2000), (5.0, 3000)])
def test_a_burnt_out_stripe_is_halved(sigma, amplitude):
    stripe = detect_stripe(bytes_of(grey_levels(TILTED, sigma, amplitude, noise=2)), GREY)
    assert rms(stripe, TILTED) < 0.08


def test_sixteen_bits():
    levels = grey_levels(TILTED, 1.5, 3000, ground=200, noise=20)
    assert rms(detect_stripe(bytes_of(levels, np.uint16), GREY), TILTED) < 0.02


def test_rows_are_columns_of_the_transposed_image():
    image = bytes_of(grey_levels(TILTED, 1.5, 200, noise=3))
    down = detect_stripe(image, GREY)
    along = detect_stripe(np.ascontiguousarray(image.T), StripeSettings("grey", columns=False))
    np.testing.assert_array_equal(down.valid, along.valid)
    np.testing.assert_allclose(down.position, along.position, atol=1e-4)


def test_a_batch_is_its_frames():
    frames = np.stack([bytes_of(grey_levels(TILTED + shift, 1.5, 200, noise=3, seed=shift)) for shift in range(3)])
    batch = detect_stripe(frames, GREY)
    for i, frame in enumerate(frames):
        np.testing.assert_allclose(batch.position[i], detect_stripe(frame, GREY).position[0], atol=1e-5)


@pytest.mark.parametrize("rows", [25, 97, 499])
def test_any_number_of_rows(rows):
    centre = rows / 2 + 0.01 * np.arange(COLUMNS)
    assert rms(detect_stripe(bytes_of(grey_levels(centre, 1.2, 200, rows=rows)), GREY), centre) < 0.01


@pytest.mark.parametrize("level", [0, 90, 255])
def test_nothing_is_found_where_there_is_nothing(level):
    image = np.full((240, COLUMNS), level, np.uint8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stripe = detect_stripe(image, GREY)
    assert not np.asarray(stripe.valid).any()
    assert np.isnan(stripe.position).all()


def test_noise_alone_is_no_stripe():
    image = bytes_of(grey_levels(TILTED, 1.0, 0.0, rows=1000, ground=60, noise=8))
    assert np.asarray(detect_stripe(image, GREY).valid).mean() < 0.01


def test_only_the_columns_that_have_it():
    levels = grey_levels(TILTED, 1.5, 150, noise=4)
    dark = grey_levels(TILTED, 1.5, 0, noise=4, seed=1)
    levels[:, 50:90] = dark[:, 50:90]
    valid = np.asarray(detect_stripe(bytes_of(levels), GREY).valid[0])
    assert not valid[50:90].any()
    assert valid[:50].all()
    assert valid[90:].all()


@pytest.mark.parametrize("blur_px", [0.4, 1.0])
def test_light_spilt_beyond_the_end_of_a_surface_is_no_stripe(blur_px):
    """What the lens spreads over the next columns is brighter than the noise, and lies on no surface."""
    levels = grey_levels(TILTED, 1.5, 180, noise=0)
    dark = grey_levels(TILTED, 1.5, 0, noise=0)
    # From the edge between columns 29 and 30 to a quarter of column 69.
    lit = np.isin(np.arange(COLUMNS), np.arange(30, 69)) + 0.25 * (np.arange(COLUMNS) == 69)
    spread = ndimage.gaussian_filter1d(dark + (levels - dark) * lit, blur_px, axis=1)
    valid = np.asarray(detect_stripe(bytes_of(spread), GREY).valid[0])
    assert np.flatnonzero(valid).tolist() == list(range(30, 69))


def test_a_stripe_cut_by_the_border_is_not_valid_and_one_beside_it_is():
    centre = np.linspace(-2.0, 12.0, COLUMNS)
    stripe = detect_stripe(bytes_of(grey_levels(centre, 1.5, 200)), GREY)
    valid = np.asarray(stripe.valid[0])
    assert not valid[centre < 0.5].any()
    assert valid[centre > 5].all()
    np.testing.assert_allclose(
        np.asarray(stripe.position[0])[valid & (centre > 5)], centre[valid & (centre > 5)], atol=0.02
    )
    mirrored = detect_stripe(np.ascontiguousarray(bytes_of(grey_levels(centre, 1.5, 200))[::-1]), GREY)
    np.testing.assert_array_equal(valid, mirrored.valid[0])


def test_a_stripe_is_preferred_to_a_broad_glare_as_bright():
    levels = grey_levels(TILTED, 2.0, 600)
    levels[150:] = 255
    assert rms(detect_stripe(bytes_of(levels), GREY), TILTED) < 0.05


def coloured(levels, channel, neutral):
    """A laser of one channel over neutral light."""
    image = np.repeat(neutral[..., None], 3, axis=-1).astype(float)
    image[..., channel] += levels
    return image


@pytest.mark.parametrize(
    ("color", "channel"), [("red", 0), pytest.param("green", 1, marks=pytest.mark.long), ("blue", 2)]
)
def test_colour_sees_its_laser_over_brighter_neutral_texture(color, channel):
    squares = 30.0 + 140 * ((np.arange(240)[:, None] // 20 + np.arange(COLUMNS) // 20) % 2)
    image = coloured(grey_levels(TILTED, 1.5, 70, ground=0), channel, squares)
    assert rms(detect_stripe(bytes_of(image), StripeSettings(color)), TILTED) < 0.02
    other = StripeSettings({"red": "green", "green": "blue", "blue": "red"}[color])
    assert np.asarray(detect_stripe(bytes_of(image), other).valid).mean() < 0.05


def test_a_white_core_in_a_red_halo_counts_as_laser():
    image = np.stack([grey_levels(TILTED, 2, amplitude, rows=480, ground=4) for amplitude in (900, 350, 400)], axis=-1)
    # The halo of light scattered in the surface stands to one side.
    image[..., 0] += 0.07 * grey_levels(TILTED + 9, 4, 900, rows=480, ground=0)
    stripe = detect_stripe(bytes_of(image), StripeSettings("red"))
    assert rms(stripe, TILTED) < 0.35


def test_a_background_takes_away_what_is_as_red_as_the_laser():
    scene = np.zeros((240, COLUMNS, 3))
    scene[180:184] = [220, 20, 20]
    lit = bytes_of(scene + coloured(grey_levels(TILTED, 1.5, 120, ground=0), 0, np.zeros((240, COLUMNS))))
    settings = StripeSettings("red")
    assert rms(detect_stripe(lit, settings, bytes_of(scene)), TILTED) < 0.02
    frames, each = np.stack([lit, lit]), np.stack([bytes_of(scene)] * 2)
    for dark in (each, each[:1], each[0]):
        np.testing.assert_array_equal(np.isfinite(detect_stripe(frames, settings, dark).position), True)
    assert abs(np.asarray(detect_stripe(lit, settings).position[0]) - 181.5).max() < 1


@pytest.mark.parametrize(
    ("image", "settings", "says"),
    [
        (np.zeros((40, 40), np.float32), GREY, "float32"),
        (np.zeros((40, 40), np.uint8), StripeSettings("red"), 'color = "grey"'),
        (np.zeros((40,), np.uint8), GREY, "shape"),
        (np.zeros((0, 40, 40), np.uint8), GREY, "shape"),
        (np.zeros((12, 40), np.uint8), GREY, "12 rows"),
        (np.zeros((2, 2, 40, 40, 3), np.uint8), StripeSettings("red"), "shape"),
    ],
)
def test_bad_images_are_refused_in_words(image, settings, says):
    with pytest.raises(InputError, match=says):
        detect_stripe(image, settings)


def test_a_background_of_another_size_or_depth_is_refused():
    image = np.zeros((40, 40), np.uint8)
    for dark in (np.zeros((40, 41), np.uint8), np.zeros((40, 40), np.uint16), np.zeros((3, 40, 40), np.uint8)):
        with pytest.raises(InputError, match="background"):
            detect_stripe(image, GREY, dark)


def test_settings_are_checked():
    with pytest.raises(InputError, match="purple"):
        StripeSettings(color="purple")
    with pytest.raises(InputError, match="columns"):
        StripeSettings(columns="yes")


def test_the_bare_bed_is_straight(data):
    # A plain red centroid leaves 0.33 to 0.46 px about a straight line on these.
    frames = np.stack([read_image(path) for path in sorted((data / "stage-flat" / "frames").glob("*.jpg"))])
    stripe = detect_stripe(frames, StripeSettings("red", columns=False))
    assert np.asarray(stripe.valid).mean() > 0.99
    rows = np.arange(frames.shape[1])
    rms = []
    for position in np.asarray(stripe.position, np.float64):
        seen = np.isfinite(position)
        line = np.polyval(np.polyfit(rows[seen], position[seen], 1), rows)
        rms.append(np.sqrt(np.mean((position - line)[seen] ** 2)))
    assert np.median(rms) < 0.28


def test_every_frame_of_the_pyramid_gives_a_profile(data):
    paths = sorted((data / "stage-pyramid" / "frames").glob("*.jpg"))[::7]
    frames = np.stack([read_image(path) for path in paths])
    stripe = detect_stripe(frames, StripeSettings("red", columns=False))
    assert (np.asarray(stripe.valid).mean(axis=1) > 0.9).all()


@pytest.mark.parametrize("name", ["etna-2", "etna-3"])
def test_the_stripe_wins_over_the_shining_metal(data, name):
    frames = np.stack([read_image(path) for path in sorted((data / name / "images").glob("*.png"))[:8]])
    stripe = detect_stripe(frames, StripeSettings("grey", columns=False))
    for position in np.asarray(stripe.position, np.float64):
        # On one plate the stripe is a slowly bending line; where it leaves the plate it jumps once.
        steps = np.abs(np.diff(position[np.isfinite(position)]))
        assert np.isfinite(position).mean() > 0.5
        assert (steps > 5).mean() < 0.03
        assert np.median(steps) < 0.6


def test_the_bust_with_and_without_its_background(data):
    lit, dark = (read_image(data / "ciclop-bust" / name) for name in ("laser.png", "laser_background.png"))
    stripe = detect_stripe(lit, StripeSettings("red", columns=False), dark)
    valid, position = np.asarray(stripe.valid[0]), np.asarray(stripe.position[0])
    on_bust = slice(60, 1110)
    assert valid[on_bust].mean() > 0.9
    assert ((position[on_bust] > 490) & (position[on_bust] < 620))[valid[on_bust]].all()


def test_a_round_spot_is_no_stripe_and_a_short_stripe_is_one():
    levels = grey_levels(TILTED, 1.5, 200, noise=2)
    # The stripe is seen in the first sixty columns and in ten more; five spots as bright as it are elsewhere.
    levels[:, 60:100] = levels[:, 110:] = 20
    v, u = np.mgrid[: len(levels), :COLUMNS]
    spots = [(74, 150), (86, 40), (120, 200), (134, 90), (148, 30)]
    for column, row in spots:
        levels += 200 * np.exp(-0.5 * ((u - column) ** 2 + (v - row) ** 2) / 1.5**2)
    valid = detect_stripe(bytes_of(levels), GREY).valid[0]
    assert valid[:60].all()
    assert valid[100:110].all()
    assert not valid[60:100].any()
    assert not valid[110:].any()


@pytest.mark.long
def test_several_devices_share_a_batch(tmp_path):
    """Two of the host's make the points that one does, each of its own half of the frames."""
    frames = np.stack([bytes_of(grey_levels(TILTED + i, 1.5, 200, noise=2, seed=i)) for i in range(5)])
    np.save(tmp_path / "frames.npy", frames)
    code = """if True:
        import sys
        import numpy as np
        from jaxscan.images import StripeSettings, detect_stripe
        from jaxscan.images.stripes import detect
        used, coarse_peaks = set(), detect.coarse_peaks
        def noted(*args):
            peaks = coarse_peaks(*args)
            used.update((device.id, len(peaks)) for device in peaks.devices())
            return peaks
        detect.coarse_peaks = noted
        stripe = detect_stripe(np.load(sys.argv[1]), StripeSettings("grey"), detector="gravity")
        assert used == {(0, 3), (1, 2)}, used
        np.save(sys.argv[2], [stripe.position, stripe.sigma, stripe.strength])
    """
    # Two devices of one machine: the smallest number that is more than one.
    two = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    out = tmp_path / "stripe.npy"
    subprocess.run([sys.executable, "-c", code, tmp_path / "frames.npy", out], env=two, check=True)
    one = detect_stripe(frames, GREY, detector="gravity")
    np.testing.assert_allclose(np.load(out), [one.position, one.sigma, one.strength], rtol=1e-6)


@pytest.mark.parametrize("parts", [np.linspace(-2, 2, 9), np.array([-1.5, 1.5])], ids=["flat-topped", "two lobes"])
def test_a_laser_that_is_no_bell_is_not_taken_for_edges(parts):
    middle = 100 + 5 * np.sin(np.arange(640) / 40)
    v = np.arange(200)[:, None]
    light = sum(np.exp(-0.5 * ((v - middle - at) / 0.9) ** 2) for at in parts)
    levels = 40 + 150 * light / light.max() + 2 * np.random.default_rng(0).standard_normal(light.shape)
    stripe = detect_stripe(bytes_of(levels), GREY)
    assert stripe.odd.all()
    error = stripe.position[0] - middle
    # Before, 0.3 and 0.8 px.
    assert np.sqrt(np.nanmean(error**2)) < 0.1
    assert np.nanmean(np.abs(error) < 2 * stripe.sigma[0]) > 0.9


@pytest.mark.parametrize(
    ("parts", "odd"),
    [
        ([(1, 0, 1.4)], False),
        ([(1, 0, 1.4), (0.1, 0, 5.6)], True),
        ([(1, 0, 1.4), (0.15, 4.5, 1.1)], True),
        ([(1, 0, 1.1), (0.5, 1.3, 1.4)], True),
    ],
    ids=["bell", "halo", "side lobe", "skewed"],
)
def test_flanks_of_a_burnt_out_stripe_tell_whether_the_laser_is_a_bell(parts, odd):
    middle = 100 + 5 * np.sin(np.arange(640) / 40)
    v, random = np.arange(200)[:, None], np.random.default_rng(0)
    light = sum(height * np.exp(-0.5 * ((v - middle - at) / s) ** 2) for height, at, s in parts)
    speckle = random.gamma(25, 0.04, light.shape)
    levels = 40 + 700 * light * speckle + 2 * random.standard_normal(light.shape)
    stripe = detect_stripe(bytes_of(levels), GREY)
    assert stripe.burnt.mean() > 0.95
    assert stripe.odd.all() == odd


@pytest.mark.parametrize("detector", DETECTORS)
def test_stripes_are_the_same_in_float64_mode(x64, detector):
    """A float32 carry of a loop became float64 where the caller had x64 on."""
    images = np.stack([bytes_of(grey_levels(TILTED, 1.5, 200, noise=3.0, seed=i)) for i in range(2)])
    found = detect_stripe(images, GREY, detector=detector)
    with jax.enable_x64(False):
        other = detect_stripe(images, GREY, detector=detector)
    for name in ("position", "sigma", "strength"):
        assert getattr(found, name).dtype == np.float32
        np.testing.assert_array_equal(getattr(found, name), getattr(other, name))
