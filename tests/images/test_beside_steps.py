"""Stripes along a silhouette or the edge of a shadow, in grey photographs."""

import numpy as np
import pytest

from benchmarks.stray_light import beside_a_step
from jaxscan.images import StripeSettings, detect_stripe

GREY = StripeSettings("grey")


@pytest.mark.parametrize(("share", "apart", "most"), [(0.2, 3.0, 0.75), (0.4, 3.0, 0.7), (0.4, 4.5, 0.65)])
def test_a_step_beside_the_stripe_does_not_move_it(share, apart, most):
    """Towards a step of 0.4 of its height, 3 px away, it was moved by 0.19 px."""
    frames, truth, asked = beside_a_step(0.2, share, apart)
    found, other = (detect_stripe(frames, GREY, detector=name) for name in ("likelihood", "gravity"))
    rms, its = (float(np.sqrt(np.nanmean((f.position - truth)[asked] ** 2))) for f in (found, other))
    assert rms < most * its
    assert found.valid[asked].mean() > 0.93
    within = np.abs(found.position - truth)[asked] < 2 * found.sigma[asked]
    assert within.mean() > 0.87


def test_without_a_step_nothing_is_another():
    """A line is measured with one only where its neighbours show it too."""
    frames, truth, _ = (x[:2] for x in beside_a_step(0.2, 0.0, 3.0))
    found = detect_stripe(frames, GREY)
    assert np.sqrt(np.nanmean((found.position - truth) ** 2)) < 0.09


@pytest.mark.parametrize("apart", [3.0, -3.0])
def test_nor_a_burnt_out_stripe(apart):
    """It was moved by 0.7 px, and its σ was half of that."""
    frames, truth, asked = (x[:3] for x in beside_a_step(0.2, 0.4, apart, 400.0))
    found = detect_stripe(frames, GREY)
    off = np.abs(found.position - truth)[asked]
    assert np.sqrt(np.nanmean(off**2)) < 0.16
    assert (off < 3 * found.sigma[asked]).mean() > 0.9
