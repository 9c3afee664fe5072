"""A turn that does not close is pointed out, and none that does."""

import numpy as np
import pytest

from jaxscan.reconstruction.closing import closing, closing_notes

TURN, LINES = 6400, np.arange(100)


def stripes(steps: np.ndarray, turn: float = TURN, noise: float = 0.15, seed: int = 0) -> np.ndarray:
    """Of a body that turns, no two heights of which are alike: a drift along it, and waves around it."""
    random = np.random.default_rng(seed)
    angle = 2 * np.pi * np.asarray(steps)[:, None] / turn
    u = 200 + 0.1 * LINES
    for wave in range(1, 4):
        u = u + random.uniform(5, 15, len(LINES)) / wave**2 * np.cos(wave * angle + random.uniform(0, 6, len(LINES)))
    return u + random.normal(0, noise, u.shape)


@pytest.mark.parametrize("count", [60, 160, 400])
@pytest.mark.parametrize("noise", [0.05, 0.15, 0.5])
def test_a_turn_that_closes_is_one(count, noise):
    steps = np.arange(count) * TURN / count
    for seed in range(5):
        assert closing_notes(stripes(steps, noise=noise, seed=seed), steps, TURN, "turntable") == []


@pytest.mark.parametrize("off", [-0.02, -0.01, 0.01, 0.03])
@pytest.mark.parametrize("count", [100, 160, 400])
def test_a_table_that_turns_by_another_angle_is_named_with_it(off, count):
    steps = np.arange(count) * TURN / count
    seen = stripes(steps, TURN * (1 + off))
    found = closing(seen, steps, TURN)
    # Where the stripe bends away from a straight line it seems to be less.
    assert 0.6 < found.misses / (-off * TURN) < 1.3
    (note,) = closing_notes(seen, steps, TURN, "turntable")
    assert note.startswith(f"the turn does not close: after 6400 motor steps the stripe is {abs(found.misses):.0f} of")
    assert f"as if a turn had {TURN - found.misses:.0f}: check the steps of turntable" in note


def test_steps_that_were_lost_and_an_object_that_was_pushed_show():
    steps = np.arange(160) * TURN / 160
    lost = np.where(steps > 3000, steps - 100, steps)
    assert closing_notes(stripes(lost), steps, TURN, "turntable")
    pushed = stripes(steps) + np.where(steps > 3000, 4.0, 0.0)[:, None] * np.cos(LINES / 30)
    moved = stripes(steps) + np.where(steps > 3000, 6.0, 0.0)[:, None]
    assert not closing_notes(stripes(steps), steps, TURN, "turntable")
    # What moved against the slopes of its own lines shows as a turn; what did not move along them may not.
    assert any(closing_notes(each, steps, TURN, "turntable") for each in (pushed, moved))


def test_more_than_a_turn_and_a_turn_from_anywhere():
    steps = 1700 + np.arange(200) * 40.0
    assert closing_notes(stripes(steps), steps, TURN, "turntable") == []
    assert closing_notes(stripes(steps, 1.01 * TURN), steps, TURN, "turntable")


def test_a_turn_that_shows_nothing_of_it_is_not_called_closed():
    """A body that is round about the axis, or a bare table with objects elsewhere."""
    steps = np.arange(160) * TURN / 160
    round_body = 200 + 0.1 * LINES + np.random.default_rng(0).normal(0, 0.15, (160, len(LINES)))
    (note,) = closing_notes(round_body, steps, TURN, "turntable")
    assert "could not be checked" in note


def test_few_photographs_and_few_lines_are_not_spoken_of():
    steps = np.arange(160) * TURN / 160
    half = steps / 2
    assert closing(stripes(half), half, TURN) is None
    assert closing(stripes(steps[:10]), steps[:10], TURN) is None
    assert closing(np.where(LINES < 10, stripes(steps), np.nan), steps, TURN) is None
