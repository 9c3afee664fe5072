"""Poses by which the camera would have looked through what it saw are pointed out, and right ones are not."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from jaxscan import read_rig, read_scan, reconstruct
from jaxscan.geometry import Pose
from jaxscan.precision import as_numpy
from jaxscan.reconstruction import RangeImage
from jaxscan.reconstruction.sight_watch import SightWatch
from jaxscan.rig import Light, Motion, Rig, given_poses, positions_of
from jaxscan.simulation import rig_2003, robot, shapes
from jaxscan.simulation.profile import true_profile

FRAMES = 19
Positions = dict[str, np.ndarray]


@cache
def drawn(name: str, moves: str, seed: int = 0) -> tuple[np.ndarray, Positions, Motion]:
    """What a camera sees in a scan, in its own frame; the positions as they are given; and what moves."""
    plain = rig_2003.simulated_rig(seed)
    bodies = getattr(shapes, name)(rig_2003.OBJECT_Y)
    scene = rig_2003.scan_scene(plain, bodies if isinstance(bodies, tuple) else (bodies,))
    steps = np.linspace(0, 72_000, FRAMES).astype(int)
    rig, given = plain, {"stage": steps}
    true = given
    if moves != "stage":
        arm = robot.Robot(moves)
        rig = robot.with_robot(plain, arm, seed)
        middle = rig_2003.middle_of_object(plain)
        first, at = robot._passing(rig, arm, rig_2003.stage_travel(plain, steps), middle, seed)
        back = first.inverse()
        scene = replace(scene, bodies=tuple(body.moved(back.matrix(), back.translation) for body in scene.bodies))
        true = positions_of(at)
        given = positions_of(arm.given(at, np.random.default_rng(seed)))
    seen = []
    for i in range(FRAMES):
        q = {axis: n[i] for axis, n in true.items()}
        points = true_profile(rig, scene, q, lighting=rig_2003.SCAN_LIGHTING).points
        seen.append(as_numpy(rig.motion.pose({axis: float(n) for axis, n in q.items()})).apply(points))
    return np.stack(seen), given, rig.motion


def notes(seen: np.ndarray, q: Positions, motion: Motion, others: Sequence[Light] = ()) -> list[str]:
    """What is said of these profiles, carried by these positions, in batches."""
    pose = as_numpy(motion.pose({axis: n.astype(float) for axis, n in q.items()}))
    places = pose.translation[:, None]
    turns = np.broadcast_to(pose.matrix(), (len(seen), 3, 3))
    valid, none = np.isfinite(seen[..., 0]), np.zeros(seen.shape[:2], np.float32)
    points = np.einsum("fji,fcj->fci", turns, seen - places)
    image = RangeImage(points, none, none, none, none, valid, q, motion)
    watch = SightWatch(motion, others)
    for first in range(0, len(seen), 8):
        watch.see(image[first : first + 8, :])
    return watch.notes()


def backwards(q: Positions) -> Positions:
    return {axis: n[::-1] for axis, n in q.items()}


def given_of(q: Positions) -> Pose[np.ndarray]:
    return given_poses({axis: n.astype(float) for axis, n in q.items()})


@pytest.mark.parametrize("moves", ["head", "object", "stage"])
@pytest.mark.parametrize(("name", "seed"), [("panda", 0), ("cup", 1), ("stair", 2)])
def test_what_the_camera_saw_it_could_see(name: str, moves: str, seed: int):
    seen, q, motion = drawn(name, moves, seed)
    assert notes(seen, q, motion) == []
    (note,) = notes(seen, backwards(q), motion)
    assert "where the camera could not have seen them" in note
    assert "in the reverse order" in note
    assert ("surface is mirrored" in note) == (moves == "stage")


@pytest.mark.parametrize("moves", ["head", "object"])
def test_transposed_rotations_are_named_and_small_errors_are_not(moves: str):
    seen, q, motion = drawn("panda", moves)
    given = given_of(q)
    (note,) = notes(seen, positions_of(Pose(-given.rotation, given.translation)), motion)
    assert "with the rotations the other way round: transpose the matrices" in note
    # What shows nothing is not spoken of: a scale of 1.01 is no reason for either mistake.
    assert notes(seen, positions_of(Pose(given.rotation, 1.01 * given.translation)), motion) == []


def test_a_stage_that_moved_the_other_way():
    seen, q, motion = drawn("cup", "stage")
    (note,) = notes(seen, {axis: -n for axis, n in q.items()}, motion)
    assert "the stage moved the other way than its steps say" in note


def turned(rig: Rig, name: str, per_frame: int, off: int, laser: int) -> tuple[np.ndarray, Positions]:
    """Seen points, positions of a turn all around: the axis stands `off` steps of the stage beside a laser's sheet."""
    scene = rig_2003.scan_scene(rig, getattr(shapes, name)(rig_2003.OBJECT_Y))
    steps = rig_2003.turning_axes(per_frame, rig_2003.step_over_axis(rig, laser) + off)
    q = {axis: np.array(n) for axis, n in steps.items()}
    at = [{axis: float(n[i]) for axis, n in q.items()} for i in range(len(q["turntable"]))]
    points = [true_profile(rig, scene, each, lighting=rig_2003.SCAN_LIGHTING, laser=laser).points for each in at]
    return np.stack([as_numpy(rig.motion.pose(each)).apply(X) for each, X in zip(at, points, strict=True)]), q


