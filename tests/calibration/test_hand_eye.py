"""Camera and hand from given poses: what is found, how well it is known, and what is said of poses that are wrong."""

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxscan.calibration.hand_eye import Fit, Seen, hand_eye, not_turned
from jaxscan.calibration.hand_start import hand_start
from jaxscan.errors import InputError
from jaxscan.geometry import Pose, matrix_to_vector
from jaxscan.rig import CARRIED_BY
from tests.unchecked import unchecked

SIGMA_MM, SIGMA_RAD = 0.08, np.radians(0.03)
# σ of a board's turn (rad) and place (mm), which is known worst along the line of sight.
BOARD_SIGMA = np.array([3e-4, 3e-4, 1e-4, 0.01, 0.01, 0.06])


def world(
    seed: int,
    moves: str = "head",
    count: int = 14,
    turn: str = "all",
    sessions: int = 1,
    sigma: tuple[float, float] = (SIGMA_MM, SIGMA_RAD),
    turned: Rotation | None = None,
    base: tuple[float, float, float] = (0.2, 2.9, 0.3),
    away_mm: float = 60.0,
) -> tuple[Pose[np.ndarray], Seen]:
    """K, and photographs whose given poses and boards are off by noise."""
    random = np.random.default_rng([seed, count, sessions])
    kind = CARRIED_BY[moves]
    K = Pose(random.normal(0, 1.2, 3), random.normal(0, away_mm, 3))
    usual = random.uniform(-0.5, 0.5, (count, 3)) * {"all": [1, 1, 1], "one": [0, 0, 1], "none": [0, 0, 0]}[turn]
    rotation = ((turned or Rotation.from_rotvec(usual)) * Rotation.from_rotvec(base)).as_rotvec()
    boards = Pose(rotation, random.uniform(-60, 60, (count, 3)) + np.array([0.0, 0.0, 380.0]))
    session = np.arange(count) % sessions
    mounted = Pose(random.normal(0, 1, (sessions, 3)), random.normal(0, 200, (sessions, 3)))
    at = Pose(mounted.rotation[session], mounted.translation[session])
    hand = kind.carry(K.inverse() @ boards @ at.inverse())
    given = Pose(
        (
            Rotation.from_rotvec(hand.rotation) * Rotation.from_rotvec(random.normal(0, sigma[1], (count, 3)))
        ).as_rotvec(),
        hand.translation + random.normal(0, sigma[0], (count, 3)),
    )
    noise = BOARD_SIGMA * random.standard_normal((count, 6))
    seen = Pose(
        (Rotation.from_rotvec(noise[:, :3]) * Rotation.from_rotvec(boards.rotation)).as_rotvec(),
        boards.translation + noise[:, 3:],
    )
    covariance = np.tile(np.diag(BOARD_SIGMA**2), (count, 1, 1))
    return K, Seen(given, seen, session, covariance, np.zeros((count, 6, 1)))


def each_world(count: int, *args: Any, **kwargs: Any) -> Iterator[tuple[Pose[np.ndarray], Seen]]:
    """Worlds of several seeds; shapes are checked with the first alone."""
    yield world(0, *args, **kwargs)
    with unchecked():
        for seed in range(1, count):
            yield world(seed, *args, **kwargs)


def off(fit: Fit, K: Pose[np.ndarray]) -> np.ndarray:
    """By how much K's turn (from the left, rad) and offset (mm) are off."""
    R = K.matrix()
    return np.concatenate([matrix_to_vector(fit.rotation @ R.T), fit.offset - R.T @ K.translation])


