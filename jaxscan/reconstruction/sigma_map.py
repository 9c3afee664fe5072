"""σ of each point as fast as the point itself: maps over the image in place of derivatives at each pixel.

With w(x) the inverse depth of pixel (u, v) with ray x, d = x / |x|, and O(q) the derivative of what the motion brings
to the camera's centre at positions q by the motion's numbers (`rig.motion.origin_shift`), a point moves along its ray
with the rig's parameters θ and the stripe's position s, to first order, by

    d · X_θ = J(u, v) − d · O(q),    J w² smooth;    d · X_s = P(u, v),    P w² smooth

so that, with the range z = 1 / w (the depth, or of a fisheye the distance: `rig.chart`) and m = −Oᵀ d, the variance
along the ray is

    σ² = z⁴ A + z² B · m + mᵀ S m + (z² D σ_s)²,    A = w⁴ J Σ Jᵀ,  B = 2 w² J Σ_m,  D = P w²,

S the covariance of the motion's numbers and Σ_m their columns of Σ. What is left is as smooth as the lens, out to where
the sheet leaves the camera's view: A, B, D and d are kept as Chebyshev polynomials in u and v, fitted to the exact
derivatives (`point_sigma`) on a grid.
"""

from collections.abc import Mapping
from functools import partial
from typing import Final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import chebyshev

from jaxscan.kept_programs import compiled
from jaxscan.reconstruction.point_sigma import PositionsOfPoints, jacobian_along, motion_shifts
from jaxscan.rig import Covariance, MovingLight, Rig
from jaxscan.rig.chart import AROUND
from jaxscan.rig.light import inverse_depths, light_at
from jaxscan.rig.projection import pixel_rays
from jaxscan.rig.rig import leaves_of

_DEGREE: Final = 10
# Of a fisheye, over whose image rays turn by up to 300°.
_DEGREE_AROUND: Final = 26
# Pixels to each side of the image at which the maps are fitted, for each degree.
_PIXELS_PER_DEGREE: Final = 2.4
# A point further than this multiple of the nearest distance in view is beyond what any scanner measures.
_FURTHEST: Final = 20.0
# Degrees, or mm, from one place of a light that moves to the next at which maps are made.
_APART: Final = 1.0


class SigmaMap(eqx.Module):
    """The maps of one light of a rig.

    Attributes:
        maps: Chebyshev coefficients of A, D, the three numbers of d and those of B in the stripe's position, line by
            line; of a light that moves, for each frame.
        length: of a line, px.
        S: covariance of the motion's numbers.
    """

    maps: Float[Array, "degrees maps *frames lines"]
    length: Float[Array, ""]
    S: Float[Array, "numbers numbers"]

    @staticmethod
    def create(
        rig: Rig, light: str, covariance: Covariance, columns: bool, q: Mapping[str, float] | None = None
    ) -> "SigmaMap":
        """The maps of one light, for stripes found column by column (or row by row).

        Of a light that moves, where it stands at positions of the axes, motor steps, or else in the middle.
        """
        degree = _DEGREE_AROUND if rig.camera.chart is AROUND else _DEGREE
        grid = round(_PIXELS_PER_DEGREE * degree)
        nodes = np.cos(np.pi * (np.arange(grid) + 0.5) / grid)
        u, v = (x.ravel() for x in np.meshgrid(nodes, nodes, indexing="ij"))
        width, height = rig.camera.image_size
        pixels = np.stack([(u + 1) / 2 * (width - 1), (v + 1) / 2 * (height - 1)], axis=-1)
        rays = pixel_rays(rig.camera, pixels)
        each = {axis: np.full(len(rays), float(steps)) for axis, steps in (q or {}).items()}
        w, _, _ = inverse_depths(light_at(rig.light(light), q or {}), rays)
        still, of_pixel = jacobian_along(rig, light, rays, each, columns)
        J, S, at = still * w[:, None] ** 2, covariance.of_leaves(rig), leaves_of(rig, "motion.")
        # What the motion's numbers move is in m, frame by frame.
        J[:, at] = 0.0
        A = np.einsum("pi,ij,pj->p", J, S, J)
        d = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        values = np.concatenate([np.stack([A, of_pixel * w**2], axis=-1), d, 2 * J @ S[:, at]], axis=-1)
        # Where the sheet is out of sight nothing is fitted, and nothing will be asked.
        seen = np.isfinite(values).all(axis=1) & (w > np.nanmax(w) / _FURTHEST)
        basis = chebyshev.chebvander2d(u, v, [degree, degree])
        # A spans decades, and where it is small it is known as well, in proportion.
        weight = 1 / np.sqrt(np.maximum(A[seen], max(1e-9 * A[seen].max(initial=0.0), 1e-300)))[:, None]
        weight /= np.median(weight) if seen.any() else 1.0
        fitted = np.linalg.lstsq(weight * basis[seen], weight * values[seen], rcond=1e-10)[0]
        fitted = fitted.reshape(degree + 1, degree + 1, -1)
        lines, length = (width, height) if columns else (height, width)
        across = chebyshev.chebvander(2 * np.arange(lines) / (lines - 1) - 1, degree)
        maps = np.einsum("li,ijm->jml" if columns else "lj,ijm->iml", across, fitted)
        return SigmaMap(*(jnp.asarray(np.asarray(x, np.float32)) for x in (maps, length, S[np.ix_(at, at)])))

    def at(self, q: PositionsOfPoints) -> "SigmaMap":
        """The maps of some frames, by the positions of the axes at each: the same of all."""
        del q
        return self


