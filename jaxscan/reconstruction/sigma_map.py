"""σ of each point as fast as the point itself: maps over the image in place of derivatives at each pixel.

With w = ω · x the inverse depth of pixel (u, v) and n the motor step count, a point moves along its ray with the rig's
parameters θ and the stripe's position s, to first order, by

    d · X_θ = J₀(u, v) + n J₁(u, v),    J₀ w² and J₁ smooth;    d · X_s = P(u, v),    P w² smooth

so that, with depth z = 1 / w in the camera frame, the variance along the ray is

    σ² = z⁴ A + n z² B + n² C + (z² D σ_s)²,    A = w⁴ J₀ Σ J₀ᵀ,  B = 2 w² J₀ Σ J₁ᵀ,  C = J₁ Σ J₁ᵀ,  D = |P| w²

What is left is as smooth as the lens, out to where the sheet leaves the camera's view: A, B, C and D are kept as
Chebyshev polynomials in u and v, fitted to the exact derivatives (`point_sigma`) on a grid.
"""

from typing import Final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import chebyshev

from jaxscan.reconstruction.point_sigma import jacobian_along
from jaxscan.rig import Covariance, Rig
from jaxscan.rig.projection import pixel_rays

_DEGREE: Final = 10
# Pixels to each side of the image at which the maps are fitted.
_GRID: Final = 24
# A point further than so many times the nearest in view is beyond what any scanner measures.
_FURTHEST: Final = 20.0


class SigmaMap(eqx.Module):
    """The maps of one laser of a rig.

    Attributes:
        maps: Chebyshev coefficients of A, B, C, D in the stripe's position, line by line.
        length: of a line, px.
        depth_per_step: that what stands on the stage gains for one motor step, mm.
    """

    maps: Float[Array, "degrees 4 lines"]
    length: Float[Array, ""]
    depth_per_step: Float[Array, ""]

    @staticmethod
    def create(rig: Rig, laser: str, covariance: Covariance, columns: bool) -> "SigmaMap":
        """The maps of one laser, for stripes found column by column (or row by row)."""
        nodes = np.cos(np.pi * (np.arange(_GRID) + 0.5) / _GRID)
        u, v = (x.ravel() for x in np.meshgrid(nodes, nodes, indexing="ij"))
        width, height = rig.camera.image_size
        pixels = np.stack([(u + 1) / 2 * (width - 1), (v + 1) / 2 * (height - 1)], axis=-1)
        rays = pixel_rays(rig.camera, pixels)
        w = rays @ np.stack([float(c) for c in rig.laser(laser).plane])
        still, of_pixel = jacobian_along(rig, laser, rays, np.zeros(len(pixels)), columns)
        moved, _ = jacobian_along(rig, laser, rays, np.ones(len(pixels)), columns)
        J0, J1, S = still * w[:, None] ** 2, moved - still, covariance.of_leaves(rig)
        products = [np.einsum("pi,ij,pj->p", a, S, b) for a, b in ((J0, J0), (J0, J1), (J1, J1))]
        values = np.stack([products[0], 2 * products[1], products[2], np.abs(of_pixel) * w**2], axis=-1)
        # Where the sheet is out of sight nothing is fitted, and nothing will be asked.
        seen = np.isfinite(values).all(axis=1) & (w > np.nanmax(w) / _FURTHEST)
        basis = chebyshev.chebvander2d(u, v, [_DEGREE, _DEGREE])
        fitted = np.linalg.lstsq(basis[seen], values[seen], rcond=1e-10)[0].reshape(_DEGREE + 1, _DEGREE + 1, 4)
        lines, length = (width, height) if columns else (height, width)
        across = chebyshev.chebvander(2 * np.arange(lines) / (lines - 1) - 1, _DEGREE)
        maps = np.einsum("li,ijm->jml" if columns else "lj,ijm->iml", across, fitted)
        per_step = 0.0 if rig.stage is None else float(rig.stage.per_step[2])
        return SigmaMap(*(jnp.asarray(x, jnp.float32) for x in (maps, length, per_step)))


@jax.jit
def point_sigmas(
    sigma_map: SigmaMap,
    position: Float[Array, "frames lines"],
    points: Float[Array, "frames lines 3"],
    steps: Float[Array, "frames"],
    stripe_sigma_px: Float[Array, "frames lines"],
) -> tuple[Float[Array, "frames lines"], Float[Array, "frames lines"]]:
    """σ of each point along its ray, of rig and pixel together and of the pixel alone (mm).

    Args:
        sigma_map: of the rig.
        position: of the stripe in each line, px.
        points: what it was triangulated to, object frame, mm.
        steps: motor step count of each frame.
        stripe_sigma_px: σ of the position.
    """
    n = steps[:, None]
    z2 = (points[..., 2] + n * sigma_map.depth_per_step) ** 2
    t = 2 * position / (sigma_map.length - 1) - 1
    A, B, C, D = (_clenshaw(sigma_map.maps[:, i, None], t) for i in range(4))
    pixel = z2 * D * stripe_sigma_px
    return jnp.sqrt(jnp.maximum(z2 * z2 * A + n * z2 * B + n * n * C, 0.0) + pixel**2), pixel


def _clenshaw(
    coefficients: Float[Array, "degrees 1 lines"], t: Float[Array, "frames lines"]
) -> Float[Array, "frames lines"]:
    """Σ c_i T_i(t)."""
    later = latest = jnp.zeros_like(t)
    for c in coefficients[:0:-1]:
        later, latest = 2 * t * later - latest + c, later
    return t * later - latest + coefficients[0]
