"""The shape of a printed board that is not flat.

With s and t from −1 to 1 along columns and rows, between the outermost points, a point of the board stands at

    z = a (1/3 − s²) + b (1/3 − t²) + c s t + d (1/3 − s²) t + e (1/3 − t²) s

a and b are the bulges along columns and rows: so far the middle stands above the edges, mm (mrcal's two terms, but for
a shift). c is the twist, by which the corners leave the plane. d and e are by how much the bulge of an edge differs
from that of the middle, with the other sign on the edge opposite. The terms are multiples of products of Legendre's
polynomials: on the board they are orthogonal to one another and to 1, s and t, so none is exchanged with the pose.

A positive z is on the far side of the board from the camera.
"""

from collections.abc import Mapping
from typing import Any, Final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from jaxscan.geometry.rotation import A, namespace
from jaxscan.precision import Leaf

# What a board may be taken for: how many terms of shape all photographs share, and whether each bends by itself too.
BOARD_SHAPES: Final = {"flat": (0, False), "bulge": (2, False), "warp": (5, False), "bend": (5, True)}
# Of fewer views of the board such a shape and the camera are one and the same, or the scatter of a few bends is chance.
FEWEST_VIEWS_FOR: Final = {"bulge": 4, "warp": 5, "bend": 6}
# As many as there are.
N_TERMS: Final = 5
# Of each block's own: the two bulges.
BENDS: Final = 2
# Bulges of less than this (mm) are none.
LEAST_BEND_MM: Final = 1e-4
# A shape's range is taken over this number of points in each direction.
_GRID = 21


class BoardShape(eqx.Module):
    """How far a board leaves its plane, mm; see the module.

    Attributes:
        bulge: a, b.
        twist: c, or nothing.
        edge: d, e, or nothing.
    """

    bulge: tuple[Leaf, Leaf]
    twist: tuple[Leaf, ...] = ()
    edge: tuple[Leaf, ...] = ()

    @staticmethod
    def of(numbers: Float[A, "terms"]) -> "BoardShape":
        """From two terms or five, in their order."""
        xp = namespace(numbers)
        each = tuple(xp.asarray(number) for number in numbers)
        return BoardShape((each[0], each[1]), each[2:3], each[3:])

    def bent(self, bend: Float[A, "2"]) -> "BoardShape":
        """The same with bulges added (mm)."""
        xp = namespace(bend, *self.bulge)
        a, b = (xp.asarray(both + own) for both, own in zip(self.bulge, bend, strict=True))
        return BoardShape((a, b), self.twist, self.edge)

    def height(self, s: Float[A, "*points"], t: Float[A, "*points"]) -> Float[A, "*points"]:
        """Z at places of the board (mm)."""
        return self.height_and_slopes(s, t)[0]

    def height_and_slopes(
        self, s: Float[A, "*points"], t: Float[A, "*points"]
    ) -> tuple[Float[A, "*points"], Float[A, "*points"], Float[A, "*points"]]:
        """Z, ∂z/∂s and ∂z/∂t (mm)."""
        xp = namespace(s, t, *self.bulge)
        S, T = 1 / 3 - s * s, 1 / 3 - t * t
        a, b = self.bulge
        z, by_s, by_t = a * S + b * T, -2 * a * s, -2 * b * t
        if self.twist:
            (c,) = self.twist
            z, by_s, by_t = z + c * s * t, by_s + c * t, by_t + c * s
        if self.edge:
            d, e = self.edge
            z, by_s, by_t = z + d * S * t + e * T * s, by_s - 2 * d * s * t + e * T, by_t + d * S - 2 * e * s * t
        return xp.asarray(z), xp.asarray(by_s), xp.asarray(by_t)


