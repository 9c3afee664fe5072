"""Where the axes of a scanner stood for each frame of a scan: `steps`, or `[scan.axes]` with a name for each axis."""

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

from jaxscan.files.settings import read_step_rule
from jaxscan.files.table import Table, show

# The axis of which `steps` speaks.
STAGE: Final = "stage"
_PLAIN_NAME: Final = re.compile(r"[A-Za-z0-9_-]+")
_NO_NAME: Final = "is no name of an axis: write letters, digits, _ and - alone"

Positions = Mapping[str, tuple[int, ...]]


@dataclass(frozen=True)
class StepRule:
    """Positions in equal steps, of frames that are not counted yet.

    Attributes:
        start: the position of frame 0, motor steps.
        per_frame: motor steps from one frame to the next; 0 for an axis that stands.
    """

    start: int
    per_frame: int

    def positions(self, first: int, count: int) -> tuple[int, ...]:
        """The positions of `count` frames, from the frame `first` on."""
        return tuple(self.start + self.per_frame * i for i in range(first, first + count))


Rules = Mapping[str, StepRule]


def is_axis_name(name: str) -> bool:
    """Whether an axis may be called so: letters, digits, _ and -."""
    return _PLAIN_NAME.fullmatch(name) is not None


def read_axis_name(table: Table, default: str | None = None) -> str:
    """The name of an axis that a table has as `axis`.

    Raises:
        InputError: it is missing and has no default, or is no name.
    """
    name = table.string("axis", default)
    if not is_axis_name(name):
        raise table.error("axis", _NO_NAME)
    return name


def read_axes(scan: Table, n_frames: int | None, outer: str = "scan") -> tuple[Positions, Rules]:
    """The positions of each axis, in the order in which the file names the axes.

    Args:
        scan: the table with `steps`, `steps_per_frame` or `axes`.
        n_frames: how many frames there are; None for a video, which has as many as a list has positions.
        outer: what the table is called.

    Returns:
        A position for each axis and frame. For a video of which nothing is a list, no positions but a rule for each
        axis.

    Raises:
        InputError: file, key, value, and how to fix it.
    """
    if "axes" in scan:
        for key in ("steps", "steps_per_frame"):
            if key in scan:
                raise scan.error(
                    key, f"[{outer}.axes] is given too: keep one of them; {key} is that of the axis {STAGE}"
                )
        table = scan.table("axes", f"[{outer}.axes] ")
        given = {name: _read_axis(table, name, outer) for name in table.values}
        if not given:
            raise scan.error("axes", "names no axis: add one, such as turntable = { start = 0, per_frame = 8 }")
    elif "steps" not in scan and "steps_per_frame" not in scan:
        by_poses = 'or poses = "poses.csv" where a robot moved, ' if outer == "scan" else ""
        raise scan.error(
            "steps",
            f"is missing: give the motor step count of each frame, or steps_per_frame, {by_poses}or [{outer}.axes] "
            f"where other axes than the {STAGE} move",
        )
    else:
        step = read_step_rule(scan, "steps_per_frame")
        table, given = scan, {STAGE: scan.wholes("steps") if step is None else StepRule(0, step)}
    if n_frames is None:
        n_frames = next((len(axis) for axis in given.values() if isinstance(axis, tuple)), None)
    if n_frames is None:
        return {}, {name: rule for name, rule in given.items() if isinstance(rule, StepRule)}
    axes: dict[str, tuple[int, ...]] = {}
    for name, axis in given.items():
        if isinstance(axis, StepRule):
            axes[name] = axis.positions(0, n_frames)
        elif len(axis) == n_frames:
            axes[name] = axis
        elif table is scan:
            raise table.error("steps", f"{len(axis)} step counts for {n_frames} frames: give one for each")
        else:
            raise table.error(
                name, f"{len(axis)} positions for {n_frames} frames: give one for each, or one number for all of them"
            )
    return axes, {}


def axes_values(axes: Positions, rules: Rules) -> dict[str, Any]:
    """The inverse of `read_axes`: the keys of `[scan]`, in their short form where the stage alone has positions."""
    if rules:
        if list(rules) == [STAGE] and rules[STAGE].start == 0 and rules[STAGE].per_frame:
            return {"steps_per_frame": rules[STAGE].per_frame}
        return {"axes": {name: asdict(rule) if rule.per_frame else rule.start for name, rule in rules.items()}}
    if set(axes) <= {STAGE}:
        return {"steps": list(axes.get(STAGE, ()))}
    # One number stands for all frames; how many these are, an axis that moves says.
    at_rest = {name: len(positions) > 1 and len(set(positions)) == 1 for name, positions in axes.items()}
    short = not all(at_rest.values())
    return {
        "axes": {name: positions[0] if short and at_rest[name] else list(positions) for name, positions in axes.items()}
    }


def _read_axis(axes: Table, name: str, outer: str) -> tuple[int, ...] | StepRule:
    """What is written for one axis: a list, one number, or where it starts and how far it goes for each frame."""
    value = axes.values[name]
    if not is_axis_name(name):
        raise axes.error(name, _NO_NAME)
    if isinstance(value, list):
        return axes.wholes(name)
    if not isinstance(value, dict):
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise axes.error(
                name,
                "must be a list of motor steps, one number for all frames, or { start = 0, per_frame = 8 }",
            )
        return StepRule(axes.whole(name), 0)
    rule = axes.table(name, f"[{outer}.axes] {name}.").only("start", "per_frame")
    if "per_frame" not in rule:
        raise axes.error(
            name, f"has no per_frame: add it, or write {name} = {show(value.get('start', 0))} where it stands still"
        )
    if (per_frame := rule.motor_steps("per_frame", f"{name} = ")) == 0:
        raise rule.error(
            "per_frame",
            "the axis does not move: give its steps from one frame to the next, or one number for all frames",
        )
    return StepRule(rule.whole("start") if "start" in rule else 0, per_frame)
