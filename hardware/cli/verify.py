"""`scanner verify`: see by a board in a scan's photographs whether its axes stood where they said."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hardware.cli.options import add_board_arguments, board_of, say

if TYPE_CHECKING:
    from jaxscan import Rig
    from jaxscan.files.scan import Scan
    from jaxscan.images import Board

HELP: Final = "see by a board that rides on the axes, in view of the photographs, whether a motor lost steps"
EXAMPLE: Final = "scanner verify cup --rig rig.json --board 9x6 --square 10 --every 20"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.description = (
        f"{parser.description}\n\nNeeds no switch, so it works for a turntable too. Fix a board beside the object, on "
        "what moves; where it is seen elsewhere than the positions say, the frames are marked in scan.toml, and "
        "reconstruct says so. Needs a rig that fits to a thousandth of the way."
    )
    parser.add_argument("folder", type=Path, metavar="SCAN", help="the scan, taken")
    parser.add_argument("--rig", type=Path, required=True, help="of the scanner (.json)")
    add_board_arguments(parser)
    parser.add_argument(
        "--every",
        type=int,
        default=1,
        metavar="FRAMES",
        help="look at the first and the last photograph, and at every FRAMES between (default: 1, all of them)",
    )


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Look, and mark."""
    from hardware.scan_plan import alone_in
    from jaxscan import read_rig, read_scan
    from jaxscan.errors import InputError

    if args.every < 1:
        raise InputError(f"--every {args.every}: give 1 photograph or more")
    board, rig, found = board_of(args), read_rig(args.rig).rig, read_scan(args.folder)
    # A scan that goes on meanwhile would write the same file.
    with alone_in(found.path.parent):
        return _looked_at(read_scan(args.folder), rig, board, args.every)


def _looked_at(scan: "Scan", rig: "Rig", board: "Board", every: int) -> dict[str, Any]:
    """Look at a scan that nobody else writes, and mark it."""
    from dataclasses import replace

    from jaxscan.errors import InputError, error_context
    from jaxscan.files.place_checks import check_values
    from jaxscan.files.scan import write_scan
    from jaxscan.images import find_board, read_image
    from jaxscan.reconstruction.landmark import landmark
    from jaxscan.reconstruction.scan_checks import check_scan

    if not scan.frames:
        raise InputError(f"{scan.path}: has no photographs, or is a video: verify a scan of photographs")
    check_scan(rig, scan)
    corners = []
    for number, path in enumerate(scan.frames):
        looked = number % every == 0 or number == len(scan.frames) - 1
        found = find_board(board, read_image(path)) if looked else None
        if looked and found is None:
            say(f"{path.name}: the board was not found")
        corners.append(None if found is None else found.corners)
    with error_context(scan.path):
        shown = landmark(rig, scan.moving, scan.axes, board.points(), corners)
    checks = shown.checks(len(scan.frames))
    kept = tuple(check for check in scan.checks if not check.by_board)
    write_scan(replace(scan, checks=(*kept, *checks)))
    return {
        "path": str(scan.path),
        "frames": len(scan.frames),
        "seen": list(shown.frames),
        "off": {axis: off.tolist() for axis, off in shown.off.items()},
        "sigma": {axis: sigma.tolist() for axis, sigma in shown.sigma.items()},
        "rms_px": shown.rms_px,
        "checks": check_values(checks),
    }


def describe(result: dict[str, Any]) -> str:
    """What was seen."""
    marked = [check for check in result["checks"] if "off" in check]
    axes = ", ".join(
        f"{axis} off by at most {max(map(abs, off)):.1f} steps (sigma {max(result['sigma'][axis]):.1f})"
        for axis, off in result["off"].items()
    )
    lines = [
        f"{result['path']}: the board is in {len(result['seen'])} of {result['frames']} frames, to "
        f"{result['rms_px']:.2f} px; {axes}",
        *(
            f"frames {check['first']} to {check['last']} are marked: steps were lost, {check['off']}"
            for check in marked
        ),
    ]
    if marked:
        lines.append("if that grows evenly with the way, --square or the rig may be wrong in place of the positions")
    else:
        lines.append("no steps were lost in the frames that it covers")
    return "\n".join(lines)
