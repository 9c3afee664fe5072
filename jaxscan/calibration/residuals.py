"""The residuals of the joint solve: raw detector pixels, each divided by its own σ.

Corner: reprojection, predicted minus seen; a circle is predicted as the centre of gravity of its image. Stripe on a
board: light plane ω and board plane β are both linear in a pixel's ray x at equal depth, so h = (ω − β) · x vanishes
where the sheet meets the board, and −h / (∂h/∂v) is the distance in rows from the seen stripe to the predicted one
(∂h/∂u, in columns, for a stripe found row by row). It is differentiated whole, denominator too: holding the denominator
still would bias and spoil the estimate.
"""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxscan.geometry import Pose, dual_plane
from jaxscan.rig import BoardWarp, Rig


class Blocks(eqx.Module):
    """Observations of one group of boards, padded to one shape. Masked entries are never read.

    A view is a block with step counts 0. A sequence on stage or turntable is one block as well: the corners of all its
    photographs, each with its step counts. Its pose is that at the counts of reference.

    Attributes:
        points: board points, mm.
        relative: the same in 0 … 1 along columns and rows, for the board's warp.
        corners: where they were seen, pixels.
        weights: relative 1 / σ of each corner.
        corner_used: which corners take part.
        steps: motor steps of the stage at each corner's photograph, relative to the block's reference.
        stripe: stripe points, pixels.
        stripe_weights: relative 1 / σ of each stripe point.
        stripe_used: which of them take part.
        stripe_columns: True where v was measured, False where u was.
        stripe_laser: which laser each belongs to.
        turns: motor steps of the turntable, as `steps`; None where no block was turned.
        radius: of the circles about the points, mm; None where points are seen.
    """

    points: Float[Array, "*blocks corners 3"]
    relative: Float[Array, "*blocks corners 2"]
    corners: Float[Array, "*blocks corners 2"]
    weights: Float[Array, "*blocks corners"]
    corner_used: Bool[Array, "*blocks corners"]
    steps: Float[Array, "*blocks corners"]
    stripe: Float[Array, "*blocks stripe 2"]
    stripe_weights: Float[Array, "*blocks stripe"]
    stripe_used: Bool[Array, "*blocks stripe"]
    stripe_columns: Bool[Array, "*blocks stripe"]
    stripe_laser: Int[Array, "*blocks stripe"]
    turns: Float[Array, "*blocks corners"] | None = None
    radius: Float[Array, "*blocks corners"] | None = None

    def residuals(
        self, rig: Rig, warp: BoardWarp | None, poses: Float[Array, "blocks 6"], noise: "Noise"
    ) -> Float[Array, "blocks residuals"]:
        """The residuals of all blocks, dimensionless: of each the corners (u, v in turn), then stripe.

        Where no stripe takes part none is computed: their rays cost more than all else.
        """
        corner = jax.vmap(partial(corner_errors, rig, warp))(poses, self)
        corner = corner * (self.weights / noise.corner)[..., None]
        corner = corner * _tamed(noise.robustness**2 * (corner**2).sum(-1))[..., None]

        def stripe_residuals() -> Float[Array, "blocks stripe"]:
            stripe = jax.vmap(partial(stripe_errors, rig))(poses, self) * (self.stripe_weights / noise.stripe)
            return stripe * _tamed(noise.robustness**2 * stripe**2)

        stripe = jnp.zeros(self.stripe_used.shape, corner.dtype)
        if rig.lasers and stripe.size:
            stripe = jax.lax.cond(self.stripe_used.any(), stripe_residuals, lambda: stripe)
        return jnp.concatenate([corner.reshape(len(corner), -1), stripe], axis=1)


class Noise(eqx.Module):
    """What residuals are divided by, and how far the sum trusts large ones.

    Attributes:
        corner: σ of a corner of weight 1 along each axis, pixels.
        stripe: σ of a stripe point of weight 1, pixels.
        robustness: 1 / c of the pseudo-Huber loss (P. Charbonnier et al. 1994), c in σ; 0 is least squares.
    """

    corner: Float[Array, ""]
    stripe: Float[Array, ""]
    robustness: Float[Array, ""]


