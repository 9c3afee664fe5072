"""Whether a scan fits a rig: what is refused before any photograph is read, and what is said of its positions."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.axis_details import POSES, is_detail
from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE
from jaxscan.files.listing import common_size
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.files.session_axes import SEQUENCES
from jaxscan.images import StripeSettings
from jaxscan.reconstruction.frames import wrong_size
from jaxscan.reconstruction.merged_steps import step_groups
from jaxscan.reconstruction.range_image import WIDE_APART_DEG
from jaxscan.reconstruction.turns import sweeps_of
from jaxscan.rig import MovingLight, Rig
from jaxscan.rig.given_poses import NM
from jaxscan.rig.light import light_axes
from jaxscan.rig.stripe_way import setting_instead, slope_across, way_across

# A stripe that runs so much more steeply than the lines in which it is looked for meets few of them.
_STEEPEST: Final = 3.0
# More full turns than these are a mistake.
_MOST_TURNS: Final = 5
# The median gap is judged from this number on: one wrong gap is then less than half of them.
_FEWEST_GAPS: Final = 3
# Points further from the origin, mm, are not resolved to 0.01 mm as float32.
_FARTHEST_MM: Final = 1e5
# A light that goes beyond its calibration by a larger part of its travel there is worth a word.
_BEYOND: Final = 0.1


def check_scan(rig: Rig, scan: Scan) -> None:
    """Refuse before any long work what cannot come out right.

    Raises:
        InputError: the photographs are not of the rig's size, or the positions of the axes are not those of the rig.
    """
    if photographs := [*scan.frames, *scan.backgrounds]:
        size = common_size(photographs)
        if size != rig.camera.image_size:
            raise InputError(wrong_size(photographs[0], size, rig.camera.image_size))
    key = "[scan] steps:" if scan.axis_names == (STAGE,) else "[scan.axes]" if scan.poses is None else "[scan] poses:"
    check_axes(rig, scan.moving, scan.axis_names, f"{scan.path}: {key}", scan.laser.name)
    _check_near(rig, scan)
    step_groups(scan)


def check_lines(rig: Rig, laser: StripeSettings, where: str) -> None:
    """Refuse to look for one point in each column of a stripe that runs down the image, or in each row across it.

    Args:
        rig: the rig.
        laser: which, and how its stripe is looked for.
        where: the settings stand, for errors.

    Raises:
        InputError: the stripe runs the other way.
    """
    columns = laser.columns
    if slope_across(rig, laser.name, columns=columns) > _STEEPEST:
        raise InputError(
            f"{where}: looks for one point in each {'column' if columns else 'row'}, but by this rig the stripe runs "
            f"{way_across(columns=columns)} over the image: {setting_instead(columns=columns)}"
        )


def check_axes(rig: Rig, moving: Sequence[str], named: Sequence[str], where: str, laser: str) -> None:
    """Refuse positions from which the rig cannot compute the pose of the object, or where the light stands.

    Args:
        rig: the rig.
        moving: the axes that move from frame to frame.
        named: those whose positions are known.
        where: what is at fault, for errors.
        laser: the name of the laser that is on.

    Raises:
        InputError: one moves that the rig lacks, or it is not said where one stands that carries one that moves.
    """
    axes = rig.axes()
    if POSES in axes and POSES not in named:
        raise InputError(
            f"{where} this rig is moved by given poses, and the scan has none: give poses = the table with the pose of "
            "each frame"
        )
    lit = [light.axis for light in rig.lights if isinstance(light, MovingLight) and laser in ("", light.name)]
    for axis in lit:
        if axis not in named:
            raise InputError(
                f"{where} the light of this rig is moved by an axis {axis}, and the scan does not say where that "
                f"stands: give its motor steps under [scan.axes], {axis} = one number for each frame, or start and "
                "per_frame"
            )
    for axis in moving:
        if axis not in axes and axis not in lit:
            has = f"it has {', '.join(axes)}" if axes else "it has none"
            fixes = [f"calibrate with a [{axis}] sequence"] if axis in (*SEQUENCES, POSES) else []
            fixes += ["name the axis as the rig does"] if axes else []
            raise InputError(
                f"{where} the {axis} moves between frames, but the rig has no such axis, {has}: "
                f"{', or '.join(fixes) or 'use a rig that has it'}"
            )
    # What moves along a line is carried alike wherever another stage stands; a turn is not.
    parts = rig.motion.parts()
    units = [part.amount(1.0)[1] for part in parts]
    for i, part in enumerate(parts):
        turned = [p for p, unit in zip(parts[i + 1 :], units[i + 1 :], strict=True) if "degrees" in (units[i], unit)]
        carried = [p.axis for p in turned if p.axis in moving]
        if carried and part.axis not in named:
            raise InputError(
                f"{where} the {carried[0]} moves, and the position of the {part.axis} that carries it is not given: "
                f"add {part.axis} = its motor steps, 0 if it was at 0"
            )


def _check_near(rig: Rig, scan: Scan) -> None:
    """Refuse places so far away that points there mean nothing."""
    if scan.poses is not None:
        farthest_mm = max(abs(n) for axis in "xyz" for n in scan.axes[f"{POSES}.{axis}"]) / NM
        if farthest_mm > _FARTHEST_MM:
            raise InputError(
                f"{scan.path}: [scan] poses: the hand is {farthest_mm / 1000:.3g} m from its base: give positions in "
                "millimetres"
            )
    for part in rig.motion.parts():
        farthest = max(scan.axes.get(part.axis, (0,)), key=abs, default=0)
        amount, unit = part.amount(float(farthest))
        if unit == "mm" and amount > _FARTHEST_MM:
            raise InputError(
                f"{scan.path}: [scan] at step {farthest} the {part.axis} is {amount / 1000:.3g} m from its step 0: are "
                "these the steps of another axis? Count them from where the object is"
            )


def _place(scan: Scan) -> str:
    first = {axis: rule.start for axis, rule in scan.rules.items()}
    first |= {axis: steps[0] for axis, steps in scan.axes.items() if not is_detail(axis)}
    return ", ".join(f"{axis} {step}" for axis, step in first.items())


def way_notes(rig: Rig, scan: Scan) -> list[str]:
    """What is said of how far each axis goes.

    Raises:
        InputError: an axis turns so far that its steps must be those of another.
    """
    notes = []
    if not scan.moving and (scan.rules or scan.listed > 1):
        notes.append(
            f"all {scan.listed or 'its'} frames are of one place, {_place(scan)}: give the motor steps of what moved "
            "between them, or there is no surface"
        )
    for axis in scan.moving:
        lit = axis in light_axes(rig.lights)
        step, unit = (rig.light_axis(axis) if lit else rig.axis(axis)).amount(1.0)
        if unit != "degrees":
            continue
        whole = step * float(np.ptp(scan.axes.get(axis, (0,))))
        gaps = step * _gaps(scan, axis)
        # Full turns left out: positions may start again at 0.
        apart = float(np.abs((gaps + 180) % 360 - 180).max(initial=0.0))
        each = float(np.median(np.abs(gaps))) if scan.rules or len(gaps) >= _FEWEST_GAPS else 0.0
        if whole > _MOST_TURNS * 360 or each > 180:
            said = f"{whole:.0f} degrees, {whole / 360:.1f} full turns" if whole else f"{each:.0f} degrees a frame"
            raise InputError(
                f"{scan.path}: [scan.axes] {axis} turns by {said}: are these the steps of another axis? A full turn is "
                f"{360 / step:.0f} steps"
            )
        if whole > 360 + apart:
            notes.append(
                f"the {axis} turns by {whole:.0f} degrees, more than one full turn: places that were seen twice have "
                "points twice, and jaxscan mesh makes one surface of them. If it turned once, the steps given for "
                f"each frame are wrong: a full turn is {360 / step:.0f}"
            )
        if apart > WIDE_APART_DEG:
            notes.append(
                f"the frames are up to {apart:.1f} degrees of the {axis} apart: profiles so far from each other give "
                f"points, but no surface; take one every {WIDE_APART_DEG:g} degrees"
                + (f", {int(WIDE_APART_DEG / step)} steps, or fewer" if step <= WIDE_APART_DEG else " or fewer")
            )
    return notes


def sweep_notes(content: RigFile, scan: Scan) -> list[str]:
    """What is said of a light that goes beyond where the calibration has seen it."""
    notes = []
    for axis, (least, most) in content.fit.get("light_positions", {}).items():
        steps = scan.axes.get(axis, ())
        beyond = max(least - min(steps, default=least), max(steps, default=most) - most)
        if beyond > _BEYOND * (most - least):
            notes.append(
                f'axis "{axis}" goes from {min(steps)} to {max(steps)} steps, the calibration from {least:g} to '
                f"{most:g}: beyond that range errors grow as σ says, and faster if the axis is not the one that was "
                "fitted: count its steps from the same place as in the session, or calibrate over the whole sweep"
            )
    return notes


def _gaps(scan: Scan, axis: str) -> Float[np.ndarray, "gaps"]:
    """Motor steps of an axis from frame to frame of each sweep; of a video with a rule, the rule's."""
    if scan.rules:
        return np.array([float(scan.rules[axis].per_frame)])
    positions = {name: np.asarray(steps) for name, steps in scan.axes.items()}
    return np.concatenate([np.diff(positions[axis][some].astype(np.float64)) for some in sweeps_of(positions)])
