"""`jaxscan gauge`: scans of objects of known shape put the rig's light planes, and its stage, right."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.options import add_units_argument
from jaxscan.errors import InputError

if TYPE_CHECKING:
    from jaxscan.calibration import Calibration
    from jaxscan.calibration.gauge_points import Gauge
    from jaxscan.calibration.gauge_shapes import Shape
    from jaxscan.files.rig_file import RigFile

HELP: Final = "put a rig's light plane and stage right by scans of objects of known shape"
EXAMPLE: Final = (
    "jaxscan gauge scans/block --rig rig.json --shape steps:1.48,3.68,8.94,14.00 -o refined.json\n"
    "  jaxscan gauge scans/block scans/turned --shape steps:1.48,14.00 --session session --trust laser stage -o a.json"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "scan",
        type=Path,
        nargs="+",
        metavar="SCAN",
        help="a gauge's scan: a folder with scan.toml, or that file; several (a gauge in several places, or several "
        "gauges) are solved together",
    )
    boards = parser.add_mutually_exclusive_group(required=True)
    boards.add_argument("--rig", type=Path, help="the rig, as jaxscan calibrate writes it: what its covariance says")
    boards.add_argument(
        "--session",
        type=Path,
        nargs="+",
        metavar="SESSION",
        help="the calibration sessions themselves: boards and gauges in one solve",
    )
    add_units_argument(parser, "a mesh file of --shape")
    parser.add_argument(
        "--shape",
        required=True,
        nargs="+",
        help="plate | steps:H1,H2,… (heights of level faces above the plate that they stand on, mm) | ball:R (radius, "
        "mm) | a mesh file (mm, z up, standing on z = 0); one for all scans, or one for each",
    )
    parser.add_argument(
        "--trust",
        choices=("laser", "stage"),
        nargs="*",
        default=("stage",),
        help="which results of the board calibration are kept, beside the camera (default: stage; the laser is "
        "assumed to have moved since). With laser and stage the gauge only adds information",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="RIG", help="the refined rig to write")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Find the stripe on the gauges, refine the rig, and write it."""
    from jaxscan.atomic import check_writable

    check_writable(args.output)
    shapes = _shapes(args.shape, len(args.scan), args.units)
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.calibration.gauge import refine_by_gauge
    from jaxscan.cli.progress import progress
    from jaxscan.files.rig_file import read_rig, write_rig
    from jaxscan.files.scan import read_scan

    scans = [read_scan(path) for path in args.scan]
    known: RigFile | Calibration
    if args.session:
        from jaxscan.cli.solve_sessions import solve_sessions

        _, known = solve_sessions(args.session)
        content = known.rig_file()
    else:
        known = content = read_rig(args.rig)
    gauges = [_look(content, scan, shape) for scan, shape in zip(scans, shapes, strict=True)]
    with progress("fitting the gauge", 1, "rig") as advance:
        fit = refine_by_gauge(known, gauges, args.trust)
        advance(1)
    # A light plane that the gauge has found again is not the one that was warned of.
    kept = content.fit if "laser" in args.trust else {k: v for k, v in content.fit.items() if k != "warnings"}
    write_rig(args.output, fit.rig_file(kept))
    return {
        "path": str(args.output),
        "gauges": [
            {
                "scan": str(path),
                "points": gauge.points,
                "rejected": gauge.rejected,
                "rms_before_mm": gauge.rms_before_mm,
                "rms_after_mm": gauge.rms_after_mm,
                "stripe_sigma_px": gauge.stripe_sigma_px,
            }
            for path, gauge in zip(args.scan, fit.gauges, strict=True)
        ],
        "from_prior_in_sigma": fit.from_prior_in_sigma,
    }


def _shapes(texts: list[str], scans: int, units: str | None) -> "list[Shape]":
    """A shape for each scan."""
    from jaxscan.calibration.gauge_shapes import parse_shape

    shapes = [parse_shape(text, units) for text in texts]
    if len(shapes) not in (1, scans):
        raise InputError(f"--shape: {len(shapes)} shapes for {scans} scans: give one for all of them, or one for each")
    return shapes * (scans // len(shapes))


def _look(content: "RigFile", photographs: Any, shape: "Shape") -> "Gauge":
    """A gauge with what is seen of it in its scan."""
    from jaxscan.calibration.gauge_points import Gauge, GaugeScan
    from jaxscan.cli.progress import progress
    from jaxscan.reconstruction import reconstruct

    with progress("reading frames", len(photographs.frames) or None, "frame") as advance:
        image = reconstruct(content, photographs, advance)
    return Gauge(GaugeScan(image.pixels, image.positions, photographs.laser.columns, photographs.laser.name), shape)


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    lines = [f"rig {result['path']}"]
    for gauge in result["gauges"]:
        before, after = gauge["rms_before_mm"], gauge["rms_after_mm"]
        lines += [
            f"  gauge      {gauge['scan']}: {gauge['points']} stripe points on it, {gauge['rejected']} elsewhere",
            f"  distance   {before:.3f} mm RMS from its surface before, {after:.3f} mm now",
        ]
    return "\n".join(
        [*lines, f"  agreement  {result['from_prior_in_sigma']:.1f} standard deviations from what was trusted"]
    )
