"""Photographs on stage and turntable that were mixed up: what is said of them names the fewest that have to move."""

import numpy as np
import pytest

from jaxscan.calibration.reorder import correction, fewest_to_move
from jaxscan.calibration.turn_order import turned_out_of_order
from jaxscan.geometry.rotation import vector_to_matrix

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


def turned(degrees: np.ndarray, noise_deg: float = 0.02, seed: int = 0) -> np.ndarray:
    """Rotations of a board that stands anyhow on a table that leans, turned to these angles."""
    random = np.random.default_rng([seed, 7])
    axis = random.normal(size=3)
    axis /= np.linalg.norm(axis)
    stands = vector_to_matrix(random.uniform(-1, 1, 3))
    noise = vector_to_matrix(np.radians(noise_deg) * random.normal(size=(len(degrees), 3)))
    return noise @ vector_to_matrix(np.radians(degrees)[:, None] * axis) @ stands


@pytest.mark.parametrize("span", [100.0, 348.75, 354.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_photographs_of_a_turn_that_were_mixed_up_are_put_in_order(span: float, seed: int):
    steps = np.linspace(0, 3100, 32)
    random = np.random.default_rng(seed)
    rotations = turned(np.linspace(0, span, 32), seed=seed)
    two = np.arange(32)
    two[[5, 9]] = two[[9, 5]]
    moved = np.insert(np.delete(np.arange(32), 4), 20, 4)
    for mixed in (two, moved, random.permutation(32)):
        order, before, after = turned_out_of_order(steps, rotations[mixed], np.zeros(3))
        assert after < 0.1 < before
        # All around, any of them may be the first; and either way round.
        way = np.diff(mixed[order])
        assert {abs(step) for step in way.tolist()} <= {1, 31}
        assert (np.abs(way) == 31).sum() <= (span > 300)


@pytest.mark.parametrize(
    "degrees",
    [
        np.linspace(0, 348.75, 32),
        -np.linspace(0, 348.75, 32),
        np.linspace(0, 720, 32, endpoint=False),
        np.linspace(0, 40, 3),
        np.cumsum(np.random.default_rng(3).uniform(1, 20, 25)),
    ],
    ids=["a turn", "the other way", "two turns", "three", "uneven steps"],
)
def test_a_turn_in_order_is_left_alone(degrees: np.ndarray):
    rotations = turned(degrees, noise_deg=0.1)
    assert turned_out_of_order(10 * (degrees - degrees[0]) * np.sign(degrees[-1]), rotations, np.zeros(3)) is None
