"""How large σ is: redundancy, limits and τ, each by itself, and all of them by drawn sessions."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration import calibrate
from jaxscan.calibration.residuals import Blocks, Noise
from jaxscan.calibration.rounds import CORNER_LIMIT, STRIPE_LIMIT, _keep, _variance_components
from jaxscan.precision import float64
from tests.calibration import synthetic
from tests.unchecked import unchecked

DRAWS = 20
# Of an AR(1) sequence of errors along the stripe: τ = (1 + ρ) / (1 − ρ) = 9.
RHO = 0.8


def blocks(corners: int, stripes: int) -> Blocks:
    return Blocks(
        points=jnp.zeros((1, corners, 3)),
        q={},
        reference={},
        corners=jnp.zeros((1, 1, corners, 2)),
        weights=jnp.ones((1, 1, corners)),
        corner_used=jnp.ones((1, 1, corners), bool),
        stripe=jnp.zeros((1, 1, stripes, 2)),
        stripe_weights=jnp.ones((1, 1, stripes)),
        stripe_used=jnp.ones((1, 1, stripes), bool),
        stripe_columns=jnp.ones((1, 1, stripes), bool),
        stripe_light=jnp.zeros((1, 1, stripes), int),
    )


def test_sigma_allows_for_what_the_fit_has_taken_away() -> None:
    """Residuals of a linear fit with a third as many unknowns as residuals: the plain RMS is 0.82 of the true σ."""
    random = np.random.default_rng(0)
    corners, stripes, true = 600, 900, (0.05, 0.2)
    n = 2 * corners + stripes
    sigma = np.concatenate([np.full(2 * corners, true[0]), np.full(stripes, true[1])])
    Q, _ = np.linalg.qr(random.standard_normal((n, n // 3)))
    whitened = random.standard_normal(n)
    left = sigma * (whitened - Q @ (Q.T @ whitened))
    leverage = (Q**2).sum(axis=1)[None]
    errors = ((left[: 2 * corners].reshape(1, 1, corners, 2), left[2 * corners :].reshape(1, 1, stripes)),)
    with float64():
        group = (blocks(corners, stripes),)
        noise = Noise.create()
        found, _ = _variance_components(group, group, errors, (leverage,), noise)
    np.testing.assert_allclose([float(found.corner), float(found.stripe)], true, rtol=0.06)
    assert np.sqrt((left[: 2 * corners] ** 2).mean()) < 0.88 * true[0]


def test_what_is_beyond_the_limits_is_left_out_and_nothing_else() -> None:
    at = np.array([0.0, 3.9, 4.1, 5.0, 7.5, 9.0])
    assert (CORNER_LIMIT, STRIPE_LIMIT) == (4.5, 4.0)
    corner = np.stack([0.05 * at, np.zeros_like(at)], axis=-1)[None, None]
    with float64():
        noise = Noise.create(0.05, 0.2)
        (kept,) = _keep((blocks(6, 6),), ((corner, -0.2 * at[None, None]),), noise)
    np.testing.assert_array_equal(np.asarray(kept.corner_used)[0, 0], [True, True, True, False, False, False])
    np.testing.assert_array_equal(np.asarray(kept.stripe_used)[0, 0], [True, True, False, False, False, False])


def drawn(clean, seed: int):
    """A session, its stripes with errors that go on from column to column; drawn again by the seed."""
    random = np.random.default_rng([7, seed])

    def noisy(view):
        corners = view.corners + 0.05 * random.standard_normal(view.corners.shape)
        stripes = []
        for stripe in view.stripes:
            white = random.standard_normal(len(stripe.pixels))
            tied = np.empty_like(white)
            tied[0] = white[0]
            for i in range(1, len(white)):
                tied[i] = RHO * tied[i - 1] + np.sqrt(1 - RHO**2) * white[i]
            pixels = stripe.pixels.copy()
            # Large beside the corners' errors, so that the stripes are what limits the plane.
            pixels[:, int(stripe.columns)] += 0.5 * tied
            stripes.append(replace(stripe, pixels=pixels))
        return replace(view, corners=corners, stripes=tuple(stripes))

    sequences = tuple(replace(each, views=tuple(map(noisy, each.views))) for each in clean.sequences)
    return replace(clean, views=tuple(map(noisy, clean.views)), sequences=sequences)


@pytest.fixture(scope="module")
def solved():
    clean = synthetic.observations(0, n_stage=5, noise=synthetic.Noise(0.0, 0.0))
    first = calibrate(drawn(clean, 0))
    with unchecked():
        return [first, *(calibrate(drawn(clean, seed)) for seed in range(1, DRAWS))]


def test_errors_that_are_tied_along_the_stripe_have_their_tau(solved) -> None:
    assert np.median([each.stripe_correlation for each in solved]) == pytest.approx((1 + RHO) / (1 - RHO), rel=0.3)


def test_the_rig_is_off_by_its_sigma(solved) -> None:
    """χ² for each number: 60 numbers of the light plane, 220 in all; without τ both are about 2.4."""
    names = list(synthetic.TRUTH)
    truth = np.array([synthetic.TRUTH[name] for name in names])
    squares, plane = [], []
    for each in solved:
        order = [list(each.covariance.names).index(name) for name in names]
        covariance = np.asarray(each.covariance.matrix)[np.ix_(order, order)]
        rig = each.rig
        values = [*rig.camera.focal, *rig.camera.principal, *rig.camera.lens.radial[:1], *rig.lights[0].plane]
        found = np.array([float(x) for x in (*values, *rig.axis("stage").per_step)])
        error = found - truth
        squares.append(error @ np.linalg.solve(covariance, error) / len(error))
        own = slice(5, 8)
        plane.append(error[own] @ np.linalg.solve(covariance[own, own], error[own]) / 3)
    # The mean of 20 χ² of 3 has a scatter of 0.18, of 11 of 0.10.
    assert 0.5 < np.mean(plane) < 1.8
    assert 0.7 < np.mean(squares) < 1.45
