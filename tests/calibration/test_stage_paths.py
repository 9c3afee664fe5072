"""Stages that are no lines: found from photographs of the board, named where they were taken for lines, refused."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxscan.calibration import calibrate
from jaxscan.errors import InputError
from jaxscan.files.rig_file import read_rig, write_rig
from jaxscan.precision import as_numpy, float64
from jaxscan.rig.rig import parameter_names
from tests.calibration import stages, synthetic

GUIDE, SCREW = {"sag_mm": 0.1}, {"wave_mm": 0.05, "phase": 1.0}
CASES = {"guide": GUIDE, "screw": SCREW, "screw_on_guide": {**GUIDE, **SCREW}}


# A quick run looks at both together.
@pytest.fixture(
    scope="module",
    params=["screw_on_guide", *(pytest.param(kind, marks=pytest.mark.long) for kind in ("guide", "screw"))],
)
def solved(request):
    of = stages.stage(**CASES[request.param])
    session = stages.session(0, of)
    return request.param, of, calibrate(session), calibrate(session, motion={"stage": request.param})


def test_its_path_is_found_within_its_sigma(solved):
    kind, of, _, found = solved
    with float64():
        true = as_numpy(of.nearest_kind())
    part = found.rig.axis("stage")
    assert part.kind == kind
    assert not any(name.startswith("motion.stage.centre") for name in found.covariance.names)
    for name in part.shape():
        for i, (value, truth) in enumerate(zip(getattr(part, name), getattr(true, name), strict=True)):
            sigma = found.covariance.sigma(f"motion.stage.{name}.{i}")
            assert abs(float(value) - float(truth)) < 4.5 * sigma, (name, i)
    assert found.corner_sigma_px == pytest.approx(0.03, rel=0.05)
    assert not found.stage_shapes
    assert not found.warnings


def test_points_on_its_load_come_back_to_step_0(solved):
    _, of, line, found = solved
    n = np.arange(0.0, stages.TRAVEL, 500.0)
    X = np.array([[-40.0, 10.0, 320.0], [40.0, 0.0, 350.0]])
    # What the stage does between its places, not where step 0 is: by the mean of all.
    errors = []
    for each in (line, found):
        moved = each.rig.pose({"stage": n}).inverse().apply(X) - of.pose({"stage": n}).inverse().apply(X)
        errors.append(np.sqrt(((moved - moved.mean(axis=0)) ** 2).sum(axis=-1).mean()))
    assert errors[1] < 0.012
    assert errors[0] > 2.5 * errors[1]


def test_taken_for_a_line_it_is_named(solved):
    kind, _, line, _ = solved
    (shape,) = line.stage_shapes
    assert (shape.axis, shape.taken, shape.kind) == ("stage", "linear", kind)
    assert shape.p < 1e-6
    assert shape.travel_mm == pytest.approx(60, rel=0.01)
    ((what, fix),) = shape.statements
    assert fix == f"Calibrate with --motion {kind}."
    assert any(warning.startswith(what) for warning in line.warnings)
    if "guide" in kind:
        assert abs(shape.bow_mm - 0.1) < 3 * shape.bow_sigma_mm < 0.06
        assert shape.turn_mrad == pytest.approx(13.3, rel=0.15)
        assert "is bowed by" in what
    else:
        assert shape.bow_mm == 0
    if "screw" in kind:
        assert shape.wave_mm == pytest.approx(0.05, abs=0.006)
        assert shape.period_steps == pytest.approx(3200, rel=0.01)
        assert not shape.aliases
    else:
        assert shape.period_steps is None
    # Nor is anything else blamed for it.
    assert not line.sheet_curves
    assert line.change is None
    assert not line.flatness.statements


def test_half_of_the_shape_is_named_too():
    session = stages.session(1, stages.stage(**CASES["screw_on_guide"]))
    for taken, bowed in (("guide", False), ("screw", True)):
        (shape,) = calibrate(session, motion={"stage": taken}).stage_shapes
        assert (shape.taken, shape.kind) == (taken, "screw_on_guide")
        assert bool(shape.bow_mm) == bowed
        assert (shape.period_steps is None) == bowed


def test_it_is_written_and_read(solved, tmp_path):
    _, _, _, found = solved
    write_rig(tmp_path / "rig.json", found.rig_file())
    back = read_rig(tmp_path / "rig.json")
    assert jax.tree.leaves(back.rig) == jax.tree.leaves(found.rig)
    assert back.rig.axis("stage").kind == found.rig.axis("stage").kind
    assert back.covariance.names == found.covariance.names


def bent_board(mm):
    points = synthetic.BOARD.points()
    s, t = ((points[:, :2] - points[:, :2].mean(axis=0)) / (np.ptp(points[:, :2], axis=0) / 2)).T
    return points + mm * (1 - 0.7 * s**2 - 0.3 * t**2)[:, None] * np.array([0.0, 0.0, 1.0])


def wobble(mm):
    return mm * np.random.default_rng(5).normal(size=(31, 3))


@pytest.mark.parametrize(
    "how",
    [
        {},
        {"aside": wobble(0.01)},
        {"aside": wobble(0.05)},
        {"aside": np.where(np.arange(31) > 18, 0.1, 0.0)[:, None] * np.array([0.6, 0.0, 0.8])},
        {"points": bent_board(0.3)},
        {"points": bent_board(1.0)},
        {"steps": np.linspace(0, stages.TRAVEL, 31)},
        {"steps": np.array([0.0, 20000.0, 60000.0])},
    ],
    ids=[
        "line",
        "wobble",
        "large wobble",
        "pushed",
        "bent board",
        "very bent board",
        "even steps",
        "three photographs",
    ],
)
def test_a_line_is_not_named(how):
    assert not calibrate(stages.session(0, stages.stage(), **how)).stage_shapes


@pytest.mark.parametrize("kind", CASES)
def test_a_line_may_be_solved_as_anything(kind):
    found = calibrate(stages.session(2, stages.stage()), motion={"stage": kind})
    part = found.rig.axis("stage")
    if "bow" in part.numbers:
        sigma = [found.covariance.sigma(f"motion.stage.bow.{i}") for i in range(3)]
        assert np.all(np.abs(np.array(part.bow, float)) < 4.5 * np.array(sigma))
    if "wave" in part.numbers:
        assert np.hypot(*map(float, part.wave)) < 0.01
        # A wave that is not there has no period.
        assert "motion.stage.period.0" not in found.covariance.names


def test_even_steps_do_not_tell_a_period_from_its_aliases():
    steps = np.linspace(0, stages.TRAVEL, 31)
    session = stages.session(0, stages.stage(**SCREW), steps)
    (shape,) = calibrate(session).stage_shapes
    assert shape.period_steps == pytest.approx(1 / (1 / 2000 - 1 / 3200), rel=0.01)
    assert any(abs(period - 3200) < 30 for period in shape.aliases)
    assert list(shape.aliases) == sorted(shape.aliases, reverse=True)
    assert "uneven steps" in shape.statements[0][0]
    found = calibrate(session, motion={"stage": "screw"})
    (said,) = found.undetermined_periods
    assert "screw_steps" in said
    assert said in found.warnings
    known = calibrate(session, motion={"stage": "screw"}, periods={"stage": 3200.0})
    assert not known.undetermined_periods
    assert float(known.rig.axis("stage").period[0]) == 3200
    assert "motion.stage.period.0" not in known.covariance.names
    np.testing.assert_allclose(np.array(known.rig.axis("stage").wave), [0.0421, 0.0270], atol=0.005)


@pytest.mark.long
def test_a_turntable_on_a_guide():
    of = stages.stage(**GUIDE)
    session = stages.session(3, of, laser=False)
    turned = synthetic.turned(3, noise=0.03)
    session = replace(session, sequences=(*session.sequences, turned))
    found = calibrate(session, motion={"stage": "guide"})
    assert list(found.rig.axes()) == ["stage", "turntable"]
    plain = calibrate(replace(session, sequences=(turned,)))
    centre = [found.rig.axis("turntable").centre, plain.rig.axis("turntable").centre]
    np.testing.assert_allclose(np.array(centre[0], float), np.array(centre[1], float), atol=0.1)
    (shape,) = calibrate(session).stage_shapes
    assert (shape.axis, shape.kind) == ("stage", "guide")


REFUSED = {
    "unknown kind": (dict(motion={"stage": "srew"}), r'"srew": this version knows linear, guide, screw'),
    "no such axis": (dict(motion={"rail": "guide"}), r"no photographs of a board on the rail, there are some on stage"),
    "turns": (dict(motion={"stage": "rotary"}), r'the stage was photographed as "linear"'),
    "period of a line": (
        dict(periods={"stage": 3200.0}),
        r'3200 steps is given for the stage, .* "screw", "screw_on_gu',
    ),
    "negative": (
        dict(motion={"stage": "screw"}, periods={"stage": -1.0}),
        r"period of the stage is -1: give .* above 0",
    ),
    "no number": (dict(motion={"stage": "screw"}, periods={"stage": np.nan}), r"period of the stage is nan"),
    "long": (dict(motion={"stage": "screw"}, periods={"stage": 5e4}), r"1.2 turns of a screw .* over 1.5 turns"),
    "same phase": (dict(motion={"stage": "screw"}, periods={"stage": 2000.0}), r"at the same places.* at uneven steps"),
    "two phases": (dict(motion={"stage": "screw"}, periods={"stage": 4000.0}), r"at the same places.* or at two"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused(case):
    how, words = REFUSED[case]
    session = stages.session(0, stages.stage(), np.linspace(0, stages.TRAVEL, 31))
    with pytest.raises(InputError, match=words):
        calibrate(session, **how)


def test_too_few_photographs_are_refused():
    session = stages.session(0, stages.stage(), np.linspace(0, stages.TRAVEL, 7))
    with pytest.raises(InputError, match=r"7 usable stage photographs at different step counts; at least 8"):
        calibrate(session, motion={"stage": "screw"})
    assert calibrate(session, motion={"stage": "guide"}).rig.axis("stage").kind == "guide"


def test_the_plain_estimate_has_kinds_too():
    found = calibrate(stages.session(0, stages.stage(**GUIDE)), motion={"stage": "guide"}, plain=True)
    assert found.corner_sigma_px == pytest.approx(0.03, rel=0.05)
    again = calibrate(found.observations, keep=found.kept)
    assert again.rig.axis("stage").kind == "guide"
    assert set(parameter_names(again.rig)) == set(parameter_names(found.rig))
