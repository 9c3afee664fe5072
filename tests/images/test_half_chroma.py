"""Colours at half resolution: how a JPEG mostly keeps them."""

import cv2
import numpy as np
import pytest
import simplejpeg
from scipy.special import ndtr

from benchmarks.video import in_a_video, moving_stripe
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripe_settings import CHANNELS
from jaxscan.images.stripes.response import half_chroma

ROWS, FACES, WIDTH, EDGE = 112, 8, 40, 8


def faces(color, s, peak, ambient=(60.0, 60.0, 60.0), seed=0):
    """A photograph of a stripe on level faces, each elsewhere among the pixels, and their rows."""
    random = np.random.default_rng(seed)
    centre = 40 + random.uniform(0, 20, FACES)
    edges = (np.arange(ROWS + 1)[:, None] - 0.5 - np.repeat(centre, WIDTH)) / s
    light = peak * s * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)
    levels = np.zeros((*light.shape, 3)) + ambient
    for channel, part in zip(CHANNELS[color], (1.0, 0.06, 0.03), strict=True):
        levels[..., channel] += part * light
    levels += 1.5 * random.standard_normal(levels.shape)
    return np.rint(levels.clip(0, 255)).astype(np.uint8), centre


def jpeg(photograph, kind, quality=90):
    return simplejpeg.decode_jpeg(simplejpeg.encode_jpeg(photograph, quality, "RGB", kind), "RGB")


def errors(photograph, settings, centre):
    """The mean error on each face, px."""
    position = detect_stripe(photograph, settings).position[0].astype(np.float64)
    return np.nanmean(position.reshape(FACES, WIDTH)[:, EDGE:-EDGE], axis=1) - centre


@pytest.mark.parametrize(
    ("color", "most"), [("red", 0.02), pytest.param("green", 0.015, marks=pytest.mark.long), ("blue", 0.04)]
)
def test_a_narrow_stripe_is_where_it_is_whatever_its_place_among_the_pixels(color, most):
    photograph, centre = faces(color, 0.8, 180)
    off = errors(jpeg(photograph, "420"), StripeSettings(color), centre)
    assert np.sqrt((off**2).mean()) < most


def test_what_runs_along_columns_is_measured_so_too():
    photograph, centre = faces("red", 0.8, 180)
    turned = jpeg(np.ascontiguousarray(photograph.transpose(1, 0, 2)), "422")
    off = errors(turned, StripeSettings("red", columns=False), centre)
    assert np.sqrt((off**2).mean()) < 0.02


def test_a_burnt_out_stripe_is_seen_to_be_full():
    photograph, centre = faces("red", 1.0, 800)
    off = errors(jpeg(photograph, "420"), StripeSettings("red"), centre)
    assert np.sqrt((off**2).mean()) < 0.03


@pytest.mark.parametrize("color", ["red", "green", "blue"])
@pytest.mark.parametrize(("s", "peak"), [(0.7, 150), (1.5, 700), (3.0, 150)])
@pytest.mark.parametrize("ambient", [60.0, 8.0])
def test_colours_at_half_resolution_are_told_from_the_pixels(color, s, peak, ambient):
    photograph, _ = faces(color, s, peak, (ambient,) * 3)
    kinds = [photograph, jpeg(photograph, "444"), jpeg(photograph, "422"), jpeg(photograph, "420")]
    rows = slice(25, 75)
    lit = np.stack([kind[rows] for kind in kinds])
    first = np.full((len(lit), lit.shape[2]), rows.start, np.int32)
    half, repeated = half_chroma(lit, first, color)
    assert half.tolist() == [False, False, False, True]
    assert not repeated.any()


@pytest.mark.parametrize("color", ["red", "green", "blue"])
@pytest.mark.parametrize("s", [0.8, 2.0])
def test_colours_that_are_repeated_are_told_from_those_that_are_interpolated(color, s):
    photograph, _ = faces(color, s, 150)
    as_in_a_video = cv2.cvtColor(cv2.cvtColor(photograph, cv2.COLOR_RGB2YUV_I420), cv2.COLOR_YUV2RGB_I420)
    rows = slice(25, 75)
    lit = np.stack([kind[rows] for kind in (photograph, jpeg(photograph, "420"), as_in_a_video)])
    half, repeated = half_chroma(lit, np.full((len(lit), lit.shape[2]), rows.start, np.int32), color)
    assert half.tolist() == [False, True, True]
    assert repeated.tolist() == [False, False, True]


@pytest.mark.parametrize(("s", "peak"), [(0.8, 150), (1.5, 700)])
def test_a_stripe_in_a_video(tmp_path, s, peak):
    """The default finds it as well as the centre of gravity does, and knows how well."""
    frames, truth, asked = moving_stripe(s, peak, 0.2, seed=2, count=12)
    kept = in_a_video(frames, tmp_path / "stripe.mp4", "mpeg4")
    stripe, peer = (detect_stripe(kept, StripeSettings("red"), detector=name) for name in ("likelihood", "gravity"))
    off, by_gravity = (np.where(asked & each.valid, each.position - truth, np.nan) for each in (stripe, peer))
    assert np.sqrt(np.nanmean(off**2)) < 1.1 * np.sqrt(np.nanmean(by_gravity**2))
    assert 0.6 < 1.4826 * np.nanmedian(np.abs(off / stripe.sigma)) < 1.5


def test_a_grey_laser_in_colours_is_full_where_any_channel_is():
    photograph, centre = faces("red", 1.5, 600)
    stripe = detect_stripe(photograph, StripeSettings("grey"))
    error = (stripe.position[0] - np.repeat(centre, WIDTH)) / stripe.sigma[0]
    assert 0.75 < 1.4826 * np.nanmedian(np.abs(error)) < 1.3
