"""The inverse up to the very fold, for lenses whose coefficients pull against each other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.rig.lens import _invert_radius, distort, invertible_radius, undistort


@pytest.mark.parametrize("radial", [[-0.134], [-0.28, 0.08], [0.3, -0.4], [-0.3, 0.2, -0.05], [0.1, -0.5, 0.1]])
def test_inverse_on_the_first_branch(x64, radial):
    r = np.linspace(0, 3, 300001)
    rd = r * (1 + sum(k * r ** (2 * i + 2) for i, k in enumerate(radial)))
    falls = np.flatnonzero(np.diff(rd) <= 0)
    last = falls[0] if falls.size else 200000
    chosen = np.unique(np.linspace(0, 0.9999 * last, 400).astype(int))
    k = tuple(map(jnp.asarray, radial))
    along = jnp.stack([jnp.asarray(rd[chosen]), jnp.zeros(len(chosen))], axis=-1)
    back = jax.jit(jax.vmap(lambda x: undistort(k, (), x)))(along)
    again = jax.jit(jax.vmap(lambda x: distort(k, (), x)))(back)
    inside = np.isfinite(np.asarray(back[:, 0]))
    # The fold is found by sampling: what is called outside lies within a thousandth of it.
    assert rd[chosen][~inside].min(initial=np.inf) > 0.999 * rd[last]
    np.testing.assert_allclose(np.asarray(again)[inside], np.asarray(along)[inside], atol=1e-12)
    assert (np.asarray(back)[inside, 0] <= r[last] * 1.001).all()


@pytest.mark.parametrize("x64", [False, True])
@pytest.mark.parametrize("radial", [[-0.134], [-0.5, 0.12, -0.005], [0.47, 0.0267, 4.4e-5, 0.767, 0.0963, 0.0014]])
def test_newton_stops_at_the_root(radial, x64):
    """One pixel that goes on keeps all of an image waiting."""
    with jax.enable_x64(x64):
        k = tuple(map(jnp.asarray, radial))
        _, rd_limit = invertible_radius(k, k[0].dtype)
        rd = jnp.linspace(0, 0.99 * rd_limit, 50001)
        _, steps = jax.jit(jax.vmap(lambda rd: _invert_radius(k, rd)))(rd)
        assert int(steps.max()) <= 20
