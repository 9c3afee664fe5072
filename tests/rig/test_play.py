"""Play: the run of an axis, where its load stands, and derivatives there; the kinds that have it."""

import jax
import numpy as np
import pytest

from jaxscan.axis_details import is_detail
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import MOTIONS, Guide, Linear, Rotary, Screw, ScrewOnGuide, run_of, runs
from jaxscan.rig.play import FAR, LinearWithPlay, RotaryWithPlay, Runs, kind_with_play

STEP = np.array([0.0, 0.0008, 0.0006])
PLAINS = {
    "linear": lambda: Linear.create(STEP),
    "guide": lambda: Guide.create(STEP, [1e-9, 0.0, 0.0], [1e-7, 0.0, 0.0], [0.0, 0.0, 300.0]),
    "screw": lambda: Screw.create(STEP, [0.02, 0.01], 3200.0),
    "screw_on_guide": lambda: ScrewOnGuide.of(PLAINS["guide"](), PLAINS["screw"]()),
    "rotary": lambda: Rotary.create([0.0, 0.002, 0.0], [10.0, 0.0, 300.0]),
}


def crossing(steps, play, start):
    """The load of a motor with slack, pushed at its ends: an independent statement of where it stands."""
    at, found = start, []
    for n in steps:
        at = min(max(at, n - play / 2), n + play / 2)
        found.append(at)
    return np.array(found)


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([0, 10, 20, 15, 15, 18], [FAR, FAR + 10, FAR + 20, -5, -5, 3]),
        ([5, 5, 3], [-FAR, -FAR, -FAR - 2]),
        ([4, 4], [0, 0]),
        ([], []),
    ],
)
def test_how_far_it_has_come_since_it_turned(steps, expected):
    assert runs(np.array(steps, float)).tolist() == expected


def test_photographs_as_they_come_have_the_same_runs():
    steps = np.array([0, 0, 10, 20, 15, 15, 18])
    for size in (2, 3, 5):
        tracker = Runs()
        found = np.concatenate([tracker.of(steps[i : i + size]) for i in range(0, len(steps), size)])
        # What stands still at first says nothing until it has moved.
        moved = 2 if size == 2 else 0
        assert found[moved:].tolist() == runs(steps)[moved:].tolist()
        assert not found[:moved].any()


@pytest.mark.parametrize("play", [0.0, 7.0, 30.0])
def test_the_load_is_where_the_slack_leaves_it(play):
    steps = np.concatenate([np.arange(0, 200, 11), np.arange(190, 20, -9), np.arange(25, 100, 40)]).astype(float)
    with float64():
        part = as_numpy(LinearWithPlay.from_plain(Linear.create(STEP), play))
    at = as_numpy(part.pose({"stage": steps, run_of("stage"): runs(steps)})).translation
    expected = crossing(steps, play, -play / 2)[:, None] * STEP
    np.testing.assert_allclose(at, expected, atol=1e-12)


@pytest.mark.parametrize("kind", PLAINS)
def test_a_kind_with_play_is_the_one_without_where_its_load_stands(kind):
    with float64():
        plain = PLAINS[kind]()
        part = MOTIONS[kind_with_play(kind)].from_plain(plain, 50.0)  # type: ignore[attr-defined]
        n = np.array([1000.0, 1000.0, 1000.0])
        found = as_numpy(part.pose({part.axis: n, run_of(part.axis): np.array([500, -500, 0])}))
        expected = as_numpy(plain.pose({part.axis: np.array([975.0, 1025.0, 1000.0])}))
    np.testing.assert_allclose(found.as_vector(), expected.as_vector(), rtol=0, atol=1e-12)
    with float64():
        assert sum(part.numbers.values()) == len(jax.tree.leaves(part)) == part.idle().shape[1]
    assert list(part.numbers)[-1] == "play"
    assert isinstance(part, type(plain))


@pytest.mark.parametrize("play", [0.0, 40.0, -40.0])
@pytest.mark.parametrize("run", [10.0, -10.0, 500.0, -500.0])
def test_its_derivative_is_that_of_finite_differences(play, run):
    if not play and abs(run) < 40:
        run *= 10

    def place(p):
        part = LinearWithPlay.from_plain(Linear.create(STEP), p)
        return part.pose({"stage": 100.0, run_of("stage"): run}).translation

    with float64():
        exact = jax.jacfwd(place)(play)
        near = (np.asarray(place(play + 1e-3)) - np.asarray(place(play - 1e-3))) / 2e-3
    np.testing.assert_allclose(exact, near, atol=1e-10)
    assert np.abs(near).max() > 0


def test_no_axis_may_be_called_as_a_run_is():
    assert is_detail(run_of("stage"))
    assert not is_detail("stage")
    assert RotaryWithPlay.from_plain(PLAINS["rotary"](), 3.0).amount(1.0)[1] == "degrees"
