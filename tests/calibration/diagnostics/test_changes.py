"""Something that moved between two photographs is named with the right one, and what was before is left out."""

import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.changes import changed_session
from benchmarks.drawn import Noise, exact_session, redrawn
from jaxscan.calibration import Observations, calibrate
from jaxscan.calibration.changed import Change
from jaxscan.calibration.diagnostics import diagnose
from jaxscan.calibration.observations import join
from jaxscan.cli.estimate_options import Estimate
from jaxscan.errors import InputError
from jaxscan.simulation import rig_2003
from jaxscan.view.model_findings import model_findings
from tests.calibration.clean import clean, refocused


@pytest.mark.parametrize(
    ("name", "kind", "size"),
    [
        ("refocus", "focus", 3e-3),
        pytest.param("lens_pushed", "image", 0.5, marks=pytest.mark.long),
        pytest.param("laser_turned", "light", 0.35, marks=pytest.mark.long),
        ("camera_turned", "light", 0.21),
        ("board_pushed", "place", 0.1),
    ],
)
def test_a_change_is_named_with_its_photograph_and_its_size(name, kind, size):
    session, behind = changed_session(0, name)
    result = refocused() if name == "refocus" else calibrate(session)
    names = [view.name for view in session.photographs()]
    assert result.change is not None
    assert (result.change.kind, result.change.before, result.change.after) == (kind, names[behind - 1], names[behind])
    assert max(map(abs, result.change.by)) == pytest.approx(size, rel=0.1)
    assert result.change.shift_in_sigma > 3
    (warning,) = result.warnings
    assert warning.startswith(f"Between {names[behind - 1]} and {names[behind]} ")
    stops = [box for box in model_findings(result, diagnose(result, thorough=False)) if box.level == "stop"]
    assert any(box.statement.startswith(f"Between {names[behind - 1]} and {names[behind]} ") for box in stops)


def test_a_change_between_two_sessions_is_named_with_them():
    session, behind = changed_session(2, "refocus")
    first = replace(session, views=session.views[:behind], sequences=())
    second = replace(session, views=session.views[behind:])
    change = calibrate(join(["monday", "tuesday"], [first, second])).change
    assert change is not None
    assert (change.before, change.after) == (f"monday/view-{behind - 1}", f"tuesday/view-{behind}")


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_nothing_is_named_where_nothing_changed(seed):
    assert clean(seed).change is None


def test_one_photograph_that_is_odd_is_no_change():
    session = redrawn(exact_session(3)[1], Noise(), np.random.default_rng(3))
    view = session.views[0]
    odd = tuple(replace(s, pixels=s.pixels + np.array([0.0, 0.6])) for s in view.stripes)
    session = replace(session, views=(replace(view, stripes=odd), *session.views[1:]))
    assert calibrate(session).change is None


def test_without_the_photographs_before_the_rig_is_as_it_was_last():
    session, behind = changed_session(4, "refocus")
    name = session.views[behind].name
    later = Estimate(since=name).taken(session)
    assert [view.name for view in later.views] == [view.name for view in session.views[behind:]]
    assert later.left_out == tuple(f"{view.name}: before {name}" for view in session.views[:behind])
    result = calibrate(later)
    assert result.change is None
    true = 1.003 * float(rig_2003.simulated_rig(4).camera.focal[0])
    assert abs(float(result.rig.camera.focal[0]) - true) < 4 * result.covariance.sigma("camera.focal.0")


def test_a_photograph_along_the_axis_cuts_the_sequence():
    session = exact_session(0)[1]
    later = session.since("stage-4")
    assert (later.views, later.sequences[0].views[0].name) == ((), "stage-4")
    assert len(later.sequences[0].steps) == len(session.sequences[0].steps) - 4


def test_order_is_session_by_session():
    session = exact_session(0)[1]
    few = replace(session, views=session.views[:2], sequences=(session.sequences[0].only([0, 1]),))
    both = join(["a", "b"], [few, few])
    names = [both.photographs()[i].name for i in both.in_order()]
    assert names == [f"{s}/{n}" for s in "ab" for n in ("view-0", "view-1", "stage-0", "stage-1")]


def test_a_photograph_that_is_not_there_is_refused_with_those_that_are():
    session: Observations = exact_session(0)[1]
    with pytest.raises(InputError, match=r'--since: there is no photograph "view-99"; the nearest .*view-0, view-1'):
        Estimate(since="view-99").taken(session)


@pytest.mark.parametrize(
    ("kind", "laser", "says", "fix"),
    [
        ("focus", "", r"the focal length changed by \+0.3 %", "--split b"),
        ("image", "", r"by \+0.003 px to the right and -0.5 px down", "--since b"),
        ("light", "green", r'of laser "green" turned by 0.003° and moved by -0.5 mm', "--split b"),
        ("place", "", "the board turned by 0.003°", "--split b gives the board another place"),
    ],
)
def test_words(kind, laser, says, fix):
    what, advice = Change(kind, (0.003, -0.5), "a", "b", "camera.focal.0", 7.25, laser).statement
    assert what.startswith("Between a and b ")
    assert what.endswith("camera.focal.0 moves by 7.2 of its σ")
    assert re.search(says, what)
    assert fix in advice