@pytest.mark.parametrize(("name", "off"), [("figure", 0), ("cup", -1000), ("panda", 3000)])
def test_a_table_that_turned_the_other_way(name: str, off: int):
    """All around, with the axis in the sheet or beside it."""
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(1), 1)
    seen, q = turned(rig, name, 60, off, 0)
    assert notes(seen, q, rig.motion) == []
    (note,) = notes(seen, {**q, "turntable": q["turntable"][::-1]}, rig.motion)
    assert "the turntable moved the other way than its steps say" in note


@pytest.mark.parametrize("name", ["panda", "figure"])
@pytest.mark.parametrize("on", [0, 1])
def test_a_turn_by_the_light_of_the_other_laser(name: str, on: int):
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(1, lasers=2), 1)
    seen, q = turned(rig, name, 80, 0, on)
    right, wrong = rig.lights[on], rig.lights[1 - on]
    assert notes(seen, q, rig.motion, [wrong]) == []
    # The same rays, met with the plane of the laser that was not on.
    elsewhere = seen / (seen @ np.array([float(w) for w in wrong.plane]))[..., None]
    (note,) = notes(elsewhere, q, rig.motion, [right])
    assert f'by the light of laser "{right.name}"' in note
    assert notes(elsewhere, q, rig.motion) == []


def test_what_shows_nothing_is_not_spoken_of():
    seen, q, motion = drawn("cup", "stage")
    few = {axis: n[:6] for axis, n in backwards(q).items()}
    assert notes(seen[:6], few, motion) == []
    # A plate: nothing stands before anything.
    flat = np.where(np.isfinite(seen), seen[:1], np.nan)
    assert notes(flat, backwards(q), motion) == []
    assert SightWatch(motion).notes() == []


def test_a_long_scan_is_remembered_coarsely():
    seen, q, motion = drawn("panda", "stage")
    many = np.repeat(seen, 40, axis=0)
    steps = {"stage": np.repeat(q["stage"], 40)}
    assert notes(many, steps, motion) == []
    assert "in the reverse order" in notes(many, backwards(steps), motion)[0]


def test_a_real_stage_whose_direction_was_published_wrong(data: Path):
    rig = read_rig(data / "stage-pyramid" / "rig.json")
    image = reconstruct(rig, read_scan(data / "stage-pyramid"))
    seen, q = np.where(image.valid[..., None], image.seen(), np.nan), image.positions["stage"]
    (note,) = notes(seen, {"stage": q}, rig.rig.motion)
    assert "the stage moved the other way than its steps say" in note
    assert notes(seen, {"stage": -q}, rig.rig.motion) == []
