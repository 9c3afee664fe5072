"""An axis that stalls or slips between two photographs is pointed out with them, and one that moves on is not."""

import numpy as np
import pytest

from jaxscan.reconstruction.stalled import stalled_notes

TURN, LINES = 6400, np.arange(200)


def stripes(steps: np.ndarray, seed: int = 0, noise: float = 0.15) -> np.ndarray:
    """Of a body that turns, on a table whose lines show nothing of it."""
    random = np.random.default_rng(seed)
    angle = 2 * np.pi * np.asarray(steps)[:, None] / TURN
    u = 200 + 0.1 * LINES
    for wave in range(1, 5):
        turned = random.uniform(10, 30, len(LINES)) / wave * np.cos(wave * angle + random.uniform(0, 6, len(LINES)))
        u = u + np.where(LINES < 120, turned, 0.0)
    return u + random.normal(0, noise, u.shape)


def said(seen: np.ndarray, steps: np.ndarray) -> list[str]:
    return stalled_notes(seen, steps, "turntable", [f"{i:03}.png" for i in range(len(steps))])


@pytest.mark.parametrize("count", [60, 120, 300])
@pytest.mark.parametrize("noise", [0.05, 0.15, 0.5])
def test_of_an_even_turn_nothing_is_said(count, noise):
    steps = np.arange(count) * TURN / count
    for seed in range(5):
        assert said(stripes(steps, seed, noise), steps) == []


@pytest.mark.parametrize("count", [60, 120])
@pytest.mark.parametrize("lost", [0.7, 1.0])
@pytest.mark.parametrize("at", [20, 41])
def test_lost_steps_are_laid_where_they_were_lost(count, lost, at):
    steps = np.arange(count) * TURN / count
    stood = steps - lost * (TURN / count) * (np.arange(count) > at)
    (note,) = said(stripes(stood), steps)
    assert f"between {at:03}.png and {at + 1:03}.png (" in note
    assert "the turntable stood still or lost steps there" in note


def test_uneven_steps_that_are_known_are_none():
    steps = np.cumsum(np.random.default_rng(1).uniform(30, 90, 100))
    assert said(stripes(steps), steps) == []


def test_what_shows_nothing_is_not_spoken_of():
    steps = np.arange(100) * TURN / 100
    assert said(np.random.default_rng(0).normal(200, 20, (100, 200)), steps) == []
    assert said(np.broadcast_to(200 + 0.1 * LINES, (100, 200)), steps) == []
    assert said(stripes(steps[:3]), steps[:3]) == []
    assert said(np.full((100, 200), np.nan), steps) == []
    # Two photographs of each place, as with two exposures.
    twice = np.repeat(steps, 2)
    assert said(stripes(twice), twice) == []
