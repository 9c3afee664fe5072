"""`jaxscan gauge`: a scan of an object of known shape puts the rig's light plane, and its stage, right."""

import argparse
from pathlib import Path
from typing import Any, Final

HELP: Final = "put a rig's light plane and stage right by a scan of an object of known shape"
EXAMPLE: Final = "jaxscan gauge scans/block --rig rig.json --shape steps:1.48,3.68,8.94,14.00 -o refined.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "scan", type=Path, metavar="SCAN", help="the gauge's scan: a folder with scan.toml, or that file"
    )
    parser.add_argument("--rig", type=Path, required=True, help="the rig, as jaxscan calibrate writes it")
    parser.add_argument(
        "--shape",
        required=True,
        help="plate | steps:H1,H2,… (heights of level faces above the plate that they stand on, mm) | ball:R (radius, "
        "mm) | a mesh file (mm, z up, standing on z = 0)",
    )
    parser.add_argument(
        "--trust",
        choices=("laser", "stage"),
        nargs="*",
        default=("stage",),
        help="what the rig's own covariance is believed of beside the camera (default: stage; the laser is taken to "
        "have been moved). With laser and stage the gauge only adds what it tells",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="RIG", help="the refined rig to write")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Find the stripe on the gauge, refine the rig, and write it."""
    from jaxscan.atomic import check_writable

    check_writable(args.output)
    from jaxscan.calibration.gauge_shapes import parse_shape

    shape = parse_shape(args.shape)
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.calibration.gauge import GaugeScan, refine_by_gauge
    from jaxscan.cli.progress import progress
    from jaxscan.files.rig_file import read_rig, write_rig
    from jaxscan.files.scan import read_scan
    from jaxscan.reconstruction import reconstruct

    content, photographs = read_rig(args.rig), read_scan(args.scan)
    with progress("reading frames", len(photographs.frames) or None, "frame") as advance:
        image = reconstruct(content, photographs, advance)
    scan = GaugeScan(image.pixels, image.steps, photographs.laser.columns, photographs.laser.name)
    with progress("fitting the gauge", 1, "rig") as advance:
        fit = refine_by_gauge(content, scan, shape, [part for part in ("laser", "stage") if part not in args.trust])
        advance(1)
    write_rig(args.output, fit.rig_file(content.fit))
    return {
        "path": str(args.output),
        "points": fit.points,
        "rejected": fit.rejected,
        "rms_before_mm": fit.rms_before_mm,
        "rms_after_mm": fit.rms_after_mm,
        "stripe_sigma_px": fit.stripe_sigma_px,
        "from_prior_in_sigma": fit.from_prior_in_sigma,
    }


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    before, after = result["rms_before_mm"], result["rms_after_mm"]
    return (
        f"rig {result['path']}\n"
        f"  gauge      {result['points']} stripe points on it, {result['rejected']} elsewhere\n"
        f"  distance   {before:.3f} mm RMS from its surface before, {after:.3f} mm now\n"
        f"  agreement  {result['from_prior_in_sigma']:.1f} standard deviations from what was trusted"
    )
