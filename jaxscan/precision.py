"""Float64 or float32 as the work needs it, whatever the caller's JAX configuration says."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float64

from jaxscan.errors import InputError

# Number of items that are computed at once where a compiled function serves any number.
AT_ONCE: Final = 1024
# A number of a rig: JAX's in a computation, NumPy's in a rig at rest (`as_numpy`).
Leaf = Float[Array | np.ndarray, ""]
# Of a stack of lights or motions there is one for each.
Leaves = Float[Array | np.ndarray, "*stack"]


@contextmanager
def float64() -> Iterator[None]:
    """Run a block in float64 and leave the caller's configuration as it was.

    Raises:
        InputError: called inside a trace (jit, grad, vmap) of a caller who has not enabled x64: the values that are
            traced would already be float32.
    """
    # A constant made inside a jit is a tracer too.
    if jnp.zeros(()).dtype == jnp.float32 and isinstance(jnp.zeros(()), jax.core.Tracer):
        raise InputError(
            "calibration runs in float64 and cannot be traced in float32: to differentiate through it, put "
            'jax.config.update("jax_enable_x64", True) before anything else'
        )
    with jax.enable_x64(True):
        yield


@contextmanager
def float32() -> Iterator[None]:
    """Run a block in float32 and leave the caller's configuration as it was."""
    with jax.enable_x64(False):
        yield


def as_float64(tree: Any) -> Any:
    """The same pytree with JAX float64 leaves; inside a `float64` block."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), tree)


def as_jax(tree: Any) -> Any:
    """The same pytree with JAX leaves, of arrays that nobody writes to later: they may share their memory.

    `jnp.asarray` would compile a copy for every shape.
    """
    return jax.device_put(tree)


def as_numpy(tree: Any) -> Any:
    """The same pytree with NumPy leaves, which keep their precision outside of `float64`."""
    return jax.tree.map(np.asarray, tree)


def batches_of(
    values: Float[np.ndarray, "values numbers"], size: int = AT_ONCE
) -> Float64[np.ndarray, "batches size numbers"]:
    """Padded with zeros to batches of one size, at least one: any number of them shares one compiled function."""
    padded = np.zeros((max(-(-len(values) // size), 1) * size, values.shape[1]))
    padded[: len(values)] = values
    return padded.reshape(-1, size, values.shape[1])