@pytest.mark.parametrize("moves", CARRIED_BY)
@pytest.mark.parametrize(("count", "sessions"), [(6, 1), (14, 1), (40, 3)])
def test_sigma_is_that_of_repeated_calibrations(moves: str, count: int, sessions: int):
    normalized, found = [], []
    for K, seen in each_world(40, moves, count, sessions=sessions):
        result = hand_eye(CARRIED_BY[moves], seen, *(hand_start(CARRIED_BY[moves], seen, None)[0], (None, None)))
        d = off(result.fit, K)
        normalized.append(d @ np.linalg.solve(result.covariance, d) / 6)
        found.append(result.found)
        assert result.kept.sum() >= count - 1
    # Of 240 squares the mean scatters by 0.09. Of 200 seeds it is 0.97 to 1.09, of 6 photographs up to 1.25.
    assert np.mean(normalized) == pytest.approx(1.0 if count > 6 else 1.15, abs=0.28)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(found), axis=0)), [SIGMA_MM, SIGMA_RAD], rtol=0.12)


@pytest.mark.parametrize("moves", CARRIED_BY)
def test_exact_poses_are_found_exactly(moves: str):
    K, seen = world(3, moves, sigma=(0.0, 0.0))
    seen = replace(seen, boards=seen.boards, covariance=1e-12 * seen.covariance)
    fit, _ = hand_start(CARRIED_BY[moves], seen, None)
    # The boards have noise, and are said to have none: it is taken for the robot's.
    result = hand_eye(CARRIED_BY[moves], seen, fit, (None, None))
    assert np.abs(off(result.fit, K)[:3]).max() < 5e-4
    assert result.found[0] < 0.2


def test_poses_that_are_wrong_are_left_out_and_nothing_else():
    for K, seen in each_world(10, "object"):
        seen.given.translation[4] += [0.0, 25.0, 0.0]
        seen.given.rotation[9] = -seen.given.rotation[9]
        fit, _ = hand_start(CARRIED_BY["object"], seen, None)
        result = hand_eye(CARRIED_BY["object"], seen, fit, (None, None))
        assert np.flatnonzero(~result.kept).tolist() == [4, 9]
        d = off(result.fit, K)
        assert d @ np.linalg.solve(result.covariance, d) < 25


@pytest.mark.parametrize("moves", CARRIED_BY)
def test_a_hand_that_never_turns_leaves_the_offset_open(moves: str):
    kind = CARRIED_BY[moves]
    for K, seen in each_world(10, moves, turn="none"):
        result = hand_eye(kind, seen, hand_start(kind, seen, None)[0], (None, None))
        assert len(result.unknown) == 3
        d = off(result.fit, K)[:3]
        assert d @ np.linalg.solve(result.covariance[:3, :3], d) < 20


@pytest.mark.parametrize("moves", CARRIED_BY)
def test_a_hand_that_turns_about_one_direction_leaves_it_open(moves: str):
    kind = CARRIED_BY[moves]
    for K, seen in each_world(10, moves, turn="one"):
        result = hand_eye(kind, seen, hand_start(kind, seen, None)[0], (None, None))
        (way,) = result.unknown
        # All boards turn about the camera's line of sight.
        assert abs(K.matrix().T[:, 2] @ way) > 0.999
        d = off(result.fit, K)
        across = np.eye(3) - np.outer(way, way)
        assert np.abs(across @ d[3:]).max() < 3.0
        assert np.degrees(np.linalg.norm(d[:3])) < 0.5


def test_one_direction_of_travel_and_no_turn_is_a_stage():
    _, seen = world(1, turn="none")
    way = np.linspace(0, 100, 14)[:, None] * [1.0, 0.0, 0.0]
    R = seen.given.matrix()[0]
    boards = Pose(seen.boards.rotation, seen.boards.translation[:1] + way)
    given = Pose(np.tile(seen.given.rotation[:1], (14, 1)), -way @ R.T)
    seen = replace(seen, given=given, boards=boards)
    with pytest.raises(InputError, match="move in two directions at least"):
        hand_eye(CARRIED_BY["head"], seen, hand_start(CARRIED_BY["head"], seen, None)[0], (None, None))


