"""Functions of one point or pixel, for any number of them."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from jaxscan.errors import InputError


def over_batch(
    one: Callable[..., Array], size: int, what: str, values: ArrayLike | Sequence[Any], *beside: Any
) -> Array:
    """Apply a function to each vector of an array, along the last axis.

    Args:
        one: of one vector, and what stands beside it.
        size: how many numbers a vector has.
        what: which function this is, and what it takes, in words, for the error.
        values: shape (…, size).
        beside: pytrees of arrays of the same batch shape (…), one entry for each vector.

    Returns:
        Shape (…, numbers of the result); for one vector alone the result itself.

    Raises:
        InputError: the last axis has another length.
    """
    array: ArrayLike = jnp.asarray(values, float) if isinstance(values, Sequence) else values
    shape = jnp.shape(array)
    if not shape or shape[-1] != size:
        raise InputError(f"{what}, in an array of shape ({size},) or (…, {size}); this one has the shape {shape}")
    if len(shape) == 1:
        return one(array, *beside)
    flat = jnp.reshape(jnp.asarray(array), (-1, size))
    rest = [jax.tree.map(lambda x: jnp.reshape(x, -1), tree) for tree in beside]
    found = jax.vmap(one)(flat, *rest)
    return jnp.reshape(found, (*shape[:-1], found.shape[-1]))
