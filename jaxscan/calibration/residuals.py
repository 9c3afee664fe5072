"""The residuals of the joint solve: raw detector pixels, each divided by its own σ.

Corner: reprojection, predicted minus seen; a circle is predicted as the centre of gravity of its image. Stripe on a
board: with x the pixel's ray and β the board's plane in dual space, the ray meets the board at x / (β · x), and
the light's level there times the inverse depth, h = level(x, β · x), vanishes where the light does: of a flat sheet ω
it is (ω − β) · x. On a board that is not flat its surface's inverse depth along the ray takes the place of β · x.
−h / (∂h/∂v) is the distance in rows from the seen stripe to the predicted one (∂h/∂u, in columns,
for a stripe found row by row). It is differentiated whole, denominator too: holding the denominator still would bias
and spoil the estimate.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxscan.calibration.lens_field import FieldPrior
from jaxscan.geometry import Pose, dual_plane_of
from jaxscan.precision import as_jax
from jaxscan.rig import Light, MovingLight, System
from jaxscan.rig.board_shape import BentBoard, BoardShape, middle_and_half
from jaxscan.rig.light import stood
from jaxscan.rig.motion import carried

# R and t (mm) of a board in each of its photographs.
Stands = tuple[Float[Array, "photographs 3 3"], Float[Array, "photographs 3"]]
# Of a group of blocks the errors of corners (blocks, photographs, corners, 2) and of stripes (blocks, photographs,
# stripe), pixels.
Errors = tuple[Float[Array | np.ndarray, "_ _ _ 2"], Float[Array | np.ndarray, "_ _ _"]]


class Blocks(eqx.Module):
    """Observations of one group of boards, padded to one shape. Masked entries are never read.

    A block is one board that stands still, or that an axis moves, in all its photographs: a view is one of a single
    photograph that no axis moves. Its pose is that at the positions of reference.

    Attributes:
        points: board points, mm.
        q: motor steps of each axis at each photograph; empty for boards that no axis moves.
        reference: motor steps of each axis at which the block's pose stands.
        corners: where the points were seen, pixels.
        weights: relative 1 / σ of each corner.
        corner_used: which corners take part.
        stripe: stripe points, pixels.
        stripe_weights: relative 1 / σ of each stripe point.
        stripe_used: which of them take part.
        stripe_columns: True where v was measured, False where u was.
        stripe_light: which light each belongs to.
        stripe_at: motor steps of the axis that moves that light; None where no light moves.
        radius: of the circles about the points, mm; None where points are seen.
        before: whether all photographs of a block were taken before something was changed (`System.earlier`); None
            where the rig is one.
    """

    points: Float[Array, "*blocks corners 3"]
    q: dict[str, Float[Array, "*blocks photographs"]]
    reference: dict[str, Float[Array, "*blocks"]]
    corners: Float[Array, "*blocks photographs corners 2"]
    weights: Float[Array, "*blocks photographs corners"]
    corner_used: Bool[Array, "*blocks photographs corners"]
    stripe: Float[Array, "*blocks photographs stripe 2"]
    stripe_weights: Float[Array, "*blocks photographs stripe"]
    stripe_used: Bool[Array, "*blocks photographs stripe"]
    stripe_columns: Bool[Array, "*blocks photographs stripe"]
    stripe_light: Int[Array, "*blocks photographs stripe"]
    stripe_at: Float[Array, "*blocks photographs stripe"] | None = None
    radius: Float[Array, "*blocks corners"] | None = None
    before: Bool[Array, "*blocks"] | None = None

    def residuals(
        self, system: System, poses: Float[Array, "blocks size"], noise: "Noise"
    ) -> Float[Array, "blocks residuals"]:
        """The residuals of all blocks, without unit: of each the corners (u, v in turn), the stripe, then its bends."""
        return self.residuals_and_errors(system, poses, noise, self)[0]

    def residuals_and_errors(
        self, system: System, poses: Float[Array, "blocks size"], noise: "Noise", judged: "Blocks"
    ) -> tuple[Float[Array, "blocks residuals"], "Errors"]:
        """The residuals of all blocks, and the errors in pixels of all that is judged, whether it takes part or not."""
        corner, stripe = errors = judged.errors(system, poses)
        corner = jnp.where(self.corner_used[..., None], corner, 0.0) * (self.weights / noise.corner)[..., None]
        corner = corner * _tamed(noise.robustness**2 * (corner**2).sum(-1))[..., None]
        stripe = jnp.where(self.stripe_used, stripe, 0.0) * (self.stripe_weights / noise.stripe)
        stripe = stripe * _tamed(noise.robustness**2 * stripe**2)
        n = len(corner)
        # What is known of the bends beforehand: they are small.
        bends = [] if noise.bend is None else [poses[:, 6:] / noise.bend]
        return jnp.concatenate([corner.reshape(n, -1), stripe.reshape(n, -1), *bends], axis=1), errors

    def errors(self, system: System, poses: Float[Array, "blocks size"]) -> "Errors":
        """All errors in pixels; zero where masked, whatever stands there.

        Where no stripe takes part none is computed: their rays cost more than all else.
        """
        stands = jax.vmap(partial(photograph_poses, system))(poses[:, :6], self)
        corner = jax.vmap(partial(corner_errors, system))(poses, stands, self)

        def of_stripes() -> Float[Array, "blocks photographs stripe"]:
            return jax.vmap(partial(stripe_errors, system))(poses, stands, self)

        stripe = jnp.zeros(self.stripe_used.shape, corner.dtype)
        if system.rig.lights and stripe.size:
            stripe = jax.lax.cond(self.stripe_used.any(), of_stripes, lambda: stripe)
        return corner, stripe

    def start(self, system: System) -> Float[Array, "blocks 6"]:
        """Far away: the poses of boards are found in closed form (`first_poses`)."""
        del system
        return far_away(len(self.points))


def far_away(blocks: int, size: int = 6) -> Float[Array, "blocks size"]:
    """Poses for boards that nothing is known of yet, in front of the camera, one metre away; what else, is 0."""
    return as_jax(np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 1000.0, *np.zeros(size - 6)], (blocks, 1)))


class Noise(eqx.Module):
    """What residuals are divided by, and how far the sum trusts large ones.

    Attributes:
        corner: σ of a corner of weight 1 along each axis, pixels.
        stripe: σ of a stripe point of weight 1, pixels.
        robustness: 1 / c of the pseudo-Huber loss (P. Charbonnier et al. 1994), c in σ; 0 is least squares.
        bend: σ of each board's bulges in addition to the common shape, mm; None where it has none.
        field: what is known of the shifts of a lens that has a field of them; None where it has none.
    """

    corner: Float[Array, ""]
    stripe: Float[Array, ""]
    robustness: Float[Array, ""]
    bend: Float[Array, ""] | None = None
    field: FieldPrior | None = None

    @staticmethod
    def create(corner: float = 1.0, stripe: float = 1.0, robustness: float = 0.0, bend: float | None = None) -> "Noise":
        """From plain numbers; inside a `float64` block."""
        numbers = (corner, stripe, robustness) + (() if bend is None else (bend,))
        return Noise(*as_jax([np.asarray(number, np.float64) for number in numbers]))

    def of(self, corner: float, stripe: float, robustness: float = 0.0) -> "Noise":
        """With other σ of corners and stripe points, and the same of the bends and of a lens's field."""
        bend = None if self.bend is None else float(self.bend)
        return replace(Noise.create(corner, stripe, robustness, bend), field=self.field)

    def robust(self, robustness: float = 1.0) -> "Noise":
        """The same σ with a loss that trusts large residuals less."""
        return self.of(float(self.corner), float(self.stripe), robustness)


