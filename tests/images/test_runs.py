"""Runs of points: which are connected, and which are the stripe."""

from functools import partial

import numpy as np

from jaxscan.images.stripes.runs import Points, likeliest, linked

LINES = np.arange(200)


def points(*runs):
    """Points of runs (lines, positions, strength, width), sorted by line; and which run each point is of."""
    parts = [
        (line, *(np.broadcast_to(x, line.shape) for x in (at, strength, width, width)))
        for line, at, strength, width in runs
    ]
    line, *values = (np.concatenate(each) for each in zip(*parts, strict=True))
    of = np.repeat(np.arange(len(runs)), [len(part[0]) for part in parts])
    order = np.argsort(line, kind="stable")
    return Points(line[order], *(np.asarray(v, np.float64)[order] for v in values)), of[order]


def responses(seen, line, row):
    """The greatest strength of a point no further than 3 px from each place."""
    near = (seen.line == line[:, None]) & (np.abs(seen.at - row[:, None]) <= 3)
    return np.where(near, seen.strength, 0.0).max(axis=1)


def taken(*runs):
    """The part of each run that is taken."""
    seen, of = points(*runs)
    chosen, _ = likeliest(seen, partial(responses, seen))
    assert np.unique(seen.line[chosen]).size == chosen.sum()
    return [chosen[of == i].mean() for i in range(len(runs))]


def test_parallel_lines_stay_apart_and_gaps_are_bridged():
    some = LINES[LINES % 7 > 2]
    seen, of = points((some, 50 + 0.5 * some, 100, 3), (LINES, 60 + 0.5 * LINES, 100, 3))
    run = linked(seen)
    assert len(set(run)) == 2
    assert all(len(set(run[of == i])) == 1 for i in (0, 1))


def test_a_fainter_line_that_crosses_takes_nothing():
    across = LINES[np.abs(LINES - 100) > 8]
    seen, of = points((LINES, 100.0, 100, 3), (across, 1.0 * across, 35, 3))
    assert len(set(linked(seen)[of == 0])) == 1
    assert taken((LINES, 100.0, 100, 3), (across, 1.0 * across, 35, 3)) == [1.0, 0.0]


def test_a_ghost_is_none_in_a_gap_of_its_stripe_either():
    stripe = LINES[(LINES < 80) | (LINES > 120)]
    assert taken((stripe, 100.0, 100, 3), (LINES, 150.0, 35, 3)) == [1.0, 0.0]


def test_a_dark_piece_at_another_depth_is_kept():
    assert taken((LINES[:110], 100.0, 100, 3), (LINES[100:], 150.0, 30, 3))[0] == 1.0
    assert taken((LINES[:110], 100.0, 100, 3), (LINES[100:], 150.0, 30, 3))[1] > 0.85


def test_what_is_burnt_out_does_not_win_by_its_brightness():
    assert taken((LINES, 100.0, 100, 3), (LINES[60:100], 150.0, 500, 3)) == [1.0, 0.0]


def test_the_faded_end_of_a_long_run_gives_way_to_a_brighter_short_one():
    shares = LINES[60:89]
    short, long = np.where(shares < 76, 65, 40), np.where(LINES[60:] < 76, 25, 100)
    seen, of = points((shares, 100.0, short, 3), (LINES[60:], 150.0, long, 3))
    chosen, _ = likeliest(seen, partial(responses, seen))
    assert chosen[(of == 0) & (seen.line < 76)].all()
    assert chosen[(of == 1) & (seen.line >= 76)].all()


def test_what_is_thicker_than_long_is_no_line():
    assert taken((LINES, 100.0, 100, 3), (LINES[60:80], 150.0, 100, 20)) == [1.0, 0.0]


def test_a_ghost_goes_on_beyond_a_gap():
    """Where a run begins was read off the end of its first points, so that gaps seemed longer than they are."""
    stripe, ghost = LINES[(LINES < 90) | (LINES >= 130)], LINES[LINES < 90]
    alone = LINES[(LINES >= 93) & (LINES < 127)]
    on, its, rest = taken((stripe, 100.0, 100, 3), (ghost, 150.0, 35, 3), (alone, 150.0, 35, 3))
    assert (on, its, rest) == (1, 0, 0)


def test_a_stripe_where_a_ghost_goes_straight_on_is_kept():
    """A step as high as the ghost lies above the stripe was once made one run with it, and left as one."""
    step = (LINES >= 80) & (LINES < 120)
    at, above = np.where(step, 50.0, 100.0), np.where(step, 0.0, 50.0)
    strength = np.where(step, 100.0, 35.0)
    kept, one, _ = taken(
        (LINES[~step], at[~step], 100, 3),
        (LINES, np.full(LINES.shape, 50.0), strength, 3),
        (LINES[step], above[step], 35, 3),
    )
    assert kept == 1
    assert abs(one - step.mean()) < 0.03


def test_a_copy_is_none_where_what_it_copies_cannot_be_measured():
    """Beside a lamp the stripe was not measured, and its ghost was taken there."""
    near, far = LINES[LINES < 150], LINES[LINES >= 160]
    seen, of = points((near, 100.0, 100, 3), (near, 150.0, 35, 3), (far, 120.0, 35, 3))

    def shows(line, row):
        return np.maximum(responses(seen, line, row), np.where((line >= 160) & (np.abs(row - 70) <= 3), 100.0, 0.0))

    assert [likeliest(seen, shows)[0][of == i].mean() for i in range(3)] == [1, 0, 0]
    assert [likeliest(seen, partial(responses, seen))[0][of == i].mean() for i in range(3)] == [1, 0, 1]
