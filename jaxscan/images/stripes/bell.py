"""The model of a stripe's profile: a bell, or nearly one, averaged over pixels.

A sheet of Gaussian cross-section, blurred by a lens and averaged over pixels of unit width, is seen in pixel k as

    μ_k = b + A P_k,    P_k = √(π/2) s [erf(x₊ / √2) − erf(x₋ / √2)],    x± = (k ± ½ − c) / s

with centre c, standard deviation s, height A and background b. A laser that is no bell has Hermite polynomials
besides, as `cross_section` finds them.
"""

from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscan.images.stripes.windows import Lines, Pixels

# Full width at half maximum of a bell, in its standard deviation: √(8 ln 2).
FWHM = 2.354820
# Of the Hermite polynomials by which a cross-section may differ from a bell.
SHAPE_ORDERS: Final = (4, 6)
_ROOT_HALF, _ROOT_HALF_PI = 0.70710678, 1.2533141


class Profile(NamedTuple):
    """θ, for each line: b, ln A, ln s, c."""

    background: Lines
    ln_height: Lines
    ln_s: Lines
    centre: Lines


def pixels(profile: Profile, size: int, shape: tuple[Lines, ...] | None) -> tuple[Pixels, tuple[Pixels, ...]]:
    """A P and J of each pixel; of a laser that is no bell by the coefficients of its cross-section."""
    A, s = jnp.exp(profile.ln_height), jnp.exp(profile.ln_s)
    x = _edges(profile, size)
    bell = jnp.exp(-0.5 * x * x)
    upto = _ROOT_HALF_PI * jax.lax.erf(_ROOT_HALF * x)
    if shape is not None:
        He = hermite(x, SHAPE_ORDERS[-1])
        upto = upto - bell * sum(c * He[n - 1] for c, n in zip(shape, SHAPE_ORDERS, strict=True))
        bell = bell * (1 + sum(c * He[n] for c, n in zip(shape, SHAPE_ORDERS, strict=True)))
    P = A * s * _between(upto)
    return P, (jnp.ones_like(P), P, P - A * s * _between(x * bell), -A * _between(bell))


def by_shape(profile: Profile, size: int) -> list[Pixels]:
    """The derivatives of A P by the coefficients of the cross-section."""
    A, s = jnp.exp(profile.ln_height), jnp.exp(profile.ln_s)
    x = _edges(profile, size)
    He, bell = hermite(x, SHAPE_ORDERS[-1]), jnp.exp(-0.5 * x * x)
    return [-A * s * _between(bell * He[n - 1]) for n in SHAPE_ORDERS]


def _edges(profile: Profile, size: int) -> Float[Array, "groups edges lines"]:
    edge = jnp.arange(size + 1, dtype=jnp.float32)[None, :, None] - 0.5
    return (edge - profile.centre) / jnp.exp(profile.ln_s)


def hermite(x: Array, last: int) -> list[Array]:
    """He₀ to the last of the Hermite polynomials: He_(n+1) = x He_n − n He_(n−1)."""
    found = [jnp.ones_like(x), x]
    for n in range(1, last):
        found.append(x * found[n] - n * found[n - 1])
    return found


def _between(at_edges: Float[Array, "groups edges lines"]) -> Pixels:
    return at_edges[:, 1:] - at_edges[:, :-1]
