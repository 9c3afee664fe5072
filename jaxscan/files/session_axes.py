"""`[stage]` and `[turntable]` of a session: the board fixed on an axis, photographed as the axis moves it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from jaxscan.files.listing import files_of
from jaxscan.files.session_lasers import Stripes, of_lasers, read_stripes, stripes_values
from jaxscan.files.settings import read_steps, relative_name
from jaxscan.files.table import Table
from jaxscan.images import StripeSettings
from jaxscan.rig import MOTIONS, Linear, Rotary
from jaxscan.rig.line import Line

# Axes of which a session can have photographs of the board, each a table.
SEQUENCES: Final = ("stage", "turntable")
_SEQUENCE_KEYS: Final = ("images", "steps", "steps_per_image", "stripes")


@dataclass(frozen=True)
class StageImages:
    """The board fixed on the stage, photographed along its travel.

    Attributes:
        images: the photographs.
        steps: the motor step count of each.
        stripes: for each laser by name, and in the order of `images`, the photograph of the same place with that laser
            on, or None where there is none; empty where no stripe is looked for. It may be the same photograph.
        motion: the kind of its motion, one of `stage_motions`.
        screw_steps: steps of one turn of its screw, where they are known; of use where the motion has a screw.
        mm_per_step: travel for one motor step where it is known otherwise, mm: it checks the size of the squares.
    """

    images: tuple[Path, ...]
    steps: tuple[int, ...]
    stripes: Mapping[str, tuple[Path | None, ...]] = field(default_factory=dict, kw_only=True)
    motion: str = field(default=Linear.kind, kw_only=True)
    screw_steps: float | None = field(default=None, kw_only=True)
    mm_per_step: float | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class TurntableImages(StageImages):
    """The board fixed on the turntable, photographed as it turns.

    Attributes:
        stage_step: motor step of the stage at which they were taken.
        motion: the kind of its motion, one of `turntable_motions`.
    """

    stage_step: int = 0
    motion: str = field(default=Rotary.kind, kw_only=True)


def stage_motions() -> tuple[str, ...]:
    """The kinds of motion that a stage may have: those along a line, more or less."""
    return tuple(name for name, kind in MOTIONS.items() if issubclass(kind, Line))


def turntable_motions() -> tuple[str, ...]:
    """The kinds of motion that a turntable may have: those about an axis."""
    return tuple(name for name, kind in MOTIONS.items() if issubclass(kind, Rotary))


def read_stage(table: Table, lasers: Sequence[StripeSettings], axes: Mapping[str, str]) -> StageImages | None:
    """The photographs along the stage, where there are any.

    Raises:
        InputError: key, value, and how to fix it.
    """
    if "stage" not in table:
        return None
    stage = table.table("stage", "[stage] ").only(*_SEQUENCE_KEYS, "motion", "screw_steps", "mm_per_step")
    images, steps, stripes = _sequence(stage, lasers, axes, "two", 2)
    motion = stage.string("motion", Linear.kind, stage_motions())
    screw = stage.number("screw_steps") if "screw_steps" in stage else None
    if screw is not None and screw <= 0:
        raise stage.error("screw_steps", "must be the steps of one turn of the screw, above 0")
    known = stage.number("mm_per_step") if "mm_per_step" in stage else None
    if known is not None and known <= 0:
        raise stage.error("mm_per_step", "must be the millimetres of one motor step, above 0")
    return StageImages(images, steps, stripes=stripes, motion=motion, screw_steps=screw, mm_per_step=known)


def read_turntable(table: Table, lasers: Sequence[StripeSettings], axes: Mapping[str, str]) -> TurntableImages | None:
    """The photographs on the turntable, where there are any.

    Raises:
        InputError: key, value, and how to fix it.
    """
    if "turntable" not in table:
        return None
    turntable = table.table("turntable", "[turntable] ").only(*_SEQUENCE_KEYS, "stage_step", "motion")
    stood = turntable.whole("stage_step") if "stage_step" in turntable else 0
    images, steps, stripes = _sequence(turntable, lasers, axes, "three", 3)
    motion = turntable.string("motion", Rotary.kind, turntable_motions())
    return TurntableImages(images, steps, stood, stripes=stripes, motion=motion)


def _sequence(
    table: Table, lasers: Sequence[StripeSettings], axes: Mapping[str, str], fewest_in_words: str, fewest: int
) -> tuple[tuple[Path, ...], tuple[int, ...], Stripes]:
    """The photographs of a board that something moves, the motor step count of each, and those of the stripe on it."""
    images = files_of(table, "images")
    steps = read_steps(table, "steps_per_image", images, "images")
    if len(set(steps)) < fewest:
        raise table.error(
            "steps" if "steps" in table else "images",
            f"photographs at {fewest_in_words} different step counts or more are needed",
        )
    if axes and "stripes" in table:
        raise table.error("stripes", "a light that is swept has its stripes on boards under [views]: leave this out")
    return images, steps, read_stripes(table, lasers, len(images))


def sequence_values(sequence: StageImages, folder: Path, lasers: int) -> dict[str, Any]:
    """The inverse of `read_stage` and `read_turntable`: the keys of the table, in a session with `lasers` lasers."""
    values: dict[str, Any] = {"images": [relative_name(path, folder) for path in sequence.images]}
    values["steps"] = list(sequence.steps)
    if sequence.stripes:
        values["stripes"] = of_lasers(stripes_values(sequence.stripes, folder), lasers)
    if isinstance(sequence, TurntableImages):
        values["stage_step"] = sequence.stage_step
        return values | ({"motion": sequence.motion} if sequence.motion != Rotary.kind else {})
    values |= {"motion": sequence.motion} if sequence.motion != Linear.kind else {}
    values |= {"screw_steps": sequence.screw_steps} if sequence.screw_steps is not None else {}
    return values | ({"mm_per_step": sequence.mm_per_step} if sequence.mm_per_step is not None else {})
