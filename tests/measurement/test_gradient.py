"""The gradient of a dimension by corner pixels: against the calibration solved again, and against its covariance."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxscan.calibration import refit
from jaxscan.errors import InputError
from jaxscan.files.part_file import Dimension
from jaxscan.measurement.gradient import dimension_gradient, narrowed
from jaxscan.measurement.measure import MeasuredDimension
from jaxscan.precision import as_jax
from jaxscan.reconstruction.point_sigma import ray_jacobian
from jaxscan.rig.rig import parameter_names


@pytest.fixture(scope="module")
def distance(calibration):
    """How far along its ray a point is, as `measure` would give it: the derivatives by the rig are its own."""
    row = ray_jacobian(calibration.rig, "", np.array([[310.0, 260.0]]), {"stage": np.array([8000.0])}, True)[0][0]
    names = parameter_names(calibration.rig)
    sigma = float(np.sqrt(row @ calibration.covariance.of_leaves(calibration.rig) @ row))
    asked = Dimension("apart", "distance", ("one", "other"))
    return MeasuredDimension(asked, 1.0, sigma=sigma, sigma_rig=sigma, by_rig=dict(zip(names, row, strict=True)))


@pytest.fixture(scope="module")
def gradient(calibration, distance):
    return dimension_gradient(calibration, distance)


def test_a_corner_that_is_moved_moves_the_dimension_as_is_said(x64, calibration, distance, gradient):
    view = calibration.observations.views[3]
    adjustment = as_jax(calibration.adjustment)
    step = 0.05
    for corner, axis in ((0, 0), (17, 1)):
        values = []
        for way in (1.0, -1.0):
            moved = adjustment.groups[0].corners.at[3, 0, corner, axis].add(way * step)
            other = eqx.tree_at(lambda a: a.groups[0].corners, adjustment, moved)
            leaves = np.array([float(x) for x in jax.tree.leaves(refit(other).rig)])
            values.append(float(gradient.by_rig @ leaves))
        slope = (values[0] - values[1]) / (2 * step)
        assert gradient.corners[view.name][corner, axis] == pytest.approx(slope, rel=1e-3, abs=1e-9)


def test_what_all_pixels_do_together_is_the_rigs_part_of_sigma(calibration, distance, gradient):
    """To first order the covariance is that of the pixels' noise through the minimum."""
    corners = np.concatenate(list(gradient.corners.values())).ravel() * calibration.corner_sigma_px
    stripes = np.concatenate(list(gradient.stripes.values())).ravel() * calibration.stripe_sigma_px
    alone = float((corners**2).sum())
    both = alone + calibration.stripe_correlation * float((stripes**2).sum())
    assert alone < distance.sigma_rig**2
    assert np.sqrt(both) == pytest.approx(distance.sigma_rig, rel=0.1)


def test_one_photograph_more_narrows_and_the_best_is_not_all_alike(calibration, distance):
    after = narrowed(calibration, distance)
    assert list(after) == [view.name for view in calibration.observations.views]
    assert max(after.values()) <= distance.sigma_rig * (1 + 1e-9)
    assert min(after.values()) < 0.99 * distance.sigma_rig


def test_what_has_no_derivative_is_refused(calibration, distance):
    with pytest.raises(InputError, match="apart: has no derivative by the rig"):
        dimension_gradient(calibration, replace(distance, by_rig={}))
    with pytest.raises(InputError, match="was measured with a rig of 1 parameters, and this calibration has"):
        narrowed(calibration, replace(distance, by_rig={"camera.focal.0": 1.0}))
