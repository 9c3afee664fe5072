"""`jaxscan calibrate`: photographs of a board in, a rig with its covariance out."""

import argparse
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.detector_options import add_detector_argument
from jaxscan.cli.estimate_options import AS_THE_SESSION, Estimate, add_estimate_arguments, estimate_asked
from jaxscan.cli.options import add_optics_arguments, check_outputs, optics_asked
from jaxscan.detectors import DEFAULT, Detector
from jaxscan.errors import InputError
from jaxscan.extras import extra

if TYPE_CHECKING:
    from jaxscan.calibration import Calibration
    from jaxscan.files.camera_file import CameraFile
    from jaxscan.files.session import CameraSettings, Session
    from jaxscan.rig import Camera, Rig
    from jaxscan.rig.speckle_limit import Optics
    from jaxscan.view.verdict import Verdict

HELP: Final = "find camera, lens, light plane and stage from photographs of a board, all together"
EXAMPLE: Final = (
    "jaxscan calibrate session -o rig.json --report report\n"
    "  jaxscan calibrate session --camera camera.yml --hold-camera\n"
    "  jaxscan calibrate calib_data.mat --lens brown --hold camera.radial.2 --plain"
)

# Up to this many photographs that were left out for one reason have a line each.
_NAMED: Final = 2
_PAGES: Final = ("report.html", "report.json")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "session",
        type=Path,
        nargs="+",
        metavar="SESSION",
        help="a folder with session.toml, that file, or the corners that Bouguet's toolbox saved: calib_data.mat; "
        "several of one rig are solved together",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("rig.json"),
        metavar="RIG",
        help="the rig to write (default: rig.json)",
    )
    parser.add_argument(
        "--camera",
        type=Path,
        metavar="FILE",
        help="start from the camera of this file, and keep its lens: a rig.json, or what `jaxscan convert` reads",
    )
    parser.add_argument("--hold-camera", action="store_true", help="keep the camera of --camera as it is")
    parser.add_argument("--camera-name", metavar="CAM", help="which camera of a camchain of several: cam0, cam1, …")
    add_estimate_arguments(parser)
    parser.add_argument(
        "--report",
        type=Path,
        metavar="DIR",
        help="look for what a small RMS hides, and write DIR/report.html and DIR/report.json",
    )
    add_detector_argument(parser)
    add_optics_arguments(
        parser, "how near the stripes come to what speckle alone leaves, in the report; all three go together"
    )


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read the session, find corners and stripes, solve, and write the rig."""
    if args.output.suffix.lower() != ".json":
        raise InputError(f"{args.output}: a rig is a JSON file: end its name with .json")
    outputs = [args.output, *([before_path(args.output)] if args.split else [])]
    check_outputs(outputs)
    if args.camera is None and (args.hold_camera or args.camera_name or args.free):
        raise InputError(
            "--hold-camera, --camera-name and --free need the camera of a file: name it with --camera FILE"
        )
    if args.hold_camera and args.free:
        free = ", ".join(name for names in args.free for name in names)
        raise InputError(
            f"--hold-camera keeps all of the camera, --free {free} estimates a part of it: leave out one of them"
        )
    optics = optics_asked(args)
    if optics and not args.report:
        raise InputError("--f-number, --wavelength-nm and --pixel-um are for the report: add --report DIR")
    pages = [args.report / name for name in _PAGES] if args.report else []
    if pages:
        extra("plots")
        _make_folder(args.report)
        check_outputs([*outputs, *pages])
    estimate = estimate_asked(args)
    calibration = calibrate_session(
        args.session,
        args.output,
        args.camera,
        args.camera_name,
        args.hold_camera,
        args.detector,
        estimate,
        bool(optics),
    )
    judged = write_report(calibration, pages[0], pages[1], optics) if pages else judge_calibration(calibration)
    from jaxscan.cli.summary import rig_summary
    from jaxscan.view.report import plain

    said = plain(judged)
    return {
        **rig_summary(args.output),
        "before": str(before_path(args.output)) if _differs(calibration) else None,
        "left_out": list(calibration.left_out),
        "rejected": list(calibration.rejected),
        "notes": list(calibration.notes),
        "model": None if calibration.choice is None else calibration.choice.as_data(),
        "warnings": said.pop("warnings"),
        "verdict": said,
        "report": {"html": str(pages[0]), "json": str(pages[1])} if pages else None,
    }


def calibrate_session(
    paths: Sequence[Path],
    output: Path,
    camera: Path | None = None,
    name: str | None = None,
    hold: bool = False,
    detector: Detector = DEFAULT,
    estimate: Estimate = AS_THE_SESSION,
    needs_laser: bool = False,
) -> "Calibration":
    """Calibrate as `solve_sessions`, and write the rig to `output`, and where it was another before, that beside it."""
    from jaxscan.files.rig_file import write_rig

    before, calibration = _solved(paths, camera, name, hold, detector, estimate, needs_laser)
    if _differs(calibration):
        write_rig(before_path(output), before.rig_file())
    write_rig(output, calibration.rig_file())
    return calibration


def before_path(output: Path) -> Path:
    """Where the rig before a change is written: `rig.before.json` beside `rig.json`."""
    return output.with_name(f"{output.stem}.before{output.suffix}")


def _differs(calibration: "Calibration") -> bool:
    """Whether the rig was another before one of the photographs."""
    return calibration.parted is not None and calibration.parted.rig_differs


def solve_sessions(
    paths: Sequence[Path],
    camera: Path | None = None,
    name: str | None = None,
    hold: bool = False,
    detector: Detector = DEFAULT,
    estimate: Estimate = AS_THE_SESSION,
    needs_laser: bool = False,
) -> "Calibration":
    """Calibrate with progress bars; a session in two parts as its second part is.

    Args:
        paths: the sessions, all of one rig; or a `.mat` with corners in place of one.
        camera: a file with a camera to start from.
        name: which camera of that file.
        hold: whether that camera is kept as it is.
        detector: how the stripe's centre is measured.
        estimate: lens, held parameters, board's shape and weights, as far as they are not the sessions'.
        needs_laser: whether the limit of speckle is asked for, which only a laser's stripe can show.
    """
    return _solved(paths, camera, name, hold, detector, estimate, needs_laser)[1]


def _solved(
    paths: Sequence[Path],
    camera: Path | None,
    name: str | None,
    hold: bool,
    detector: Detector,
    estimate: Estimate,
    needs_laser: bool,
) -> tuple["Calibration", "Calibration"]:
    """The rig before a change and now: one and the same where there was none."""
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.calibration import calibrate, calibrate_by_evidence, calibrate_split
    from jaxscan.calibration.board_views import observations_from
    from jaxscan.calibration.held import held_parameters, parameters_beyond_camera
    from jaxscan.calibration.known_scale import scale_note
    from jaxscan.calibration.model import Model
    from jaxscan.calibration.observations import join
    from jaxscan.calibration.observe import observe, photograph_count, photograph_names, unseen
    from jaxscan.cli.progress import progress
    from jaxscan.files.cameras import read_camera_file
    from jaxscan.files.session import CameraSettings, Session, check_stage_known, read_session
    from jaxscan.rig.camera import camera_parameters

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
    # These for their errors, so that they come before the long work.
    joined = join(_names(paths), each)
    sheets = _sheets(paths, contents, estimate)
    motion, periods = _stage_motion(paths, contents, estimate)
    motion |= _turntable_motion(paths, contents)
    left, notes = _once(paths, contents)
    paths, contents, each = [paths[i] for i in left], list(left.values()), [each[i] for i in left]
    _check_poses(paths, contents, sum(len(given.views) for given in each), shapes[0])
    sessions = [content for content in contents if isinstance(content, Session)]
    check_stage_known(sessions)
    if needs_laser and not joined.lasers:
        raise InputError(
            f"{paths[0]}: has no [laser], and --f-number, --wavelength-nm and --pixel-um are for the stripe of one: "
            "add [laser] to session.toml, or leave out these options"
        )
    if estimate.sheet and not joined.lasers:
        raise InputError(f"{paths[0]}: has no [laser], and --sheet needs one: add [laser], or leave --sheet out")
    start = _start(camera, name, settings[0], contents[0].image_size) if camera else None
    asked, lens = settings[0], start.lens.kind if start else settings[0].lens
    tilted = asked.tilt or bool(start and start.tilt)
    if hold and asked.tilt and start is not None and not start.tilt:
        raise InputError(
            f"{camera}: its sensor is not tilted, and --hold-camera keeps it so; --tilt, or tilt under [camera], "
            "estimates a tilt: leave out one of them"
        )
    rig = _rig_with(camera, asked.hold) if camera else None
    holding = asked.hold
    if hold:
        holding = tuple(dict.fromkeys((*camera_parameters(lens, tilted=tilted), *asked.hold)))
    beyond = parameters_beyond_camera(rig) if rig else ()
    held_parameters(holding, lens, asked.principal_point, has_start=start is not None, tilted=tilted, beyond=beyond)
    if len(sessions) == len(contents):
        named = [photograph_names(session) for session in sessions]
        several = [f"{of}/{one}" for of, each_name in zip(_names(paths), named, strict=True) for one in each_name]
        estimate.check_named(several if len(named) > 1 else named[0])
    photographs = sum(map(photograph_count, sessions))
    with progress("finding boards and stripes", photographs) as advance:
        each = [
            observe(content, advance, detector) if isinstance(content, Session) else given
            for content, given in zip(contents, each, strict=True)
        ]
    observations = estimate.taken(join(_names(paths), each) if len(each) > 1 else each[0])
    observations = replace(observations, notes=(*notes, *observations.notes))
    held = settings[0].hold
    if start is not None and camera is not None:
        zeros = estimate.zeros(camera, start)
        held = holding if hold else tuple({*held, *zeros})
        if zeros and not hold:
            observations = replace(observations, notes=(*observations.notes, _kept_at_zero(camera, zeros)))
    model = Model(lens, settings[0].tilt, shapes[0], sheets, motion, periods)
    rest = {"principal_point": settings[0].principal_point, "start": rig or start, "hold": held}
    with progress("solving", unit="step") as advance:
        if estimate.split is not None:
            rest |= {"plain": estimate.plain, "advance": advance.says}
            try:
                split = calibrate_split(observations, estimate.split, **model.asked(), **rest)
            except InputError as error:
                raise InputError(f"--split: {error}") from None
            found = [split.before, split.after]
        elif estimate.chooses:
            fixed = estimate.fixed() | ({"lens"} if start else set())
            found = [calibrate_by_evidence(observations, model, fixed=fixed, advance=advance.says, **rest)]
        else:
            found = [calibrate(observations, **model.asked(), **rest, plain=estimate.plain, advance=advance.says)]
    scaled = [content for content in contents if isinstance(content, Session) and content.stage is not None]
    found = [
        replace(one, notes=(*one.notes, note)) if scaled and (note := scale_note(one, scaled)) else one for one in found
    ]
    return found[0], found[-1]


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


def _stage_motion(
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


def _check_poses(
    paths: Sequence[Path], contents: Sequence["Session | CameraFile"], read: int, board_shape: str
) -> None:
    """Refuse too few poses, before the long work where the number of listed photographs shows it.

    Args:
        paths: of the sessions.
        contents: what was read there.
        read: how many poses the files of corners hold.
        board_shape: what of the board's shape is to be found.
    """
    from jaxscan.calibration.refusals import FEWEST_VIEWS, check_views_for
    from jaxscan.files.session import Session

    poses = read + sum(len(content.views.boards) for content in contents if isinstance(content, Session))
    if poses < FEWEST_VIEWS:
        raise InputError(
            f"{', '.join(map(str, paths))}: the board is shown in {poses} {'pose' if poses == 1 else 'poses'}; at "
            f"least {FEWEST_VIEWS} are needed, 10 to 15 are good: photograph it in more, tilted in different "
            "directions, and name them in [views] boards"
        )
    try:
        check_views_for(board_shape, poses)
    except InputError as error:
        raise InputError(f"{', '.join(map(str, paths))}: {error}") from None


def _in_words(settings: "CameraSettings") -> str:
    held = f", {', '.join(settings.hold)} held" if settings.hold else ""
    tilt = ", sensor tilted" if settings.tilt else ""
    return f"lens {settings.lens}, principal point {settings.principal_point}{held}{tilt}"


def _kept_at_zero(path: Path, zeros: Sequence[str]) -> str:
    """The note on terms that a file has as 0."""
    are = "is" if len(zeros) == 1 else "are"
    return f"{', '.join(zeros)} {are} 0 in {path} and stayed 0: to have one found, name it with --free"


def _start(path: Path, name: str | None, settings: "CameraSettings", image_size: tuple[int, int]) -> "Camera":
    """The camera of a file, if it can have taken the photographs."""
    from jaxscan.files.cameras import read_camera

    camera = read_camera(path, name=name, image_size=image_size)
    centre = tuple((n - 1) / 2 for n in image_size)
    if settings.principal_point == "centre" and tuple(map(float, camera.principal)) != centre:
        raise InputError(
            f'{path}: its principal point is not the centre of the image, but the session holds it at the "centre": '
            "leave out principal_point, or the camera"
        )
    return camera


def _rig_with(path: Path, hold: Sequence[str]) -> "Rig | None":
    """The rig of a rig.json, where what is held is more than its camera's."""
    from jaxscan.files.cameras import format_of
    from jaxscan.files.rig_file import read_rig

    if all(name.startswith("camera.") for name in hold) or format_of(path) != "rig":
        return None
    return read_rig(path).rig


