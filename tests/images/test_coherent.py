import numpy as np
import pytest

from jaxscan.images.stripes.candidates import choose
from jaxscan.images.stripes.coherent import HALO, support

FRAMES, LINES = 12, 60
# Where a glint crosses the stripe either will do.
CROSSING_PX = 2


def scene(speed=3.0, seed=0, jump=0.0):
    """A stripe of strength 0.6 and a stronger glint elsewhere in every frame; the stripe jumps in line 30, frame 6."""
    random = np.random.default_rng(seed)
    true = 100 + speed * np.arange(FRAMES)[:, None] + 0.5 * np.arange(LINES)
    true += jump * ((np.arange(FRAMES)[:, None] >= 6) | (np.arange(LINES) >= 30))
    glint = random.uniform(20, 460, (FRAMES, 1)) + random.uniform(-1, 1, (FRAMES, 1)) * np.arange(LINES)
    rows = np.rint(np.stack([glint, true, np.zeros_like(true)], axis=-1)).astype(np.int32)
    return rows, np.broadcast_to(np.float32([1.0, 0.6, 0.0]), rows.shape), rows[..., 1]


@pytest.mark.parametrize("speed", [0.0, 3.0, 14.0, -40.0])
def test_what_goes_on_in_time_is_taken_before_what_is_brighter_however_fast_it_moves(speed):
    rows, strength, true = scene(speed)
    np.testing.assert_allclose(choose(rows, strength, "coherent"), true, atol=CROSSING_PX)
    assert (choose(rows, strength, "continuous") != true).mean() > 0.5


def test_a_jump_in_depth_is_found_in_its_own_frame_and_line():
    rows, strength, true = scene(14.0, jump=90.0)
    np.testing.assert_allclose(choose(rows, strength, "coherent"), true, atol=CROSSING_PX)


def test_a_stripe_that_was_lost_is_found_in_the_frame_in_which_it_is_back():
    rows, strength, true = scene(5.0, seed=1)
    strength = strength.copy()
    strength[4, 10:50, 1] = 0
    strength[8, :, 1] = 0
    there = strength[..., 1] > 0
    np.testing.assert_allclose(choose(rows, strength, "coherent")[there], true[there], atol=CROSSING_PX)


def test_support_is_one_on_a_straight_course_and_none_for_what_is_not_there():
    rows, strength, _ = scene(7.0)
    inner = support(rows, strength)[HALO:-HALO]
    assert inner[..., 1].min() > 0.8
    assert inner[..., 0].mean() < 0.2
    assert not inner[..., 2].any()


def test_a_choice_depends_on_two_frames_to_either_side_alone():
    random = np.random.default_rng(3)
    rows = random.integers(0, 480, (FRAMES, LINES, 4)).astype(np.int32)
    strength = random.uniform(-0.3, 1.0, rows.shape).clip(0).astype(np.float32)
    whole = choose(rows, strength, "coherent")
    for first in range(0, FRAMES, 3):
        low, high = max(first - HALO, 0), min(first + 3 + HALO, FRAMES)
        part = choose(rows[low:high], strength[low:high], "coherent")
        np.testing.assert_array_equal(part[first - low :][:3], whole[first : first + 3])


@pytest.mark.parametrize("frames", [1, 2])
def test_with_too_few_frames_strength_and_lines_decide(frames):
    rows, strength, true = scene()
    strength = strength.copy()
    strength[..., 0] = 0
    np.testing.assert_array_equal(choose(rows[:frames], strength[:frames], "coherent"), true[:frames])
