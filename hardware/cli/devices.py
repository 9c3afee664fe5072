"""`scanner devices`: what is there, and whether the scanner that is described answers."""

import argparse
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
    answers = {"stage": "answers", "camera": "opens"}
    try:
        stage = open_stage(settings, homed=True) if settings.stage.values["kind"] == "bistep" else open_stage(settings)
        stage.position()
    except HardwareError as error:
        if "no reference" not in str(error):
            answers["stage"] = str(error)
    else:
        stage.close()
    if answers["stage"] == "answers":
        try:
            open_scanner(settings, args.seed).camera.close()
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
            f"  stage: {result['stage']}",
            f"  camera: {result['camera']}",
        ]
    )
