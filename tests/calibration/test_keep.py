"""`keep`: with the mask given, what it leaves out is not read at all."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxscan.calibration import InlierMask, calibrate
from jaxscan.errors import InputError


@pytest.fixture(scope="module")
def spoilt(session):
    """The session with corners, stage corners and a piece of stripe spoilt, and a view that shows too little."""
    views, stage = list(session.views), session.sequences[0]
    corners = views[2].corners.copy()
    corners[[3, 17]] += [[9.0, -7.0], [0.0, 4.0]]
    views[2] = replace(views[2], corners=corners)
    pixels = views[4].stripes[0].pixels.copy()
    pixels[np.flatnonzero(np.isfinite(pixels).all(axis=1))[:40], 1] += 6.0
    views[4] = replace(views[4], stripes=(replace(views[4].stripes[0], pixels=pixels),))
    views[7] = replace(views[7], corners=np.where(np.arange(54)[:, None] < 5, views[7].corners, np.nan))
    staged = list(stage.views)
    staged[1] = replace(staged[1], corners=staged[1].corners + np.where(np.arange(54)[:, None] == 9, 5.0, 0.0))
    return replace(session, views=tuple(views), sequences=(replace(stage, views=tuple(staged)),))


@pytest.fixture(scope="module")
def finished(spoilt):
    return calibrate(spoilt)


@pytest.fixture(scope="module")
def kept_only(spoilt, finished):
    return calibrate(spoilt, keep=finished.kept)


def with_value(observations, kept, value):
    """The observations with one value in place of everything that was not kept."""

    def spoil(view, mask):
        stripes = tuple(
            replace(s, pixels=np.where(m[:, None], s.pixels, value))
            for s, m in zip(view.stripes, mask.stripes, strict=True)
        )
        return replace(view, corners=np.where(mask.corners[:, None], view.corners, value), stripes=stripes)

    views = [spoil(view, mask) for view, mask in zip(observations.photographs(), kept, strict=True)]
    n = len(observations.views)
    stage = replace(observations.sequences[0], views=tuple(views[n:]))
    return replace(observations, views=tuple(views[:n]), sequences=(stage,))


def test_the_mask_is_of_all_photographs_and_leaves_the_outliers_out(spoilt, finished):
    assert len(finished.kept) == len(spoilt.photographs())
    assert not finished.kept[2].corners[[3, 17]].any()
    assert finished.kept[4].stripes[0].sum() == finished.fits[4].stripe_kept.sum()
    assert not finished.kept[7].corners.any()
    assert not finished.kept[7].stripes[0].any()
    assert not finished.kept[len(spoilt.views) + 1].corners[9]


@pytest.mark.parametrize("value", [np.nan, 1e300, -40.0])
def test_what_is_not_kept_is_not_read_bit_for_bit(spoilt, finished, kept_only, value):
    changed = with_value(spoilt, finished.kept, value)
    again = calibrate(changed, keep=finished.kept)
    fields = ("system", "rig", "adjustment", "covariance", "fits", "moved_fits", "kept")
    for name in (*fields, "corner_sigma_px", "stripe_sigma_px", "stripe_correlation", "corner_rms_px", "stripe_rms_px"):
        a, b = (leaves(getattr(c, name)) for c in (kept_only, again))
        assert len(a) == len(b) > 0
        for x, y in zip(a, b, strict=True):
            assert x.tobytes() == y.tobytes(), name
    assert (again.left_out, again.solves, again.steps) == (kept_only.left_out, kept_only.solves, kept_only.steps)


def leaves(value):
    """All numbers in a result, as arrays."""
    if hasattr(value, "__dataclass_fields__") and not jax.tree_util.all_leaves([value]):
        return [np.asarray(leaf) for leaf in jax.tree.leaves(value)]
    if hasattr(value, "__dataclass_fields__"):
        return [leaf for name in value.__dataclass_fields__ for leaf in leaves(getattr(value, name))]
    if isinstance(value, tuple):
        return [leaf for each in value for leaf in leaves(each)]
    return [np.asarray(value)]


def test_nothing_is_rejected_and_the_answer_is_that_of_the_rounds(finished, kept_only):
    assert all(np.array_equal(a.corners, b.corners) for a, b in zip(finished.kept, kept_only.kept, strict=True))
    assert all(fit.stripe_kept.all() for fit in kept_only.fits)
    sigma = np.sqrt(np.diagonal(finished.covariance.matrix))
    a, b = (np.array([float(x) for x in jax.tree.leaves(c.rig)]) for c in (finished, kept_only))
    # σ and weights settle within a hundredth; the minimum itself is the same.
    assert (np.abs(a - b) < 0.05 * sigma).all()
    assert kept_only.corner_sigma_px == pytest.approx(finished.corner_sigma_px, rel=0.01)


def test_a_mask_that_does_not_fit_is_refused(session, finished):
    with pytest.raises(InputError, match="keep has masks for 3 photographs"):
        calibrate(session, keep=finished.kept[:3])
    with pytest.raises(InputError, match="view-0: the mask of what to keep has 5 corners"):
        calibrate(session, keep=(InlierMask(np.ones(5, bool)), *finished.kept[1:]))
