"""Levels along tracks: right to the third order across the stripe, and as noisy as they say."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.images.stripes.tracks import Tracks, gather_passage

ROWS, COLUMNS = 32, 1000


@pytest.fixture(scope="module")
def tracks():
    place = np.array([10.0, 10.25, 10.5, 10.8])
    v = np.broadcast_to(place[:, None], (4, COLUMNS))
    u = np.arange(COLUMNS) + np.array([0.0, 0.5, 0.5, 0.1])[:, None]
    return Tracks(jnp.zeros((1, 4), jnp.int32), *(jnp.asarray(x[None], jnp.float32) for x in (u, v)))


def test_a_cubic_across_the_stripe_is_interpolated_to_rounding(tracks):
    def level(v):
        return 3000 + 200 * (v - 10) - 90 * (v - 10) ** 2 + 11 * (v - 10) ** 3

    image = np.broadcast_to(level(np.arange(ROWS))[:, None].clip(0, 65535), (ROWS, COLUMNS))
    seen = gather_passage(jnp.asarray(np.rint(image)[None], jnp.uint16), tracks, columns=True)
    np.testing.assert_allclose(seen.levels, level(np.asarray(tracks.v)), atol=1.5)


def test_levels_between_pixels_scatter_by_the_gain(tracks):
    noise = 20000 + 1000 * np.random.default_rng(0).standard_normal((1, ROWS, COLUMNS))
    seen = gather_passage(jnp.asarray(np.rint(noise), jnp.uint16), tracks, columns=True)
    scatter = np.asarray(seen.levels, float).std(axis=2) / 1000
    gain = np.asarray(seen.gain)[..., 0]
    np.testing.assert_allclose(scatter, np.sqrt(gain), rtol=0.08)
    assert gain[0, 0] == pytest.approx(1.0)
    assert gain[0, 2] < 0.35
