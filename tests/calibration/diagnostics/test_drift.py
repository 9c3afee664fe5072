"""What goes on slowly from photograph to photograph."""

import jax
import numpy as np
import pytest

from benchmarks.left_over import drifting
from jaxscan.calibration import calibrate
from tests.calibration.clean import clean, refocused


@pytest.mark.parametrize(
    ("seed", "by"), [(0, 2e-3), *(pytest.param(1, by, marks=pytest.mark.long) for by in (2e-3, -2e-3))]
)
def test_a_lens_that_warms_up_is_named_and_its_rig_lies_within_sigma(seed, by):
    first, middle, session = drifting(seed, by)
    result = calibrate(session)
    assert result.drift.kind == "focus"
    assert result.drift.by == pytest.approx(100 * by, abs=0.06)
    what, fix = result.drift.statement
    assert "focal length drifts" in what
    assert "warm up" in fix
    assert any("focal length drifts" in warning for warning in result.warnings)
    own = np.array([float(leaf) for leaf in jax.tree.leaves(result.rig)])
    for rig in (first, middle):
        true = np.array([float(leaf) for leaf in jax.tree.leaves(rig)])
        off = np.abs(own - true)
        assert (off < 3 * np.sqrt(np.diagonal(result.covariance.of_leaves(result.rig)))).all()
    # Along the stage the drift looks like travel.
    formal = result.formal_covariance.sigma("motion.stage.per_step.2")
    assert abs(own - true)[-1] > 30 * formal


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_nothing_drifts_in_a_clean_session(seed):
    assert clean(seed).drift is None


def test_a_lens_that_was_refocused_once_does_not_drift():
    result = refocused()
    assert result.change.kind == "focus"
    assert result.drift is None
