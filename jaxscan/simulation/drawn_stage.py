"""A stage that is no line, as a machine has it: a carriage on the arc of a circle, driven by a screw that wobbles.

Drawn by formulas of its own, not by the kinds of motion that a calibration fits: the guide is a circle, on which the
carriage turns as a rigid body about the circle's centre; the screw is ahead of its steps by a sine of its turn; and the
load lags behind the motor by half of its play, but for so much as the motor has not yet crossed since it turned.
"""

from collections.abc import Mapping
from typing import ClassVar, Final

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.geometry import Pose, vector_to_matrix
from jaxscan.precision import Leaf
from jaxscan.rig import Positions, ScrewOnGuide, run_of
from jaxscan.rig.line import Line
from jaxscan.rig.play import ScrewOnGuideWithPlay

_Vector = tuple[Leaf, Leaf, Leaf]
# A guide that is off a line by less has a circle too large for its numbers, mm.
_STRAIGHT: Final = 1e-9


class DrawnStage(Line):
    """The motion of a stage by motor steps.

    Attributes:
        per_step: the mean travel of one motor step along the guide's tangent at step 0 (mm, camera frame).
        towards: to which side the guide is bowed, at right angles to that, unit.
        origin: where the carriage stands at step 0 (mm, camera frame).
        sag: how far the middle of the travel is off the line through its ends (mm).
        over: that travel, from step 0 (mm).
        wave: by how much the screw is ahead at most (mm).
        period: steps of one turn of the screw.
        phase: of its sine at step 0 (radians).
        play: by how much farther on the carriage stands when it comes back (mm).
        turning: whether the carriage follows the guide's tangent; otherwise it is only shifted.
        axis: its name.
    """

    kind: ClassVar[str] = "drawn"
    numbers: ClassVar[Mapping[str, int]] = {
        "per_step": 3,
        "towards": 3,
        "origin": 3,
        **dict.fromkeys(("sag", "over", "wave", "period", "phase", "play"), 1),
    }
    fewest: ClassVar[int] = 2

    towards: _Vector
    origin: _Vector
    sag: tuple[Leaf]
    over: tuple[Leaf]
    wave: tuple[Leaf]
    period: tuple[Leaf]
    phase: tuple[Leaf]
    play: tuple[Leaf]
    turning: bool = eqx.field(static=True, default=True, kw_only=True)

    @staticmethod
    def create(
        per_step: Float[np.ndarray, "3"],
        *,
        sag_mm: float = 0.0,
        over_mm: float = 60.0,
        towards: Float[np.ndarray, "3"] | None = None,
        origin: Float[np.ndarray, "3"] | None = None,
        wave_mm: float = 0.0,
        period: float = 3200.0,
        phase: float = 0.0,
        play_mm: float = 0.0,
        turning: bool = True,
    ) -> "DrawnStage":
        """From plain numbers; bowed away from the camera, about a place before it, unless they say otherwise."""
        along = per_step / np.linalg.norm(per_step)
        side = np.array([0.0, 0.0, 1.0]) if towards is None else towards
        side = side - (side @ along) * along
        place = np.array([0.0, 0.0, 350.0]) if origin is None else origin
        a, b, c = (_leaves(each) for each in (per_step, side / np.linalg.norm(side), place))
        numbers = [(np.asarray(number, np.float64),) for number in (sag_mm, over_mm, wave_mm, period, phase, play_mm)]
        return DrawnStage(a, b, c, *numbers, turning=turning)

    @classmethod
    def fitted(
        cls,
        axis: str,
        positions: Float[np.ndarray, "photographs"],
        poses: Pose[np.ndarray],
        middle: Float[np.ndarray, "3"],
    ) -> "DrawnStage":
        """Refused: it is what photographs are drawn with.

        Raises:
            InputError: always.
        """
        raise InputError(f"the {axis} is drawn, not found: calibrate it as one of the kinds of a stage's motion")

    @classmethod
    def at_rest(cls, axis: str) -> "DrawnStage":
        """Refused, as `fitted`."""
        raise InputError(f"the {axis} is drawn, not found: calibrate it as one of the kinds of a stage's motion")

    def pose(self, q: Positions) -> Pose[np.ndarray]:
        """The carriage on its circle, brought back to the identity at step 0."""
        n = np.asarray(q.get(self.axis, 0.0), np.float64)
        sag, over, ahead, period, phase = self._plain()
        step, side, origin = (np.array(each, np.float64) for each in (self.per_step, self.towards, self.origin))
        w = 2 * np.pi * n / period + phase
        s = n * np.linalg.norm(step) + ahead * (np.sin(w) - np.sin(phase))
        come = np.asarray(q.get(run_of(self.axis), 0.0), np.float64) * np.linalg.norm(step)
        play = float(self.play[0])
        s = s - np.sign(come) * (np.clip(np.abs(come), 0.0, play) - play / 2)
        along = step / np.linalg.norm(step)
        if abs(sag) < _STRAIGHT:
            shift = s[..., None] * along
            return Pose(np.zeros_like(shift), shift)
        radius = ((over / 2) ** 2 + sag**2) / (2 * sag)
        centre = origin + radius * side
        turn = (s / radius)[..., None] * np.cross(along, side)
        moved = Pose.about(turn, centre)
        if self.turning:
            return moved
        # Of the carriage's place alone.
        R = vector_to_matrix(turn)
        shift = (R @ (origin - centre)) + centre - origin
        return Pose(np.zeros_like(shift), shift)

    def _plain(self) -> tuple[float, float, float, float, float]:
        sag, over, wave, period, phase = (
            float(each[0]) for each in (self.sag, self.over, self.wave, self.period, self.phase)
        )
        return sag, over, wave, period, phase

    def nearest_kind(self) -> ScrewOnGuide:
        """The same as a rig file can have it; the circle as a parabola: 0.1 mm over 60 mm are alike to 0.003 mm."""
        step, side = (np.array(each, np.float64) for each in (self.per_step, self.towards))
        sag, over, ahead, period, phase = self._plain()
        length = np.linalg.norm(step)
        curve = 0.0 if abs(sag) < _STRAIGHT else 2 * sag / ((over / 2) ** 2 + sag**2)
        turn = curve * np.cross(step, side) if self.turning else np.zeros(3)
        wave = ahead * np.array([np.sin(phase), np.cos(phase)])
        bow = 0.5 * curve * length**2 * side
        found = ScrewOnGuide.create(step, bow, turn, np.array(self.origin), wave, period, self.axis)
        play = float(self.play[0])
        return ScrewOnGuideWithPlay.from_plain(found, play / float(length)) if play else found


def _leaves(vector: Float[np.ndarray, "3"]) -> _Vector:
    a, b, c = (np.asarray(x, np.float64) for x in vector)
    return a, b, c
