"""Calibration with a splined lens: a field that no formula has is found, σ hold, and too little is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.drawn_fields import Field, camera_of, rays_of, session_through
from benchmarks.splined import _PIXELS, in_sigma
from jaxscan.calibration import Observations, View, calibrate
from jaxscan.calibration.block_arrow import linearise
from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.bundle import as_arrow
from jaxscan.calibration.field_sparsity import field_sparsity
from jaxscan.calibration.first_camera import first_camera
from jaxscan.calibration.first_poses import first_poses
from jaxscan.calibration.lens_field import with_field
from jaxscan.calibration.residuals import Noise
from jaxscan.errors import InputError
from jaxscan.precision import float64
from jaxscan.rig import Rig, System
from tests.calibration import synthetic


@pytest.mark.long
def test_a_field_is_found_and_its_sigma_holds():
    field = Field.random(2, 0.5)
    calibration = calibrate(session_through(camera_of(), field, 2, laser=False)[1], lens="splined")
    z = np.abs(in_sigma(calibration, rays_of(camera_of(), field, _PIXELS)))
    assert (z < 3).mean() > 0.95
    assert calibration.corner_sigma_px < 0.055
    assert not any("extent" in name or "principal" in name for name in calibration.covariance.names)
    # Along a valley that is not straight it took hundreds.
    assert calibration.steps <= 12


def test_products_of_many_coefficients_are_the_jacobian():
    session = synthetic.observations(0, n_views=5, n_stage=0, laser=False)
    with float64():
        camera, groups = with_field(first_camera(session, "brown")), (view_blocks(session),)
        system = System(Rig(camera), (first_poses(camera, groups[0]),))
        free = jnp.ones(len(system.shared_names()), bool)
        y, _, residual = as_arrow(system, free, groups, Noise.create(0.05, 0.1))
        sparsity = field_sparsity(system, groups)
        assert max(sparsity.classes) + 1 == 4 + 5 + 4 + 50
        few = jax.jit(lambda y, sparsity: linearise(residual, y, sparsity)[1])(y, sparsity)
        whole = jax.jit(lambda y: linearise(residual, y)[1])(y)
        np.testing.assert_allclose(few.blocks[0], whole.blocks[0], atol=1e-9 * np.abs(whole.blocks[0]).max())


def test_too_few_corners_are_refused():
    session = synthetic.observations(0, n_views=3, n_stage=0, laser=False)
    few = np.arange(len(session.board.points()))[:, None] < 20
    views = tuple(View(view.name, np.where(few, view.corners, np.nan)) for view in session.views)
    with pytest.raises(InputError, match='lens = "splined", with 286 shifts, needs 143 and more'):
        calibrate(Observations(session.image_size, session.board, views, (), ()), lens="splined")


def test_terms_are_held_by_name_or_refused():
    with pytest.raises(InputError, match='a camera with the lens "splined" has '):
        calibrate(synthetic.observations(0, n_stage=0), lens="splined", hold=["camera.angular.0"])
