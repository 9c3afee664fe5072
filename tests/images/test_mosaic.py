"""A stripe in the photographs of a sensor whose pixels see one colour each."""

import cv2
import numpy as np
import pytest
from jaxtyping import Float, UInt

from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripe_settings import CHANNELS
from jaxscan.images.stripes.mosaic import NO_MOSAIC, native_pixels
from jaxscan.images.stripes.stripe import Stripe

_ROWS, _COLUMNS, _FRAMES = 160, 320, 3
# The pattern begins with red, then green.
_INTERPOLATE = {"bilinear": cv2.COLOR_BayerBG2RGB, "edges kept": cv2.COLOR_BayerBG2RGB_EA}


def _centre(frame: int, columns: int = _COLUMNS) -> Float[np.ndarray, "columns"]:
    u = np.arange(columns)
    return 70.3 + 7.13 * frame + 9 * np.sin(u / 37) + 0.03 * u


def _photographs(
    s: float, color: str = "red", speckle: float = 0.15, shape: tuple[int, int] = (_ROWS, _COLUMNS)
) -> UInt[np.ndarray, "frames rows columns 3"]:
    """A bell of standard deviation `s` px over a ground with texture, as a sensor of three full colours sees it."""
    random = np.random.default_rng(7)
    v, frames = np.arange(shape[0])[:, None], []
    for i in range(_FRAMES):
        light = 150 * np.exp(-0.5 * ((v - _centre(i, shape[1])) / s) ** 2)
        light = light * random.gamma(speckle**-2, speckle**2, light.shape) if speckle else light
        ground = 40 + 8 * np.sin(np.arange(shape[1]) / 60) + 0.05 * v
        frame = np.repeat(ground[..., None], 3, axis=2)
        frame[..., CHANNELS[color][0]] += light
        frames.append(frame + 2 * random.standard_normal(frame.shape))
    return np.rint(np.clip(frames, 0, 255)).astype(np.uint8)


def _mosaic(frames: UInt[np.ndarray, "frames rows columns 3"]) -> UInt[np.ndarray, "frames rows columns"]:
    """Red in even rows and columns, blue in odd ones, green between."""
    return np.where(
        np.indices(frames.shape[1:3]).sum(0) % 2 == 1,
        frames[..., 1],
        np.where(np.arange(frames.shape[1])[:, None] % 2 == 0, frames[..., 0], frames[..., 2]),
    )


def _seen(
    frames: UInt[np.ndarray, "frames rows columns 3"], how: str = "bilinear"
) -> UInt[np.ndarray, "frames rows columns 3"]:
    return np.stack([cv2.cvtColor(each, _INTERPOLATE[how]) for each in _mosaic(frames)])


def _errors(found: Stripe) -> Float[np.ndarray, "frames columns"]:
    columns = found.position.shape[1]
    return (found.position - np.stack([_centre(i, columns) for i in range(len(found.position))]))[:, 4:-4]


def _rms(errors: Float[np.ndarray, "..."]) -> float:
    return float(np.sqrt(np.nanmean(errors**2)))


@pytest.mark.parametrize("how", _INTERPOLATE)
@pytest.mark.parametrize("s", [0.8, 1.2, 2.5])
def test_the_stripe_is_as_sharp_as_half_the_pixels_show_it(s, how):
    frames = _photographs(s)
    full, found = (detect_stripe(x, StripeSettings()) for x in (frames, _seen(frames, how)))
    assert found.mosaic.all()
    assert not full.mosaic.any()
    assert found.valid[:, 4:-4].mean() > 0.98
    # Every second line has half the pixels, √2 of the error; the others are means of two. What is hardly wider than its
    # pixels are apart is also seen in another way wherever it lies.
    assert _rms(_errors(found)) < (1.5 if s > 1 else 1.7) * _rms(_errors(full))
    assert abs(np.nanmean(_errors(found))) < 0.02
    assert np.nanmedian(found.width) == pytest.approx(np.nanmedian(full.width), rel=0.25)


