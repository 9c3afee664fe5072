"""A stage as it is drawn: a carriage on a circle, a screw that is ahead of its steps, and the kind that is alike."""

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import run_of
from jaxscan.simulation import rig_2003
from jaxscan.simulation.drawn_stage import DrawnStage
from jaxscan.simulation.folders import with_kinds_of_files

PER_STEP = np.array([1e-4, 9e-4, -4e-4]) / np.sqrt(0.98)
N = np.linspace(0, 60000, 301)
ORIGIN = np.zeros(3)
# About which a carriage turns that is not told where it stands.
AT = np.array([0.0, 0.0, 350.0])


def path(stage, X=ORIGIN):
    return stage.pose({"stage": N}).apply(X[None])[:, 0]


def test_a_straight_stage_without_a_wave_is_a_line():
    np.testing.assert_allclose(path(DrawnStage.create(PER_STEP)), N[:, None] * PER_STEP, atol=1e-10)


def test_the_carriage_runs_on_a_circle_of_that_sag():
    origin = np.array([5.0, -20.0, 340.0])
    stage = DrawnStage.create(PER_STEP, sag_mm=0.1, over_mm=60.0, origin=origin)
    P = path(stage, origin)
    chord = (P[-1] - P[0]) / np.linalg.norm(P[-1] - P[0])
    off = P - P[0] - ((P - P[0]) @ chord)[:, None] * chord
    assert np.linalg.norm(off, axis=1).max() == pytest.approx(0.1, rel=1e-4)
    assert np.linalg.norm(off, axis=1).argmax() == len(N) // 2
    # Rigid, and turned by the angle of the arc.
    turned = stage.pose({"stage": N}).rotation
    assert np.linalg.norm(turned[-1]) == pytest.approx(60 / 4500, rel=1e-3)
    still = DrawnStage.create(PER_STEP, sag_mm=0.1, over_mm=60.0, origin=origin, turning=False)
    assert not np.any(still.pose({"stage": N}).rotation)
    np.testing.assert_allclose(path(still, origin), P, atol=1e-9)


def test_the_screw_is_ahead_of_its_steps():
    stage = DrawnStage.create(PER_STEP, wave_mm=0.05, period=3000.0, phase=1.0)
    ahead = path(stage) @ PER_STEP / np.linalg.norm(PER_STEP) - N * np.linalg.norm(PER_STEP)
    assert np.ptp(ahead) == pytest.approx(0.1, rel=0.02)
    assert ahead[0] == 0
    np.testing.assert_allclose(ahead[15:], ahead[:-15], atol=1e-9)


def test_the_kind_of_a_rig_file_is_alike():
    stage = DrawnStage.create(PER_STEP, sag_mm=0.1, over_mm=60.0, wave_mm=0.05, phase=0.4)
    with float64():
        kind = as_numpy(stage.nearest_kind())
    for X in np.array([[0.0, 0.0, 350.0], [60.0, -40.0, 300.0]]):
        np.testing.assert_allclose(path(kind, X), path(stage, X), atol=3e-3)


def test_with_play_it_lags_behind_by_half_of_it_and_is_alike():
    stage = DrawnStage.create(PER_STEP, sag_mm=0.1, over_mm=60.0, play_mm=0.2)
    with float64():
        kind = as_numpy(stage.nearest_kind())
    assert kind.kind == "screw_on_guide_with_play"
    for run, ahead in ((5000, -0.1), (-5000, 0.1), (0, 0.0), (50, 0.05), (-100, 0.0)):
        q = {"stage": N, run_of("stage"): np.full(len(N), run)}
        moved = stage.pose(q).apply(AT[None])[:, 0] - path(stage, AT)
        np.testing.assert_allclose(moved @ PER_STEP / 1e-3, ahead, atol=2e-3)
        np.testing.assert_allclose(kind.pose(q).apply(AT[None]), stage.pose(q).apply(AT[None]), atol=3e-3)


def test_it_is_no_kind_to_be_found():
    with pytest.raises(InputError, match="drawn, not found"):
        DrawnStage.at_rest("stage")
    rig = rig_2003.simulated_rig(0)
    assert rig_2003.with_stage(rig) is rig


def test_a_turntable_may_stand_on_it():
    rig = rig_2003.with_turntable(rig_2003.with_stage(rig_2003.simulated_rig(1), guide_mm=0.1), 1)
    assert [part.kind for part in rig.motion.parts()] == ["drawn", "rotary"]
    written = with_kinds_of_files(rig)
    assert {name: part.kind for name, part in written.axes().items()} == {
        "stage": "screw_on_guide",
        "turntable": "rotary",
    }
    q = {"stage": np.array([0.0, 30000.0]), "turntable": np.array([800.0, 800.0])}
    X = np.array([0.0, 0.0, 340.0])
    moved = [as_numpy(each.pose(q)).apply(X[None])[:, 0] for each in (rig, written)]
    np.testing.assert_allclose(*moved, atol=3e-3)
