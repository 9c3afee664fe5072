"""`jaxscan calibrate`: photographs of a board in, a rig with its covariance out."""

import argparse
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.detector_options import add_detector_argument
from jaxscan.cli.estimate_options import add_estimate_arguments, estimate_asked
from jaxscan.cli.options import add_optics_arguments, check_outputs, check_rig_name, optics_asked
from jaxscan.errors import InputError
from jaxscan.extras import extra

if TYPE_CHECKING:
    from jaxscan.calibration import Calibration
    from jaxscan.files.rig_file import RigFile
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
# How many of a photograph were left out.
_POINTS: Final = re.compile(r": (\d+) of \d+ (?:corners|stripe points)")
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
    check_rig_name(args.output)
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
    from jaxscan.cli.solve_sessions import solve_sessions

    parts = solve_sessions(
        args.session, args.camera, args.camera_name, args.hold_camera, args.detector, estimate, bool(optics)
    )
    calibration = _write(parts, args.output)
    if pages:
        judged = write_report(calibration, pages[0], pages[1], optics)
        carry_on(judged, calibration.rig_file(), args.output)
    else:
        judged = judge_calibration(calibration, args.output)
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


def calibrate_session(paths: Sequence[Path], output: Path) -> "Calibration":
    """Calibrate as the sessions say, with progress bars, and write the rig; beside it what it was before a change."""
    from jaxscan.cli.solve_sessions import solve_sessions

    return _write(solve_sessions(paths), output)


def _write(parts: tuple["Calibration", "Calibration"], output: Path) -> "Calibration":
    from jaxscan.files.rig_file import write_rig

    before, calibration = parts
    if _differs(calibration):
        write_rig(before_path(output), before.rig_file())
    write_rig(output, calibration.rig_file())
    return calibration


def carry_on(judged: "Verdict", content: "RigFile", output: Path) -> None:
    """Write a rig again with the reasons not to use it, where it has some: every command that uses it says them."""
    from jaxscan.files.rig_file import write_rig

    gravest = [box.statement.rstrip(".") for box in judged.warnings if box.level == "stop"]
    said = [f"The calibration was not to be used: {words}" for words in gravest if words not in content.warnings]
    if said:
        write_rig(output, replace(content, fit={**content.fit, "warnings": [*content.warnings, *said]}))


def before_path(output: Path) -> Path:
    """Where the rig before a change is written: `rig.before.json` beside `rig.json`."""
    return output.with_name(f"{output.stem}.before{output.suffix}")


def _differs(calibration: "Calibration") -> bool:
    """Whether the rig was another before one of the photographs."""
    return calibration.parted is not None and calibration.parted.rig_differs


def judge_calibration(calibration: "Calibration", output: Path) -> "Verdict":
    """The part of the report that is computed in a moment; a red verdict goes into the rig's file."""
    from jaxscan.view.verdict import verdict

    judged = verdict(calibration)
    carry_on(judged, calibration.rig_file(), output)
    return judged


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
        counted = [(line.partition(": ")[0], int(found[1])) for line in rejected if (found := _POINTS.search(line))]
        count, points = len({name for name, _ in counted}), sum(n for _, n in counted)
        of = "1 photograph" if count == 1 else f"{count} photographs"
        lines.append(f"rejected as outliers: {points} points in {of}, listed by --report and --json")
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
