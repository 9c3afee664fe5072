"""A turntable calibrated with everything else: recovery within the covariance, what is said of it, what is refused."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from jaxscan.calibration import Calibration, Observations, calibrate
from jaxscan.calibration.diagnostics.halves import halves, solve_apart
from jaxscan.calibration.diagnostics.stage_errors import stage_errors, turntable_errors
from jaxscan.calibration.on_board import pose_of
from jaxscan.errors import InputError
from jaxscan.files.rig_file import read_rig, write_rig
from jaxscan.geometry import Pose
from jaxscan.precision import as_float64, float64
from jaxscan.rig.rig import parameter_names
from tests.calibration import synthetic

TRUTH = synthetic.TRUTH_WITH_TURNTABLE
STAGE_STEP = 3000


@pytest.fixture(scope="module")
def with_turntable(session: Observations) -> Observations:
    return replace(session, sequences=(*session.sequences, synthetic.turned(0, stage_step=STAGE_STEP)))


@pytest.fixture(scope="module")
def found(with_turntable: Observations) -> Calibration:
    return calibrate(with_turntable)


def respoilt(observations: Observations, **changes: Any) -> Observations:
    """The same with another sequence on the turntable."""
    on_stage, turned = observations.sequences
    if "turns" in changes:
        changes["positions"] = {**turned.positions, "turntable": changes.pop("turns")}
    return replace(observations, sequences=(on_stage, replace(turned, **changes)))


def values(calibration: Calibration) -> np.ndarray:
    leaves = map(float, jax.tree.leaves(calibration.rig))
    by_name = dict(zip(parameter_names(calibration.rig), leaves, strict=True))
    return np.array([by_name[name] for name in calibration.covariance.names])


def chi2(error: np.ndarray, matrix: np.ndarray, rank: int) -> float:
    """χ² of numbers whose covariance has this rank, which is less than their count."""
    scale = np.sqrt(np.diagonal(matrix))
    spread, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    np.testing.assert_allclose(spread[:-rank], 0, atol=1e-9)
    assert (spread[-rank:] > 1e-7).all()
    return float(((vectors.T @ (error / scale))[-rank:] ** 2 / spread[-rank:]).sum())


def test_the_truth_lies_within_the_predicted_covariance(found):
    assert set(found.covariance.names) == set(TRUTH)
    error = values(found) - [TRUTH[name] for name in found.covariance.names]
    # χ² with 11 + 5 degrees of freedom: 99.9 % below 39.3.
    assert chi2(error, found.covariance.matrix, 16) < 39.3
    at = [i for i, name in enumerate(found.covariance.names) if name.startswith("turntable")]
    # With 5: 99.9 % below 20.5.
    assert chi2(error[at], found.covariance.matrix[np.ix_(at, at)], 5) < 20.5
    assert found.settled
    assert not [line for line in found.left_out if "turntable" in line]


def test_the_centre_is_the_point_of_the_axis_nearest_to_the_origin(found):
    w, c = (np.stack(part) for part in (found.rig.axis("turntable").per_step, found.rig.axis("turntable").centre))
    assert abs(w @ c) < 1e-12 * np.linalg.norm(w) * np.linalg.norm(c)


def test_boards_stand_where_they_stood(with_turntable, found):
    turned = with_turntable.sequences[1]
    with float64():
        places = found.photograph_poses()
        first = len(with_turntable.views) + len(with_turntable.sequences[0].views)
        for i, view in enumerate(turned.views):
            board = pose_of(places, first + i)
            X = synthetic.BOARD.points() @ np.asarray(board.matrix()).T + np.asarray(board.translation)
            off = np.asarray(jax.vmap(as_float64(found.rig.camera).project)(X)) - view.corners
            assert np.sqrt((off**2).mean()) < 0.08


def test_the_pose_at_step_0_has_a_covariance_that_turns_with_it(with_turntable, found):
    """Counted from the middle of the sequence, the pose at step 0 is the one that the solve has."""
    turned = with_turntable.sequences[1]
    middle = float(turned.steps.mean())
    moved = calibrate(respoilt(with_turntable, turns=turned.steps - middle))
    np.testing.assert_allclose(values(moved), values(found), rtol=1e-7, atol=1e-13)
    there, here = found.moved_covariances[1], moved.moved_covariances[1]
    names = list(there.names)
    at = [names.index(f"motion.turntable.{part}.{i}") for part in ("per_step", "centre") for i in range(3)]
    pose = slice(len(names) - 6, len(names))
    with float64():
        numbers = [np.asarray(x) for x in (*found.rig.axis("turntable").per_step, *found.rig.axis("turntable").centre)]
        start = np.concatenate([found.system.moved.rotation[1], found.system.moved.translation[1]])

        def at_middle(each: np.ndarray) -> np.ndarray:
            table = type(found.rig.axis("turntable")).create(each[:3], each[3:6])
            return np.asarray(
                (
                    table.pose({"turntable": np.asarray(middle)}) @ Pose.from_vector(jax.numpy.asarray(each[6:]))
                ).as_vector()
            )

        each, J = np.concatenate([numbers, start]), np.eye(len(names))
        for column, k in enumerate([*at, *range(pose.start, pose.stop)]):
            step = 1e-6 * max(abs(each[column]), 1e-3) * np.eye(12)[column]
            J[pose, k] = (at_middle(each + step) - at_middle(each - step)) / (2 * step[column])
    scale = np.sqrt(np.diagonal(here.matrix))
    carried = J @ there.matrix @ J.T
    np.testing.assert_allclose(carried / np.outer(scale, scale), here.matrix / np.outer(scale, scale), atol=1e-4)


def test_a_board_that_was_only_photographed_on_axes_is_refused_and_told_why(with_turntable):
    text = "0 usable views of the board; .* The 13 photographs of it on the stage and the turntable do not count"
    with pytest.raises(InputError, match=text):
        calibrate(replace(with_turntable, views=()))
    with pytest.raises(InputError, match=r"The 8 photographs of it on the turntable do not count.* held in the hand"):
        calibrate(replace(with_turntable, views=(), sequences=with_turntable.sequences[1:]))


def test_one_photograph_of_another_place_is_left_out(with_turntable, found):
    views = list(with_turntable.sequences[1].views)
    views[3] = replace(views[3], corners=views[3].corners + np.array([7.0, -4.0]))
    spoilt = calibrate(respoilt(with_turntable, views=tuple(views)))
    assert any(line.startswith("turntable-3: 54 of 54 corners rejected") for line in spoilt.left_out)
    sigma = np.sqrt(np.diagonal(found.covariance.matrix))
    assert (np.abs(values(spoilt) - values(found)) < 2 * sigma).all()


def test_an_angle_that_is_off_is_measured(with_turntable, found):
    (straight,) = turntable_errors(found)
    assert straight.chi2_turn < 3
    assert straight.chi2_wobble < 3
    np.testing.assert_allclose(straight.turn_deg, 45.0 * np.arange(8), atol=0.02)
    assert len(stage_errors(found)) == 1
    # 1 step of 3200 is 0.1125°; the fit, through eight photographs, takes a little of it.
    turns = with_turntable.sequences[1].steps.copy()
    turns[4] -= 1.0
    (missed,) = turntable_errors(calibrate(respoilt(with_turntable, turns=turns)))
    assert np.argmax(np.abs(missed.turn_error_deg[:, 0])) == 4
    assert 0.08 < missed.turn_error_deg[4, 0] < 0.1125
    assert missed.chi2_turn > 4


def test_halves_agree_in_the_numbers_that_a_turntable_has(found):
    parts = halves(found.observations)
    assert parts is not None
    agreement = solve_apart(found, *parts)
    assert agreement is not None
    assert len(agreement.names) == 16
    assert not agreement.disagree
    assert abs(agreement.scale) < 4 * agreement.scale_sigma


def test_in_the_report_and_in_the_rig_file(tmp_path, found):
    pytest.importorskip("matplotlib", reason="the extra plots is not installed")
    from jaxscan.view import motion_sections

    errors = SimpleNamespace(turntables=turntable_errors(found))
    section = motion_sections.turntable(found, errors)  # pyright: ignore[reportArgumentType]
    assert "anticlockwise as the camera sees it" in section.paragraphs[0]
    assert section.tables[0].rows[0][0] == "turntable-0 … turntable-7"
    write_rig(tmp_path / "rig.json", found.rig_file())
    back = read_rig(tmp_path / "rig.json")
    assert back.fit["turntable_images"] == 8
    assert back.fit["stage_images"] == 5
    assert back.covariance.sigma("motion.turntable.per_step.1") == found.covariance.sigma("motion.turntable.per_step.1")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.only([0, 1]), "2 usable turntable photographs at different step counts; at least 3"),
        (
            lambda s: replace(s, positions={**s.positions, "turntable": s.steps[[0, 1, 0, 1, 0, 1, 0, 1]]}),
            "2 usable turntable photographs",
        ),
        (lambda s: replace(s, views=s.views[:1] * 8), "turntable-0 … turntable-0: the board .* turned by 0.0°"),
    ],
)
def test_what_is_no_turn_is_refused(with_turntable, change, words):
    on_stage, turned = with_turntable.sequences
    with pytest.raises(InputError, match=words):
        calibrate(replace(with_turntable, sequences=(on_stage, change(turned))))


def test_away_from_step_0_without_a_stage_is_refused(with_turntable):
    with pytest.raises(InputError, match="give stage_step = 0"):
        calibrate(replace(with_turntable, sequences=with_turntable.sequences[1:]))


def test_shapes_that_do_not_fit_are_refused(session):
    turned = synthetic.turned(0)
    few = {"stage": turned.positions["stage"], "turntable": turned.steps[:3]}
    with pytest.raises(InputError, match="3 step counts of the turntable for 8 photographs"):
        replace(session, sequences=(replace(turned, positions=few),))
