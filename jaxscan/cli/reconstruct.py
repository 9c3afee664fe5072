"""`jaxscan reconstruct`: photographs of an object and a rig in, its points out."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.detector_options import add_choice_argument, add_depths_argument, add_detector_argument, depths_of
from jaxscan.cli.options import add_outputs_argument, check_outputs
from jaxscan.detectors import DEFAULT, DEFAULT_CHOICE, Choice, Detector

if TYPE_CHECKING:
    from jaxscan.reconstruction import Scanner, Written

HELP: Final = "turn the photographs of a scan into points"
EXAMPLE: Final = "jaxscan reconstruct scans/cup --rig rig.json -o cup.ply"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("scan", type=Path, metavar="SCAN", help="a folder with scan.toml, or that file")
    parser.add_argument("--rig", type=Path, required=True, help="the rig, as jaxscan calibrate writes it")
    add_outputs_argument(
        parser,
        "POINTS",
        ".ply (points) or .npz (the organised range image); also .xyz, .pcd, and with the extra exchange .e57 and .laz",
    )
    add_detector_argument(parser)
    add_choice_argument(parser)
    parser.add_argument(
        "--spacetime",
        action="store_true",
        help="measure when the light passes over each point of the surface, and not where it is in each frame: right "
        "at borders of prints and of the object too; needs a scan in small, equal steps",
    )
    add_depths_argument(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read rig and scan, find the stripe in every frame, triangulate, and write the points."""
    from jaxscan.files.cloud import check_ending
    from jaxscan.files.exchange import check_exchange

    for path in args.output:
        check_ending(path)
        check_exchange(path)
    check_outputs(args.output)
    done, scanner = reconstruct_scan(
        args.scan, args.rig, args.output, args.detector, args.stripe, args.spacetime, depths_of(args)
    )
    return {
        "kind": "points",
        "path": [str(path) for path in args.output],
        "frames": done.frames,
        "frames_without_stripe": done.empty,
        "points": done.points,
        "left_out": scanner.left_out,
        "notes": scanner.notes,
        "warnings": [f"{args.rig}: {warning}" for warning in scanner.warnings],
    }


def reconstruct_scan(
    scan: Path,
    rig: Path,
    outputs: list[Path],
    detector: Detector = DEFAULT,
    choice: Choice = DEFAULT_CHOICE,
    spacetime: bool = False,
    depths_mm: tuple[float, float] | None = None,
) -> tuple["Written", "Scanner"]:
    """Reconstruct with a progress bar, writing the points to each output; what was written, and what did it."""
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.cli.progress import progress
    from jaxscan.files.rig_file import read_rig
    from jaxscan.files.scan import read_scan
    from jaxscan.reconstruction import Scanner, write_stream

    calibrated, photographs = read_rig(rig), read_scan(scan)
    with progress("reading frames", len(photographs.frames) or None, "frame") as advance:
        scanner = Scanner(calibrated, detector, choice, spacetime, depths_mm)
        return write_stream(outputs, scanner.scan(photographs, advance)), scanner


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    empty = result["frames_without_stripe"]
    return (
        f"{result['points']} points from {result['frames']} frames"
        + (f" ({empty} without a stripe)" if empty else "")
        + f": {', '.join(result['path'])}"
        + "".join(f"\nnote: {note}" for note in result["notes"])
        + "".join(f"\nwarning: {warning}." for warning in result["warnings"])
    )
