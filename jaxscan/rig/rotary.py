"""A turntable: what stands on it turns about an axis, by motor steps."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.geometry.rotation import A, namespace
from jaxscan.geometry.turn import axis_point, rate_of_turn
from jaxscan.precision import Leaf
from jaxscan.rig.motion import Positions, unit_vector
from jaxscan.rig.readable import Readable

# An axis within this share of its length of the line of sight's right angle is seen from the side.
_FROM_THE_SIDE = 0.25
# Less cannot be distinguished from the noise of single poses, radians.
_LEAST_TURN = 0.05


class Rotary(Readable):
    """A turn about an axis of the object frame.

    Attributes:
        per_step: rotation vector of one motor step: the axis, times the angle (radians).
        centre: the point of the axis that is nearest to the frame's origin, mm.
        axis: its name.
    """

    kind: ClassVar[str] = "rotary"
    numbers: ClassVar[Mapping[str, int]] = {"per_step": 3, "centre": 3}
    units: ClassVar[Mapping[str, str]] = {"per_step": "rad", "centre": "mm", "play": "steps"}
    # The third shows whether the first two were a turn at all.
    fewest: ClassVar[int] = 3

    per_step: tuple[Leaf, Leaf, Leaf]
    centre: tuple[Leaf, Leaf, Leaf]
    axis: str = eqx.field(static=True, default="turntable")

    @staticmethod
    def create(
        per_step: ArrayLike | Sequence[float], centre: ArrayLike | Sequence[float], axis: str = "turntable"
    ) -> "Rotary":
        """A turntable from twice three numbers (radians for each motor step, mm)."""
        a, b, c = jnp.asarray(per_step, dtype=float)
        x, y, z = jnp.asarray(centre, dtype=float)
        return Rotary((a, b, c), (x, y, z), axis)

    @classmethod
    def fitted(
        cls,
        axis: str,
        positions: Float[np.ndarray, "photographs"],
        poses: Pose[np.ndarray],
        middle: Float[np.ndarray, "3"],
    ) -> "Rotary":
        """The turn, from the median rate and the circle of least absolute distances from the board's middle."""
        w = rate_of_turn(poses.matrix(), positions)
        if (turn := float(np.linalg.norm(w) * np.ptp(positions))) < _LEAST_TURN:
            raise InputError(
                f"the board on the {axis} turned by {np.degrees(turn):.1f}° in {np.ptp(positions):g} steps: turn it by "
                f"30° or more in all, and check the step counts under [{axis}] and that the board turns with the table"
            )
        return cls.create(w, axis_point(poses.apply(middle[None])[:, 0], positions, w)[0], axis)

    @classmethod
    def at_rest(cls, axis: str) -> "Rotary":
        """One that does not turn."""
        return cls.create(np.zeros(3), np.zeros(3), axis)

    def parts(self) -> "tuple[Rotary]":
        """Itself."""
        return (self,)

    def pose(self, q: Positions) -> Pose:
        """X ↦ R (x − centre) + centre, R the turn by n · per_step."""
        steps = q.get(self.axis, 0.0)
        xp = namespace(steps, *self.per_step, *self.centre)
        w, centre = (xp.stack([xp.asarray(leaf) for leaf in part]) for part in (self.per_step, self.centre))
        return Pose.about(xp.tensordot(xp.asarray(steps), w, axes=0), centre)

    def idle(self) -> Float[A, "1 6"]:
        """Where along the axis the centre stands."""
        xp = namespace(*self.per_step)
        w = xp.stack([xp.asarray(leaf) for leaf in self.per_step])
        return xp.concatenate([0 * w, w])[None]

    def way(self) -> str:
        """How its load goes as the step count rises, as the camera sees it, in words."""
        x, y, z = (float(leaf) for leaf in self.per_step)
        if abs(z) > _FROM_THE_SIDE * float(np.linalg.norm([x, y, z])):
            return "clockwise" if z > 0 else "anticlockwise"
        # What is nearest to the camera has the velocity w × (0, 0, −1) = (−y, x, 0).
        to = ("to the left", "to the right")[int(y < 0)] if abs(y) > abs(x) else ("up", "down")[int(x > 0)]
        return f"its near side {to}"

    def direction(self) -> Float[np.ndarray, "3"]:
        """Unit vector of its axis; it turns about it by the right-hand rule."""
        return unit_vector(self.per_step)

    def amount(self, steps: float) -> tuple[float, str]:
        """Degrees."""
        return abs(steps) * float(np.degrees(np.linalg.norm([float(leaf) for leaf in self.per_step]))), "degrees"