class BentBoard(eqx.Module):
    """A bent board where it stands, as rays of the camera meet it.

    Attributes:
        shape: its shape.
        plane: its plane in dual space, β, 1/mm.
        places: two rows, of which s and t of the plane's point on a ray x are the ratio to β · x.
        offsets: −s and −t of the foot of the perpendicular from the camera's centre.
        away: the distance of the plane from the camera's centre along its normal, mm.
    """

    shape: BoardShape
    plane: Float[Array | np.ndarray, "3"]
    places: Float[Array | np.ndarray, "2 3"]
    offsets: Float[Array | np.ndarray, "2"]
    away: Leaf

    @staticmethod
    def create(
        shape: BoardShape, R: Float[A, "3 3"], t: Float[A, "3"], middle: Float[A, "2"], half: Float[A, "2"]
    ) -> "BentBoard":
        """A board of a shape, with the middle and half the extent of its points (mm), that stands at R, t."""
        xp = namespace(R, t, middle, half)
        away = R[0, 2] * t[0] + R[1, 2] * t[1] + R[2, 2] * t[2]
        plane = R[:, 2] / away
        foot = [R[0, i] * t[0] + R[1, i] * t[1] + R[2, i] * t[2] for i in range(2)]
        offsets = xp.stack([(foot[i] + middle[i]) / half[i] for i in range(2)])
        places = xp.stack([R[:, i] / half[i] - offsets[i] * plane for i in range(2)])
        return BentBoard(shape, plane, places, offsets, xp.asarray(away))

    def inverse_depth(self, x: Float[A, "*rays 3"]) -> Float[A, "*rays"]:
        """1 / t of the point t ray at which rays meet the board, 1/mm: of (x, y, 1) one over its depth.

        One step of Newton's method from the plane's, w₀ = β · x: with h the board's height there and q its slope along
        the ray, w = w₀ (1 − h / (n · t + h − q)). What it leaves out is half the curvature times the square of the way
        between the two points along the board: 6e-5 mm for a bulge of 0.5 mm on 160 mm, seen at 60° to its normal.
        """
        # Written out: XLA fuses sums with what surrounds them, but not small matrix products.
        dots = [row[0] * x[..., 0] + row[1] * x[..., 1] + row[2] * x[..., 2] for row in (self.plane, *self.places)]
        w = dots[0]
        s, t = dots[1] / w, dots[2] / w
        z, by_s, by_t = self.shape.height_and_slopes(s, t)
        slope = by_s * (s + self.offsets[0]) + by_t * (t + self.offsets[1])
        return namespace(x, w).asarray(w * (1 - z / (self.away + z - slope)))


def half_diagonal_of(points: Float[A, "points 3"]) -> float:
    """Half the diagonal of the rectangle that a board's points fill, mm."""
    return float(np.linalg.norm(np.ptp(np.asarray(points)[:, :2], axis=0))) / 2


def middle_and_half(points: Float[A, "points 3"]) -> tuple[Float[A, "2"], Float[A, "2"]]:
    """Coordinates of a board's points along columns and rows, mm."""
    xp = namespace(points)
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    return xp.asarray((low + high) / 2), xp.asarray((high - low) / 2)


def places_on_board(points: Float[A, "points 3"]) -> tuple[Float[A, "points"], Float[A, "points"]]:
    """S and t of a board's own points."""
    middle, half = middle_and_half(points)
    s, t = (namespace(points).asarray((points[:, i] - middle[i]) / half[i]) for i in range(2))
    return s, t


def basis(
    s: Float[np.ndarray, "*points"], t: Float[np.ndarray, "*points"], terms: int
) -> Float[np.ndarray, "terms *points"]:
    """The terms at places of the board, each with the coefficient 1 mm."""
    return np.stack([BoardShape.of(each).height(s, t) for each in np.eye(terms)])


def bent_by(
    terms: Float[np.ndarray, "terms"], covariance: Float[np.ndarray, "terms terms"] | None = None
) -> tuple[float, float]:
    """From the lowest to the highest point of a board of this shape, mm, and σ of that (0 without a covariance)."""
    s, t = (each.ravel() for each in np.meshgrid(*(np.linspace(-1, 1, _GRID),) * 2))
    each = basis(s, t, len(terms))
    height = terms @ each
    across = each[:, np.argmax(height)] - each[:, np.argmin(height)]
    sigma = 0.0 if covariance is None else float(np.sqrt(across @ covariance @ across))
    return float(np.ptp(height)), sigma


def shape_in_words(fit: Mapping[str, Any]) -> str | None:
    """What a rig file's `fit` says of the board's shape; None where it was taken to be flat."""
    if "board_shape" not in fit:
        return None
    by, sigma = fit["board_bent_mm"], fit["board_bent_sigma_mm"]
    words = f"bent by {by:.2g} ± {sigma:.1g} mm from its lowest to its highest point"
    if "board_bends_sigma_mm" in fit:
        words += f", and {bulges_in_words(fit['board_bends_sigma_mm'])}"
    return words


def bulges_in_words(sigma_mm: float) -> str:
    """What the σ of the additional bulges of each photograph means."""
    if sigma_mm < 2 * LEAST_BEND_MM:
        return "alike in all photographs"
    return f"from photograph to photograph its bulges differ by {rounded_mm(sigma_mm)} (σ)"


def rounded_mm(value: float) -> str:
    """A length that is known to a tenth of itself or so, or to a hundredth of a millimetre."""
    return f"{value:.2f} mm" if value >= 0.1 else f"{value:.1g} mm"
