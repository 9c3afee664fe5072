"""A session in which something was changed, solved in two parts: what differs, what is shared, and each rig's σ."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest

from benchmarks.changes import changed_rig, changed_session
from benchmarks.drawn import Noise, exact_session, exact_turn, exact_views, redrawn
from jaxscan.calibration import BoardSequence, Calibration, Observations, Split, calibrate, calibrate_split
from jaxscan.calibration.bundle import solve
from jaxscan.calibration.observations import join
from jaxscan.calibration.parted import Amount
from jaxscan.calibration.split_parts import choose_parts, price
from jaxscan.calibration.uncertainty import precision
from jaxscan.cli import calibrate as command
from jaxscan.cli.estimate_options import Estimate
from jaxscan.cli.main import main
from jaxscan.errors import InputError
from jaxscan.files.rig_file import read_rig
from jaxscan.geometry import Pose
from jaxscan.precision import as_jax, as_numpy, float64
from jaxscan.rig import Rig
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003
from jaxscan.view.calibration_report import calibration_report
from jaxscan.view.report import as_html
from jaxscan.view.verdict import verdict


@cache
def changed(name: str) -> tuple[Observations, str]:
    """A session, and its first photograph after the change."""
    session, behind = changed_session(1, name)
    return session, session.photographs()[behind].name


@cache
def solved(name: str) -> Split:
    return calibrate_split(*changed(name))


@pytest.fixture(scope="module")
def refocused() -> tuple[Observations, str]:
    return changed("refocus")


@pytest.fixture(scope="module")
def split() -> Split:
    return solved("refocus")


def in_sigma(found: Calibration, rig: Rig) -> np.ndarray:
    """Errors of the numbers that were sought, in σ."""
    off = np.array(jax.tree.leaves(found.rig), float) - np.array(jax.tree.leaves(rig.normal()), float)
    sigma = np.sqrt(np.diagonal(found.covariance.of_leaves(found.rig)))
    return np.abs(off[sigma > 0] / sigma[sigma > 0])


def kinds(found: Split) -> list[str]:
    return [each.part for each in found.parted.differ]


@pytest.mark.parametrize(
    ("name", "part", "value"),
    [
        ("refocus", "focus", 0.3),
        pytest.param("lens_pushed", "image", 0.5, marks=pytest.mark.long),
        pytest.param("laser_turned", "light", 0.05, marks=pytest.mark.long),
    ],
)
def test_the_part_that_was_changed_is_found_and_both_rigs_are_within_their_sigma(name, part, value):
    found = solved(name)
    assert kinds(found) == [part]
    (difference,) = found.parted.differ
    nearest = min(difference.amounts, key=lambda amount: abs(abs(amount.value) - value))
    assert abs(abs(nearest.value) - value) < 3 * nearest.sigma
    assert difference.chi2 > price(difference.numbers)
    rig = rig_2003.simulated_rig(1)
    for result, true in ((found.before, rig), (found.after, changed_rig(rig, name))):
        assert (in_sigma(result, true) < 3).all()
        assert result.change is None


def test_what_is_shared_is_known_better_than_from_one_part(split, refocused):
    alone = calibrate(refocused[0].since(refocused[1]))
    for name in ("camera.principal.0", "camera.principal.1", "camera.radial.0", "lights.0.plane.1", "lights.0.plane.2"):
        one, both = alone.covariance.sigma(name), split.after.covariance.sigma(name)
        assert one is not None
        assert both is not None
        assert both < 0.95 * one
        assert split.before.covariance.sigma(name) == pytest.approx(both, rel=1e-6)
    shared = [i for i, name in enumerate(parameter_names(split.after.rig)) if "focal" not in name]
    a, b = (np.array(jax.tree.leaves(each.rig), float)[shared] for each in (split.before, split.after))
    np.testing.assert_allclose(a, b, rtol=1e-12)


@pytest.mark.parametrize("later", [False, True])
def test_a_part_has_of_the_other_what_that_one_says_by_itself(split, later):
    mine, other = (split.after, split.before) if later else (split.before, split.after)
    (known,) = mine.adjustment.factors
    with float64():
        theirs = as_jax(other.adjustment)
        system = replace(theirs.start, poses=theirs.start.poses[: len(theirs.groups)])
        motion = [name.startswith("motion") for name in system.shared_names()]
        # Without photographs on the stage its motion is not known.
        free = np.asarray(theirs.free) & ~(np.array(motion) & (not other.adjustment.counts[1]))
        alone = precision(system, as_jax(free), theirs.groups, theirs.noise)
        covariance = np.asarray(alone.covariance)
    focal = np.array(["focal" in name for name in parameter_names(mine.rig)])
    at = np.flatnonzero(free & ~focal)
    # What differs is the other part's own: of its numbers those that are shared, with all others free.
    root = np.asarray(known.root)
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(np.linalg.inv((root.T @ root)[np.ix_(at, at)]))),
        np.sqrt(np.diagonal(covariance)[at]),
        rtol=1e-4,
    )
    assert not root[:, focal].any()


@pytest.mark.parametrize("later", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_part_is_the_minimum_of_its_own_problem_and_has_its_covariance(split, later):
    result = split.after if later else split.before
    with float64():
        adjustment = as_jax(result.adjustment)
        groups = (*adjustment.groups, *adjustment.factors)
        again = solve(adjustment.start, adjustment.free, groups, adjustment.noise)
        moved = np.array(again.system.values()) - np.array(adjustment.start.values())
        known = precision(adjustment.start, adjustment.free, groups, adjustment.noise)
    sigma = np.sqrt(np.diagonal(np.asarray(known.covariance)))
    assert (np.abs(moved / sigma) < 1e-3).all()
    # σ of a part is that of its problem; nothing was widened here.
    np.testing.assert_allclose(sigma, np.sqrt(np.diagonal(result.covariance.of_leaves(result.rig))), rtol=0.02)


def test_the_rig_is_that_of_both_parts_solved_by_hand(split, refocused):
    # Two solves apart, put together by the formula for least squares with d = 0 in what is shared.
    session, name = refocused
    before, after = session.parted(session.before(name))
    a, b = calibrate(replace(before, sequences=())), calibrate(after)
    names = [n for n in a.covariance.names if not n.startswith("motion")]
    x, y = (dict(zip(parameter_names(each.rig), map(float, jax.tree.leaves(each.rig)), strict=True)) for each in (a, b))
    at = [i for i, n in enumerate(names) if "focal" not in n]
    A = np.eye(len(names))[at]
    d = A @ np.array([y[n] - x[n] for n in names])
    S, T = (each.covariance.matrix[np.ix_(*[[each.covariance.names.index(n) for n in names]] * 2)] for each in (a, b))
    gain = T @ A.T @ np.linalg.inv(A @ (S + T) @ A.T)
    expected, covariance = np.array([y[n] for n in names]) - gain @ d, T - gain @ A @ T
    found = dict(zip(parameter_names(split.after.rig), map(float, jax.tree.leaves(split.after.rig)), strict=True))
    sigma = np.array([split.after.covariance.sigma(n) for n in names], float)
    # σ and outliers are found for both together, or for each: by a few per cent other weights.
    assert (np.abs(np.array([found[n] for n in names]) - expected) < 0.3 * sigma).all()
    np.testing.assert_allclose(sigma, np.sqrt(np.diagonal(covariance)), rtol=0.1)


def test_where_nothing_changed_the_session_is_solved_whole():
    session, behind = changed_session(2, "refocus", 0.0)
    found = calibrate_split(session, session.photographs()[behind].name)
    whole = calibrate(session)
    assert found.parted.differ == ()
    assert found.after is found.before
    assert jax.tree.leaves(found.after.rig) == jax.tree.leaves(whole.rig)
    assert "nothing differs" in found.parted.sentence


def test_a_board_that_was_pushed_on_its_axis_has_two_places_and_one_rig():
    session, behind = changed_session(0, "board_pushed")
    name = session.photographs()[behind].name
    found = calibrate_split(session, name)
    (place,) = found.parted.differ
    assert (place.part, place.name) == ("place", "stage")
    assert place.amounts[1].value == pytest.approx(0.1, abs=3 * place.amounts[1].sigma)
    assert not found.parted.rig_differs
    assert found.before is found.after
    assert len(found.after.observations.sequences) == 2
    assert len(found.after.fits) == len(session.views)
    assert (in_sigma(found.after, rig_2003.simulated_rig(0)) < 3).all()


@pytest.mark.long
def test_a_laser_that_was_pushed_along_the_stage_cuts_its_photographs():
    rig, exact = exact_session(2)
    later = changed_rig(rig, "laser_turned")
    stage, steps = rig_2003.stage_pose(rig, 2), exact.sequences[0].steps[:14]
    moved = rig_2003.stage_travel(rig, steps)
    poses = Pose(np.repeat(stage.rotation[None], 14, axis=0), stage.translation + moved)
    views = [exact_views(each, poses, "stage", 4) for each in (rig, later)]
    along = BoardSequence({"stage": steps}, views[0][:7] + views[1][7:])
    session = redrawn(replace(exact, sequences=(along,)), Noise(), np.random.default_rng(2))
    found = calibrate_split(session, "stage-7")
    assert kinds(found) == ["light"]
    assert "the board on the stage" in found.parted.shared
    for result, true in ((found.before, rig), (found.after, later)):
        assert (in_sigma(result, true) < 3.5).all()
    assert not found.after.fits
    (lent,) = found.parted.lent
    assert lent.startswith("the focal length, the principal point and the lens's distortion (0 views from stage-7 on")
    judged = verdict(found.after)
    assert "This is the rig from stage-7 on." in judged.statement
    assert any(box.statement.lower().startswith("the focal length, the principal") for box in judged.warnings)
    assert judged.level == "care"
    report, _ = calibration_report(found.after)
    text = as_html(report)
    assert "In two parts: between stage-6 and stage-7 the sheet of light turned by" in text


@pytest.mark.long
def test_a_turntable_in_two_sessions_is_shared_by_them():
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(0), 0)
    later = changed_rig(rig, "refocus")
    parts = []
    for each, seed in ((rig, 1), (later, 2)):
        views = exact_views(each, rig_2003.board_poses(rig, 0))
        stage = replace(exact_session(0)[1], views=views, sequences=())
        stage_turn = exact_turn(each, 0, 4)
        on_stage = exact_session(0)[1].sequences[0]
        poses = Pose(
            np.repeat(rig_2003.stage_pose(rig, 0).rotation[None], 8, axis=0),
            rig_2003.stage_pose(rig, 0).translation + rig_2003.stage_travel(rig, on_stage.steps[:8]),
        )
        along = BoardSequence({"stage": on_stage.steps[:8]}, exact_views(each, poses, "stage", None))
        parts.append(redrawn(replace(stage, sequences=(along, stage_turn)), Noise(), np.random.default_rng(seed)))
    found = calibrate_split(join(["monday", "tuesday"], parts), "tuesday/view-0")
    assert kinds(found) == ["focus"]
    assert {"the motion of the turntable", "the motion of the stage"} <= set(found.parted.shared)
    for result, true in ((found.before, rig), (found.after, later)):
        assert (in_sigma(result, true) < 3.5).all()


@pytest.mark.long
def test_of_two_lasers_one_may_differ():
    rig, exact = exact_session(0, 2)
    upper, lower = rig.lights
    pushed = jax.tree.map(lambda x: np.asarray(x * 1.001), lower)
    later = as_numpy(replace(rig, lights=(upper, pushed)))
    poses = rig_2003.board_poses(rig, 0)
    views = [exact_views(each, poses) for each in (rig, later)]
    session = redrawn(replace(exact, views=views[0][:5] + views[1][5:]), Noise(), np.random.default_rng(3))
    found = calibrate_split(session, "view-5")
    assert [(each.part, each.name) for each in found.parted.differ] == [("light", "lower")]
    for result, true in ((found.before, rig), (found.after, later)):
        assert (in_sigma(result, true) < 3.5).all()


def test_a_camera_without_laser_and_stage(refocused):
    session, name = refocused
    views = tuple(replace(view, stripes=()) for view in session.views)
    found = calibrate_split(replace(session, views=views, sequences=(), lasers=()), name)
    assert kinds(found) == ["focus"]
    assert float(found.after.rig.camera.focal[0]) > float(found.before.rig.camera.focal[0])


@pytest.mark.long
def test_other_settings_of_jax_give_the_same(split, refocused):
    with jax.enable_x64(True):
        again = calibrate_split(*refocused)
    assert jax.tree.leaves(again.after.rig) == jax.tree.leaves(split.after.rig)


@pytest.mark.parametrize(
    ("name", "asked", "words"),
    [
        ("view-99", {}, 'there is no photograph "view-99"; the nearest names are view-9.*view-0, view-1'),
        ("view-0", {}, "0 photographs before view-0, and at least 2 are needed"),
        ("view-1", {}, "1 photograph before view-1.*name a later one"),
        ("stage-30", {}, "1 photograph from stage-30 on.*name an earlier one"),
        ("view-5", {"keep": [1]}, "keep does not go with a split"),
        ("view-5", {"lens": "splined"}, "splined"),
    ],
)
def test_refusals(refocused, name, asked, words):
    with pytest.raises(InputError, match=words):
        calibrate_split(refocused[0], name, **asked)


def test_a_side_that_shows_nothing_to_compare_is_refused_with_what_it_lacks(refocused):
    words = (
        r"11 usable photographs before stage-0 and 31 from it on.*the focal length, the principal point and the lens's "
        r"distortion \(0 views from stage-0 on, 3 are needed\); the sheet of light \(0 stripes from stage-0 on, 2 are "
        r"needed\); the motion of the stage \(0 positions before stage-0, 2 are needed\)"
    )
    with pytest.raises(InputError, match=words):
        calibrate_split(refocused[0], "stage-0")


@pytest.mark.parametrize(
    ("d", "differ"),
    [
        ([0.0, 0.0, 0.0], ()),
        ([3.5, 0.0, 0.0], ()),
        ([6.0, 0.0, 0.0], (0,)),
        ([0.0, 5.0, 5.0], (1,)),
        ([9.0, 9.0, 0.0], (0, 1)),
    ],
)
def test_parts_are_chosen_by_what_they_explain(d, differ):
    chosen = choose_parts([[0], [1, 2]], np.array(d), np.eye(3))
    assert chosen.differ == differ
    assert (chosen.gain > 0) == bool(differ)


def test_of_two_parts_that_look_alike_one_is_chosen():
    # One cause that either explains: each alone is known to a fifth of its σ.
    C = np.array([[1.0, 0.98], [0.98, 1.0]])
    assert len(choose_parts([[0], [1]], np.array([0.8, -0.8]), C).differ) == 1


def test_amounts_are_said_to_two_digits_of_sigma():
    assert str(Amount(0.30139, 0.0026, "%", "longer by {}")) == "longer by 0.3014 ± 0.0026 %"
    assert str(Amount(0.0479, 0.0081, "°", "turned by {}")) == "turned by 0.0479 ± 0.0081°"
    assert str(Amount(-123.4, 56.0, "", "{}")) == "-123 ± 56"


def seen_in_place_of_photographs(monkeypatch, session):
    monkeypatch.setattr("jaxscan.calibration.observe.observe", lambda content, *_: session)
    names = [view.name for view in session.photographs()]
    monkeypatch.setattr("jaxscan.calibration.observe.photograph_names", lambda content: names)


def test_a_name_that_no_photograph_has_is_refused_before_they_are_looked_at(world, tmp_path, monkeypatch, capsys):
    def never(*_):
        raise AssertionError

    monkeypatch.setattr("jaxscan.calibration.observe.observe", never)
    for option in ("--split", "--since"):
        assert (
            main(["calibrate", str(world / "session"), "-o", str(tmp_path / "rig.json"), option, "boards/77.png"]) == 2
        )
        assert f'{option}: there is no photograph "boards/77.png"; the nearest' in capsys.readouterr().err


def test_the_command_writes_both_rigs(world, tmp_path, monkeypatch, capsys, refocused):
    session, name = refocused
    seen_in_place_of_photographs(monkeypatch, session)
    out = tmp_path / "rig.json"
    words = ["calibrate", str(world / "session"), "-o", str(out), "--split", name]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert f"before the change: {tmp_path / 'rig.before.json'}" in said
    assert "the focal length became longer by 0.30" in said
    now, before = read_rig(out), read_rig(tmp_path / "rig.before.json")
    assert float(now.rig.camera.focal[0]) / float(before.rig.camera.focal[0]) == pytest.approx(1.003, abs=2e-4)
    assert now.fit["parted"] == before.fit["parted"]
    assert any("the motion of the stage" in warning for warning in before.warnings)


def test_the_command_refuses_what_it_cannot_do(world, tmp_path, monkeypatch, capsys, refocused):
    session, name = refocused
    seen_in_place_of_photographs(monkeypatch, session)
    words = ["calibrate", str(world / "session"), "-o", str(tmp_path / "rig.json")]
    assert main([*words, "--split", name, "--since", name]) == 2
    assert "keep one of them" in capsys.readouterr().err
    assert main([*words, "--split", "view-77"]) == 2
    assert '--split: there is no photograph "view-77"; the nearest' in capsys.readouterr().err
    (tmp_path / "rig.before.json").mkdir()
    assert main([*words, "--split", name]) == 2
    assert "rig.before.json" in capsys.readouterr().err
    assert not (tmp_path / "rig.json").exists()


def test_a_split_takes_the_model_of_the_session():
    assert Estimate().chooses
    assert not Estimate(split="view-5").chooses
    assert command.before_path(command.Path("a/rig.json")) == command.Path("a/rig.before.json")
