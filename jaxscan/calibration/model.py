"""What a calibration takes camera, sheets, board and axes to be, and how that was chosen."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from jaxscan.rig import MOTIONS, LightPlane

# What has an error of this or more is written without digits after the point.
_WHOLE: Final = 10.0


@dataclass(frozen=True)
class Model:
    """What `calibrate` estimates in addition to the parameters that every rig has.

    Attributes:
        lens: the kind of the lens.
        tilted: whether the sensor is tilted.
        board_shape: of the board.
        lights: the kind of each laser's sheet.
        motion: the kind of those axes that differ from what their photographs say, by their names.
        periods: steps of one turn of an axis's screw, by its name, where they are known.
    """

    lens: str = "radial1"
    tilted: bool = False
    board_shape: str = "flat"
    lights: tuple[str, ...] = ()
    motion: Mapping[str, str] = field(default_factory=dict)
    periods: Mapping[str, float] = field(default_factory=dict)

    def asked(self) -> dict[str, Any]:
        """The arguments of `calibrate`."""
        return {
            "lens": self.lens,
            "tilted": self.tilted,
            "board_shape": self.board_shape,
            "light": self.lights,
            "motion": dict(self.motion),
            "periods": {axis: each for axis, each in self.periods.items() if self._has_period(axis)},
        }

    def _has_period(self, axis: str) -> bool:
        return axis in self.motion and "period" in MOTIONS[self.motion[axis]].numbers

    def in_words(self) -> str:
        """What it is: `lens brown, board bend, sheet bowed`."""
        parts = [f"lens {self.lens}" + (" on a tilted sensor" if self.tilted else ""), f"board {self.board_shape}"]
        parts += [f"sheet {kind}" for kind in dict.fromkeys(self.lights)]
        parts += [f"{axis} {kind}" for axis, kind in self.motion.items()]
        return ", ".join(parts)

    def beyond(self, other: "Model") -> str:
        """What it has that another has not, in words."""
        parts = [f"lens {self.lens}"] if self.lens != other.lens else []
        parts += ["tilted sensor"] if self.tilted != other.tilted else []
        parts += [f"board {self.board_shape}"] if self.board_shape != other.board_shape else []
        before = (*other.lights, *(LightPlane.kind,) * len(self.lights))[: len(self.lights)]
        changed = [now for now, then in zip(self.lights, before, strict=True) if now != then]
        parts += [f"sheet {kind}" for kind in dict.fromkeys(changed)]
        parts += [f"{axis} {kind}" for axis, kind in self.motion.items() if other.motion.get(axis) != kind]
        return ", ".join(parts)


@dataclass(frozen=True)
class Trial:
    """A model that was tried beside a simpler one.

    Attributes:
        model: it.
        of: what it has beyond the simpler one, in words.
        why: what asked for it, in words.
        gain: by how much −2 log of the density falls at which the others predict a photograph, in the mean of
            all photographs; NaN where one of the two was not solved.
        error: the standard error of that, from photograph to photograph.
        taken: whether it took the place of the simpler one.
        refused: why it could not be solved, "" where it was.
    """

    model: Model
    of: str
    why: str
    gain: float
    error: float
    taken: bool
    refused: str = ""


@dataclass(frozen=True)
class Choice:
    """How a model was chosen.

    Attributes:
        model: the one.
        trials: those that were tried, in their order.
    """

    model: Model
    trials: tuple[Trial, ...]

    def as_data(self) -> dict[str, Any]:
        """For programs: the statement, the model, and what was tried."""
        trials = [{**vars(trial), "model": trial.model.asked()} for trial in self.trials]
        for trial in trials:
            for name in ("gain", "error"):
                trial[name] = trial[name] if math.isfinite(trial[name]) else None
        return {"statement": self.sentence, **self.model.asked(), "trials": trials}

    @property
    def added(self) -> tuple[Trial, ...]:
        """What was taken beyond what was asked."""
        return tuple(trial for trial in self.trials if trial.taken)

    @property
    def sentence(self) -> str:
        """What was chosen, and why."""
        if not self.added:
            return f"{self.model.in_words()}, as asked: the photographs show no need for more"
        each = [
            f"{trial.of}, since {trial.why}"
            + (
                "; photographs that were held out are predicted better by it "
                f"(−2 log p is lower by {_with_error(trial.gain, trial.error)} each)"
                if math.isfinite(trial.gain)
                else ""
            )
            for trial in self.added
        ]
        return f"{self.model.in_words()}. Chosen: {'; '.join(each)}"


def _with_error(value: float, error: float) -> str:
    """With the digits that the error leaves."""
    digits = 0 if error >= _WHOLE else 1
    return f"{value:.{digits}f} ± {error:.{digits}f}"
