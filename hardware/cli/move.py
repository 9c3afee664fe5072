"""`scanner move`: go to a step count."""

import argparse
from typing import Any, Final

from hardware.cli.options import add_axis_argument, add_scanner_arguments, axes_alone, check_travel

HELP: Final = "send an axis to a step count; it is homed first, unless --homed"
EXAMPLE: Final = "scanner move 20000 --homed\n  scanner move 800 --axis turntable"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("step", type=int, help="motor steps from the reference")
    add_axis_argument(parser, "stage", "which to move (default: stage)")
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Move it."""
    from hardware.devices import read_scanner
    from hardware.scan import ensure_homed

    check_travel(read_scanner(args.scanner), [{args.axis: args.step}])
    with axes_alone(args) as axes:
        ensure_homed(axes)
        axes[args.axis].move_to(args.step)
        return {"positions": {args.axis: axes[args.axis].position()}}


def describe(result: dict[str, Any]) -> str:
    """The text of the result: the position of the axis."""
    ((name, step),) = result["positions"].items()
    return f"the {name} is at step {step}"
