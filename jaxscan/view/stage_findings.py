"""Findings about stage and turntable: photographs in another order than their step counts, uneven steps, play.

One cause has one message. Photographs that a message of their own says to be wrong do not count here.
"""

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.calibration.diagnostics import Diagnostics
from jaxscan.view.report import Box

# Mean square of errors of stage or turntable in σ.
_STAGE = 4.0
# That many photographs show whether steps are even.
_FEWEST = 3
_UNEVEN = "Look for backlash (approach from one side), missed steps, and wrong step counts in session.toml."


def mixed_names(diagnostics: Diagnostics) -> set[str]:
    """The photographs of sequences on the stage that were mixed up."""
    return {name for each in diagnostics.stage_orders for name in each.names}


def off_their_places(diagnostics: Diagnostics) -> set[str]:
    """Photographs that fit worse because their places are uneven or off the line or turn, or mixed up."""
    bad = {suspect.name for suspect in diagnostics.suspects}
    stages = [each.without(bad) for each in diagnostics.stages]
    turns = [each.without(bad) for each in diagnostics.turntables]
    off = [each.names for each in stages if max(each.chi2_along, each.chi2_across) > _STAGE]
    off += [each.names for each in turns if max(each.chi2_turn, each.chi2_wobble) > _STAGE]
    return mixed_names(diagnostics).union(*off)


def mixed_up(diagnostics: Diagnostics) -> list[Box]:
    """Stage photographs that do not go with their step counts."""
    return [Box("stop", f"{what}.", fix) for what, fix in (each.statement for each in diagnostics.stage_orders)]


def stage_findings(calibration: Calibration, diagnostics: Diagnostics) -> list[Box]:
    """What is known of the shape of a stage's path; uneven steps, a crooked path, a turntable that wobbles."""
    mixed = mixed_names(diagnostics)
    orders = [set(each.names) for each in diagnostics.stage_orders]
    bad = {suspect.name for suspect in diagnostics.suspects}
    crooked = {stage.axis for stage in diagnostics.stages if any(set(stage.names) & order for order in orders)}
    shapes = [shape for shape in calibration.stage_shapes if shape.axis not in crooked]
    boxes = [Box("care", f"{what}.", fix) for shape in shapes for what, fix in shape.statements]
    boxes += [Box("care", f"{untold}.", "") for untold in calibration.undetermined_periods]
    named = {shape.axis for shape in shapes}
    return [*boxes, *_stages(calibration, diagnostics, named, mixed, bad), *_turntables(calibration, diagnostics, bad)]


def _stages(
    calibration: Calibration, diagnostics: Diagnostics, named: set[str], mixed: set[str], bad: set[str]
) -> list[Box]:
    boxes = []
    for whole in diagnostics.stages:
        if whole.axis in named or mixed & set(whole.names) or _in_two_places(calibration, whole.names):
            continue
        each = whole.without(bad)
        if len(each.names) < _FEWEST:
            continue
        if each.chi2_along > _STAGE:
            boxes.append(
                Box(
                    "care",
                    "The stage's steps are uneven: places along its travel are off by "
                    f"{np.sqrt((each.error_mm[:, 0] ** 2).mean()):.3f} mm RMS, {np.sqrt(each.chi2_along):.1f} times "
                    "what the corners explain.",
                    _UNEVEN,
                )
            )
        if each.chi2_across > _STAGE:
            boxes.append(
                Box(
                    "care",
                    "The stage is not straight: the board leaves the line by up to "
                    f"{np.abs(each.error_mm[:, 1:]).max():.3f} mm, {np.sqrt(each.chi2_across):.1f} times what the "
                    "corners explain.",
                    "The board may not be fixed, or the guide has play.",
                )
            )
    return boxes


def _turntables(calibration: Calibration, diagnostics: Diagnostics, bad: set[str]) -> list[Box]:
    boxes = []
    for whole in diagnostics.turntables:
        each = whole.without(bad)
        if len(each.names) < _FEWEST or _in_two_places(calibration, whole.names):
            continue
        if each.chi2_turn > _STAGE:
            boxes.append(
                Box(
                    "care",
                    "The turntable's steps are uneven: its angles are off by "
                    f"{np.sqrt((each.turn_error_deg[:, 0] ** 2).mean()):.3f}° RMS, {np.sqrt(each.chi2_turn):.1f} times "
                    "what the corners explain.",
                    _UNEVEN,
                )
            )
        if each.chi2_wobble > _STAGE:
            boxes.append(
                Box(
                    "care",
                    "The turntable wobbles: the board leaves its turn by up to "
                    f"{np.abs(each.turn_error_deg[:, 1:]).max():.3f}° and {np.abs(each.error_mm).max():.3f} mm, "
                    f"{np.sqrt(each.chi2_wobble):.1f} times what the corners explain.",
                    "The board may not be fixed, or the bearing has play.",
                )
            )
    return boxes


def _in_two_places(calibration: Calibration, names: tuple[str, ...]) -> bool:
    """Whether something changed between two of the photographs, which is said by itself."""
    change = calibration.change
    return change is not None and {change.before, change.after} <= set(names)
