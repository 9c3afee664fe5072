"""Small systems solved in batches, and that nothing of ours waits for LAPACK in two threads."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.elimination import solve_blocks

# Corners of a board of 12 x 16, which are fitted as one batch of 192, in four threads at once.
_FITS_IN_THREADS = """
import numpy as np
from concurrent.futures import ThreadPoolExecutor
from jaxscan.images.saddle import fit_saddles

v, u = np.mgrid[:400, :520]
image = np.where((u // 30 + v // 30) % 2, 200, 40).astype(np.uint8)
at = np.stack(np.meshgrid(np.arange(30, 510, 30), np.arange(30, 390, 30)), axis=-1).reshape(-1, 2) - 0.5
along = np.ones((len(at), 1)) * np.array([[30.0, 0.0]])

def fit(_):
    return fit_saddles(image, at, (along, along[:, ::-1]), np.zeros((len(at), 2)), 0.45, np.full(len(at), 30.0), 12.0)

fit(0)
with ThreadPoolExecutor(4) as pool:
    for found in pool.map(fit, range(40)):
        assert np.abs(found.pixels - at).max() < 0.01
"""


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("blocks", "size"), [(1, 1), (5, 6), (600, 13)])
def test_blocks_are_solved_as_numpy_solves_them(dtype, blocks, size):
    random = np.random.default_rng(0)
    J = random.normal(size=(blocks, 3 * size, size)) * 10.0 ** random.uniform(-3, 3, size)
    V, right = J.swapaxes(1, 2) @ J, random.normal(size=(blocks, size, 2))
    expected = np.linalg.solve(V, right)
    with jax.enable_x64(dtype == np.float64):
        found = np.asarray(solve_blocks(jnp.asarray(V, dtype), jnp.asarray(right, dtype)))
    assert found.dtype == dtype
    # In units in which the diagonal is one, where size and condition bound the error of a system.
    scale = np.sqrt(np.einsum("bii->bi", V))
    off = np.abs((found - expected) * scale[..., None]).max((1, 2)) / np.abs(expected * scale[..., None]).max((1, 2))
    condition = np.linalg.cond(V / scale[:, :, None] / scale[:, None, :])
    assert (off < 5 * size * condition * np.finfo(dtype).eps).all()


def test_padded_blocks_stay_where_they_are(x64):
    V = jnp.asarray(np.stack([np.eye(3) * 2, np.zeros((3, 3))]))
    x = solve_blocks(V, jnp.ones((2, 3, 1)).at[1].set(0.0))
    np.testing.assert_allclose(x[..., 0], [[0.5] * 3, [0.0] * 3])


def test_many_corners_in_several_threads_do_not_wait_for_each_other():
    done = subprocess.run([sys.executable, "-c", _FITS_IN_THREADS], capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
