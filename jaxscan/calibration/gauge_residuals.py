"""The residual of a stripe point on an object of known shape, in detector pixels.

Ray and light plane give the point P = x / (ω · x) − n · per_step of the object frame, the gauge's pose its place in the
gauge's frame, Rᵀ (P − t). With q the nearest point of the surface and m the normal there, d = m · (Rᵀ (P − t) − q) is
the distance from the surface, and −d / (∂d/∂v) that from the seen stripe to the predicted one in rows (∂d/∂u, in
columns, for a stripe found row by row), as for a stripe on a board. q and m are held while a solve lasts, and found
anew between solves; at the end a curved surface errs by nothing, for there d is next to nought.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxscan.calibration.residuals import Noise
from jaxscan.geometry import Pose
from jaxscan.rig import BoardWarp, Rig


class GaugePoints(eqx.Module):
    """Stripe points on gauges, one block a scan, padded to one shape. Masked entries are never read.

    Attributes:
        stripe: where the stripe was seen, pixels.
        columns: True where v was measured, False where u was.
        steps: motor steps of each point's frame.
        laser: which laser lit it.
        surface: q, the nearest points of the surface, mm in the gauge's frame.
        normals: m, unit normals there.
        used: which points take part.
        weights: 1 / σ of each, 1/px.
        laid: the pose at which each gauge was laid in: there it stays along what its shape leaves open (a plate may
            slide in its plane).
        laid_to: how far its pose is taken to be known by that: rotation vector (radians) and translation (mm).
    """

    stripe: Float[Array, "*scans points 2"]
    columns: Bool[Array, "*scans points"]
    steps: Float[Array, "*scans points"]
    laser: Int[Array, "*scans points"]
    surface: Float[Array, "*scans points 3"]
    normals: Float[Array, "*scans points 3"]
    used: Bool[Array, "*scans points"]
    weights: Float[Array, "*scans points"]
    laid: Float[Array, "*scans 6"]
    laid_to: Float[Array, "*scans 6"]

    def residuals(
        self, rig: Rig, warp: BoardWarp | None, poses: Float[Array, "scans 6"], noise: Noise
    ) -> Float[Array, "scans residuals"]:
        """The residuals of each scan, dimensionless: of the stripe, then of the pose. A gauge has its own weights."""
        del warp, noise
        errors, _ = jax.vmap(lambda pose, scan: gauge_errors(rig, pose, scan))(poses, self)
        moved = (poses - self.laid) / self.laid_to
        return jnp.concatenate([errors * jnp.where(self.used, self.weights, 0.0), moved], axis=1)


def point_of_object(
    rig: Rig, omega: Float[Array, "3"], pixel: Float[Array, "2"], columns: Bool[Array, ""], steps: Float[Array, ""]
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """P (mm, object frame) and ∂P/∂v, or ∂P/∂u, mm a pixel."""

    def point(pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        x = rig.camera.ray(pixel)
        P = x / (omega @ x)
        return P if rig.stage is None else P - rig.stage.displacement(steps)

    axis = jnp.where(columns, jnp.array([0.0, 1.0]), jnp.array([1.0, 0.0]))
    return jax.jvp(point, (pixel,), (axis,))


def gauge_errors(
    rig: Rig, pose: Float[Array, "6"], scan: GaugePoints
) -> tuple[Float[Array, "points"], Float[Array, "points"]]:
    """Of each point of one scan: predicted minus seen position, pixels, and ∂d/∂v, mm a pixel; 0 and 1 where masked."""
    T = Pose.from_vector(pose)
    R = T.matrix()
    omegas = jnp.stack([laser.omega for laser in rig.lasers])[scan.laser]
    pixels = jnp.where(scan.used[:, None], scan.stripe, jnp.stack(rig.camera.principal))
    P, along = jax.vmap(lambda *each: point_of_object(rig, *each))(omegas, pixels, scan.columns, scan.steps)
    # R m, the normals in the object frame.
    facing = scan.normals @ R.T
    d = (facing * (P - T.translation[None])).sum(-1) - (scan.normals * scan.surface).sum(-1)
    slope = jnp.where(scan.used, (facing * along).sum(-1), 1.0)
    return jnp.where(scan.used, -d / slope, 0.0), slope
