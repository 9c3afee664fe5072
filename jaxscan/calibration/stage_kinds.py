"""The kind of motion of each axis: as it is asked for, checked, and begun from the line that fits best.

A stage whose path is no line is solved twice: first as a line, with all that makes it another held, then with what the
own places of its photographs say of that.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jaxscan.calibration.observations import BoardSequence, Observations
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.stage_paths import (
    FEWEST_EACH_WAY,
    FEWEST_TURNS,
    LEAST_TOLD,
    Course,
    courses,
    first_came_otherwise,
    started,
    told_of_wave,
)
from jaxscan.calibration.stage_shape import aliases_in_words
from jaxscan.errors import InputError
from jaxscan.precision import as_float64
from jaxscan.rig import MOTIONS, System, motion_of, run_of
from jaxscan.rig.line import Line
from jaxscan.rig.rig import Rig, parameter_names


def with_kinds(observations: Observations, motion: Mapping[str, str], periods: Mapping[str, float]) -> Observations:
    """The same with the kind of motion that is asked for in the sequences of each axis.

    Raises:
        InputError: there is no such axis or kind, or it is none for this axis; a period that is none; or photographs
            of one pass, where play is asked for.
    """
    kinds = {sequence.axis: sequence.kind for sequence in observations.sequences}
    for axis, kind in motion.items():
        if axis not in kinds:
            has = f"there are some on {', '.join(kinds)}" if kinds else "there are none on any axis"
            raise InputError(
                f'motion of "{axis}" = "{kind}": no photographs of a board on the {axis}, {has}: photograph one along '
                "its travel, or leave out the kind of its motion"
            )
        if kind not in MOTIONS:
            raise InputError(
                f'motion of "{axis}" = "{kind}": this version knows {", ".join(MOTIONS)}; register the kind before'
            )
        if issubclass(MOTIONS[kind], Line) != issubclass(MOTIONS[kinds[axis]], Line):
            raise InputError(
                f'motion of "{axis}" = "{kind}": the {axis} was photographed as "{kinds[axis]}": give a kind of motion '
                "that moves the board as it does"
            )
    kinds |= motion
    for axis, period in periods.items():
        if not (math.isfinite(period) and period > 0):
            raise InputError(f"the screw's period of the {axis} is {period:g}: give the steps of one turn, above 0")
        if axis not in kinds or "period" not in MOTIONS[kinds[axis]].numbers:
            screws = ", ".join(f'"{name}"' for name, kind in MOTIONS.items() if "period" in kind.numbers)
            raise InputError(
                f"a screw's period of {period:g} steps is given for the {axis}, whose motion has none: ask for one of "
                f"the kinds {screws}, or leave out the period"
            )
        steps = np.concatenate([each.steps for each in observations.sequences if each.axis == axis])
        if np.ptp(steps) < FEWEST_TURNS * period:
            raise InputError(
                f"the {axis} was photographed over {np.ptp(steps):g} steps, {np.ptp(steps) / period:.2g} turns of a "
                f"screw of {period:g} steps: photograph the board over {FEWEST_TURNS:g} turns and more, or give the "
                "right period"
            )
    sequences = tuple(replace(sequence, kind=kinds[sequence.axis]) for sequence in observations.sequences)
    played = [axis for axis, kind in kinds.items() if "play" in MOTIONS[kind].numbers]
    for axis in played:
        _check_there_and_back(axis, kinds[axis], [sequence for sequence in sequences if sequence.axis == axis])
    return replace(
        observations,
        sequences=tuple(_with_run(sequence) if sequence.axis in played else sequence for sequence in sequences),
    )


def _with_run(sequence: BoardSequence) -> BoardSequence:
    """With the run of its axis among its positions."""
    return replace(sequence, positions={**sequence.positions, run_of(sequence.axis): sequence.runs})


def _check_there_and_back(axis: str, kind: str, sequences: Sequence[BoardSequence]) -> None:
    """Refuse photographs that do not determine play."""
    counts = [(int((each.runs > 0).sum()), int((each.runs < 0).sum())) for each in sequences]
    if max(min(each) for each in counts) < FEWEST_EACH_WAY:
        rising, falling = max(counts, key=min)
        raise InputError(
            f'motion of "{axis}" = "{kind}": {sequences[0].views[0].name} … {sequences[-1].views[-1].name}: of the '
            f"photographs on the {axis}, in their order, {rising} were approached by rising steps and {falling} by "
            f"falling ones: play needs at least {FEWEST_EACH_WAY} of each in one sequence. Photograph the board "
            "along the travel there and back, and list the photographs in the order they were taken; or ask for a "
            "motion without play"
        )


def first_approach(observations: Observations, as_lines: Calibration) -> tuple[Observations, list[str]]:
    """The same with the run of each sequence's first photograph as the place of its board says, and what was changed.

    Nothing else shows from where an axis came before it: often from home, on the other side. It is taken to have been
    approached as the second was, unless the other way leaves less of its own place by more than chance.

    Args:
        observations: with runs.
        as_lines: a calibration with them, whose play was held at 0.

    Returns:
        The observations, and sentences without their full stops.
    """
    found, said = courses(as_lines), []
    sequences = list(observations.sequences)
    for axis, course in found.items():
        own = [i for i, sequence in enumerate(sequences) if sequence.axis == axis]
        if "play" not in as_lines.rig.axis(axis).numbers or len(own) <= course.sequence.max():
            continue
        for k, i in enumerate(own):
            sequence = sequences[i]
            if first_came_otherwise(course, k):
                runs = sequence.runs.copy()
                first = runs == runs[0]
                runs[first & (np.cumsum(~first) == 0)] *= -1
                sequences[i] = replace(sequence, positions={**sequence.positions, run_of(axis): runs})
                side = "rising" if runs[0] > 0 else "falling"
                said.append(
                    f"{sequence.views[0].name}: the first photograph on the {axis} is where one approached by {side} "
                    "steps would be, unlike the second, and was treated as such"
                )
    return replace(observations, sequences=tuple(sequences)), said


def shape_parameters(rig: Rig) -> set[str]:
    """The names of what makes the motion of an axis another than a line."""
    lines = [part for part in rig.motion.parts() if isinstance(part, Line)]
    stems = [f"motion.{part.axis}.{name}." for part in lines for name in part.shape()]
    return {name for name in parameter_names(rig) if stems and name.startswith(tuple(stems))}


def begun(system: System, as_lines: Calibration, periods: Mapping[str, float]) -> tuple[System, set[str], list[str]]:
    """The system of a solve whose stages were lines, with the shape that the own places of its photographs have.

    Args:
        system: where that solve ended.
        as_lines: the same, assembled.
        periods: steps of one turn of an axis's screw, where they are known.

    Returns:
        The system; the names of the periods that keep their value, those that are known and those of screws that show
        no wave; and sentences about periods that the photographs do not determine, without their full stops.

    Raises:
        InputError: the photographs do not determine a wave of a period that is given.
    """
    found, parts, held, said = courses(as_lines), [], set(), []
    for part in system.rig.motion.parts():
        if isinstance(part, Line) and part.shape() and part.axis in found:
            course, period = found[part.axis], periods.get(part.axis)
            if period is not None:
                _check_told(part, course, period)
            start, told = started(part, course, period)
            parts.append(start)
            if "wave" in part.shape() and told is None:
                held.add(f"motion.{part.axis}.period.0")
            if told is not None and told.others:
                said.append(
                    f"The {part.axis}'s screw is taken to have a period of {told.period:.5g} steps. "
                    f"{aliases_in_words(told.others)}"
                )
        else:
            parts.append(part)
    rig = as_float64(Rig(system.rig.camera, system.rig.lights, motion_of(tuple(parts))))
    return System(rig, system.poses, system.shape), held, said


def _check_told(part: Line, course: Course, period: float) -> None:
    """Refuse a period of which all photographs show the same."""
    beside = course.line()
    if "bow" in part.shape():
        beside = np.concatenate([beside, course.bow()], axis=1)
    if "play" in part.shape():
        beside = np.concatenate([beside, course.play()], axis=1)
    if told_of_wave(course, beside, period) < LEAST_TOLD:
        raise InputError(
            f"the {part.axis}'s screw has a period of {period:g} steps, and its photographs stand at the same places "
            f"of that, or at two: they do not show its wave. Photograph the board at uneven steps, or ask for a "
            "motion without a screw"
        )
