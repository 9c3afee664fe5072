"""Places: where each axis stands for one photograph, and the lists of them that make a scan."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from hardware.errors import SettingsError
from hardware.stages.travel_settings import HERE, Travel
from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE

TURNTABLE: Final = "turntable"
# Motor steps by the axis's name.
Place = dict[str, int]
Axes = Mapping[str, tuple[int, ...]]


def places_of(axes: Axes) -> tuple[Place, ...]:
    """Positions by axis as one place for each photograph."""
    return tuple(dict(zip(axes, steps, strict=True)) for steps in zip(*axes.values(), strict=True))


def axes_of(places: Sequence[Place]) -> dict[str, tuple[int, ...]]:
    """The inverse of `places_of`.

    Raises:
        InputError: the places are not all of the same axes.
    """
    names = tuple(places[0]) if places else ()
    for place in places:
        if set(place) != set(names):
            raise InputError(
                f"a scan has a position of {' and '.join(names)} for one photograph, and of {' and '.join(place)} for "
                "another: give each axis of it for all of them"
            )
    return {name: tuple(place[name] for place in places) for name in names}


def along(axis: str, steps: Sequence[int], at: Mapping[str, int] | None = None) -> tuple[Place, ...]:
    """Places that differ in one axis, with others at rest in theirs."""
    return tuple({axis: step, **(at or {})} for step in steps)


def full_turn(travels: Mapping[str, Travel], axis: str, frames: int, first: int = 0) -> tuple[int, ...]:
    """Positions of `frames` photographs all around, to the nearest step; the last is one before the first.

    Raises:
        SettingsError: it is not known how many steps a turn has, or there are fewer of them than photographs.
    """
    travel = travel_of(travels, axis)
    if travel.steps_per_turn is None:
        raise SettingsError(
            f"a full turn of the {axis}: how many motor steps that is, is not known: give steps_per_turn in its table "
            "of scanner.toml"
        )
    if not 1 <= frames <= travel.steps_per_turn:
        raise SettingsError(f"{frames} photographs in a full turn: give 1 to {travel.steps_per_turn}, its motor steps")
    return tuple(first + round(i * travel.steps_per_turn / frames) for i in range(frames))


def check_places(travels: Mapping[str, Travel], places: Sequence[Place]) -> None:
    """See that the axes may be sent to all of these, and that each turns once at most.

    Raises:
        SettingsError: which axis, and why not.
    """
    for name in dict.fromkeys(name for place in places for name in place):
        steps = [place[name] for place in places if name in place]
        travel = travel_of(travels, name)
        if travel.steps_per_turn is not None:
            _check_turn(name, travel.steps_per_turn, places)
        travel.check(steps, name)


def check_scan(travels: Mapping[str, Travel], places: Sequence[Place]) -> None:
    """As `check_places`; and where other axes than the stage move, it has to be said where the stage stands.

    Raises:
        SettingsError: as `check_places`, or nothing says where the stage is to stand.
    """
    check_places(travels, places)
    if STAGE in travels and places and STAGE not in places[0]:
        raise SettingsError(
            f"a scan on the {' and '.join(places[0])}: say where the {STAGE} is to stand meanwhile ({STAGE}=STEP), for "
            "what is seen depends on it"
        )


def check_zero(travels: Mapping[str, Travel], names: Iterable[str], known: Iterable[str] = ()) -> None:
    """See that a scan with photographs can be continued: an axis without a switch does not find its step 0 again.

    Args:
        travels: of the scanner's axes.
        names: the axes of the scan.
        known: those that have kept their count since.

    Raises:
        SettingsError: which axis has not.
    """
    for name in names:
        if name in travels and travels[name].reference == HERE and name not in known:
            raise SettingsError(
                f"the {name} has no switch, and where its step 0 was for the photographs that are there is lost: begin "
                "another scan"
            )


def read_places(path: Path) -> tuple[Place, ...]:
    """Places from a table: the axes' names in the first line, then a line for each photograph, separated by commas.

    Raises:
        InputError: the file cannot be read, or a line is none of motor steps.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = [(number, line) for number, line in enumerate(csv.reader(file), 1) if line]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error}): name a text file with commas (.csv)") from error
    if len(lines) < 2:
        raise InputError(f"{path}: has no positions: give the names of the axes in a line, then a line for each frame")
    names = [name.strip() for name in lines[0][1]]
    if len(set(names)) < len(names):
        raise InputError(f"{path}: line 1: an axis stands there twice: {', '.join(names)}")
    places = []
    for number, line in lines[1:]:
        try:
            places.append({name: int(text) for name, text in zip(names, line, strict=True)})
        except ValueError as error:
            raise InputError(
                f"{path}: line {number}: is {','.join(line)!r}: give whole motor steps of {', '.join(names)}"
            ) from error
    return tuple(places)


def travel_of(travels: Mapping[str, Travel], axis: str) -> Travel:
    """Way and pace of one axis.

    Raises:
        SettingsError: there is none of that name.
    """
    if axis not in travels:
        raise SettingsError(f"this scanner has no axis {axis}, but {', '.join(travels)}: name one of them")
    return travels[axis]


def _check_turn(name: str, steps_per_turn: int, places: Sequence[Place]) -> None:
    """Refuse more than a turn with everything else at rest."""
    turns: dict[tuple[tuple[str, int], ...], list[int]] = {}
    for place in places:
        rest = tuple(sorted((other, step) for other, step in place.items() if other != name))
        if name in place:
            turns.setdefault(rest, []).append(place[name])
    for steps in turns.values():
        if (span := max(steps) - min(steps)) > steps_per_turn:
            raise SettingsError(
                f"steps {min(steps)} to {max(steps)} of the {name} are {span / steps_per_turn:.2f} turns, and more "
                f"than a full one photographs the same again: a turn has {steps_per_turn} steps"
            )
