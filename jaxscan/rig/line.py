"""What all axes have in common that move their load along a line, more or less."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.rotation import A, namespace
from jaxscan.precision import Leaf
from jaxscan.rig.motion import unit_vector
from jaxscan.rig.readable import Readable

# A direction that is less than this share of the way is not worth a word.
_A_WORD = 0.25


class Line(Readable):
    """A motion along a line, and how it differs from one.

    Attributes:
        numbers: as `AxisMotion` has it; the first is `per_step`.
        given: which of them a solve takes as they are: they say where something is measured, not how it moves.
        of_the_line: which of them the line itself is.
        per_step: what stands on the stage moves by this in the camera frame for one motor step (mm).
        axis: its name.
    """

    numbers: ClassVar[Mapping[str, int]]
    units: ClassVar[Mapping[str, str]] = {
        "per_step": "mm",
        "bow": "mm",
        "turn": "rad",
        "centre": "mm",
        "wave": "mm",
        "period": "steps",
        "play": "steps",
    }
    given: ClassVar[tuple[str, ...]] = ()
    of_the_line: ClassVar[str] = "per_step"

    per_step: tuple[Leaf, Leaf, Leaf]
    axis: str = eqx.field(static=True, default="stage", kw_only=True)

    def parts(self) -> tuple[Any]:
        """Itself."""
        return (self,)

    @classmethod
    def shape(cls) -> tuple[str, ...]:
        """The numbers that say how it differs from a line: what a solve may hold at first."""
        return tuple(name for name in cls.numbers if name not in (cls.of_the_line, *cls.given))

    def bent(self, by: Float[np.ndarray, "3"], shape: Mapping[str, Float[np.ndarray, "_"]]) -> "Line":
        """The same with a line that goes on by so much more for a step (mm), and with other numbers of its shape."""
        changed = {**shape, self.of_the_line: np.array([float(leaf) for leaf in self.per_step]) + by}
        return replace(self, **{name: tuple(np.asarray(x) for x in numbers) for name, numbers in changed.items()})

    def idle(self) -> Float[A, "0 numbers"]:
        """None."""
        return namespace(*self.per_step).zeros((0, sum(self.numbers.values())))

    def way(self) -> str:
        """Where its load goes as the step count rises, as the camera sees it, in words."""
        words = (("to the left", "to the right"), ("up", "down"), ("towards the camera", "away from the camera"))
        shares = zip(words, self.direction(), strict=True)
        return " and ".join(pair[int(s > 0)] for pair, s in shares if abs(s) > _A_WORD)

    def direction(self) -> Float[np.ndarray, "3"]:
        """Along its travel, where it stands at step 0."""
        return unit_vector(self.per_step)

    def amount(self, steps: float) -> tuple[float, str]:
        """Millimetres."""
        return abs(steps) * float(np.linalg.norm([float(leaf) for leaf in self.per_step])), "mm"


def per_steps(steps: Float[A, "*stack"] | float, leaves: tuple[Leaf, Leaf, Leaf]) -> Float[A, "*stack 3"]:
    """The product of `steps` and the vector of `leaves`."""
    xp = namespace(steps, *leaves)
    return xp.tensordot(xp.asarray(steps), xp.stack([xp.asarray(leaf) for leaf in leaves]), axes=0)


def median_slope(
    positions: Float[np.ndarray, "photographs"], places: Float[np.ndarray, "photographs 3"]
) -> Float[np.ndarray, "3"]:
    """The line, estimated by the median of slopes (H. Theil 1950, P. K. Sen 1968)."""
    i, j = np.triu_indices(len(positions), 1)
    moved = positions[i] != positions[j]
    slopes = (places[j] - places[i])[moved] / (positions[j] - positions[i])[moved, None]
    return np.median(slopes, axis=0)
