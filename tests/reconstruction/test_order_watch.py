"""Photographs in no order are pointed out, and none that are in one."""

import numpy as np
import pytest

from jaxscan.reconstruction.order_watch import OrderWatch
from jaxscan.rig import Fixed

LINES = np.arange(640)


def stripes(count: int, turns: float = 1.0, height_px: float = 20.0) -> np.ndarray:
    """Of an eccentric body that turns, with waves along it."""
    angle = 2 * np.pi * turns * np.arange(count)[:, None] / count
    noise = np.random.default_rng(0).normal(0, 0.1, (count, len(LINES)))
    return 200 + height_px * np.cos(angle + LINES / 100) + noise


def notes(pixels: np.ndarray, positions: np.ndarray, **other: np.ndarray) -> list[str]:
    watch = OrderWatch(Fixed())
    for first in range(0, len(pixels), 16):
        some = slice(first, first + 16)
        watch.see(pixels[some], {axis: q[some] for axis, q in {"turntable": positions, **other}.items()})
    return watch.notes()


@pytest.mark.parametrize("count", [20, 37, 160])
@pytest.mark.parametrize("turns", [0.3, 1.0, 2.0])
def test_a_scan_in_order_is_one_however_coarse(count, turns):
    assert notes(stripes(count, turns), 20 * np.arange(count)) == []


@pytest.mark.parametrize("count", [24, 160])
@pytest.mark.parametrize("seed", range(5))
def test_shuffled_photographs_are_pointed_out(count, seed):
    shuffled = np.random.default_rng(seed).permutation(count)
    (note,) = notes(stripes(count)[shuffled], 20 * np.arange(count))
    assert note.startswith("the photographs seem to be in no order: the stripe differs by ")
    # Where the steps were taken in that order all is well.
    assert notes(stripes(count)[shuffled], 20 * shuffled) == []


def test_what_shows_nothing_is_not_spoken_of():
    count = 60
    shuffled, steps = np.random.default_rng(1).permutation(count), np.arange(count)
    # A plate looks alike everywhere; few frames; few lines; two axes.
    assert notes(stripes(count, height_px=0.5)[shuffled], steps) == []
    assert notes(stripes(10)[::-1][[3, 1, 7, 5, 0, 9, 2, 8, 4, 6]], np.arange(10)) == []
    assert notes(np.where(LINES < 10, stripes(count)[shuffled], np.nan), steps) == []
    assert notes(stripes(count)[shuffled], steps, stage=steps) == []
    assert OrderWatch(Fixed()).notes() == []
