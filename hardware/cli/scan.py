"""`scanner scan`: move, photograph, write, frame by frame."""

import argparse
import os
import shlex
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hardware.cli.options import add_axis_argument, add_scanner_arguments, as_input, say, scanner

if TYPE_CHECKING:
    from hardware.frame import Frame
    from hardware.places import Place
    from hardware.stages import Travel

HELP: Final = "take a scan into a folder; Ctrl-Z pauses it, Ctrl-C ends it, --resume continues one that ended early"
EXAMPLE: Final = (
    "scanner scan cup --frames 37 --apart 2000\n"
    "  scanner scan cup --resume\n"
    "  scanner scan owl --axis turntable --full-turn --frames 400 --at stage=37000\n"
    "  scanner scan owl --positions owl.csv   # any mixture: a line `stage,turntable`, then one for each frame"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("folder", type=Path, metavar="SCAN", help="the folder to make")
    parser.add_argument("--resume", action="store_true", help="continue the scan in this folder, as it was begun")
    parser.add_argument("--frames", type=int, help="how many")
    apart = parser.add_mutually_exclusive_group()
    apart.add_argument("--apart", type=int, metavar="STEPS", help="motor steps from one to the next")
    apart.add_argument("--full-turn", action="store_true", help="once around, in --frames equal parts")
    apart.add_argument(
        "--positions", type=Path, metavar="CSV", help="the axes' names in a line, then one for each frame"
    )
    parser.add_argument("--first", type=int, metavar="STEP", help="step count of the first (default: 0)")
    add_axis_argument(parser, "stage", "which moves from frame to frame (default: stage)")
    parser.add_argument(
        "--at", action="append", default=[], metavar="AXIS=STEP", help="where another axis stands; may be given again"
    )
    parser.add_argument("--settle", type=float, default=0.2, metavar="S", help="wait before each (default: 0.2 s)")
    parser.add_argument("--dark", action="store_true", help="with each frame one with the laser off")
    parser.add_argument(
        "--verify",
        type=int,
        nargs="?",
        const=0,
        metavar="FRAMES",
        help="meet the switch again at the end, and after every FRAMES frames, to see whether the motor lost steps; if "
        "it did, the frames since the last check are marked in scan.toml (default: at the end, where an axis can)",
    )
    parser.add_argument("--no-verify", action="store_true", help="end where the last frame was taken, unverified")
    parser.add_argument("--name", default="", help="what is scanned")
    add_scanner_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Take it."""
    from hardware.devices import read_scanner
    from hardware.places import check_zero
    from hardware.scan import Control, take, verifiable
    from hardware.scan_plan import ScanFolder
    from jaxscan.errors import InputError
    from jaxscan.files.place_checks import check_values

    if args.verify is not None and (args.no_verify or args.verify < 0):
        raise InputError(
            f"--verify {args.verify}: leave one of it and --no-verify out"
            if args.no_verify
            else f"--verify {args.verify}: give a number of frames, or none for a check at the end"
        )

    if args.resume:
        asked = [f"--{name}" for name in ("frames", "apart", "first", "positions") if getattr(args, name) is not None]
        if asked:
            raise InputError(
                f"--resume continues the plan that is in {args.folder}: leave out {', '.join(asked)}, or scan into "
                "another folder"
            )
        folder = ScanFolder.resume(args.folder)
        if folder.done.frames:
            with as_input():
                check_zero(read_scanner(args.scanner).travels, folder.plan.axes)
        say(f"{len(folder.done.frames)} of {len(folder.plan.places)} frames are there")
    else:
        folder = ScanFolder.create(args.folder, _plan(args))

    def taken(path: Path, frame: "Frame") -> None:
        say(f"taken {path.name} at {frame.place}: {len(folder.done.frames)} of {len(folder.plan.places)}")

    class Suspended(Control):
        """Pauses by suspending the program, once the laser is off and the frame is written."""

        def wait(self) -> None:
            if self.paused:
                say("paused, the laser is off; fg continues")
                os.kill(os.getpid(), signal.SIGSTOP)
                self.resume()
            super().wait()

    control = Suspended()
    with scanner(args) as devices, _on_suspension(control.pause):
        able = verifiable(devices.axes, folder.plan.axes)
        if args.verify is not None and (unable := sorted(set(folder.plan.axes).difference(able))):
            raise InputError(
                f"--verify: the {' and the '.join(unable)} cannot be verified: no switch, or a controller that does "
                "not say at which count it met it; continue with --resume, without --verify"
            )
        try:
            notes = take(folder, devices, control, taken, verify=None if args.no_verify else args.verify or 0)
        except KeyboardInterrupt:
            count = f"{len(folder.done.frames)} of {len(folder.plan.places)}"
            say(
                f"stopped: the axes are still, the laser is off, {count} frames are kept; "
                f"to go on: scanner scan {shlex.quote(str(args.folder))} --resume"
            )
            raise
    axes = {name: list(steps) for name, steps in folder.done.axes.items()}
    checks = check_values(folder.done.checks)
    return {"path": str(args.folder), "frames": len(folder.done.frames), "axes": axes, "checks": checks, "notes": notes}


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
    """The scan that the arguments ask for, within the travel of the axes."""
    from hardware.devices import read_scanner
    from hardware.places import axes_of, check_scan
    from hardware.scan_plan import Plan

    settings = read_scanner(args.scanner)
    with as_input():
        places = _places(args, settings.travels)
        check_scan(settings.travels, places)
    return Plan(
        axes_of(places),
        args.settle,
        args.dark,
        settings.exposure_s,
        settings.gain,
        name=args.name,
        laser=settings.stripe,
    )


def _places(args: argparse.Namespace, travels: "Mapping[str, Travel]") -> "tuple[Place, ...]":
    """Where the frames are to be taken."""
    from hardware.places import along, full_turn, read_places
    from jaxscan.errors import InputError

    if args.positions is not None:
        if args.frames is not None or args.first is not None or args.at:
            raise InputError("--positions says where each frame is taken: leave out --frames, --first and --at")
        return read_places(args.positions)
    if args.frames is None or (args.apart is None and not args.full_turn):
        raise InputError(
            "--frames and --apart: say how many frames, and how many motor steps apart (or --full-turn, --positions, "
            "--resume)"
        )
    first = args.first or 0
    if args.full_turn:
        steps = full_turn(travels, args.axis, args.frames, first)
    elif args.frames < 1 or (not args.apart and args.frames > 1):
        raise InputError(f"--frames {args.frames} --apart {args.apart}: give one frame or more, at places of their own")
    else:
        steps = tuple(range(first, first + args.apart * args.frames, args.apart)) if args.apart else (first,)
    return along(args.axis, steps, _at(args))


def _at(args: argparse.Namespace) -> dict[str, int]:
    """Where the other axes stand."""
    from jaxscan.errors import InputError

    at: dict[str, int] = {}
    for text in args.at:
        name, _, step = text.partition("=")
        try:
            at[name] = int(step)
        except ValueError as error:
            raise InputError(f"--at {text}: give an axis and its motor step, as stage=18000") from error
        if name == args.axis:
            raise InputError(f"--at {text}: the {name} is what moves (--axis): give its first step by --first")
    return at


def describe(result: dict[str, Any]) -> str:
    """What there is, and what to do with it."""
    axes = ", ".join(_from_to(*axis) for axis in result["axes"].items())
    verified = sum(check["last"] - check["first"] + 1 for check in result["checks"] if len(check) == 2)
    places = "all verified" if verified == result["frames"] else f"{verified} of {result['frames']} verified"
    return (
        f"{result['path']}: {result['frames']} frames, {axes}; places: {places}\n"
        + "".join(f"note: {note}\n" for note in result["notes"])
        + f"next: jaxscan reconstruct {shlex.quote(result['path'])} --rig rig.json -o points.ply"
    )


def _from_to(axis: str, steps: Sequence[int]) -> str:
    """The first and the last step of an axis, in words."""
    where = f"steps {steps[0]} to {steps[-1]}" if len(set(steps)) > 1 else f"step {steps[0]}"
    return where if axis == "stage" else f"{axis} {where}"
