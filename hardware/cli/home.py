"""`scanner home`: find the reference switch."""

import argparse
from typing import Any, Final

from hardware.cli.options import add_scanner_arguments, stage_alone

HELP: Final = "drive the stage to its reference switch, and from there to step 0"
EXAMPLE: Final = "scanner home"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Home it."""
    with stage_alone(args) as stage:
        stage.home()
        return {"step_count": stage.position()}


def describe(result: dict[str, Any]) -> str:
    """Where it stands."""
    return f"homed; the stage stands at step {result['step_count']}"