def test_a_larger_sigma_than_was_given_is_used():
    _, seen = world(2)
    fit, _ = hand_start(CARRIED_BY["head"], seen, None)
    small = hand_eye(CARRIED_BY["head"], seen, fit, (SIGMA_MM / 10, SIGMA_RAD / 10))
    free = hand_eye(CARRIED_BY["head"], seen, fit, (None, None))
    np.testing.assert_allclose(small.sigma, free.sigma, rtol=0.05)
    large = hand_eye(CARRIED_BY["head"], seen, fit, (10 * SIGMA_MM, 10 * SIGMA_RAD))
    np.testing.assert_allclose(large.sigma, [10 * SIGMA_MM, 10 * SIGMA_RAD])


MISTAKES = {
    "the inverse": (lambda given: given.inverse(), "change moves to the other of head and object"),
    "the quaternion's order": (
        lambda given: Pose(
            Rotation.from_quat(np.roll(Rotation.from_rotvec(given.rotation).as_quat(), -1, axis=1)).as_rotvec(),
            given.translation,
        ),
        "write qw first",
    ),
    "metres": (lambda given: Pose(given.rotation, given.translation / 1000), "in metres"),
    "centimetres": (lambda given: Pose(given.rotation, given.translation / 10), "in centimetres"),
    "inches": (lambda given: Pose(given.rotation, given.translation / 25.4), "in inches"),
    "transposed": (lambda given: Pose(-given.rotation, given.translation), "transpose the matrices"),
    "shuffled": (lambda given: Pose(given.rotation[::-1], given.translation[::-1]), "check that each name"),
}


@pytest.mark.parametrize("name", MISTAKES)
@pytest.mark.parametrize("moves", CARRIED_BY)
def test_usual_mistakes_are_named(moves: str, name: str):
    spoil, expected = MISTAKES[name]
    for _, seen in each_world(5, moves):
        with pytest.raises(InputError, match=expected):
            hand_start(CARRIED_BY[moves], replace(seen, given=spoil(seen.given)), None)


def test_boards_that_look_the_same_after_half_a_turn():
    middle = np.array([40.0, 25.0])
    half = Pose(np.array([0.0, 0.0, np.pi]), np.array([*(2 * middle), 0.0]))
    for seed, (K, seen) in enumerate(each_world(10)):
        fit, same = hand_start(CARRIED_BY["head"], seen, middle)
        np.testing.assert_allclose(same.boards.translation, seen.boards.translation)
        flipped = np.random.default_rng(seed).random(14) < 0.5
        turned = seen.boards @ half
        boards = Pose(
            np.where(flipped[:, None], turned.rotation, seen.boards.rotation),
            np.where(flipped[:, None], turned.translation, seen.boards.translation),
        )
        fit, back = hand_start(CARRIED_BY["head"], replace(seen, boards=boards), middle)
        assert hand_eye(CARRIED_BY["head"], back, fit, (None, None)).kept.all()
        assert np.degrees(np.linalg.norm(off(fit, K)[:3])) < 1.0


def test_boards_that_look_the_same_where_the_hand_turned_by_right_angles():
    middle = np.array([40.0, 25.0])
    for seed in range(4):
        yaw = Rotation.from_rotvec(np.outer(np.pi / 2 * (np.arange(14) % 3), [0, 0, 1]))
        tilt = np.random.default_rng(seed).uniform(-0.1, 0.1, (14, 3)) * [1, 1, 0]
        _, seen = world(seed, turned=yaw * Rotation.from_rotvec(tilt), base=(np.pi, 0.0, 0.0))
        fit, back = hand_start(CARRIED_BY["head"], seen, middle)
        np.testing.assert_allclose(back.boards.translation, seen.boards.translation)
        assert hand_eye(CARRIED_BY["head"], back, fit, (None, None)).kept.all()


