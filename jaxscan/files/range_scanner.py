"""What a range image's file says of its scanner: where the axes stood at each frame, the motion and the light."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Int, Int64, UInt8

from jaxscan.axis_details import is_detail
from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE, is_axis_name
from jaxscan.files.range_npz import RangeArrays, as_json, from_json
from jaxscan.files.rig_parts import lights_values, motion_values, part_tables, read_lights, read_motion
from jaxscan.files.table import Table
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Fixed, Light, Linear, Motion


class RangeScanner(NamedTuple):
    """The scanner of a range image."""

    positions: dict[str, Int[np.ndarray, "frames"]]
    motion: Motion
    sheets: tuple[Light, ...]


def scanner_arrays(
    positions: Mapping[str, Int[np.ndarray, "frames"]], motion: Motion, sheets: tuple[Light, ...]
) -> tuple[Int64[np.ndarray, "frames axes"], UInt8[np.ndarray, "bytes"]]:
    """As `RangeArrays` has them: positions, and all else as JSON."""
    values = {"axes": list(positions), "lights": lights_values(sheets), "motion": motion_values(motion)}
    return np.stack([np.asarray(steps, np.int64) for steps in positions.values()], axis=-1), as_json(values)


def read_scanner(path: str | os.PathLike[str], arrays: RangeArrays) -> RangeScanner:
    """The inverse of `scanner_arrays`; older files have the steps of a stage, and how far it moves for one.

    Raises:
        InputError: what is said of the scanner is not sound.
    """
    if (arrays.scanner is None) != (arrays.positions is None):
        raise InputError(f'{path}: has one of "scanner" and "positions" without the other: reconstruct again')
    if arrays.scanner is None or arrays.positions is None:
        if arrays.per_step is None or not arrays.per_step.any():
            return RangeScanner({STAGE: arrays.steps}, Fixed(), ())
        with float64():
            stage = Linear.create(arrays.per_step)
        return RangeScanner({STAGE: arrays.steps}, as_numpy(stage), ())
    values = from_json(path, "scanner", arrays.scanner)
    if not isinstance(values, dict):
        raise InputError(f'{path}: "scanner" is no object: reconstruct again')
    table = Table(Path(path), "scanner.", values)
    axes = table.sequence("axes", "names of axes")
    if not all(isinstance(axis, str) and (is_axis_name(axis) or _of_axis(axis, axes)) for axis in axes):
        raise table.error("axes", "must be names of letters, digits, _ and - alone: reconstruct again")
    if len(set(axes)) < len(axes):
        raise table.error("axes", "name an axis twice: reconstruct again")
    if len(axes) != arrays.positions.shape[1]:
        raise table.error("axes", f"{len(axes)} names for {arrays.positions.shape[1]} positions: reconstruct again")
    with float64():
        lights = read_lights(part_tables(table, "lights", "lights"), [])
        if len(lights) > 1:
            raise table.error("lights", f"holds {len(lights)} lights, a scan is taken in one: reconstruct again")
        motion = read_motion(part_tables(table, "motion", "axes"), [])
    positions = {axis: arrays.positions[:, i] for i, axis in enumerate(axes)}
    known = [part.axis for part in motion.parts()]
    for axis, steps in positions.items():
        if known and not is_detail(axis) and axis not in known and len(steps) and np.ptp(steps):
            raise table.error(
                "axes",
                f"the {axis} moves, but the motion is that of {', '.join(known)}: reconstruct with the scan's rig",
            )
    return RangeScanner(positions, as_numpy(motion), as_numpy(lights))


def _of_axis(name: str, axes: Sequence[str]) -> bool:
    """Whether a name is that of a detail of one of the axes."""
    axis, _, detail = name.partition(".")
    return axis in axes and is_axis_name(axis) and is_axis_name(detail)
