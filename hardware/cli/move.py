"""`scanner move`: go to a step count."""

import argparse
from typing import Any, Final

from hardware.cli.options import add_scanner_arguments, stage_alone

HELP: Final = "send the stage to a step count; it is homed first, unless --homed"
EXAMPLE: Final = "scanner move 20000 --homed"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("step", type=int, help="motor steps from the reference")
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Move it."""
    from hardware.scan import ensure_homed

    with stage_alone(args) as stage:
        ensure_homed(stage)
        stage.move_to(args.step)
        return {"step_count": stage.position()}


def describe(result: dict[str, Any]) -> str:
    """Where it stands."""
    return f"the stage stands at step {result['step_count']}"