@pytest.mark.parametrize("moves", CARRIED_BY)
@pytest.mark.parametrize("turn_rad", [0.005, 0.02, 0.05])
def test_small_turns_far_from_the_base(moves: str, turn_rad: float):
    """About x and y the hand turns by little, which moves a base that is far away all the same."""
    kind, normalized, found = CARRIED_BY[moves], [], []
    for seed in range(20):
        turned = np.random.default_rng(seed).normal(0, 1, (14, 3)) * [turn_rad, turn_rad, 0.3]
        with unchecked() if seed else nullcontext():
            K, seen = world(seed, moves, turned=Rotation.from_rotvec(turned), away_mm=800.0)
            result = hand_eye(kind, seen, hand_start(kind, seen, None)[0], (None, None))
        found.append(result.found)
        if not len(result.unknown):
            d = off(result.fit, K)
            normalized.append(d @ np.linalg.solve(result.covariance, d) / 6)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(found), axis=0)), [SIGMA_MM, SIGMA_RAD], rtol=0.15)
    assert len(normalized) >= 15
    assert np.mean(normalized) == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize("moves", CARRIED_BY)
def test_hands_that_turn_between_two_mountings_alone(moves: str):
    """Each session has a board of its own, whose place takes up whatever all of its photographs have in common."""
    kind = CARRIED_BY[moves]
    for seed in range(5):
        turned = Rotation.from_rotvec(np.where(np.arange(14)[:, None] % 2, [0.4, -0.3, -0.4], [0.0, 0.5, 0.3]))
        _, seen = world(seed, moves, sessions=2, turned=turned)
        result = hand_eye(kind, seen, hand_start(kind, seen, None)[0], (None, None))
        assert len(result.unknown) == 3
        np.testing.assert_allclose(result.found, [SIGMA_MM, SIGMA_RAD], rtol=0.6)


@pytest.mark.parametrize("which", range(3))
def test_a_session_all_of_whose_poses_are_wrong(which: int):
    K, seen = world(1, count=24, sessions=3)
    random, spoilt = np.random.default_rng(0), seen.session == which
    seen.given.translation[spoilt] += random.normal(0, 30, (8, 3))
    seen.given.rotation[spoilt] += random.normal(0, 0.2, (8, 3))
    result = hand_eye(CARRIED_BY["head"], seen, hand_start(CARRIED_BY["head"], seen, None)[0], (None, None))
    np.testing.assert_array_equal(result.kept, ~spoilt)
    np.testing.assert_allclose(result.found, [SIGMA_MM, SIGMA_RAD], rtol=0.3)
    d = off(result.fit, K)
    assert d @ np.linalg.solve(result.covariance, d) < 20


@pytest.mark.parametrize("moves", CARRIED_BY)
def test_lengths_that_photographs_and_poses_show(moves: str):
    kind, normalized = CARRIED_BY[moves], []
    for _, seen in each_world(12, moves):
        scale = hand_eye(kind, seen, hand_start(kind, seen, None)[0], (None, None)).scale
        normalized.append((scale.ln / scale.sigma) ** 2)
        boards = Pose(seen.boards.rotation, 1.02 * seen.boards.translation)
        larger = replace(seen, boards=boards)
        scale = hand_eye(kind, larger, hand_start(kind, larger, None)[0], (None, None)).scale
        assert scale.ln == pytest.approx(-np.log(1.02), abs=0.002)
        assert -scale.ln / scale.sigma > 4
    assert np.mean(normalized) == pytest.approx(1.0, abs=0.75)


def test_what_turns_little_is_taken_not_to_turn():
    small, one = np.random.default_rng(0).normal(0, 0.002, (20, 3)), np.zeros(20, int)

    def open_along(rotations: np.ndarray, session: np.ndarray = one) -> int:
        return len(not_turned(Pose(rotations, np.zeros((20, 3))), session, 5e-4))

    assert open_along(small) == 3
    assert open_along(small + np.outer(np.linspace(-1, 1, 20), [0, 0, 1])) == 1
    assert open_along(20 * small) == 0
    assert open_along(small + np.outer(np.arange(20) % 2, [0.5, 0.4, 0.3])) < 3
    assert open_along(small + np.outer(np.arange(20) % 2, [0.5, 0.4, 0.3]), np.arange(20) % 2) == 3
