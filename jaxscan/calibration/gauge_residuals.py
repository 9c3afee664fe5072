"""The residual of a stripe point on an object of known shape, in detector pixels.

Ray and light give the point P = M(q)⁻¹ (x z) of the object frame, the gauge's pose its place in the
gauge's frame, Rᵀ (P − t). With q the nearest point of the surface and m the normal there, d = m · (Rᵀ (P − t) − q) is
the distance from the surface, and −d / (∂d/∂v) that from the seen stripe to the predicted one in rows (∂d/∂u, in
columns, for a stripe found row by row), as for a stripe on a board. q and m are held while a solve lasts, and found
again between solves; at the end a curved surface errs by nothing, for there d is next to nought.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxscan.calibration.residuals import Noise
from jaxscan.geometry import Pose
from jaxscan.rig import Rig, System


class GaugePoints(eqx.Module):
    """Stripe points on gauges, one block a scan, padded to one shape. Masked entries are never read.

    Attributes:
        stripe: where the stripe was seen, pixels.
        columns: True where v was measured, False where u was.
        q: motor steps of each axis at each point's frame.
        light: which light lit it.
        surface: q, the nearest points of the surface, mm in the gauge's frame.
        normals: m, unit normals there.
        used: which points take part.
        weights: 1 / σ of each, 1/px.
        laid: the pose at which each gauge was aligned: it keeps this in the directions that its shape leaves open (a
            plate may slide in its plane).
        laid_to: how far its pose is taken to be known by that: rotation vector (radians) and translation (mm).
    """

    stripe: Float[Array, "*scans points 2"]
    columns: Bool[Array, "*scans points"]
    q: dict[str, Float[Array, "*scans points"]]
    light: Int[Array, "*scans points"]
    surface: Float[Array, "*scans points 3"]
    normals: Float[Array, "*scans points 3"]
    used: Bool[Array, "*scans points"]
    weights: Float[Array, "*scans points"]
    laid: Float[Array, "*scans 6"]
    laid_to: Float[Array, "*scans 6"]

    def residuals(
        self, system: System, poses: Float[Array, "scans 6"], noise: Noise
    ) -> Float[Array, "scans residuals"]:
        """The residuals of each scan, dimensionless: of the stripe, then of the pose. A gauge has its own weights."""
        del noise
        errors, _ = jax.vmap(lambda pose, scan: gauge_errors(system.rig, pose, scan))(poses, self)
        moved = (poses - self.laid) / self.laid_to
        return jnp.concatenate([errors * jnp.where(self.used, self.weights, 0.0), moved], axis=1)

    def start(self, system: System) -> Float[Array, "scans 6"]:
        """The poses at which the gauges were aligned."""
        del system
        return self.laid


def points_of_object(
    rig: Rig, scan: GaugePoints, pixels: Float[Array, "points 2"]
) -> tuple[Float[Array, "points 3"], Float[Array, "points 3"]]:
    """P of each point of one scan (mm, object frame) and ∂P/∂v, or ∂P/∂u, mm a pixel."""
    back = rig.pose(scan.q).inverse()
    R, t = (jnp.broadcast_to(x, (len(pixels), *x.shape[-k:])) for x, k in ((back.matrix(), 2), (back.translation, 1)))

    def each(
        pixel: Float[Array, "2"], columns: Bool[Array, ""], which: Int[Array, ""], R: Array, t: Array
    ) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        def point(pixel: Float[Array, "2"]) -> Float[Array, "3"]:
            x = rig.camera.ray(pixel)
            inverse_depth = rig.lights[0].inverse_depth(x)
            for i, light in enumerate(rig.lights[1:], 1):
                inverse_depth = jnp.where(which == i, light.inverse_depth(x), inverse_depth)
            return R @ (x / inverse_depth) + t

        axis = jnp.where(columns, jnp.array([0.0, 1.0]), jnp.array([1.0, 0.0]))
        return jax.jvp(point, (pixel,), (axis,))

    return jax.vmap(each)(pixels, scan.columns, scan.light, R, t)


def gauge_errors(
    rig: Rig, pose: Float[Array, "6"], scan: GaugePoints
) -> tuple[Float[Array, "points"], Float[Array, "points"]]:
    """For each point of one scan: predicted minus seen position, px, and ∂d/∂v, mm a pixel; 0 and 1 where masked."""
    T = Pose.from_vector(pose)
    R = T.matrix()
    pixels = jnp.where(scan.used[:, None], scan.stripe, jnp.stack(rig.camera.principal))
    P, along = points_of_object(rig, scan, pixels)
    # R m, the normals in the object frame.
    facing = scan.normals @ R.T
    d = (facing * (P - T.translation[None])).sum(-1) - (scan.normals * scan.surface).sum(-1)
    slope = jnp.where(scan.used, (facing * along).sum(-1), 1.0)
    return jnp.where(scan.used, -d / slope, 0.0), slope
