"""`scanner console`: raw lines to the controller, and what it says."""

import argparse
import sys
from typing import Any, Final

from hardware.cli.options import add_axis_argument, add_scanner_arguments

HELP: Final = "send lines to an axis's controller as they are typed, and show its answers; nothing is checked"
EXAMPLE: Final = "scanner console --port /dev/ttyUSB0 --baud 9600"

# How long answers are waited for after each line.
_LISTEN_S: Final = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--port", help="another port than the described scanner's")
    parser.add_argument("--baud", type=int, help="of --port (default: 9600)")
    parser.add_argument(
        "--end", choices=("none", "cr", "lf", "crlf"), help="after each line (default: as the controller)"
    )
    add_axis_argument(parser, "stage", "whose controller (default: stage)")
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Talk until the input ends."""
    from hardware.devices import open_stage, read_scanner
    from hardware.stages import Line
    from jaxscan.errors import InputError

    if args.port:
        line, end = Line(args.port, args.baud or 9600), args.end or "none"
    else:
        settings = read_scanner(args.scanner)
        axis = open_stage(settings, args.axis)
        line = getattr(axis, "line", None)
        if not isinstance(line, Line):
            raise InputError(f"the {args.axis} has no serial line to talk on: choose another --axis")
        end = args.end or ("crlf" if settings.axes[args.axis].table.values["kind"] in ("grbl", "marlin") else "none")
    ending = {"none": b"", "cr": b"\r", "lf": b"\n", "crlf": b"\r\n"}[end]
    try:
        for typed in sys.stdin:
            line.forget()
            line.send(typed.rstrip("\r\n").encode("latin-1", "replace") + ending)
            print(line.listen(_LISTEN_S).decode("latin-1").strip(), flush=True)
    finally:
        line.close()


def describe(result: dict[str, Any]) -> str:
    """Everything has been said."""
    return ""
