"""Two sides that overlap: which points belong together, and how their distance moves with the two poses.

With p and n of one side, q and m of the other, all in the common frame, the residual is

    r = (p − q) · (n + m) / |n + m|.

It is zero, to second order in |p − q|, for any two points of a surface of constant curvature (S. Rusinkiewicz, "A
symmetric objective function for ICP", 2019): that p and q are not the same point costs nothing, and no grid has to be
interpolated. Its σ is √(σ_p² + σ_q²).

Points belong together where q is the nearest to p, their normals differ by less than 45°, and neither is on the rim of
its side: what lies beyond the other's rim is not overlap (Turk and Levoy 1994).
"""

from dataclasses import dataclass
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxscan.geometry import Pose, vector_to_matrix
from jaxscan.kept_programs import compiled
from jaxscan.precision import float64
from jaxscan.robust import NORMAL_MAD
from jaxscan.surface.side import Side

_SAME_WAY: Final = np.cos(np.radians(45.0))
# Tukey's biweight in units of the residuals' scatter: 95 % efficient for a normal distribution.
_TUKEY: Final = 4.685
# Matches are padded to multiples of this many, so that pairs share a compilation.
_BUCKET: Final = 1024
_SEED: Final = 2003


@dataclass(frozen=True)
class Matches:
    """Points of two sides that belong together, each way round.

    Attributes:
        first: numbers of points of the one side.
        second: of the other.
        overlap: the part of the points looked up, of the side with the larger part, that have a partner.
    """

    first: Int[np.ndarray, "matches"]
    second: Int[np.ndarray, "matches"]
    overlap: float

    def __len__(self) -> int:
        return len(self.first)


@dataclass(frozen=True)
class Equations:
    """The residuals of a pair, linear in small motions of both sides.

    Attributes:
        residual: r, mm.
        J: ∂r of (rotation, translation) of the one side, then of the other; radians about the given centre, mm.
        sigma: of r, mm.
        weight: of r² / σ², from 0 to 1 (Tukey's).
        scale: the scatter of r / σ, by its median.
    """

    residual: Float[np.ndarray, "matches"]
    J: Float[np.ndarray, "matches 12"]
    sigma: Float[np.ndarray, "matches"]
    weight: Float[np.ndarray, "matches"]
    scale: float


def sample(side: Side, most: int) -> Int[np.ndarray, "points"]:
    """Some points of a side, none on its rim; always the same ones."""
    inner = np.flatnonzero(~side.rim)
    return np.sort(np.random.default_rng(_SEED).permutation(inner)[:most])


def match(a: Side, b: Side, T_a: Pose, T_b: Pose, reach: float, most: int) -> Matches:
    """The points of two sides that belong together.

    Args:
        a: the one side.
        b: the other.
        T_a: where the one stands.
        T_b: where the other stands.
        reach: how far apart two points may be, mm.
        most: points of each side that are looked up.
    """
    T_b_a = T_b.inverse() @ T_a
    p, q = _one_way(a, b, T_b_a, reach, most)
    q2, p2 = _one_way(b, a, T_b_a.inverse(), reach, most)
    looked_up = [max(1, min(most, int((~side.rim).sum()))) for side in (a, b)]
    overlap = max(len(p) / looked_up[0], len(q2) / looked_up[1])
    return Matches(np.concatenate([p, p2]), np.concatenate([q, q2]), overlap)


def _one_way(
    a: Side, b: Side, T_b_a: Pose, reach: float, most: int
) -> tuple[Int[np.ndarray, "matches"], Int[np.ndarray, "matches"]]:
    p = sample(a, most)
    points, normals = _moved(a, p, T_b_a)
    away, q = b.tree.query(points, distance_upper_bound=reach)
    q = np.where(np.isfinite(away), q, 0)
    alike = (normals * b.normals[q]).sum(axis=1) > _SAME_WAY
    good = np.isfinite(away) & alike & ~b.rim[q]
    return p[good], q[good]


def _moved(
    side: Side, index: Int[np.ndarray, "points"], T: Pose
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
    """Some points of a side and their normals, carried along."""
    R = T.matrix()
    return side.points[index] @ R.T + T.translation, side.normals[index] @ R.T


def equations(a: Side, b: Side, T_a: Pose, T_b: Pose, matches: Matches, centre: Float[np.ndarray, "3"]) -> Equations:
    """The residuals of matches, their derivatives and weights.

    Args:
        a: the one side.
        b: the other.
        T_a: where the one stands.
        T_b: where the other stands.
        matches: of their points.
        centre: what small rotations turn about, common frame, mm.
    """
    i, j = matches.first, matches.second
    (p, n), (q, m) = _moved(a, i, T_a), _moved(b, j, T_b)
    vectors = [p - centre, n, q - centre, m]
    short = -len(i) % _BUCKET
    with float64():
        padded = [jnp.asarray(np.pad(v, ((0, short), (0, 0)), constant_values=1.0)) for v in vectors]
        r, J = (np.asarray(x)[: len(i)] for x in _linearised(*padded))
    sigma = np.hypot(a.sigma[i], b.sigma[j])
    scale = NORMAL_MAD * float(np.median(np.abs(r / sigma))) if len(r) else np.inf
    u = r / (sigma * _TUKEY * max(scale, 1.0))
    return Equations(r, J, sigma, np.clip(1 - u**2, 0, None) ** 2, scale)


@compiled()
def _linearised(p: Array, n: Array, q: Array, m: Array) -> tuple[Float[Array, "matches"], Float[Array, "matches 12"]]:
    """Residuals and their derivatives by x ↦ exp(ω) x + τ of each side, at none."""

    def residual(motion: Array, p: Array, n: Array, q: Array, m: Array) -> Array:
        R, S = vector_to_matrix(motion[:3]), vector_to_matrix(motion[6:9])
        middle = R @ n + S @ m
        apart = R @ p + motion[3:6] - S @ q - motion[9:]
        return apart @ middle / jnp.linalg.norm(middle)

    def both(*vectors: Array) -> tuple[Array, Array]:
        still = jnp.zeros(12, vectors[0].dtype)
        return residual(still, *vectors), jax.jacfwd(residual)(still, *vectors)

    return jax.vmap(both)(p, n, q, m)
