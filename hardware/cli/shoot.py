"""`scanner shoot`: one photograph."""

import argparse
from pathlib import Path
from typing import Any, Final

from hardware.cli.options import add_axis_argument, add_scanner_arguments, check_travel, scanner

HELP: Final = "take one photograph where the axes stand, with the laser on"
EXAMPLE: Final = "scanner shoot stripe.png --step 20000\n  scanner shoot stripe.png --axis turntable --step 800"

_ENDINGS: Final = ".png", ".jpg", ".jpeg", ".tif", ".tiff"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("output", type=Path, metavar="IMAGE", help="the photograph to write: .png, .jpg or .tif")
    parser.add_argument("--step", type=int, help="go there first")
    add_axis_argument(parser, "stage", "which goes to --step (default: stage)")
    parser.add_argument("--dark", action="store_true", help="with the laser off")
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Take it."""
    from hardware.devices import read_scanner
    from hardware.safety import safely
    from hardware.scan import ensure_homed
    from jaxscan.atomic import check_writable
    from jaxscan.errors import InputError
    from jaxscan.images import write_image

    if args.output.suffix.lower() not in _ENDINGS:
        raise InputError(f"{args.output}: end its name with one of {', '.join(_ENDINGS)}: others cannot be read again")
    check_writable(args.output)
    if args.step is not None:
        check_travel(read_scanner(args.scanner), [{args.axis: args.step}])
    with scanner(args) as devices, safely(devices.axes, devices.laser):
        positions = {}
        if args.step is not None:
            axis = devices.axes[args.axis]
            ensure_homed({args.axis: axis})
            axis.move_to(args.step)
            positions[args.axis] = axis.position()
        if not args.dark:
            devices.laser.on()
        frame = devices.camera.expose(positions)
    write_image(args.output, frame.image)
    rows, columns = frame.image.shape[:2]
    return {"path": str(args.output), "image_size": [columns, rows], "exposure_s": frame.exposure_s}


def describe(result: dict[str, Any]) -> str:
    """What was written."""
    columns, rows = result["image_size"]
    return f"{result['path']}: {columns} × {rows} pixels, {result['exposure_s']:g} s"
