"""The laser's own cross-section, where it is no bell: out of focus, flat, sharpened by a camera, with lobes.

What the lines of a frame leave of a Gaussian, they leave alike. With x the distance from the centre over s, the stripe
is taken to be

    f(x) = exp(−x² / 2) (1 + c₄ He₄(x) + c₆ He₆(x))

He the Hermite polynomials. Odd ones are left out: they would move the centre, in some frames and not in others. The
coefficients are those of least squares over all lines, each with a background, height, width and centre of its own:
what these may take of it is projected out, line by line.
"""

from dataclasses import replace
from functools import partial
from math import factorial
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.images.stripes.bell import SHAPE_ORDERS, by_shape
from jaxscan.images.stripes.likelihood import fit
from jaxscan.images.stripes.normal_equations import orthogonal
from jaxscan.images.stripes.ranks import median
from jaxscan.images.stripes.windows import Outline, Pixels, Sensor, Windows

# Steps of the coefficients, and of the profile in each of them.
_ROUNDS, _STEPS = 5, 4
# Of a burnt-out stripe the lines that are not are no sample: they are its ends and edges.
_LEAST_OPEN: Final = 0.5
# A line that is further off than this multiple of what is usual is not asked.
_MOST_OF_USUAL: Final = 8.0
# Coefficients that come to these are none: a stripe has a gap in its middle, or what is left has another cause.
MOST: Final = (0.12, 0.02)
_TINY: Final = 1e-9

Coefficients = tuple[Float[Array, "frames"], ...]


def cross_section(windows: Windows, around: Outline, sensor: Sensor, asked: Bool[Array, "frames"]) -> Coefficients:
    """The coefficients of each frame; 0 of those that are not asked, and of those that are burnt out in most lines."""
    open_ = around.whole[:, 0] & ~windows.full.any(1)
    asked = asked & (open_.mean(1) > _LEAST_OPEN * around.whole.mean((1, 2)))

    def step(_: int, shape: Coefficients) -> Coefficients:
        here = replace(sensor, shape=shape)
        found = fit(windows, around, jax.tree.map(lambda x: x[:, None, None], here), censored=True, steps=_STEPS)
        left = (found.weight * found.residual**2).sum(1)
        known = open_ & jnp.isfinite(found.inverse_sigma[:, 0])
        usual = median(jnp.where(known, left, jnp.nan))[:, None]
        root = jnp.where((known & (left < _MOST_OF_USUAL * usual))[:, None], jnp.sqrt(found.weight), 0.0)
        basis = [root * y for y in orthogonal(found.jacobian, found.factor)]
        own: list[Pixels] = []
        for T in by_shape(found.profile, windows.response.shape[1]):
            z = root * T
            own.append(z - sum(y * (y * z).sum(1, keepdims=True) for y in basis))
        change = _least_squares(own, root * found.residual)
        return tuple(
            jnp.where(asked, jnp.clip(jnp.nan_to_num(c + by), -most, most), 0.0)
            for c, by, most in zip(shape, change, MOST, strict=True)
        )

    zero = jnp.zeros_like(sensor.read)
    return jax.lax.fori_loop(0, _ROUNDS, step, (zero,) * len(MOST))


def _least_squares(columns: list[Pixels], z: Pixels) -> list[Float[Array, "frames"]]:
    """The coefficients by which the columns explain z, of each frame, by orthogonal parts of one after another.

    The columns are much alike, and in float32 the normal equations of `factor` would lose digits.
    """

    def dot(a: Pixels, b: Pixels) -> Float[Array, "frames"]:
        return (a * b).sum((1, 2))

    parts, in_parts = [], []
    for column in columns:
        shares = [dot(column, part) / jnp.maximum(dot(part, part), _TINY) for part in parts]
        in_parts.append(shares)
        parts.append(column - sum(share[:, None, None] * part for share, part in zip(shares, parts, strict=True)))
    found = [dot(part, z) / jnp.maximum(dot(part, part), _TINY) for part in parts]
    for i in reversed(range(len(found))):
        found[i] = found[i] - sum(in_parts[k][i] * found[k] for k in range(i + 1, len(found)))
    return found


def either(which: Bool[np.ndarray, "frames"], one: Sensor, other: Sensor) -> Sensor:
    """One sensor, of a known cross-section, in some frames, and another one in the rest, of bells if it knows none."""
    bells = (jnp.zeros_like(one.read),) * len(MOST)
    return jax.tree.map(partial(jnp.where, which), one, replace(other, shape=other.shape or bells))


def size_of(shape: Coefficients) -> Float[np.ndarray, "frames"]:
    """What is beside the bell, in parts of it: of normalised Hermite polynomials the root of the sum of squares."""
    return np.sqrt(sum(factorial(n) * np.asarray(c) ** 2 for c, n in zip(shape, SHAPE_ORDERS, strict=True)))
