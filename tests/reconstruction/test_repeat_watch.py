"""Photographs that were given twice: pointed out where noise shows that it is no chance."""

from pathlib import Path

import numpy as np

from jaxscan.reconstruction.repeat_watch import RepeatWatch
from tests.reconstruction.small import wavy_stripe


def notes(levels: list[np.ndarray], sigma: float, offset: float = 0.0, again: tuple[int, ...] = ()) -> list[str]:
    """Of photographs in which those `again` are the ones before them, looked at three at a time."""
    random = np.random.default_rng(0)
    images = [
        np.rint(level + offset + sigma * random.standard_normal(level.shape)).clip(0, 255).astype(np.uint8)
        for level in levels
    ]
    for i in again:
        images[i] = images[i - 1]
    watch, paths = RepeatWatch(), tuple(Path(f"frames/{i:03d}.png") for i in range(len(images)))
    for first in range(0, len(images), 3):
        watch.see(np.stack(images[first : first + 3]))
    return watch.notes(paths)


MOVING = [wavy_stripe(i) for i in range(10)]
FLAT = [wavy_stripe(0) for _ in range(8)]


def test_a_photograph_that_comes_twice_is_named_with_the_one_before_it() -> None:
    assert notes(MOVING, 1.0) == []
    (said,) = notes(MOVING, 1.0, again=(3, 8))
    assert said.startswith("003.png is a copy of 002.png, 008.png is a copy of 007.png, to the last bit")
    (said,) = notes(MOVING, 0.3, again=(2, 4, 6, 8, 9))
    assert "006.png is a copy of 005.png, and 2 more are copies, to the last bit" in said


def test_without_noise_photographs_may_be_equal() -> None:
    ball = [level * (1 + 0.01 * i) for i, level in enumerate(MOVING)]
    assert notes(FLAT + MOVING, 0.0) == []
    assert notes(FLAT[:2] + ball, 0.0) == []
    assert notes(FLAT, 0.0) == []


def test_black_photographs_say_nothing() -> None:
    assert notes([np.zeros_like(level) for level in MOVING], 0.0) == []
    # Noise below black is cut off everywhere but in the stripe.
    assert notes(MOVING, 1.0, offset=-40.0, again=(3,)) == []