def shape_of_block(system: System, pose: Float[Array, "size"]) -> BoardShape | None:
    """The shape of one block's board, its own bends with it; None for a flat one."""
    if system.shape is None or pose.shape[0] == 6:
        return system.shape
    return system.shape.bent(pose[6:])


def corner_errors(
    system: System, pose: Float[Array, "size"], stands: Stands, block: Blocks
) -> Float[Array, "photographs corners 2"]:
    """Predicted minus seen position of each board point, or of the circle about it, pixels; zero where masked."""
    points, camera, shape = block.points, system.where(block.before).rig.camera, shape_of_block(system, pose)
    extent = middle_and_half(points)
    R, t = stands
    seen = jnp.where(block.corner_used[..., None], block.corners, 0.0)

    def error(
        R: Float[Array, "3 3"],
        t: Float[Array, "3"],
        point: Float[Array, "3"],
        corner: Float[Array, "2"],
        radius: Float[Array, ""] | None,
    ) -> Float[Array, "2"]:
        def pixel(at: Float[Array, "2"]) -> Float[Array, "2"]:
            z = point[2]
            if shape is not None:
                middle, half = extent
                z = z + shape.height((at[0] - middle[0]) / half[0], (at[1] - middle[1]) / half[1])
            # Written out, here and below: XLA fuses sums with what surrounds them, but not small matrix products.
            return camera.project(jnp.stack([R[i, 0] * at[0] + R[i, 1] * at[1] + R[i, 2] * z + t[i] for i in range(3)]))

        return (pixel(point[:2]) if radius is None else _centre_of_gravity(pixel, point, radius)) - corner

    of_photograph = jax.vmap(error, in_axes=(None, None, 0, 0, None if block.radius is None else 0))
    errors = jax.vmap(of_photograph, in_axes=(0, 0, None, 0, None))(R, t, points, seen, block.radius)
    return jnp.where(block.corner_used[..., None], errors, 0.0)


