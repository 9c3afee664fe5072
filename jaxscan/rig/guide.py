"""Linear stages whose guide is bowed, whose screw has a period, or both.

A carriage on a bowed guide moves by n per_step + n² bow, and turns as it follows the guide. The bow may lie across the
travel, as of a rail that sags, or along it, as of a screw whose pitch changes. It turns about a place that is given,
the middle of the board that determined it: so `per_step` and `bow` are the path of what stood there, whatever the turn.

A screw that is not centred, or whose thread is not a true helix, moves its load along the travel to and fro beside the
steps, by a (cos w − 1) + b sin w with w = 2π n / period: nothing at step 0, as of any motion.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float

from jaxscan.geometry import Pose
from jaxscan.geometry.rotation import A, namespace
from jaxscan.precision import Leaf
from jaxscan.rig.line import Line, median_slope, per_steps
from jaxscan.rig.motion import Positions

_Vector = tuple[Leaf, Leaf, Leaf]
# Of a screw whose turn nothing is known of yet, steps.
_SOME_PERIOD: Final = 1e3


class Guide(Line):
    """A motion along a bowed guide.

    Attributes:
        per_step: the travel at step 0 for one motor step, of what stands at the centre (mm, camera frame).
        bow: n² times this is how far it is off that line at step n (mm).
        turn: by which the carriage turns for one motor step, a rotation vector (radians).
        centre: about which it turns, where it stands at step 0 (mm); given.
        axis: its name.
    """

    kind: ClassVar[str] = "guide"
    numbers: ClassVar[Mapping[str, int]] = {"per_step": 3, "bow": 3, "turn": 3, "centre": 3}
    given: ClassVar[tuple[str, ...]] = ("centre",)
    fewest: ClassVar[int] = 4

    bow: _Vector
    turn: _Vector
    centre: _Vector

    @staticmethod
    def create(
        per_step: ArrayLike | Sequence[float],
        bow: ArrayLike | Sequence[float] = (0.0, 0.0, 0.0),
        turn: ArrayLike | Sequence[float] = (0.0, 0.0, 0.0),
        centre: ArrayLike | Sequence[float] = (0.0, 0.0, 0.0),
        axis: str = "stage",
    ) -> "Guide":
        """From four times three numbers."""
        return Guide(_vector(per_step), _vector(bow), _vector(turn), _vector(centre), axis=axis)

    @classmethod
    def fitted(
        cls,
        axis: str,
        positions: Float[np.ndarray, "photographs"],
        poses: Pose[np.ndarray],
        middle: Float[np.ndarray, "3"],
    ) -> "Guide":
        """A line through the board's middle, from which the solve finds the bow."""
        slope, centre = _line_of_middle(positions, poses, middle)
        return cls.create(slope, centre=centre, axis=axis)

    @classmethod
    def at_rest(cls, axis: str) -> "Guide":
        """One that does not move."""
        return cls.create(np.zeros(3), axis=axis)

    def pose(self, q: Positions) -> Pose:
        """The turn n · turn about the centre, then n · per_step + n² · bow."""
        n = q.get(self.axis, 0.0)
        return _turned(n, self.turn, self.centre, per_steps(n, self.per_step) + per_steps(n * n, self.bow))


class Screw(Line):
    """A motion along a line, by a screw that has a period.

    Attributes:
        per_step: the mean travel for one motor step (mm, camera frame).
        wave: a and b: at step n it is ahead of that by a (cos w − 1) + b sin w, w = 2π n / period (mm).
        period: steps of one turn of the screw.
        axis: its name.
    """

    kind: ClassVar[str] = "screw"
    numbers: ClassVar[Mapping[str, int]] = {"per_step": 3, "wave": 2, "period": 1}
    fewest: ClassVar[int] = 8

    wave: tuple[Leaf, Leaf]
    period: tuple[Leaf]

    @staticmethod
    def create(
        per_step: ArrayLike | Sequence[float],
        wave: ArrayLike | Sequence[float] = (0.0, 0.0),
        period: float = _SOME_PERIOD,
        axis: str = "stage",
    ) -> "Screw":
        """From three numbers, two, and one."""
        return Screw(_vector(per_step), _pair(wave), (jnp.asarray(period, dtype=float),), axis=axis)

    @classmethod
    def fitted(
        cls,
        axis: str,
        positions: Float[np.ndarray, "photographs"],
        poses: Pose[np.ndarray],
        middle: Float[np.ndarray, "3"],
    ) -> "Screw":
        """A line, from whose residuals the wave is found."""
        return cls.create(_line_of_middle(positions, poses, middle)[0], axis=axis)

    @classmethod
    def at_rest(cls, axis: str) -> "Screw":
        """One that does not move."""
        return cls.create(np.zeros(3), axis=axis)

    def pose(self, q: Positions) -> Pose:
        """The translation n · per_step, and the wave along it."""
        n = q.get(self.axis, 0.0)
        shift = per_steps(n, self.per_step) + _waved(n, self.per_step, self.wave, self.period)
        return Pose.shift(shift)


