"""The inverse up to the very fold, for lenses whose coefficients pull against each other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.rig import growing
from jaxscan.rig.opencv_lens import _WIDEST_RADIUS, _height, distort, invertible_radius, undistort

# The coefficients as arguments: lenses with as many of them share what is compiled.
DISTORT = jax.jit(jax.vmap(distort, in_axes=(None, None, 0)))
UNDISTORT = jax.jit(jax.vmap(undistort, in_axes=(None, None, 0)))
JACOBIAN = jax.jit(jax.vmap(jax.jacfwd(distort, argnums=2), in_axes=(None, None, 0)))


@pytest.mark.parametrize("radial", [[-0.134], [-0.28, 0.08], [0.3, -0.4], [-0.3, 0.2, -0.05], [0.1, -0.5, 0.1]])
def test_inverse_on_the_first_branch(x64, radial):
    r = np.linspace(0, 3, 300001)
    rd = r * (1 + sum(k * r ** (2 * i + 2) for i, k in enumerate(radial)))
    falls = np.flatnonzero(np.diff(rd) <= 0)
    last = falls[0] if falls.size else 200000
    chosen = np.unique(np.linspace(0, 0.9999 * last, 400).astype(int))
    k = tuple(map(jnp.asarray, radial))
    along = jnp.stack([jnp.asarray(rd[chosen]), jnp.zeros(len(chosen))], axis=-1)
    back = UNDISTORT(k, (), along)
    again = DISTORT(k, (), back)
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

        def along(rd):
            return growing.inverse_and_steps(lambda r: _height(k, r), _WIDEST_RADIUS, rd)

        _, steps = jax.jit(jax.vmap(along))(rd)
        assert int(steps.max()) <= 20


@pytest.mark.parametrize("x64", [False, True])
@pytest.mark.parametrize(
    ("radial", "tangential"),
    [
        # The radial part folds for good; folds and rises again; tends to a constant.
        ([-0.134, 0.0, 0.0], [1e-2, -2e-2]),
        ([-0.5, 0.1, 0.0], [1e-3, -2e-3]),
        pytest.param([0.47, 0.0267, 4.4e-5, 0.767, 0.0963, 0.0014], [-1.2e-5, 9e-5], marks=pytest.mark.long),
    ],
)
def test_tangential_inverse_is_on_the_branch_of_the_centre_or_nan(radial, tangential, x64):
    """A point is on the branch where J is positive definite all the way from the centre to it."""
    with jax.enable_x64(True):
        k, p = (tuple(map(jnp.asarray, c)) for c in (radial, tangential))
        _, rd_limit = invertible_radius(k, k[0].dtype)

        def least(x):
            way = np.linspace(0, 1, 101)[1:, None, None] * x
            J = JACOBIAN(k, p, jnp.asarray(way.reshape(-1, 2)))
            return np.linalg.eigvalsh(J).min(axis=1).reshape(100, -1).min(axis=0)

        random = np.random.default_rng(0)
        rd, angle = random.uniform(0.8, 1.2, 1000) * float(rd_limit), random.uniform(0, 2 * np.pi, 1000)
        xd = rd[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    with jax.enable_x64(x64):
        own = [tuple(map(jnp.asarray, c)) for c in (radial, tangential)]
        x = np.asarray(UNDISTORT(*own, jnp.asarray(xd)), float)
    with jax.enable_x64(True):
        found = np.isfinite(x).all(axis=1)
        assert found.sum() > 300
        x = np.where(found[:, None], x, 0.0)
        assert least(x)[found].min() > (-1e-6 if x64 else -1e-2)
        # And whatever lies on the branch, not within rounding of its edge, is found again.
        x *= random.uniform(0.5, 1.05, (len(x), 1))
        inside = found & (least(x) > 0.01)
        xd = DISTORT(k, p, jnp.asarray(x))
    with jax.enable_x64(x64):
        back = UNDISTORT(*own, jnp.asarray(np.asarray(xd)))
    np.testing.assert_allclose(np.asarray(back)[inside], x[inside], atol=1e-11 if x64 else 1e-3)
