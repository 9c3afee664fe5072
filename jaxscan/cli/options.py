"""Options that several commands have, and their values."""

import argparse
import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxscan.errors import InputError

if TYPE_CHECKING:
    from jaxscan.rig.speckle_limit import Optics


def add_outputs_argument(parser: argparse.ArgumentParser, metavar: str, what: str, required: bool = True) -> None:
    """Declare `-o`, which may be given more than once: the file's ending says what is written."""
    words = f"what to write: {what}; may be given more than once"
    parser.add_argument(
        "-o", "--output", type=Path, required=required, default=[], action="append", metavar=metavar, help=words
    )


def check_outputs(outputs: Iterable[Path], picture: Path | None = None, inputs: Iterable[Path] = ()) -> None:
    """Refuse places where what is asked for could not be written or would replace what is needed, before any work.

    Args:
        outputs: the files to write, but the picture.
        picture: the picture to draw, of matplotlib, where one is asked for.
        inputs: what is read, and stays.

    Raises:
        InputError: a place cannot be written to, is that of an input or of another output, or the picture is no PNG.
    """
    from jaxscan.atomic import check_writable

    if picture is not None and picture.suffix.lower() != ".png":
        raise InputError(f"--png {picture}: the picture is a PNG: end its name with .png")
    read, written = {os.path.realpath(path) for path in inputs}, set()
    for path in [*outputs, *([] if picture is None else [picture])]:
        check_writable(path)
        place = os.path.realpath(path)
        if place in read:
            raise InputError(f"{path}: is read, and writing to it would replace it: name another file to write")
        if place in written:
            raise InputError(f"{path}: two things are to be written there: name a file for each")
        written.add(place)


def check_rig_name(path: Path) -> None:
    """Refuse a name of a rig to be written that no reader would take for one.

    Raises:
        InputError: it does not end with .json.
    """
    if path.suffix.lower() != ".json":
        raise InputError(f"{path}: a rig is a JSON file: end its name with .json")


def add_units_argument(parser: argparse.ArgumentParser, what: str, option: str = "--units") -> None:
    """Declare in which unit of length what is read is given."""
    words = f"unit of length of {what} (default: mm; an object less than 2 mm across is reported)"
    parser.add_argument(option, choices=("mm", "cm", "m", "inch"), help=words)


def check_units(path: Path, units: str | None, option: str = "--units") -> None:
    """Refuse a unit of length for a range image, which has its own."""
    if units is not None and path.suffix.lower() == ".npz":
        raise InputError(f"{option} {units}: {path} is a range image, and these are in millimetres: leave it out")


def add_optics_arguments(parser: argparse.ArgumentParser, what: str) -> Any:
    """Declare lens, laser and pixel, for the limit of speckle; the group of them."""
    group = parser.add_argument_group("the limit of speckle", what)
    group.add_argument("--f-number", type=positive, metavar="N", help="of the camera's lens: 0.5 to 64")
    group.add_argument("--wavelength-nm", type=positive, metavar="NM", help="of the laser, in nanometres: 200 to 2000")
    group.add_argument(
        "--pixel-um", type=positive, metavar="UM", help="pitch of the sensor's pixels, in micrometres: 0.5 to 50"
    )
    return group


def optics_asked(args: argparse.Namespace) -> "Optics | None":
    """Lens, laser and pixel, or None.

    Raises:
        InputError: some of them are given and others are not, or a number is none that a lens, laser or sensor has.
    """
    asked = {name: getattr(args, name) for name in ("f_number", "wavelength_nm", "pixel_um")}
    missing = list(asked.values()).count(None)
    if missing == len(asked):
        return None
    if missing:
        raise InputError("--f-number, --wavelength-nm and --pixel-um go together: give all three, or none")
    from jaxscan.rig.speckle_limit import PLAUSIBLE, Optics

    for name, value in asked.items():
        if refusal := PLAUSIBLE[name].refusal(value):
            raise InputError(f"--{name.replace('_', '-')} {value:g}: {refusal}")
    return Optics(**asked)


def columns_and_rows(text: str) -> tuple[int, int] | None:
    """The two whole numbers of a text such as 9x6; None where it is none of that kind, or one of them is 0."""
    counts = text.lower().split("x")
    # Other digits than these, as ², are none that a number is written with.
    if len(counts) != 2 or not all(count.isascii() and count.isdecimal() and int(count) for count in counts):
        return None
    return int(counts[0]), int(counts[1])


def finite(text: str) -> float:
    """A number: neither nan nor inf, which Python takes for numbers too."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def positive(text: str) -> float:
    """A finite number that is more than 0."""
    value = finite(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not more than 0")
    return value


def not_nan(text: str) -> float:
    """A number that may be infinite."""
    value = float(text)
    if math.isnan(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return value


def numbers(
    count: int, kind: Callable[[str], Any] = finite, what: str = "finite numbers"
) -> Callable[[str], list[Any]]:
    """A parser of `count` numbers with commas between them; `what` they are, in words."""

    def read(text: str) -> list[Any]:
        try:
            values = [kind(word) for word in text.split(",")]
        except (ValueError, argparse.ArgumentTypeError):
            values = []
        if len(values) != count:
            raise argparse.ArgumentTypeError(f"{text!r} is not {count} {what} with commas between them")
        return values

    return read