class ScrewOnGuide(Line):
    """A motion along a bowed guide, by a screw that has a period: the numbers of `Guide` and of `Screw`."""

    kind: ClassVar[str] = "screw_on_guide"
    numbers: ClassVar[Mapping[str, int]] = {
        "per_step": 3,
        "bow": 3,
        "turn": 3,
        "centre": 3,
        "wave": 2,
        "period": 1,
    }
    given: ClassVar[tuple[str, ...]] = Guide.given
    fewest: ClassVar[int] = 9

    bow: _Vector
    turn: _Vector
    centre: _Vector
    wave: tuple[Leaf, Leaf]
    period: tuple[Leaf]

    @staticmethod
    def create(
        per_step: ArrayLike,
        bow: ArrayLike,
        turn: ArrayLike,
        centre: ArrayLike,
        wave: ArrayLike,
        period: float,
        axis: str = "stage",
    ) -> "ScrewOnGuide":
        """From all its numbers."""
        return ScrewOnGuide.of(Guide.create(per_step, bow, turn, centre, axis), Screw.create(per_step, wave, period))

    @staticmethod
    def of(guide: Guide, screw: Screw) -> "ScrewOnGuide":
        """A guide, and the wave of a screw."""
        return ScrewOnGuide(
            guide.per_step, guide.bow, guide.turn, guide.centre, screw.wave, screw.period, axis=guide.axis
        )

    @classmethod
    def fitted(
        cls,
        axis: str,
        positions: Float[np.ndarray, "photographs"],
        poses: Pose[np.ndarray],
        middle: Float[np.ndarray, "3"],
    ) -> "ScrewOnGuide":
        """A line through the board's middle, from whose residuals bow and wave are found."""
        return cls.of(Guide.fitted(axis, positions, poses, middle), Screw.at_rest(axis))

    @classmethod
    def at_rest(cls, axis: str) -> "ScrewOnGuide":
        """One that does not move."""
        return cls.of(Guide.at_rest(axis), Screw.at_rest(axis))

    def pose(self, q: Positions) -> Pose:
        """The turn n · turn about the centre, then n · per_step + n² · bow, and the wave along per_step."""
        n = q.get(self.axis, 0.0)
        shift = per_steps(n, self.per_step) + per_steps(n * n, self.bow)
        return _turned(n, self.turn, self.centre, shift + _waved(n, self.per_step, self.wave, self.period))


def _turned(n: Float[A, "*stack"] | float, turn: _Vector, centre: _Vector, shift: Float[A, "*stack 3"]) -> Pose:
    xp = namespace(shift, *centre)
    return Pose.about(per_steps(n, turn), xp.stack([xp.asarray(leaf) for leaf in centre]), shift)


def _waved(
    n: Float[A, "*stack"] | float, per_step: _Vector, wave: tuple[Leaf, Leaf], period: tuple[Leaf]
) -> Float[A, "*stack 3"]:
    xp = namespace(n, *per_step, *wave, *period)
    along = xp.stack([xp.asarray(leaf) for leaf in per_step])
    square = (along * along).sum()
    # What does not move yet has no direction to be ahead in.
    length = xp.sqrt(xp.where(square > 0, square, 1.0))
    w = (2 * np.pi / period[0]) * xp.asarray(n)
    ahead = wave[0] * (xp.cos(w) - 1) + wave[1] * xp.sin(w)
    return xp.tensordot(ahead, along / length, axes=0)


def _line_of_middle(
    positions: Float[np.ndarray, "photographs"], poses: Pose[np.ndarray], middle: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """The travel of the board's middle for one step, and where it stands at step 0 (mm)."""
    places = poses.apply(middle[None])[:, 0]
    slope = median_slope(positions, places)
    return slope, np.median(places - positions[:, None] * slope, axis=0)


def _vector(values: ArrayLike | Sequence[float]) -> _Vector:
    a, b, c = jnp.asarray(values, dtype=float)
    return a, b, c


def _pair(values: ArrayLike | Sequence[float]) -> tuple[Leaf, Leaf]:
    a, b = jnp.asarray(values, dtype=float)
    return a, b