def photograph_poses(system: System, pose: Float[Array, "6"], block: Blocks) -> Stands:
    """Where the board of a block stands in each of its photographs: R and t (mm)."""
    motion = system.where(block.before).rig.motion
    R, t = carried(motion, block.q, block.reference, Pose.from_vector(pose))
    return (R, t) if block.q else (R[None], t[None])


def _centre_of_gravity(
    seen: Callable[[Float[Array, "2"]], Float[Array, "2"]],
    centre: Float[Array, "3"],
    radius: Float[Array, ""],
) -> Float[Array, "2"]:
    """The centre of gravity of the image of a disc on the board, px.

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
    light: Light, board: Float[Array, "3"] | BentBoard, x: Float[Array, "3"], dx: Float[Array, "3"]
) -> Float[Array, ""]:
    """Predicted minus seen position of the stripe along the axis in which it was found, pixels.

    Args:
        light: the light.
        board: where it is bent; a flat one's plane in dual space, 1/mm.
        x: the ray of the seen pixel.
        dx: how it changes for each pixel along that axis.
    """

    def height(x: Float[Array, "3"]) -> Float[Array, ""]:
        # Of the light above the board along the ray, times the inverse depth: without it the minimum moves.
        if isinstance(board, BentBoard):
            return light.level(x, board.inverse_depth(x))
        return light.level(x, board[0] * x[0] + board[1] * x[1] + board[2] * x[2])

    h, dh = jax.jvp(height, (x,), (dx,))
    return -h / dh


def stripe_errors(
    system: System, pose: Float[Array, "size"], stands: Stands, block: Blocks
) -> Float[Array, "photographs stripe"]:
    """The stripe's errors of one block in pixels; zero where masked. The rig has a light, the block a stripe."""
    rig, shape, (R, t) = system.where(block.before).rig, shape_of_block(system, pose), stands
    if shape is None:
        board = dual_plane_of(R, t)
    else:
        extent = middle_and_half(block.points)
        board = jax.vmap(lambda R, t: BentBoard.create(shape, R, t, *extent))(R, t)
    pixel = jnp.where(block.stripe_used[..., None], block.stripe, jnp.stack(rig.camera.principal))
    axis = jnp.where(block.stripe_columns[..., None], jnp.array([0.0, 1.0]), jnp.array([1.0, 0.0]))
    x, dx = jax.vmap(jax.vmap(rig.camera.ray_and_change))(pixel, axis)

    def errors(light: Light) -> Float[Array, "photographs stripe"]:
        def error(board: Array | BentBoard, x: Array, dx: Array, at: Array | None) -> Array:
            return stripe_error(light if at is None else stood(light, at), board, x, dx)

        moves = block.stripe_at if isinstance(light, MovingLight) else None
        of_photograph = jax.vmap(error, in_axes=(None, 0, 0, None if moves is None else 0))
        return jax.vmap(of_photograph, in_axes=(0, 0, 0, None if moves is None else 0))(board, x, dx, moves)

    found = errors(rig.lights[0])
    for i, light in enumerate(rig.lights[1:], 1):
        found = jnp.where(block.stripe_light == i, errors(light), found)
    return jnp.where(block.stripe_used, found, 0.0)


def _tamed(square: Float[Array, "*any"]) -> Float[Array, "*any"]:
    """The factor that turns a residual r into one whose square is the pseudo-Huber loss 2c²(√(1 + (r/c)²) − 1)."""
    return jnp.sqrt(2 / (1 + jnp.sqrt(1 + square)))
