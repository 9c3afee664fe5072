"""`scanner scan`: move, photograph, write, frame by frame."""

import argparse
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hardware.cli.options import add_scanner_arguments, check_travel, say, scanner

if TYPE_CHECKING:
    from hardware.frame import Frame

HELP: Final = "take a scan into a folder; Ctrl-Z pauses it, Ctrl-C ends it, --resume goes on with one that ended early"
EXAMPLE: Final = "scanner scan cup --frames 37 --apart 2000\n  scanner scan cup --resume"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("folder", type=Path, metavar="SCAN", help="the folder to make")
    parser.add_argument("--resume", action="store_true", help="go on with the scan in this folder, as it was begun")
    parser.add_argument("--frames", type=int, help="how many")
    parser.add_argument("--apart", type=int, help="motor steps from one to the next")
    parser.add_argument("--first", type=int, default=0, help="step count of the first (default: 0)")
    parser.add_argument("--settle", type=float, default=0.2, metavar="S", help="wait before each (default: 0.2 s)")
    parser.add_argument("--dark", action="store_true", help="with each frame one with the laser off")
    parser.add_argument("--name", default="", help="what is scanned")
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Take it."""
    from hardware.scan import Control, take
    from hardware.scan_plan import ScanFolder

    if args.resume:
        folder = ScanFolder.resume(args.folder)
        say(f"{len(folder.done.frames)} of {len(folder.plan.steps)} frames are there")
    else:
        folder = ScanFolder.create(args.folder, _plan(args))

    def taken(path: Path, frame: "Frame") -> None:
        say(f"taken {path.name} at step {frame.step_count}: {len(folder.done.frames)} of {len(folder.plan.steps)}")

    class Suspended(Control):
        """Pauses by suspending the program, once the laser is off and the frame is written."""

        def wait(self) -> None:
            if self.paused:
                say("paused, the laser is off; fg goes on")
                os.kill(os.getpid(), signal.SIGSTOP)
                self.resume()
            super().wait()

    control = Suspended()
    with scanner(args) as devices, _on_suspension(control.pause):
        take(folder, devices, control, taken)
    return {"path": str(args.folder), "frames": len(folder.done.frames), "steps": list(folder.done.steps)}


@contextmanager
def _on_suspension(pause: Callable[[], None]) -> Iterator[None]:
    """Let Ctrl-Z do this, where there is one; by itself it would leave the laser on."""
    if not hasattr(signal, "SIGTSTP"):
        yield
        return
    before = signal.signal(signal.SIGTSTP, lambda *_: pause())
    try:
        yield
    finally:
        signal.signal(signal.SIGTSTP, before)


def _plan(args: argparse.Namespace) -> Any:
    """The scan that the arguments ask for, within the stage's travel."""
    from hardware.devices import read_scanner
    from hardware.scan_plan import Plan
    from jaxscan.errors import InputError

    if args.frames is None or args.apart is None:
        raise InputError("--frames and --apart: say how many frames, and how many motor steps apart (or --resume)")
    if args.frames < 1 or (args.apart == 0 and args.frames > 1):
        raise InputError(f"--frames {args.frames} --apart {args.apart}: give one frame or more, at places of their own")
    settings = read_scanner(args.scanner)
    steps = tuple(args.first + args.apart * i for i in range(args.frames))
    check_travel(settings, steps)
    return Plan(
        steps, args.settle, args.dark, settings.exposure_s, settings.gain, name=args.name, laser=settings.stripe
    )


def describe(result: dict[str, Any]) -> str:
    """What there is, and what to do with it."""
    return (
        f"{result['path']}: {result['frames']} frames, steps {result['steps'][0]} to {result['steps'][-1]}\n"
        f"next: jaxscan reconstruct {result['path']} --rig rig.json -o points.ply"
    )
