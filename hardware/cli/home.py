"""`scanner home`: find the reference switches."""

import argparse
from typing import Any, Final

from hardware.cli.options import add_axis_argument, add_scanner_arguments, axes_alone

HELP: Final = "drive each axis to its reference switch, and from there to step 0"
EXAMPLE: Final = "scanner home\n  scanner home --axis turntable"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_axis_argument(parser, None, "this one alone (default: all of them, one after the other)")
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Home it."""
    with axes_alone(args) as axes:
        for axis in axes.values():
            axis.home()
        return {"positions": {name: axis.position() for name, axis in axes.items()}}


def describe(result: dict[str, Any]) -> str:
    """The text of the result: the position of each axis."""
    places = (f"the {name} is at step {step}" for name, step in result["positions"].items())
    return f"homed; {', '.join(places)}"
