"""How far given weights are believed."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration.residuals import Blocks
from jaxscan.calibration.rounds import _believed
from jaxscan.precision import float64


@pytest.mark.parametrize("common", [0.0, 0.5, 1.0])
def test_weights_are_drawn_towards_equal_ones_as_far_as_the_errors_ask(common):
    random = np.random.default_rng(0)
    n = 4000
    given = random.uniform(0.2, 2, (1, n))
    sigma = 0.03 * np.sqrt(common + (1 - common) / given**2)
    errors = sigma[..., None] * random.standard_normal((1, n, 2))
    # One that is left out has no say, and keeps no weight.
    given[0, 0], errors[0, 0] = 0.0, 1e6
    with float64():
        used = jnp.asarray(given > 0)
        none, off = jnp.zeros((1, 1, 0)), jnp.zeros((1, 1, 0), bool)
        group = Blocks(
            points=jnp.zeros((1, n, 3)),
            q={},
            reference={},
            corners=jnp.zeros((1, 1, n, 2)),
            weights=jnp.asarray(given[:, None]),
            corner_used=used[:, None],
            stripe=jnp.zeros((1, 1, 0, 2)),
            stripe_weights=none,
            stripe_used=off,
            stripe_columns=off,
            stripe_light=jnp.zeros((1, 1, 0), int),
        )
        (believed,) = _believed((group,), (group,), ((jnp.asarray(errors[:, None]), none),))
        weights = np.asarray(believed.weights)[:, 0]
    assert weights[0, 0] == 0
    np.testing.assert_allclose(weights[0, 1:], 0.03 / sigma[0, 1:], rtol=0.15)
