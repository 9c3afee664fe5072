"""A head, or an object, that a robot, a gantry or a tracker moves: a pose is given for each photograph.

With G the given pose, T_base_hand, of what carries the hand (a robot's flange, a tracker's target) in the frame of the
base, the object stands in the camera's frame at

    M(q) = K G⁻¹     the head moves: the camera is on the hand, the object frame is the base's;
    M(q) = K G       the object moves: it is on the hand, the object frame is the hand's.

K takes what the poses leave open, T_camera_hand or T_camera_base: a turn and an offset, x ↦ R (x + offset), found from
photographs of a board (`calibration.hand_eye`). The offset is in the axes of hand or base, because a direction about
which no pose turned is fixed there.

Positions are whole numbers. So the axis `poses` counts the poses of a scan, and what a pose is stands beside it:
`poses.x`, `.y`, `.z` in nanometres and `poses.a`, `.b`, `.c`, its rotation vector, in nanoradians.
"""

from collections.abc import Mapping
from typing import Any, ClassVar, Final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Int

from jaxscan.axis_details import POSES
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.geometry.rotation import A, namespace
from jaxscan.precision import Leaf
from jaxscan.rig.motion import Positions
from jaxscan.rig.readable import Readable

_NUMBERS: Final = ("x", "y", "z", "a", "b", "c")
# Nanometres in a millimetre, nanoradians in a radian.
NM: Final = 1e6
_PER_UNIT: Final = np.array([NM] * 3 + [1e9] * 3)


def positions_of(poses: Pose[np.ndarray]) -> dict[str, Int[np.ndarray, "*poses"]]:
    """Given poses T_base_hand as positions of the axis `poses`: one pose, or a stack of them in the order of frames.

    Equal poses after each other are one position, as equal steps are.
    """
    vector = np.concatenate([poses.translation, poses.rotation], axis=-1)
    whole = np.rint(vector * _PER_UNIT).astype(np.int64)
    moved = np.zeros(whole.shape[:-1], np.int64)
    if whole.ndim > 1:
        moved[1:] = np.cumsum((np.diff(whole, axis=0) != 0).any(axis=-1))
    return {POSES: moved} | {f"{POSES}.{name}": whole[..., i] for i, name in enumerate(_NUMBERS)}


def given_poses(q: Positions) -> Pose:
    """The inverse of `positions_of`; the identity where there is none."""
    numbers = [q.get(f"{POSES}.{name}", 0.0) / unit for name, unit in zip(_NUMBERS, _PER_UNIT, strict=True)]
    xp = namespace(*numbers)
    vector = xp.stack([xp.asarray(number) for number in numbers], axis=-1)
    return Pose(vector[..., 3:], vector[..., :3])


class _GivenPoses(Readable):
    """A motion by given poses.

    Attributes:
        given: a solve of boards holds its numbers; `hand_eye` finds them afterwards.
        rotation: rotation vector of K, radians.
        offset: what K adds before that turn, mm.
        axis: its name.
    """

    kind: ClassVar[str]
    numbers: ClassVar[Mapping[str, int]] = {"rotation": 3, "offset": 3}
    units: ClassVar[Mapping[str, str]] = {"rotation": "rad", "offset": "mm"}
    given: ClassVar[tuple[str, ...]] = ("rotation", "offset")
    fewest: ClassVar[int] = 3

    rotation: tuple[Leaf, Leaf, Leaf]
    offset: tuple[Leaf, Leaf, Leaf]
    axis: str = eqx.field(static=True, default=POSES)

    @classmethod
    def create(cls, rotation: ArrayLike, offset: ArrayLike, axis: str = POSES) -> Any:
        """From twice three numbers (radians, mm)."""
        a, b, c = jnp.asarray(rotation, dtype=float)
        x, y, z = jnp.asarray(offset, dtype=float)
        return cls((a, b, c), (x, y, z), axis)

    @classmethod
    def fitted(
        cls,
        axis: str,
        positions: Float[np.ndarray, "photographs"],
        poses: Pose[np.ndarray],
        middle: Float[np.ndarray, "3"],
    ) -> Any:
        """No steps are its positions.

        Raises:
            InputError: always.
        """
        del positions, poses, middle
        raise InputError(f"the {axis} are given poses, and have no motor steps: list the photographs under [{POSES}]")

    @classmethod
    def at_rest(cls, axis: str) -> Any:
        """One whose camera is the hand or the base: what a solve holds while nothing is known of it."""
        return cls.create(np.zeros(3), np.zeros(3), axis)

    @staticmethod
    def carry(given: Pose[A]) -> Pose[A]:
        """What stands behind K."""
        raise NotImplementedError

    @staticmethod
    def from_hand(given: Pose[np.ndarray], points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """Where points of the object frame lie from the hand, which a wrong given pose turns them about, mm."""
        raise NotImplementedError

    def parts(self) -> tuple[Any]:
        """Itself."""
        return (self,)

    def to_camera(self) -> Pose:
        """K: T_camera_hand of a head that moves, T_camera_base of an object."""
        xp = namespace(*self.rotation, *self.offset)
        w, offset = (xp.stack([xp.asarray(leaf) for leaf in part]) for part in (self.rotation, self.offset))
        return Pose(w, (Pose(w, xp.zeros_like(w)).matrix() @ offset[..., None])[..., 0])

    def pose(self, q: Positions) -> Pose:
        """K and what the given poses say."""
        return self.to_camera() @ self.carry(given_poses(q))

    def idle(self) -> Any:
        """None."""
        return namespace(*self.rotation).zeros((0, sum(self.numbers.values())))

    def way(self) -> str:
        """In words: there are no steps."""
        return "as its poses are given"

    def direction(self) -> Float[np.ndarray, "3"]:
        """Not a number: it has none of its own."""
        return np.full(3, np.nan)

    def amount(self, steps: float) -> tuple[float, str]:
        """Poses have no length each."""
        return abs(steps), POSES


class HeadPoses(_GivenPoses):
    """A head that moves by given poses: the camera is on the hand; the object frame is the base's.

    `HeadPoses.create(rotation, offset)` makes one; `to_camera()` is its K, T_camera_hand.
    """

    kind: ClassVar[str] = "head_poses"

    @staticmethod
    def carry(given: Pose[A]) -> Pose[A]:
        """G⁻¹."""
        return given.inverse()

    @staticmethod
    def from_hand(given: Pose[np.ndarray], points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """G⁻¹ x."""
        return given.inverse().apply(points)


class ObjectPoses(_GivenPoses):
    """An object that moves by given poses: it is on the hand; the object frame is the hand's.

    `ObjectPoses.create(rotation, offset)` makes one; `to_camera()` is its K, T_camera_base.
    """

    kind: ClassVar[str] = "object_poses"

    @staticmethod
    def carry(given: Pose[A]) -> Pose[A]:
        """G."""
        return given

    @staticmethod
    def from_hand(given: Pose[np.ndarray], points: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
        """The points themselves."""
        return points


# By what moves, as session.toml has it.
CARRIED_BY: Final[Mapping[str, type[HeadPoses] | type[ObjectPoses]]] = {"head": HeadPoses, "object": ObjectPoses}
