"""From which number on a pixel is full, read off the tops of lines."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.images.stripes.saturation import full_number

WINDOW, LINES = 25, 100
PIXEL = np.arange(WINDOW)[:, None]


def windows(full: float, burnt: int, borders: tuple[float, ...], noise: float = 1.0) -> np.ndarray:
    """Lines of a frame: so many are cut off at `full`, and some show a lit border instead; the others have bells."""
    random = np.random.default_rng(0)
    height = np.where(np.arange(LINES) < burnt, 900.0, 120.0)
    light = 40 + height * np.exp(-0.5 * ((PIXEL - 12) / 1.5) ** 2)
    for i, level in enumerate(borders):
        light[:, LINES - 1 - i] = np.where(PIXEL[:, 0] < 12, level, 40)
    seen = np.minimum(light + noise * random.standard_normal(light.shape), full)
    return np.rint(seen.clip(0, 255)).astype(np.uint8)[None]


@pytest.mark.parametrize("full", [255.0, 200.0])
def test_lit_borders_are_no_full_pixels(full):
    """Between burnt-out lines they made every pixel above 40 a full one."""
    for borders in ((), (110.0, 112.0, 170.0, 172.0, 175.0)):
        found = int(full_number(jnp.asarray(windows(full, 30, borders)), jnp.zeros(1, bool))[0])
        assert 0.87 * full < found <= full
