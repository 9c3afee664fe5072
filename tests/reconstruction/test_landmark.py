"""A board that rides on the stage shows lost steps, by its corners as the true rig projects them."""

import jax
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.place_checks import PlaceCheck
from jaxscan.precision import as_float64, float64
from jaxscan.reconstruction.landmark import Landmark, landmark
from jaxscan.simulation import rig_2003

STEPS = tuple(range(0, 20001, 2500))
POINTS = rig_2003.BOARD.points()


def corners(lost: dict[int, int] | None = None, seed: int = 0, noise_px: float = 0.05, ride: float = 1.0) -> list:
    """Corners of the board on the stage; from a photograph on, the stage stands so many steps off."""
    rig, random = rig_2003.simulated_rig(0), np.random.default_rng(seed)
    off, seen = 0, []
    with float64():
        rig = as_float64(rig)
        pose = rig_2003.stage_pose(rig, 0)
        for i, step in enumerate(STEPS):
            off += (lost or {}).get(i, 0)
            points = rig.pose({"stage": ride * float(step + off)}).apply(pose.apply(POINTS))
            seen.append(np.asarray(rig.camera.project(points)) + random.normal(0, noise_px, (len(POINTS), 2)))
    return seen


def look(uv: list) -> Landmark:
    return landmark(rig_2003.simulated_rig(0), ("stage",), {"stage": STEPS}, POINTS, uv)


@pytest.mark.parametrize("x64", [True, False])
def test_lost_steps_are_found_and_measured(x64: bool):
    with jax.enable_x64(x64):
        found = look(corners({4: -300, 7: -80}))
    assert found.missed == (False,) * 4 + (True,) * 5
    np.testing.assert_array_less(
        np.abs(found.off["stage"] - np.array([0] * 4 + [-300] * 3 + [-380] * 2)), 4 * found.sigma["stage"] + 1e-9
    )
    (good, bad) = found.checks(len(STEPS))
    assert (good.first, good.last, good.off) == (0, 3, {})
    assert (bad.first, bad.last, bad.by_board) == (4, 8, True)
    assert bad.off["stage"] == pytest.approx(-380, abs=4 * found.sigma["stage"].max())


def test_no_false_alarm_and_sigma_as_predicted():
    pulls = []
    for seed in range(20):
        found = look(corners(seed=seed))
        assert not any(found.missed)
        assert found.checks(len(STEPS)) == (PlaceCheck(0, 8, by_board=True),)
        assert found.rms_px == pytest.approx(0.05, rel=0.1)
        pulls.append(found.off["stage"][1:] / found.sigma["stage"][1:])
    # Offsets of one scan share the board's pose and the reference, so the scatter is that of 20 scans.
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.5


def test_frames_between_boards_are_answered_for_by_the_next():
    uv = corners({3: 500})
    seen = [uv[i] if i in (1, 4, 6) else None for i in range(len(uv))]
    first, good, bad, last = look(seen).checks(len(uv))
    assert (first.first, first.last, first.unverified) == (0, 0, True)
    assert (good.first, good.last, good.off) == (1, 1, {})
    assert (bad.first, bad.last) == (2, 6)
    assert (last.first, last.last, last.unverified) == (7, 8, True)


def test_what_shows_nothing_is_said():
    few = [np.where(np.arange(len(POINTS))[:, None] < 7, uv, np.nan) for uv in corners()]
    with pytest.raises(InputError, match=r"in 0 of 9 photographs with 8 corners or more \(most: 7 of 54\)"):
        look(few)
    with pytest.raises(InputError, match="in 1 of 9 photographs"):
        look([corners()[0], *[None] * 8])
    with pytest.raises(InputError, match="stands still"):
        look(corners(ride=0.0))
    with pytest.raises(InputError, match="px from where the rig has it"):
        look([uv * [1.0, 1.05] for uv in corners()])
    with pytest.raises(InputError, match="nothing moves"):
        landmark(rig_2003.simulated_rig(0), ("stage",), {"stage": [5] * 9}, POINTS, corners(ride=0.0))


def test_a_turntable_that_slipped():
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(0), 0)
    turns, random, seen = tuple(range(0, 401, 50)), np.random.default_rng(1), []
    with float64():
        exact, pose = as_float64(rig), rig_2003.turntable_pose(rig, 0)
        for i, step in enumerate(turns):
            points = exact.pose({"turntable": float(step + 30 * (i >= 5))}).apply(pose.apply(POINTS))
            seen.append(np.asarray(exact.camera.project(points)) + random.normal(0, 0.05, (len(POINTS), 2)))
    found = landmark(rig, ("turntable",), {"turntable": turns}, POINTS, seen)
    assert found.missed == (False,) * 5 + (True,) * 4
    np.testing.assert_array_less(np.abs(found.off["turntable"][5:] - 30), 4 * found.sigma["turntable"][5:])
