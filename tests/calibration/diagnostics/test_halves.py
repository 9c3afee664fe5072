"""Parts solved apart: they agree within σ on drawn data, and not where one view is of another camera."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from jaxscan.calibration import calibrate
from jaxscan.calibration.diagnostics.halves import compare, halves, sessions, solve_apart, stands_alone
from jaxscan.calibration.diagnostics.resolve import Part, PartialRig, resolve
from jaxscan.calibration.observations import join
from jaxscan.errors import InputError
from jaxscan.images import Board
from jaxscan.rig import Covariance
from tests.calibration import synthetic
from tests.calibration.diagnostics import cases


def test_all_photographs_give_the_calibration_again(session, calibration):
    everything = Part("all", np.ones(11, bool), np.ones(5, bool))
    again = resolve(calibration, everything)
    assert again is not None
    sigma = np.sqrt(np.diagonal(calibration.covariance.matrix))
    theirs = [float(x) for x in (*calibration.rig.camera.focal, *calibration.rig.camera.principal)]
    assert (np.abs(again.values[:4] - theirs) < 0.02 * sigma[:4]).all()
    np.testing.assert_allclose(np.sqrt(np.diagonal(again.covariance.matrix)), sigma, rtol=0.02)


def test_halves_of_drawn_data_agree(calibration):
    parts = halves(calibration.observations)
    assert parts is not None
    assert not (parts[0].views & parts[1].views).any()
    assert (parts[0].views | parts[1].views).all()
    found = solve_apart(calibration, *parts)
    assert found is not None
    assert not found.disagree
    assert np.abs(found.differences_in_sigma).max() < 4


def test_halves_disagree_when_a_view_is_of_another_camera(session, monkeypatch):
    """A focal length 1 % longer: its corners are not far enough off to be rejected."""
    result = calibrate(cases.of_another_camera(session, 4, monkeypatch, focal=1.01))
    parts = halves(result.observations)
    assert parts is not None
    found = solve_apart(result, *parts)
    assert found is not None
    assert found.disagree


def test_the_comparison_is_numpys():
    shape = ("lights.0.bow.0", "lights.1.round.0")
    names = ("camera.focal.0", "lights.0.plane.0", "lights.0.plane.1", *shape, "motion.stage.per_step.0")
    A, B = (np.diag([4.0, 1e-10, 1e-10, 1e-4, 1.0, 1e-10]) * s for s in (1.0, 2.0))
    a = np.array([700.0, -0.005, 0.003, 2.4, 7.0, 0.001])
    # b's millimetres are 4 % longer; how a light's own number grows with them is not known.
    b = a * [1, 1 / 1.04, 1 / 1.04, 1.04, 1.0, 1.04] + [1.0, 0, 0, 0, 3.0, 0]
    views = np.ones(3, bool)
    parts = [PartialRig(Part(n, views, views), x, Covariance(names, C)) for n, x, C in (("a", a, A), ("b", b, B))]
    found = compare(*parts)
    chi2 = (b - a) @ np.linalg.inv(A + B) @ (b - a)
    assert found.chi2_per_parameter == pytest.approx(chi2 / 6)
    assert found.p == pytest.approx(stats.chi2.sf(chi2, 6), rel=1e-6)
    assert found.scale == pytest.approx(0.04, rel=0.05)


def test_too_few_photographs_give_no_halves(session):
    few = Part("few", np.arange(11) < 2, np.ones(5, bool))
    assert not stands_alone(session, few)
    assert sessions(session) == ()


@pytest.mark.long
def test_a_board_of_another_size_shows_between_sessions():
    """Both sessions state 16 mm; the second board's squares have 15.2 mm, so its millimetres come out 5 % longer."""
    right = synthetic.observations(seed=0, n_stage=5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic, "BOARD", Board.checkerboard([9, 6], 15.2))
        wrong = synthetic.observations(seed=1, n_stage=5)
    both = join(["monday", "tuesday"], [right, replace(wrong, board=right.board)])
    result = calibrate(both)
    parts = sessions(result.observations)
    assert [part.name for part in parts] == ["monday", "tuesday"]
    found = solve_apart(result, *parts)
    assert found is not None
    assert found.scale == pytest.approx(16 / 15.2 - 1, abs=4 * found.scale_sigma + 0.002)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"board": Board.checkerboard([9, 6], 15.0)},
            "tuesday has the board 9 x 6 at 15 mm, monday has 9 x 6 at 16 mm.*ruler",
        ),
        ({"image_size": (1280, 960)}, "1280, 960"),
        ({"lasers": ("left", "right")}, "left.*right"),
    ],
)
def test_sessions_of_different_rigs_are_refused(session, change, words):
    with pytest.raises(InputError, match=words):
        join(["monday", "tuesday"], [session, replace(session, **change)])