@pytest.mark.parametrize("quality", [75, 90])
@pytest.mark.parametrize("s", [1.1, 1.6])
def test_a_jpeg_of_it_is_measured_no_worse_than_by_gravity(s, quality):
    """Its colours have half the resolution: no pixel is as the sensor saw it."""
    frames = []
    for each in _seen(_photographs(s)):
        options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, 0x220000]
        frames.append(cv2.imdecode(cv2.imencode(".jpg", each[..., ::-1], options)[1], cv2.IMREAD_COLOR)[..., ::-1])
    own, by_gravity = (detect_stripe(np.stack(frames), StripeSettings(), detector=d) for d in ("likelihood", "gravity"))
    assert not own.mosaic.any()
    assert own.valid[:, 4:-4].mean() > 0.98
    assert _rms(_errors(own)) < 1.05 * _rms(_errors(by_gravity))


@pytest.mark.parametrize("s", [1.3, 2.0])
def test_sigma_is_that_of_the_errors(s):
    found = detect_stripe(_seen(_photographs(s)), StripeSettings())
    z = _errors(found) / found.sigma[:, 4:-4]
    assert 0.85 < np.sqrt(np.nanmedian(z**2)) / 0.6745 < 1.15
    assert np.nanmean(np.abs(z) < 3) > 0.98


@pytest.mark.parametrize("color", ["red", "blue"])
def test_red_and_blue_have_pixels_of_their_own(color):
    frames = _photographs(1.2, color)
    settings = StripeSettings(color)
    full, found = (detect_stripe(x, settings) for x in (frames, _seen(frames)))
    assert found.mosaic.all()
    assert _rms(_errors(found)) < 1.5 * _rms(_errors(full))


def test_rows_are_measured_as_columns_are():
    frames = _seen(_photographs(1.2))
    upright = detect_stripe(frames, StripeSettings())
    lying = detect_stripe(np.ascontiguousarray(frames.swapaxes(1, 2)), StripeSettings(columns=False))
    np.testing.assert_allclose(lying.position, upright.position, atol=1e-4)


@pytest.mark.parametrize("shape", [(161, 320), (160, 321), (159, 319)])
def test_sizes_may_be_odd(shape):
    found = detect_stripe(_seen(_photographs(1.2, shape=shape)), StripeSettings())
    assert found.position.shape == (_FRAMES, shape[1])
    assert found.mosaic.all()
    assert _rms(_errors(found)) < 0.15


def test_a_frame_does_not_depend_on_those_beside_it():
    plain = _photographs(1.2)
    mixed = plain.copy()
    mixed[1] = _seen(plain)[1]
    found = detect_stripe(mixed, StripeSettings())
    assert found.mosaic.tolist() == [False, True, False]
    for i in range(_FRAMES):
        alone = detect_stripe(mixed[i], StripeSettings())
        np.testing.assert_allclose(found.position[i], alone.position[0], atol=1e-4)
        np.testing.assert_allclose(found.sigma[i], alone.sigma[0], rtol=1e-3)


def test_a_background_has_the_same_mosaic():
    frames = _photographs(1.2)
    dark = _photographs(1.2, speckle=0)[:1] * 0 + 40
    found = detect_stripe(_seen(frames), StripeSettings(), _seen(dark))
    assert found.mosaic.all()
    assert _rms(_errors(found)) < 0.15


def test_the_band_is_that_of_the_photograph():
    frames = _seen(_photographs(1.2))
    nowhere = np.full(_COLUMNS, 120.0), np.full(_COLUMNS, 140.0)
    around = np.full(_COLUMNS, 40.0), np.full(_COLUMNS, 110.0)
    assert not detect_stripe(frames, StripeSettings(), band=nowhere).valid.any()
    assert detect_stripe(frames, StripeSettings(), band=around).valid.mean() > 0.9