class MovedFrames(eqx.Module):
    """How the motion carried some frames.

    Attributes:
        rows: those of T_camera_object that take a point to what the square of its range is the sum of the squares of.
        shifts: O, mm for each unit of the motion's numbers.
    """

    rows: Float[Array, "frames rows 4"]
    shifts: Float[Array, "frames 3 numbers"]

    @staticmethod
    def create(rig: Rig, q: PositionsOfPoints, frames: int) -> "MovedFrames":
        """The frames of a rig at positions of its axes, one for each frame."""
        pose = rig.pose({axis: np.asarray(steps, np.float64) for axis, steps in q.items()})
        both = np.concatenate([np.asarray(pose.matrix()), np.asarray(pose.translation)[..., None]], axis=-1)
        rows = both[..., rig.camera.chart.rows, :]
        rows = np.broadcast_to(rows, (frames, *rows.shape[-2:]))
        shifts = motion_shifts(rig, q, frames)
        return MovedFrames(jnp.asarray(rows, jnp.float32), jnp.asarray(shifts, jnp.float32))


@compiled()
def point_sigmas(
    sigma_map: SigmaMap,
    frames: MovedFrames,
    position: Float[Array, "frames lines"],
    points: Float[Array, "frames lines 3"],
    stripe_sigma_px: Float[Array, "frames lines"],
) -> tuple[Float[Array, "frames lines"], Float[Array, "frames lines"]]:
    """σ of each point along its ray, of rig and pixel together and of the pixel alone (mm).

    Args:
        sigma_map: of the rig.
        frames: how the motion carried them.
        position: of the stripe in each line, px.
        points: what it was triangulated to, object frame, mm.
        stripe_sigma_px: σ of the position.
    """
    z2 = jnp.zeros_like(position)
    for row in jnp.moveaxis(frames.rows, 1, 0)[:, :, None]:
        at = row[..., 0] * points[..., 0] + row[..., 1] * points[..., 1] + row[..., 2] * points[..., 2] + row[..., 3]
        z2 = z2 + at**2
    t = 2 * position / (sigma_map.length - 1) - 1
    maps = sigma_map.maps if sigma_map.maps.ndim == 4 else sigma_map.maps[:, :, None]
    A, D, x, y, z, *B = (_clenshaw(maps[:, i], t) for i in range(maps.shape[1]))
    shifts, S = frames.shifts[:, None], sigma_map.S
    m = [-(shifts[..., 0, k] * x + shifts[..., 1, k] * y + shifts[..., 2, k] * z) for k in range(len(B))]
    variance = z2 * z2 * A
    for k, of_rig in enumerate(B):
        variance = variance + m[k] * (z2 * of_rig + S[k, k] * m[k])
        for other in range(k):
            variance = variance + 2 * S[k, other] * m[k] * m[other]
    pixel = jnp.abs(z2 * D) * stripe_sigma_px
    return jnp.sqrt(jnp.maximum(variance, 0.0) + pixel**2), pixel


def _clenshaw(
    coefficients: Float[Array, "degrees frames_or_1 lines"], t: Float[Array, "frames lines"]
) -> Float[Array, "frames lines"]:
    """Σ c_i T_i(t)."""
    later = latest = jnp.zeros_like(t)
    for c in coefficients[:0:-1]:
        later, latest = 2 * t * later - latest + c, later
    return t * later - latest + coefficients[0]


class SweptMap:
    """The maps of a light that moves: made where it stands every degree or millimetre, and linear between.

    Args:
        rig: the rig.
        light: which of its lights.
        covariance: of the rig's parameters.
        columns: whether stripes are found column by column.
    """

    def __init__(self, rig: Rig, light: str, covariance: Covariance, columns: bool) -> None:
        moved = rig.light(light)
        assert isinstance(moved, MovingLight)
        self._axis = moved.axis
        self._apart = _APART / moved.amount(1.0)[0]
        self._create = partial(SigmaMap.create, rig, light, covariance, columns)
        self._made: dict[int, SigmaMap] = {}

    def at(self, q: PositionsOfPoints) -> SigmaMap:
        """The maps of some frames, by the positions of the axes at each."""
        at = np.asarray(q[self._axis], np.float64) / self._apart
        below = np.floor(at).astype(int)
        low, high = ([self._of(k + by) for k in below.tolist()] for by in (0, 1))
        part = (at - below).astype(np.float32)[:, None]
        maps = [np.stack([np.asarray(one.maps) for one in each], axis=2) for each in (low, high)]
        return SigmaMap(jnp.asarray(maps[0] + part * (maps[1] - maps[0])), low[0].length, low[0].S)

    def _of(self, k: int) -> SigmaMap:
        if k not in self._made:
            self._made[k] = self._create({self._axis: k * self._apart})
        return self._made[k]
