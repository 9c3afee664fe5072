"""What carries the object: where its frame stands in the camera's for given positions of the axes.

The object frame is the camera frame while all axes stand at 0. A motion is a pytree of numbers with a `kind`, which the
rig file names; which kinds there are is listed in `rig.kinds`.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.geometry import Pose
from jaxscan.geometry.rotation import A, namespace
from jaxscan.precision import Leaf

# Motor steps of each axis, by its name; all of one shape. An axis that is not named stands at 0. Beside an axis's own
# there may be details of it: `stage.run` (`rig.play`), `poses.x` (`rig.given_poses`).
Positions = Mapping[str, Any]


@runtime_checkable
class Motion(Protocol):
    """A rigid motion by the positions of named axes. A pytree whose leaves are its numbers."""

    def parts(self) -> "tuple[AxisMotion, ...]":
        """The motions of single axes that it is made of, from the room to the object."""
        ...

    def pose(self, q: Positions) -> Pose:
        """T_camera_object at given positions, a stack of them where the positions are arrays (mm)."""
        ...


@runtime_checkable
class AxisMotion(Motion, Protocol):
    """The motion of one axis.

    A kind some of whose numbers are taken as they are, and not sought, names them in a further attribute, `given`.

    Attributes:
        kind: what the rig file calls it.
        numbers: its numbers in their order, and how many each has; the first are its travel or turn.
        fewest: positions at which a board must have been seen to find it.
        axis: the name of its axis.
    """

    kind: ClassVar[str]
    numbers: ClassVar[Mapping[str, int]]
    fewest: ClassVar[int]
    axis: str

    @classmethod
    def fitted(
        cls,
        axis: str,
        positions: Float[np.ndarray, "photographs"],
        poses: Pose[np.ndarray],
        middle: Float[np.ndarray, "3"],
    ) -> "AxisMotion":
        """A start for a solve: the motion of a board that was seen at these places (T_camera_board).

        Args:
            axis: the name of the axis.
            positions: motor steps of each photograph, two different ones at least.
            poses: where the board stood in each; one that is wrong must have no say.
            middle: of the board, mm in its own frame.

        Raises:
            InputError: the board did not move so.
        """
        ...

    @classmethod
    def at_rest(cls, axis: str) -> "AxisMotion":
        """One that does not move: what a solve holds while nothing is known of the axis."""
        ...

    def idle(self) -> Float[A, "ways numbers"]:
        """Ways along which its numbers, in their order, can be changed by any amount and it stays the same motion."""
        ...

    def way(self) -> str:
        """Where its load goes as the step count rises, as the camera sees it, in words."""
        ...

    def direction(self) -> Float[np.ndarray, "3"]:
        """Unit vector of its travel, or of its axis."""
        ...

    def amount(self, steps: float) -> tuple[float, str]:
        """How far `steps` motor steps move it, and the unit: mm or degrees."""
        ...


class Fixed(eqx.Module):
    """No motion: the object stays where it is."""

    def parts(self) -> tuple[AxisMotion, ...]:
        """None."""
        return ()

    def pose(self, q: Positions) -> Pose:
        """The identity, whatever the positions."""
        return _still(q)


class Chain(eqx.Module):
    """A chain of motions: the last carries the object, and each carries the next one.

    Attributes:
        links: the motions, from the room to the object.
    """

    links: tuple[AxisMotion, ...]

    def parts(self) -> tuple[AxisMotion, ...]:
        """The links."""
        return self.links

    def pose(self, q: Positions) -> Pose:
        """The product of the links' poses, in their order. A link whose axis is not among the positions stands at 0."""
        pose = _still(q)
        for i, link in enumerate(link for link in self.links if link.axis in q):
            pose = pose @ link.pose(q) if i else link.pose(q)
        return pose


def _still(q: Positions) -> Pose:
    shape = np.shape(next(iter(q.values()), 0.0))
    return Pose(np.zeros((*shape, 3)), np.zeros((*shape, 3)))


def motion_of(parts: tuple[AxisMotion, ...]) -> Motion:
    """The motion of some axes, from the room to the object; `Fixed` of none."""
    return (parts[0] if len(parts) == 1 else Chain(parts)) if parts else Fixed()


def carried(motion: Motion, q: Positions, reference: Positions, pose: Pose) -> tuple[Array, Array]:
    """Where what stood at a pose at positions of reference stands at others: M(q) M(reference)⁻¹ T, as R and t.

    Link by link and in matrices: no rotation is composed of others, and a link that only shifts multiplies nothing.

    Args:
        motion: what carries it.
        q: the positions, a stack of them.
        reference: one for all.
        pose: T_camera_body at the reference.

    Returns:
        Rotation matrices and translations (mm), stacked as the positions are.
    """
    R, t = pose.matrix(), pose.translation
    if not q:
        return R, t
    links = [link for link in motion.parts() if link.axis in q]
    for then in (link.pose(reference) for link in links):
        t = t - then.translation
        if not then.only_shifts:
            R, t = _turned(then.matrix().T, R, t)
    stack = (None,) * np.ndim(next(iter(q.values())))
    R, t = R[stack], t[stack]
    for now in (link.pose(q) for link in reversed(links)):
        if not now.only_shifts:
            R, t = _turned(now.matrix(), R, t)
        t = t + now.translation
    return jnp.broadcast_to(R, (*t.shape, 3)), t


def _turned(
    M: Float[Array, "*stack 3 3"], R: Float[Array, "*some 3 3"], t: Float[Array, "*some 3"]
) -> tuple[Float[Array, "*stack 3 3"], Float[Array, "*stack 3"]]:
    moved = M @ jnp.stack([R[..., 0], R[..., 1], R[..., 2], t], axis=-1)
    return moved[..., :3], moved[..., 3]


def origin_shift(motion: Motion, q: Positions, other: Motion) -> Float[Array, "*stack 3"]:
    """How far another motion carries what this one brings to the camera's centre, mm.

    Its derivative by the other's numbers, where both are the same, shows how an error of the motion moves points along
    their rays: a turn about the camera's centre does not.
    """
    one, two = motion.pose(q), other.pose(q)
    back = -(one.matrix().swapaxes(-1, -2) @ jnp.asarray(one.translation)[..., None])
    return (two.matrix() @ back)[..., 0] + two.translation


def normal_motion(motion: Motion) -> Motion:
    """The same motion by the numbers that the rig file keeps: without anything along the ways that are idle."""

    def normal(part: AxisMotion) -> AxisMotion:
        leaves, structure = jax.tree.flatten(part)
        xp = namespace(*leaves)
        numbers = xp.stack([xp.asarray(leaf) for leaf in leaves])
        for way in part.idle():
            numbers = numbers - way * (way @ numbers) / (way @ way)
        return jax.tree.unflatten(structure, list(numbers))

    return motion_of(tuple(normal(part) for part in motion.parts()))


def unit_vector(leaves: tuple[Leaf, Leaf, Leaf]) -> Float[np.ndarray, "3"]:
    """The direction of a part's three numbers."""
    vector = np.array([float(leaf) for leaf in leaves])
    return vector / np.linalg.norm(vector)
