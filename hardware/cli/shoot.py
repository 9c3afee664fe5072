"""`scanner shoot`: one photograph."""

import argparse
from pathlib import Path
from typing import Any, Final

from hardware.cli.options import add_scanner_arguments, scanner

HELP: Final = "take one photograph where the stage stands, with the laser on"
EXAMPLE: Final = "scanner shoot stripe.png --step 20000"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("output", type=Path, metavar="IMAGE", help="the photograph to write: .png, .jpg or .tif")
    parser.add_argument("--step", type=int, help="go there first")
    parser.add_argument("--dark", action="store_true", help="with the laser off")
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Take it."""
    from hardware.safety import safely
    from hardware.scan import ensure_homed
    from jaxscan.atomic import check_writable
    from jaxscan.images import write_image

    check_writable(args.output)
    with scanner(args) as devices, safely(devices.stage, devices.laser):
        step = 0
        if args.step is not None:
            ensure_homed(devices.stage)
            devices.stage.move_to(args.step)
            step = devices.stage.position()
        if not args.dark:
            devices.laser.on()
        frame = devices.camera.expose(step)
    write_image(args.output, frame.image)
    rows, columns = frame.image.shape[:2]
    return {"path": str(args.output), "image_size": [columns, rows], "exposure_s": frame.exposure_s}


def describe(result: dict[str, Any]) -> str:
    """What was written."""
    columns, rows = result["image_size"]
    return f"{result['path']}: {columns} × {rows} pixels, {result['exposure_s']:g} s"
