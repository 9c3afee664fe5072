"""The model that the photographs ask for."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.models import session as drawn_session
from jaxscan.calibration import Model, calibrate, calibrate_by_evidence
from jaxscan.calibration.model import Choice, Trial

PLAIN = Model(lights=("plane",))
session = cache(drawn_session)
# As many corners of the board as a pose needs; the last one is near the middle.
_CORNERS = [0, 8, 31, 45, 53, 22]


def chosen(observations, **asked):
    return calibrate_by_evidence(observations, Model(), **asked)


def test_where_nothing_is_amiss_nothing_is_added_and_nothing_else_is_solved():
    observations = session("nothing", 0)
    result = chosen(observations)
    assert result.choice == Choice(PLAIN, ())
    assert result.choice.sentence.startswith("lens radial1, board flat, sheet plane, as asked")
    plain = calibrate(observations)
    np.testing.assert_array_equal(result.covariance.matrix, plain.covariance.matrix)
    assert result.rig_file().fit["model"] == result.choice.sentence
    assert "model" not in plain.rig_file().fit


@pytest.mark.parametrize(
    ("kind", "model"),
    [
        ("radial2", {"lens": "radial2"}),
        ("bowed", {"lights": ("bowed",)}),
        # That a motion is chosen is in test_played_stages.py.
        pytest.param("bent", {"board_shape": "warp"}, marks=pytest.mark.long),
        pytest.param("guide", {"motion": {"stage": "guide"}}, marks=pytest.mark.long),
        # The benchmark `models` has ten kinds.
        pytest.param("brown_on_guide", {"lens": "brown", "motion": {"stage": "guide"}}, marks=pytest.mark.long),
    ],
)
def test_the_kind_that_was_drawn_is_chosen(kind, model):
    result = chosen(session(kind, 3))
    assert result.choice.model == replace(PLAIN, **model)
    assert len(result.choice.added) == len(model)
    for trial in result.choice.added:
        assert trial.gain > 2 * trial.error
        assert trial.of in result.choice.sentence
    json.dumps(result.choice.as_data())


def test_what_is_fixed_stays_and_is_named():
    result = chosen(session("bowed", 3), fixed={"lights"})
    assert result.choice.model == PLAIN
    assert result.sheet_curves


def test_where_it_begins_nothing_is_taken_away():
    result = calibrate_by_evidence(session("nothing", 1), Model(lens="radial2"))
    assert result.choice.model == replace(PLAIN, lens="radial2")


def test_a_model_that_cannot_be_solved_is_passed_over_with_the_reason():
    observations = session("bent", 3)
    few = replace(observations, views=observations.views[:4])
    result = chosen(few)
    assert result.flatness.bent
    assert result.choice.model == PLAIN
    (trial,) = result.choice.trials
    assert "usable views of the board" in trial.refused
    assert trial.of == "board warp"
    assert result.choice.as_data()["trials"][0]["gain"] is None


def test_a_photograph_of_which_the_richer_model_keeps_too_few_corners_is_not_compared():
    observations = session("bowed", 3)
    view = observations.views[0]
    # One of them is 4 px off: without it the view is left out.
    few = np.full_like(view.corners, np.nan)
    few[_CORNERS] = view.corners[_CORNERS]
    few[_CORNERS[-1]] += 4.0
    result = chosen(replace(observations, views=(replace(view, corners=few), *observations.views[1:])))
    assert result.kept[0].corners.sum() < len(_CORNERS)
    assert result.choice.model == replace(PLAIN, lights=("bowed",))


def test_words():
    model = Model("brown", True, "bend", ("bowed", "bowed"), {"stage": "screw"})
    assert model.in_words() == "lens brown on a tilted sensor, board bend, sheet bowed, stage screw"
    assert model.beyond(PLAIN) == "lens brown, tilted sensor, board bend, sheet bowed, stage screw"
    trial = Trial(replace(PLAIN, lens="brown"), "lens brown", "it is", 12.34, 1.0, True)
    assert Choice(trial.model, (trial,)).sentence.endswith("(−2 log p is lower by 12.3 ± 1.0 each)")
    large = replace(trial, gain=699.4, error=123.4)
    assert Choice(large.model, (large,)).sentence.endswith("(−2 log p is lower by 699 ± 123 each)")
