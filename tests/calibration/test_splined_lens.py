"""Calibration with a splined lens: a field that no formula has is found, σ hold, and a formula loses nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.drawn_fields import Field, camera_of, rays_of, session_through
from benchmarks.splined import _PIXELS, in_sigma
from jaxscan.calibration import calibrate, refit
from jaxscan.calibration.block_arrow import linearise
from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.bundle import as_arrow
from jaxscan.calibration.field_sparsity import field_sparsity
from jaxscan.errors import InputError
from jaxscan.precision import as_float64, float64
from jaxscan.rig import System
from jaxscan.rig.splined import Splined
from tests.calibration import synthetic


@pytest.fixture(scope="module")
def found():
    field = Field.random(1, 0.5)
    return field, calibrate(session_through(camera_of(), field, 1, laser=False)[1], lens="splined")


@pytest.mark.long
def test_a_field_is_found_and_its_sigma_holds(found):
    field, calibration = found
    z = np.abs(in_sigma(calibration, rays_of(camera_of(), field, _PIXELS)))
    assert (z < 1).mean() > 0.55
    assert (z < 3).mean() > 0.97
    assert calibration.corner_sigma_px < 0.053
    assert not any("extent" in name for name in calibration.covariance.names)


@pytest.mark.long
def test_products_of_many_coefficients_are_the_jacobian(found):
    _, calibration = found
    with float64():
        adjustment = as_float64(calibration.adjustment.start), calibration.adjustment
        system, noise = adjustment[0], as_float64(adjustment[1].noise)
        groups = (view_blocks(calibration.observations),)
        y, _, residual = as_arrow(system, jnp.asarray(adjustment[1].free), groups, noise)
        few = jax.jit(lambda y: linearise(residual, y, field_sparsity(system, groups))[1])(y)
        whole = jax.jit(lambda y: linearise(residual, y)[1])(y)
        for one, other in zip(few.blocks, whole.blocks, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-9 * float(jnp.abs(other).max()))
        np.testing.assert_allclose(few.shared, whole.shared, atol=1e-9)


@pytest.mark.long
def test_refit_stays_where_it_is(found):
    _, calibration = found
    with jax.enable_x64(True):
        again = refit(calibration.adjustment)
    assert isinstance(again, System)
    one, other = (np.array(jax.tree.leaves(each.rig.camera), float) for each in (again, calibration.system))
    np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-7)


@pytest.mark.long
def test_of_a_formula_it_finds_the_formula():
    session = synthetic.observations(3, n_views=12, n_stage=0, laser=False)
    brown, splined = (calibrate(session, lens=lens) for lens in ("brown", "splined"))
    sigma = brown.covariance.sigma("camera.focal.0")
    assert abs(splined.rig.camera.focal[0] - brown.rig.camera.focal[0]) < 0.5 * sigma
    assert isinstance(splined.rig.camera.lens, Splined)


def test_too_few_corners_are_refused():
    session = synthetic.observations(0, n_views=3, n_stage=0, laser=False)
    few = session.__class__(
        session.image_size,
        session.board,
        tuple(
            v.__class__(v.name, np.where(np.arange(len(v.corners))[:, None] < 20, v.corners, np.nan))
            for v in session.views
        ),
    )
    with pytest.raises(InputError, match='lens = "splined", with 286 shifts, needs 143 and more'):
        calibrate(few, lens="splined")


def test_terms_are_held_by_name_or_refused():
    with pytest.raises(InputError, match='a camera with the lens "splined" has '):
        calibrate(synthetic.observations(0, n_stage=0), lens="splined", hold=["camera.angular.0"])
