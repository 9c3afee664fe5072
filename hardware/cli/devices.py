"""`scanner devices`: what is there, and whether the scanner that is described answers."""

import argparse
from contextlib import closing
from pathlib import Path
from typing import Any, Final

from hardware.cli.options import add_scanner_arguments

HELP: Final = "list serial ports and cameras, and see whether the described scanner answers"
EXAMPLE: Final = "scanner devices"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Look."""
    from serial.tools.list_ports import comports

    from hardware.devices import open_scanner, open_stage, read_scanner
    from hardware.errors import HardwareError

    settings = read_scanner(args.scanner)
    answers: dict[str, Any] = {"axes": {}, "camera": "not tried: not every axis answers"}
    for name in settings.axes:
        try:
            with closing(open_stage(settings, name)) as axis:
                axis.check()
                answers["axes"][name] = "answers"
        except HardwareError as error:
            answers["axes"][name] = str(error)
    if set(answers["axes"].values()) == {"answers"}:
        try:
            with closing(open_scanner(settings, args.seed)):
                answers["camera"] = "opens"
        except HardwareError as error:
            answers["camera"] = str(error)
    return {
        "ports": [{"port": port.device, "what": port.description} for port in comports()],
        "cameras": sorted(str(path) for path in Path("/dev").glob("video*")),
        "described": str(settings.path or "simulated, there is no scanner.toml"),
        **answers,
    }


def describe(result: dict[str, Any]) -> str:
    """One line each."""
    ports = [f"  {port['port']}  {port['what']}" for port in result["ports"]] or ["  none"]
    cameras = [f"  {camera}" for camera in result["cameras"]] or ["  none under /dev"]
    return "\n".join(
        [
            "serial ports:",
            *ports,
            "cameras:",
            *cameras,
            f"scanner: {result['described']}",
            *(f"  {name}: {words}" for name, words in result["axes"].items()),
            f"  camera: {result['camera']}",
        ]
    )