def corner_error(
    rig: Rig,
    warp: BoardWarp | None,
    R: Float[Array, "3 3"],
    t: Float[Array, "3"],
    point: Float[Array, "3"],
    relative: Float[Array, "2"],
    steps: Float[Array, ""],
    corner: Float[Array, "2"],
    turns: Float[Array, ""] | None = None,
    radius: Float[Array, ""] | None = None,
) -> Float[Array, "2"]:
    """Predicted minus seen position of a board point, or of the circle about it, pixels."""
    if warp is not None:
        point = point + jnp.array([0.0, 0.0, 1.0]) * warp.height(relative)

    def seen(at: Float[Array, "2"]) -> Float[Array, "2"]:
        # Written out, here and below: XLA fuses sums with what surrounds them, but not small matrix products.
        X = jnp.stack([R[i, 0] * at[0] + R[i, 1] * at[1] + R[i, 2] * point[2] + t[i] for i in range(3)])
        if turns is not None and rig.turntable is not None:
            X = rig.turntable.turned(turns).apply(X)
        if rig.stage is not None:
            X = X + rig.stage.displacement(steps)
        return rig.camera.project(X)

    if radius is None:
        return seen(point[:2]) - corner
    return _centre_of_gravity(seen, point, radius) - corner


def _centre_of_gravity(
    seen: Callable[[Float[Array, "2"]], Float[Array, "2"]],
    centre: Float[Array, "3"],
    radius: Float[Array, ""],
) -> Float[Array, "2"]:
    """Of the image of a disc on the board.

    The mean of the image u over the disc, weighted by how much |∂u / ∂(x, y)| each part of it is enlarged, by four
    points that have the disc's second moments: what is left out is of the fourth order in the radius. Perspective and
    lens are both in it.
    """
    apart = radius / np.sqrt(2) * jnp.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    at = centre[None, :2] + apart
    u, J = jax.vmap(seen)(at), jax.vmap(jax.jacfwd(seen))(at)
    enlarged = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
    return (u * enlarged[:, None]).sum(0) / enlarged.sum()


def stripe_error(
    rig: Rig, beta: Float[Array, "3"], omega: Float[Array, "3"], pixel: Float[Array, "2"], columns: Bool[Array, ""]
) -> Float[Array, ""]:
    """Predicted minus seen position of the stripe along the axis in which it was found, pixels."""
    axis = jnp.where(columns, jnp.array([0.0, 1.0]), jnp.array([1.0, 0.0]))
    x, dx = rig.camera.ray_and_change(pixel, axis)
    a, b, c = omega - beta
    return -(a * x[0] + b * x[1] + c * x[2]) / (a * dx[0] + b * dx[1])


def block_errors(
    rig: Rig, warp: BoardWarp | None, pose: Float[Array, "6"], block: Blocks
) -> tuple[Float[Array, "corners 2"], Float[Array, "stripe"]]:
    """All errors of one block in pixels; zero where masked, whatever stands there."""
    corner = corner_errors(rig, warp, pose, block)
    if not rig.lasers or block.stripe.shape[0] == 0:
        return corner, jnp.zeros(block.stripe.shape[0], corner.dtype)
    return corner, stripe_errors(rig, pose, block)


def corner_errors(
    rig: Rig, warp: BoardWarp | None, pose: Float[Array, "6"], block: Blocks
) -> Float[Array, "corners 2"]:
    """The corners' errors of one block in pixels; zero where masked."""
    R = Pose.from_vector(pose).matrix()
    seen = jnp.where(block.corner_used[:, None], block.corners, 0.0)
    corner = jax.vmap(lambda *each: corner_error(rig, warp, R, pose[3:], *each))(
        block.points, block.relative, block.steps, seen, block.turns, block.radius
    )
    return jnp.where(block.corner_used[:, None], corner, 0.0)


def stripe_errors(rig: Rig, pose: Float[Array, "6"], block: Blocks) -> Float[Array, "stripe"]:
    """The stripe's errors of one block in pixels; zero where masked. The rig has a laser, the block a stripe."""
    centre = jnp.stack(rig.camera.principal)
    beta = dual_plane(Pose.from_vector(pose))
    omegas = jnp.stack([laser.omega for laser in rig.lasers])
    omega = jnp.broadcast_to(omegas[:1], (block.stripe.shape[0], 3)) if len(omegas) == 1 else omegas[block.stripe_laser]
    pixel = jnp.where(block.stripe_used[:, None], block.stripe, centre)
    stripe = jax.vmap(lambda *each: stripe_error(rig, beta, *each))(omega, pixel, block.stripe_columns)
    return jnp.where(block.stripe_used, stripe, 0.0)


def _tamed(square: Float[Array, "*any"]) -> Float[Array, "*any"]:
    """The factor that turns a residual r into one whose square is the pseudo-Huber loss 2c²(√(1 + (r/c)²) − 1)."""
    return jnp.sqrt(2 / (1 + jnp.sqrt(1 + square)))
