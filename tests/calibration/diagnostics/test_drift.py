"""What goes on slowly from photograph to photograph."""

import jax
import numpy as np
import pytest

from benchmarks.changes import changed_session
from benchmarks.drawn_bent import clean_session
from benchmarks.left_over import drifting
from jaxscan.calibration import calibrate


@pytest.mark.parametrize(("seed", "by"), [(0, 2e-3), (1, 2e-3), (1, -2e-3)])
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


@pytest.mark.parametrize("seed", range(4))
def test_nothing_drifts_in_a_clean_session(seed):
    assert calibrate(clean_session(seed)).drift is None


def test_a_lens_that_was_refocused_once_does_not_drift():
    result = calibrate(changed_session(0, "refocus")[0])
    assert result.change.kind == "focus"
    assert result.drift is None
