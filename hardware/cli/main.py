"""The command `scanner`."""

import signal
from collections.abc import Sequence
from types import FrameType
from typing import Final, NoReturn

from hardware.errors import HardwareError
from jaxscan.cli.main import Program, run_program
from jaxscan.cli.process import run_as_process

COMMANDS: Final = {
    "devices": "hardware.cli.devices",
    "home": "hardware.cli.home",
    "move": "hardware.cli.move",
    "shoot": "hardware.cli.shoot",
    "scan": "hardware.cli.scan",
    "verify": "hardware.cli.verify",
    "calibrate": "hardware.cli.calibrate",
    "console": "hardware.cli.console",
    "serve": "hardware.cli.serve",
    "user": "hardware.cli.user",
}
# The others wait for somebody.
SHOWS_WORK: Final = COMMANDS.keys() - {"console", "serve", "user"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line of `scanner`; a signal that ends it switches laser and motor off first, as Ctrl-C does."""
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), _interrupt)
    description = "Drive a laser line scanner: its stage, its laser and its camera, or simulated ones."
    return run_program(Program("scanner", description, COMMANDS, (HardwareError,), SHOWS_WORK), argv)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def entry() -> NoReturn:
    """The process `scanner`."""
    run_as_process(main)