def judge_calibration(calibration: "Calibration") -> "Verdict":
    """The part of the report that is computed in a moment."""
    from jaxscan.view.verdict import verdict

    return verdict(calibration)


def write_report(calibration: "Calibration", html: Path, json: Path, optics: "Optics | None") -> "Verdict":
    """Look at a calibration from every side, with a progress bar; the verdict of that."""
    from jaxscan.cli.progress import progress
    from jaxscan.view.calibration_report import REPORT_PARTS, calibration_report
    from jaxscan.view.report import write_report_html, write_report_json

    with progress("judging", REPORT_PARTS, "part") as advance:
        report, judged = calibration_report(calibration, advance, optics)
    write_report_html(html, report)
    write_report_json(json, report)
    return judged


def _names(paths: Sequence[Path]) -> list[str]:
    """What each session is called: its folder's name, or its whole path where two have the same."""
    folders = [path if path.is_dir() else path.parent for path in paths]
    names = [folder.resolve().name for folder in folders]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--report {path}: no folder can be made there ({error.strerror}): name another") from error


def describe(result: dict[str, Any]) -> str:
    """The rig in words, what was left out and what was found wrong, and at the end the verdict in three lines."""
    from jaxscan.cli.format_summary import format_summary

    # What the rig's file warns of is among what the verdict does.
    lines = [format_summary({**result, "warnings": []})]
    lines += [f"before the change: {result['before']}"] if result["before"] else []
    lines += [f"left out: {line}" for line in _by_reason(result["left_out"])]
    if rejected := result["rejected"]:
        of = "1 photograph" if len(rejected) == 1 else f"{len(rejected)} photographs"
        lines.append(f"rejected as outliers: some points of {of}, listed by --report and --json")
    warned = {box["statement"] for box in result["warnings"]}
    lines += [f"note: {line}" for line in result["notes"] if f"{line[:1].upper()}{line[1:]}." not in warned]
    if result["report"]:
        lines.append(f"report: {result['report']['html']}, {result['report']['json']}")
    lines += [f"warning: {box['statement']} {box['advice']}".rstrip() for box in result["warnings"]]
    verdict = result["verdict"]
    lines += [f"verdict: {verdict['statement']}", f"what limits it: {verdict['limits']}"]
    return "\n".join([*lines, f"photograph next: {verdict['next']}"])


def _by_reason(left_out: Sequence[str]) -> list[str]:
    """What was left out, photographs with one reason in one line."""
    names: dict[str, list[str]] = {}
    for line in left_out:
        name, _, reason = line.partition(": ")
        names.setdefault(reason, []).append(name)
    lines = []
    for reason, each in names.items():
        if len(each) <= _NAMED or not reason:
            lines += [f"{name}: {reason}" if reason else name for name in each]
        else:
            lines.append(f"{len(each)} photographs: {reason} ({each[0]} … {each[-1]}; all of them with --json)")
    return lines
