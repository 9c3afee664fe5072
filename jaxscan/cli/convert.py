"""`jaxscan convert`: a camera from the file of one program into that of another."""

import argparse
import warnings
from pathlib import Path
from typing import Any, Final

from jaxscan.cli.camera_options import add_camera_arguments
from jaxscan.cli.options import check_outputs
from jaxscan.errors import InputError
from jaxscan.files.formats import ENDINGS, FORMATS, format_to_write
from jaxscan.files.table import PassedOverWarning

HELP: Final = "write the camera of a file for another program: Bouguet's toolbox, OpenCV, ROS, Kalibr, mrcal"
EXAMPLE: Final = "jaxscan convert Calib_Results.mat camera.yaml --format ros"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("source", type=Path, metavar="IN", help=f"a camera: {', '.join(ENDINGS)}")
    parser.add_argument("target", type=Path, metavar="OUT", help="the file to write; its ending says the format")
    parser.add_argument("--format", choices=list(FORMATS), help="the format of OUT, where it ends in .yml or .yaml")
    add_camera_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read, say what the other format does not take, and write."""
    form = format_to_write(args.target, args.format)
    check_outputs([args.target], inputs=[args.source])
    from jaxscan.cli.summary import camera_summary
    from jaxscan.files.cameras import format_of, lost, read_camera_file, write_camera_file

    if form == format_of(args.source) == "rig":
        raise InputError(f"{args.source}: is a rig already, and {args.target} would be its camera alone: copy the file")
    content = read_camera_file(args.source, name=args.name, image_size=args.image_size)
    write_camera_file(args.target, content, format=form)
    gone = lost(content, form)
    if gone:
        title = FORMATS[form].title
        warnings.warn(f"{args.target}: {title} has no place for {', '.join(gone)}", PassedOverWarning, stacklevel=1)
    return {**camera_summary(args.target, None, content.image_size), "left_out": gone}


def describe(result: dict[str, Any]) -> str:
    """What was written, in words."""
    from jaxscan.cli.format_summary import format_summary

    return format_summary(result)
