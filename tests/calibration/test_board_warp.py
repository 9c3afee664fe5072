"""A board that bulges: its shape and the rig are found together, whatever the board stands on."""

from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxscan.calibration import Calibration, Observations, calibrate
from jaxscan.calibration.diagnostics import climb
from jaxscan.errors import InputError
from jaxscan.rig.rig import parameter_names
from tests.calibration import synthetic
from tests.calibration.synthetic import BOARD, TRUTH_WITH_TURNTABLE

BULGE = {"warp.x": 1.2, "warp.y": -0.7}


@pytest.fixture
def bulging(monkeypatch: pytest.MonkeyPatch) -> None:
    """The board of the synthetic sessions with its points on the bulge."""
    flat = type(BOARD).points

    def points(board) -> np.ndarray:
        X = flat(board)
        a, b = (X[:, :2] / X[:, :2].max(axis=0)).T
        X[:, 2] = 4 * BULGE["warp.x"] * a * (1 - a) + 4 * BULGE["warp.y"] * b * (1 - b)
        return X

    monkeypatch.setattr(type(BOARD), "points", points)


def session(moved: bool) -> Observations:
    """Views, and with them a board on the stage and one on the turntable."""
    seen = synthetic.observations(seed=3, n_stage=9 if moved else 0, laser=False)
    return replace(seen, sequences=(*seen.sequences, synthetic.turned(seed=3))) if moved else seen


def errors_in_sigma(result: Calibration) -> dict[str, float]:
    values = dict(zip(parameter_names(result.rig), jax.tree.leaves(result.rig), strict=True))
    off = {
        name: (float(values[name]) - TRUTH_WITH_TURNTABLE[name]) / (result.covariance.sigma(name) or np.nan)
        for name in result.covariance.names
    }
    assert result.system.warp is not None
    assert result.warp_covariance is not None
    for name, value in BULGE.items():
        found = float(getattr(result.system.warp, name.removeprefix("warp.")))
        off[name] = (found - value) / (result.warp_covariance.sigma(name) or np.nan)
    return off


@pytest.fixture
def calibrate_bulging(bulging: None, monkeypatch: pytest.MonkeyPatch) -> Callable[[bool], Calibration]:
    def solved(moved: bool) -> Calibration:
        seen = session(moved)
        monkeypatch.undo()
        return calibrate(seen, board_warp=True)

    return solved


@pytest.mark.parametrize("moved", [False, True], ids=["in the hand", "on stage and turntable"])
def test_rig_and_bulge_lie_within_their_sigma(moved: bool, calibrate_bulging):
    result = calibrate_bulging(moved)
    off = errors_in_sigma(result)
    assert max(map(abs, off.values())) < 4.0, off
    assert len(off) == (14 if moved else 5) + 2
    assert result.corner_sigma_px == pytest.approx(0.05, rel=0.1)
    sigmas = np.sqrt(np.diagonal(result.warp_covariance.matrix))
    assert ((sigmas > 0.001) & (sigmas < 0.1)).all()


@pytest.mark.long
def test_lenses_are_tried_on_the_board_as_it_is(calibrate_bulging):
    """On a flat one the bulge would be the lens's."""
    result = calibrate_bulging(False)
    ladder = climb(result)
    assert ladder.supported == "radial1"
    (own,) = (rung for rung in ladder.rungs if rung.lens == "radial1")
    assert own.rms_px == pytest.approx(result.corner_rms_px, rel=0.02)


def test_it_does_not_go_with_a_laser():
    with pytest.raises(InputError, match="board_warp does not go with a laser"):
        calibrate(synthetic.observations(seed=3, n_stage=0), board_warp=True)
