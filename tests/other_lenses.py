"""Lenses that are none of OpenCV's: one that is symmetric about its axis, one that is not, one that is not smooth."""

from contextlib import contextmanager
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxscan.rig import LENSES, register_lens


class Division(eqx.Module):
    """x = x_d / (1 + λ r_d²) (A. Fitzgibbon 2001). Derivatives of its inverse are withheld."""

    kind = "division"
    numbers: ClassVar = {"division": 1}
    pinhole = True

    division: tuple

    @classmethod
    def nominal(cls):
        return cls((jnp.zeros(()),))

    def distort(self, x):
        return 2 * x / (1 + jnp.sqrt(1 - 4 * self.division[0] * (x @ x)))

    def undistort(self, xd):
        return jax.lax.stop_gradient(xd / (1 + self.division[0] * (xd @ xd)))

    def invertible_radius(self, dtype):
        return jnp.asarray(10.0, dtype)


class Prism(eqx.Module):
    """x_d = x + r² s: a lens that was ground askew, its shares of x and of y by names of their own."""

    kind = "prism"
    numbers: ClassVar = {"across": 1, "along": 1}
    pinhole = True

    across: tuple
    along: tuple

    @classmethod
    def nominal(cls):
        return cls((jnp.zeros(()),), (jnp.zeros(()),))

    def distort(self, x):
        return x + (x @ x) * jnp.stack([self.across[0], self.along[0]])

    def undistort(self, xd):
        return jax.lax.fori_loop(0, 60, lambda _, x: xd + x - self.distort(x), xd)

    def invertible_radius(self, dtype):
        return jnp.asarray(10.0, dtype)


class Faceted(Division):
    """A division lens with a kink at every twentieth of the radius."""

    kind = "faceted"

    def distort(self, x):
        r = jnp.sqrt(x @ x)
        return x * (1 + self.division[0] * jnp.abs(jnp.sin(20 * jnp.pi * r)))

    def undistort(self, xd):
        return jax.lax.fori_loop(0, 60, lambda _, x: xd + x - self.distort(x), xd)


@contextmanager
def registered(*kinds):
    """Among the kinds of lens while it lasts."""
    for kind in kinds:
        register_lens(kind)
    try:
        yield
    finally:
        for kind in kinds:
            del LENSES[kind.kind]
