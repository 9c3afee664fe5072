"""Sessions, and files of corners, that `jaxscan calibrate` solves together: of one rig, and read before long work."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from jaxscan.cli.estimate_options import Estimate
from jaxscan.errors import InputError

if TYPE_CHECKING:
    from jaxscan.calibration import Observations
    from jaxscan.files.camera_file import CameraFile
    from jaxscan.files.session import CameraSettings, Session


@dataclass(frozen=True)
class Together:
    """What sessions and files of corners of one rig say, each photograph once.

    Attributes:
        paths: of the sessions and files.
        contents: what is in each.
        unseen: of each, what is known of it before a photograph is looked at.
        camera: what is asked of the camera.
        board_shape: what of the board's shape is found.
        sheets: the kind of each laser's sheet.
        motion: the kind of each axis that is not the usual one, by its name.
        periods: motor steps of a turn of an axis's screw, by its name.
        lasers: how many lasers there are.
        notes: on what was given twice.
    """

    paths: list[Path]
    contents: list["Session | CameraFile"]
    unseen: list["Observations"]
    camera: "CameraSettings"
    board_shape: str
    sheets: tuple[str, ...]
    motion: dict[str, str]
    periods: dict[str, float]
    lasers: int
    notes: list[str]

    @property
    def sessions(self) -> list["Session"]:
        """Those that are no files of corners."""
        from jaxscan.files.session import Session

        return [content for content in self.contents if isinstance(content, Session)]

    def photographs(self) -> list[str] | None:
        """What results call each photograph of the boards; None where a file of corners has names of its own."""
        from jaxscan.calibration.observe import photograph_names

        if len(self.sessions) < len(self.contents):
            return None
        named = [photograph_names(session) for session in self.sessions]
        several = [f"{of}/{one}" for of, each in zip(names(self.paths), named, strict=True) for one in each]
        return several if len(named) > 1 else named[0]

    def check_laser(self, estimate: Estimate, needs_laser: bool) -> None:
        """Refuse what only a laser's stripe can show where there is none.

        Raises:
            InputError: there is no laser.
        """
        if needs_laser and not self.lasers:
            raise InputError(
                f"{self.paths[0]}: has no [laser], and --f-number, --wavelength-nm and --pixel-um are for the stripe "
                "of one: add [laser] to session.toml, or leave out these options"
            )
        if estimate.sheet and not self.lasers:
            raise InputError(
                f"{self.paths[0]}: has no [laser], and --sheet needs one: add [laser], or leave --sheet out"
            )


def read_together(paths: Sequence[Path], estimate: Estimate) -> Together:
    """Read sessions, and files of corners (`.mat`), of one rig.

    Args:
        paths: of each.
        estimate: what the command line asks for in their place.

    Raises:
        InputError: one of them is not usable, or they do not go together: file and entry.
    """
    from jaxscan.calibration.board_views import observations_from
    from jaxscan.calibration.observations import join
    from jaxscan.calibration.observe import unseen
    from jaxscan.files.cameras import read_camera_file
    from jaxscan.files.session import CameraSettings, Session, check_stage_known, read_session

    contents, settings, shapes = [], [], []
    for path in paths:
        mat = path.suffix.lower() == ".mat"
        contents.append(read_camera_file(path) if mat else read_session(path))
        settings.append(estimate.of(CameraSettings() if mat else contents[-1].camera))
        shapes.append(estimate.board_shape or ("flat" if mat else contents[-1].board_shape))
        if shapes[-1] != shapes[0]:
            raise InputError(
                f'{path}: its board has shape = "{shapes[-1]}", that of {paths[0]} "{shapes[0]}": sessions that are '
                "solved together show one board, so give all the same [board], or choose with --board-shape"
            )
        if settings[-1] != settings[0]:
            raise InputError(
                f"{path}: its {_in_words(settings[-1])}; those of {paths[0]}: {_in_words(settings[0])}: sessions "
                "of one rig have one camera, so give all the same [camera]"
            )
    each = [
        unseen(content) if isinstance(content, Session) else observations_from(content, path)
        for content, path in zip(contents, paths, strict=True)
    ]
    # For its errors, so that they come before the long work.
    joined = join(names(paths), each)
    sheets = _sheets(paths, contents, estimate)
    motion, periods = stage_motion(paths, contents, estimate)
    motion |= _turntable_motion(paths, contents)
    left, notes = _once(paths, contents)
    together = Together(
        [paths[i] for i in left],
        list(left.values()),
        [each[i] for i in left],
        settings[0],
        shapes[0],
        sheets,
        motion,
        periods,
        len(joined.lasers),
        notes,
    )
    _check_counts(together)
    check_stage_known(together.sessions)
    return together


def _sheets(paths: Sequence[Path], contents: Sequence["Session | CameraFile"], estimate: Estimate) -> tuple[str, ...]:
    """The kind of each laser's sheet, the same in all sessions.

    Raises:
        InputError: they differ.
    """
    from jaxscan.files.session import Session

    asked = {
        path: estimate.sheets(content)
        for path, content in zip(paths, contents, strict=True)
        if isinstance(content, Session)
    }
    (first, sheets), *others = asked.items() or [(paths[0], ())]
    for path, own in others:
        if own != sheets:
            raise InputError(
                f"{path}: its [laser] sheet is {', '.join(own)}, that of {first} is {', '.join(sheets)}: sessions of "
                "one rig have one laser, so give all the same"
            )
    return sheets


def stage_motion(
    paths: Sequence[Path], contents: Sequence["Session | CameraFile"], estimate: Estimate
) -> tuple[dict[str, str], dict[str, float]]:
    """The kind of the stage's motion and the steps of a turn of its screw, by the axis's name; the same in all.

    Raises:
        InputError: they differ, or none shows a stage whose motion is asked for.
    """
    from jaxscan.files.axes import STAGE
    from jaxscan.files.session import Session

    stages = {
        path: content.stage
        for path, content in zip(paths, contents, strict=True)
        if isinstance(content, Session) and content.stage
    }
    if not stages:
        if estimate.stage_motion is not None:
            raise InputError(f"{paths[0]}: has no [stage], and --motion needs one: add [stage], or leave --motion out")
        return {}, {}
    asked = {path: (estimate.stage_motion or stage.motion, stage.screw_steps) for path, stage in stages.items()}
    (first, (motion, screw)), *others = asked.items()
    for path, own in others:
        if own != (motion, screw):
            raise InputError(
                f"{path}: its [stage] has {_stage_words(*own)}, that of {first} {_stage_words(motion, screw)}: "
                "sessions of one rig have one stage, so give all the same"
            )
    return {STAGE: motion}, {STAGE: screw} if screw is not None else {}


def _turntable_motion(paths: Sequence[Path], contents: Sequence["Session | CameraFile"]) -> dict[str, str]:
    """The kind of the turntable's motion, by the axis's name; the same in all, and none where it is a plain turn.

    Raises:
        InputError: they differ.
    """
    from jaxscan.files.session import Session
    from jaxscan.rig import Rotary

    kinds = {
        path: content.turntable.motion
        for path, content in zip(paths, contents, strict=True)
        if isinstance(content, Session) and content.turntable
    }
    for path, kind in kinds.items():
        first, usual = next(iter(kinds.items()))
        if kind != usual:
            raise InputError(
                f'{path}: its [turntable] has motion = "{kind}", that of {first} "{usual}": sessions of one rig have '
                "one turntable, so give all the same"
            )
    kind = next(iter(kinds.values()), Rotary.kind)
    return {"turntable": kind} if kind != Rotary.kind else {}


def _stage_words(motion: str, screw: float | None) -> str:
    return f'motion = "{motion}"' + (f", screw_steps = {screw:g}" if screw is not None else ", no screw_steps")


def _once(
    paths: Sequence[Path], contents: Sequence["Session | CameraFile"]
) -> tuple[dict[int, "Session | CameraFile"], list[str]]:
    """The sessions and files of corners without what stands in one before, by their places, and notes on what did.

    Raises:
        InputError: a photograph has one role in one session and another in another.
    """
    from jaxscan.files.session import Session
    from jaxscan.files.shared import listed_once

    sessions, notes = listed_once([content for content in contents if isinstance(content, Session)])
    rest, corners = iter(sessions), set()
    left: dict[int, Session | CameraFile] = {}
    for i, (path, content) in enumerate(zip(paths, contents, strict=True)):
        if isinstance(content, Session):
            if (own := next(rest)).photographs():
                left[i] = own
        elif (file := os.path.realpath(path)) in corners:
            notes.append(f"{path} is given twice, and counts once")
        else:
            corners.add(file)
            left[i] = content
    return left, notes


def _check_counts(together: Together) -> None:
    """Refuse too few poses or places, before the long work where the number of listed photographs shows it.

    Raises:
        InputError: there are too few.
    """
    from jaxscan.calibration.refusals import FEWEST_VIEWS, check_places, check_views_for

    read = sum(len(given.views) for given in together.unseen)
    poses = read + sum(len(session.views.boards) for session in together.sessions)
    listed = ", ".join(map(str, together.paths))
    if poses < FEWEST_VIEWS:
        raise InputError(
            f"{listed}: the board is shown in {poses} {'pose' if poses == 1 else 'poses'}; at "
            f"least {FEWEST_VIEWS} are needed, 10 to 15 are good: photograph it in more, tilted in different "
            "directions, and name them in [views] boards"
        )
    try:
        check_views_for(together.board_shape, poses)
        for session in together.sessions:
            for axis, sequence in session.sequences.items():
                if axis in together.motion:
                    check_places(axis, together.motion[axis], len(set(sequence.steps)))
    except InputError as error:
        raise InputError(f"{listed}: {error}") from None


def _in_words(settings: "CameraSettings") -> str:
    held = f", {', '.join(settings.hold)} held" if settings.hold else ""
    tilt = ", sensor tilted" if settings.tilt else ""
    return f"lens {settings.lens}, principal point {settings.principal_point}{held}{tilt}"


def names(paths: Sequence[Path]) -> list[str]:
    """What each session is called: its folder's name, or its whole path where two have the same."""
    folders = [path if path.is_dir() else path.parent for path in paths]
    own = [folder.resolve().name for folder in folders]
    return own if len(set(own)) == len(own) else [str(path) for path in paths]
