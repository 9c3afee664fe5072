"""Axes with play: where one stands depends on the side from which it was approached.

Between motor and load there is slack, the play p. While the steps rise the load lags behind them by p / 2, while they
fall it is ahead by p / 2. When an axis turns, the motor crosses the slack before the load follows. So with r the motor
steps since it last turned, signed, the load stands at

    n − sign(r) p / 2 for |r| ≥ |p|,    n − sign(r) (|r| − p / 2) before,

and where r = 0, that is unknown, at n. It is taken to have crossed its slack before it turns again.

A position of one photograph does not say r. So positions have it as an entry of its own, `stage.run` beside `stage`;
axes without play do not look at it. `runs` finds it from the positions in the order in which photographs were taken.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Pose
from jaxscan.geometry.rotation import A, namespace
from jaxscan.precision import Leaf
from jaxscan.rig.guide import Guide, Screw, ScrewOnGuide
from jaxscan.rig.linear import Linear
from jaxscan.rig.motion import AxisMotion, Motion, Positions
from jaxscan.rig.rotary import Rotary

# What the entry of an axis ends in; no name of an axis has a dot.
_RUN: Final = ".run"
# An axis is taken to have reversed last this number of steps before the first photograph: more than any play has.
FAR: Final = 10**9
_SUFFIX: Final = "_with_play"


def run_of(axis: str) -> str:
    """The entry of the positions that says how far an axis has come since it last turned."""
    return axis + _RUN


class Runs:
    """How far an axis has come since it last turned, motor steps, photograph by photograph as they come.

    Equal steps keep the run. The first photograph is taken to have been approached as the second is.
    """

    def __init__(self) -> None:
        self._last: float | None = None
        self._run = 0

    def of(self, steps: Float[np.ndarray, "photographs"] | Int[np.ndarray, "photographs"]) -> Int[np.ndarray, "_"]:
        """The run of the next photographs, signed; 0 while nothing has moved yet."""
        found = []
        for i, n in enumerate(steps.tolist()):
            before = n if self._last is None else self._last
            if not self._run:
                moved = next((m - before for m in steps[i:].tolist() if m != before), 0)
                self._run = FAR * int(np.sign(moved))
            by = n - before
            # Behind a turn it begins again.
            self._run = int(self._run + by if by * self._run >= 0 else by)
            self._last = n
            found.append(self._run)
        return np.array(found, np.int64)


def runs(steps: Float[np.ndarray, "photographs"] | Int[np.ndarray, "photographs"]) -> Int[np.ndarray, "photographs"]:
    """How far an axis has come since it last turned at each of some photographs, in the order they were taken."""
    return Runs().of(steps)


def played_axes(motion: Motion) -> tuple[str, ...]:
    """The axes of a motion that have play."""
    return tuple(part.axis for part in motion.parts() if "play" in part.numbers)


class _WithPlay(eqx.Module):
    """What the kinds with play have beside those without.

    Attributes:
        base: the kind without.
        play: motor steps between where a load stands that is approached by falling steps, and by rising ones.
    """

    base: ClassVar[type[Any]]
    play: tuple[Leaf] = eqx.field(kw_only=True)
    if TYPE_CHECKING:
        # Of the kind without.
        axis: str

    @classmethod
    def from_plain(cls, plain: AxisMotion, play: Leaf | float = 0.0) -> Any:
        """A motion without play, and its play (motor steps)."""
        numbers = {name: getattr(plain, name) for name in plain.numbers}
        return cls(**numbers, play=(jnp.asarray(play, dtype=float),), axis=plain.axis)  # type: ignore[call-arg]

    @classmethod
    def fitted(
        cls,
        axis: str,
        positions: Float[np.ndarray, "photographs"],
        poses: Pose[np.ndarray],
        middle: Float[np.ndarray, "3"],
    ) -> Any:
        """As the kind without play, from which the solve finds it."""
        return cls.from_plain(cls.base.fitted(axis, positions, poses, middle))

    @classmethod
    def at_rest(cls, axis: str) -> Any:
        """One that does not move."""
        return cls.from_plain(cls.base.at_rest(axis))

    def idle(self) -> Float[A, "ways numbers"]:
        """Those of the kind without play."""
        ways, xp = self._plain().idle(), namespace(*self.play)
        return xp.concatenate([ways, xp.zeros((len(ways), 1))], axis=1)

    def pose(self, q: Positions) -> Pose:
        """That of the kind without play where the load stands."""
        n, run = q.get(self.axis, 0.0), q.get(run_of(self.axis), 0.0)
        return self._plain().pose({**q, self.axis: n - _lag(run, self.play[0])})

    def _plain(self) -> Any:
        return self.base(**{name: getattr(self, name) for name in self.base.numbers}, axis=self.axis)


def _lag(run: Float[A, "*stack"] | Int[A, "*stack"] | float, play: Leaf) -> Float[A, "*stack"]:
    """The number of steps by which a load lags behind its motor."""
    xp = namespace(run, play)
    run, play = xp.asarray(run), xp.asarray(play)
    way, far = xp.sign(run), xp.abs(run)
    # With a derivative where the play is 0.
    crossing = xp.where(play < 0, -far, far) - play / 2
    return xp.asarray(way * xp.where(far >= xp.abs(play), play / 2, crossing))


def _with(numbers: Mapping[str, int]) -> dict[str, int]:
    return {**numbers, "play": 1}


class LinearWithPlay(_WithPlay, Linear):
    """A motion along a line, with play."""

    kind: ClassVar[str] = Linear.kind + _SUFFIX
    numbers: ClassVar[Mapping[str, int]] = _with(Linear.numbers)
    base: ClassVar[type[Any]] = Linear


class GuideWithPlay(_WithPlay, Guide):
    """A motion along a bowed guide, with play."""

    kind: ClassVar[str] = Guide.kind + _SUFFIX
    numbers: ClassVar[Mapping[str, int]] = _with(Guide.numbers)
    base: ClassVar[type[Any]] = Guide


class ScrewWithPlay(_WithPlay, Screw):
    """A motion by a screw that has a period, with play."""

    kind: ClassVar[str] = Screw.kind + _SUFFIX
    numbers: ClassVar[Mapping[str, int]] = _with(Screw.numbers)
    base: ClassVar[type[Any]] = Screw


class ScrewOnGuideWithPlay(_WithPlay, ScrewOnGuide):
    """A motion along a bowed guide by a screw that has a period, with play."""

    kind: ClassVar[str] = ScrewOnGuide.kind + _SUFFIX
    numbers: ClassVar[Mapping[str, int]] = _with(ScrewOnGuide.numbers)
    base: ClassVar[type[Any]] = ScrewOnGuide


class RotaryWithPlay(_WithPlay, Rotary):
    """A turn about an axis, with play."""

    kind: ClassVar[str] = Rotary.kind + _SUFFIX
    numbers: ClassVar[Mapping[str, int]] = _with(Rotary.numbers)
    base: ClassVar[type[Any]] = Rotary


def kind_with_play(kind: str) -> str:
    """The name of the kind with play."""
    return kind if kind.endswith(_SUFFIX) else kind + _SUFFIX
