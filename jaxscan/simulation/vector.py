"""Vectors as three separate arrays.

A renderer works on millions of rays at once. XLA fuses arithmetic on three arrays of equal shape into one pass over
memory; it does not do so with a last axis of length three. So a vector here is a tuple of its components, each a
scalar or an array, and all of them broadcast.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float


class Vec(NamedTuple):
    """x, y, z: scalars, or arrays of one shape."""

    x: Float[Array, "*any"]
    y: Float[Array, "*any"]
    z: Float[Array, "*any"]


class Rays(NamedTuple):
    """The points origin + t · direction; the direction need not have length one."""

    origin: Vec
    direction: Vec

    def at(self, t: Float[Array, "*any"]) -> Vec:
        """The points at parameter t."""
        return add(self.origin, scale(self.direction, t))


def vec(array: Any) -> Vec:
    """An array of three numbers as a vector of scalars."""
    return Vec(array[0], array[1], array[2])


def add(a: Vec, b: Vec) -> Vec:
    """The sum."""
    return Vec(a.x + b.x, a.y + b.y, a.z + b.z)


def subtract(a: Vec, b: Vec) -> Vec:
    """The difference, a − b."""
    return Vec(a.x - b.x, a.y - b.y, a.z - b.z)


def scale(a: Vec, factor: Any) -> Vec:
    """A vector times a number."""
    return Vec(a.x * factor, a.y * factor, a.z * factor)


def dot(a: Vec, b: Vec) -> Float[Array, "*any"]:
    """The inner product."""
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: Vec, b: Vec) -> Vec:
    """The outer product, a × b."""
    return Vec(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def select(condition: Any, a: Vec, b: Vec) -> Vec:
    """A where the condition holds, else b."""
    return Vec(jnp.where(condition, a.x, b.x), jnp.where(condition, a.y, b.y), jnp.where(condition, a.z, b.z))
