"""Charts of directions: the two numbers by which a lens knows a ray, and the direction that they mean.

A lens maps two numbers to two numbers. What these say of a direction depends on how far from its axis the lens sees:

- `FLAT`: x = (X / Z, Y / Z), the ray (x, y, 1). Where a ray goes on straight, x is its image. It ends before 90°.
- `AROUND`: x = θ (X, Y) / √(X² + Y²), θ the angle from the axis: the ray (x sin θ / θ, cos θ), of length 1. It ends
  before 180°, and what it does at 90° is nothing special.

A point X = t ray is at the range t: its depth in a flat chart, its distance from the camera's centre in the other.
"""

from collections.abc import Callable
from typing import Any, Final, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.geometry.rotation import A, namespace

# Of cos √q and sin √q / √q on 0 … π²: by the bytes of a number, so that they are met to its rounding.
_DEGREES: Final = {4: 6, 8: 10}
# Below this tan² θ the angle is taken by its series, which has a derivative on the axis.
_NEAR_AXIS: Final = 1e-6


@runtime_checkable
class Chart(Protocol):
    """How two numbers mean a direction.

    Attributes:
        rows: which coordinates of a point in the camera frame have the squared range as the sum of their squares.
    """

    rows: slice

    def coordinates(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        """Those of the ray to a point of the camera frame, with derivatives, and whether there are any."""
        ...

    def components(
        self, x: Float[Array, "*any"], y: Float[Array, "*any"]
    ) -> tuple[Float[Array, "*any"], Float[Array, "*any"], Float[Array, "*any"]]:
        """The ray's X, Y, Z."""
        ...

    def range_of(self, points: Float[A, "*points 3"]) -> Float[A, "*points"]:
        """T of points = t ray, mm; in a flat chart not positive behind the camera."""
        ...


class _Flat:
    """The plane at right angles to the axis, at the depth 1."""

    rows = slice(2, 3)

    def coordinates(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        in_front = point[2] > 0
        return point[:2] / jnp.where(in_front, point[2], 1.0), in_front

    def components(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        return x, y, jnp.ones_like(x)

    def range_of(self, points: Float[A, "*points 3"]) -> Float[A, "*points"]:
        return points[..., 2]


class _Around:
    """The angle from the axis, in all directions around it."""

    rows = slice(0, 3)

    def coordinates(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        aside2, z = point[0] ** 2 + point[1] ** 2, point[2]
        near = aside2 < _NEAR_AXIS * z * z
        ahead = near & (z > 0)
        # Towards 180° all directions around the axis are one ray.
        there = (aside2 > 0) & ~near | ahead
        aside = jnp.sqrt(jnp.where(near | ~there, 1.0, aside2))
        depth = jnp.where(ahead, z, 1.0)
        tan2 = aside2 / depth**2
        per_aside = jnp.where(ahead, (1 - tan2 / 3 + tan2**2 / 5) / depth, jnp.arctan2(aside, z) / aside)
        return point[:2] * per_aside, there

    def components(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        square = x * x + y * y
        per_angle = _polynomial(square, _SINC)
        return x * per_angle, y * per_angle, _polynomial(square, _COS)

    def range_of(self, points: Float[A, "*points 3"]) -> Float[A, "*points"]:
        return namespace(points).linalg.norm(points, axis=-1)


def _coefficients(function: Callable[[np.ndarray], np.ndarray]) -> dict[int, list[float]]:
    def of_degree(degree: int) -> list[float]:
        fit = np.polynomial.Chebyshev.interpolate(function, degree, domain=[0.0, np.pi**2])
        return fit.convert(kind=np.polynomial.Polynomial).coef.tolist()

    return {size: of_degree(degree) for size, degree in _DEGREES.items()}


def _polynomial(at: Any, coefficients: dict[int, list[float]]) -> Any:
    *lower, highest = coefficients[at.dtype.itemsize]
    total = jnp.full_like(at, highest)
    for c in reversed(lower):
        total = c + at * total
    return total


_COS: Final = _coefficients(lambda square: np.cos(np.sqrt(square)))
_SINC: Final = _coefficients(lambda square: np.sinc(np.sqrt(square) / np.pi))

FLAT: Final[Chart] = _Flat()
AROUND: Final[Chart] = _Around()