@pytest.mark.parametrize("s", [0.7, 0.85, 1.0, 1.5, 3.0])
@pytest.mark.parametrize("phase", [-0.3, 0.0, 0.2, 0.7])
def test_a_level_stripe_is_no_mosaic(s, phase):
    """Of one that stays at a pixel, every second one is less curved: the nearest thing to a mosaic."""
    frames = np.full((_FRAMES, _ROWS, _COLUMNS, 3), 40, np.uint8)
    bell = np.exp(-0.5 * ((np.arange(_ROWS) - 80 - phase) / s) ** 2)
    frames[..., 0] = np.rint(40 + 150 * bell)[:, None]
    assert not detect_stripe(frames, StripeSettings()).mosaic.any()


def test_what_is_sharpened_denoised_or_grey_is_no_mosaic():
    frames = _photographs(1.2)
    blurred = np.stack([cv2.GaussianBlur(x, (0, 0), 1.0) for x in frames])
    sharp = np.clip(2.0 * frames - blurred, 0, 255).astype(np.uint8)
    for some in (blurred, sharp):
        assert not detect_stripe(some, StripeSettings()).mosaic.any()
    assert not detect_stripe(frames[..., 0], StripeSettings("grey")).mosaic.any()


@pytest.mark.parametrize(
    ("shape", "halved"), [((25, 320), False), ((48, 320), False), ((50, 320), True), ((60, 20), False)]
)
def test_small_photographs_are_looked_at(shape, halved):
    """Half of one with fewer lines or pixels is too small to be looked at."""
    rows = slice(70 - shape[0] // 2, 70 - shape[0] // 2 + shape[0])
    u = np.arange(shape[1])
    found = detect_stripe(_seen(np.roll(_photographs(1.2)[:1], -2, axis=1)[:, rows, : shape[1]]), StripeSettings())
    assert found.position.shape == (1, len(u))
    assert found.mosaic.tolist() == [halved]


def test_frames_that_go_together_are_as_the_greater_part_of_them():
    frames = _photographs(1.2)
    seen = _seen(frames)
    # The whole photograph of one row further on has the other parity.
    mixed = np.stack([frames[0], seen[0], seen[1], np.roll(seen[2], 1, axis=0), seen[2]])
    peak = np.stack([np.rint(_centre(i)).astype(int) + more for i, more in ((0, 0), (0, 0), (1, 0), (2, 1), (2, 0))])
    each = native_pixels(mixed, None, StripeSettings(), peak, np.ones(5, bool))
    assert each is not None
    assert each.tolist() == [NO_MOSAIC, 0, 0, 1, 0]
    together = native_pixels(mixed, None, StripeSettings(), peak, np.ones(5, bool), alike=True)
    assert together is not None
    assert together.tolist() == [0] * 5


@pytest.mark.parametrize("slope", [0.01, 0.03, 0.1])
@pytest.mark.parametrize("shape", ["bell", "flat top", "peaked"])
def test_a_burnt_out_stripe_over_squares_is_no_mosaic(shape, slope):
    """Half of its lines are full: of a bell without its core every second pixel may be less curved."""
    random, u = np.random.default_rng(3), np.arange(_COLUMNS)
    frames = []
    for i in range(8):
        x = (np.arange(_ROWS)[:, None] - 80 - i / 7 - slope * (u - 160)) / 0.8
        profile = {
            "bell": np.exp(-0.5 * x**2),
            "flat top": np.clip(1.5 - np.abs(x), 0, 1),
            "peaked": np.exp(-np.abs(x)),
        }
        light = 40 + np.where(u // 20 % 2, 600, 150) * profile[shape] + random.standard_normal(x.shape)
        frame = np.full((*x.shape, 3), 40.0)
        frame[..., 0] = light
        frames.append(np.rint(frame.clip(0, 255)).astype(np.uint8))
    assert not detect_stripe(np.stack(frames), StripeSettings()).mosaic.any()
