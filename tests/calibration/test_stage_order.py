"""Photographs on the stage that were mixed up: what is said of them names the fewest that have to move."""

import numpy as np
import pytest

from jaxscan.calibration.stage_order import correction, fewest_to_move

NAMES = [f"{i:02d}" for i in range(12)]


def exchanged(i: int, j: int) -> list[str]:
    names = list(NAMES)
    names[i], names[j] = names[j], names[i]
    return names


def moved(i: int, j: int) -> list[str]:
    names = list(NAMES)
    names.insert(j, names.pop(i))
    return names


@pytest.mark.parametrize(
    ("names", "says"),
    [
        (exchanged(3, 4), "if 04 and 03 were exchanged"),
        (exchanged(2, 9), "if 09 and 02 were exchanged"),
        (moved(5, 10), "if 05 were between 04 and 06"),
        (moved(0, 7), "if 00 were first"),
        (moved(11, 3), "if 11 were last"),
        (NAMES[::-1], f"if they were in the order {', '.join(NAMES)}"),
        (
            [*NAMES[:4], "08", *NAMES[4:6], "10", *NAMES[6:8], "09", "11"],
            "if 08 were between 07 and 09, and 10 were between 09 and 11",
        ),
    ],
)
def test_the_fewest_are_named(names: list[str], says: str):
    assert correction(names, NAMES) == says


def test_no_smaller_set_will_do():
    random = np.random.default_rng(0)
    for _ in range(50):
        names = [NAMES[i] for i in random.permutation(7)]
        moves = fewest_to_move(names, NAMES[:7])
        left = [name for name in names if name not in moves]
        assert left == sorted(left)
        longest = max(
            bin(kept).count("1")
            for kept in range(1 << 7)
            if (run := [names[i] for i in range(7) if kept >> i & 1]) == sorted(run)
        )
        assert len(left) == longest


def test_of_a_long_shuffle_the_order_is_cut():
    names = [f"{i:03d}" for i in range(50)]
    assert correction(names[::-1], names).endswith("039 and 10 more")
