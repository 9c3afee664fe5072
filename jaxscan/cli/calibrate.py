"""`jaxscan calibrate`: photographs of a board in, a rig with its covariance out."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from jaxscan.calibration import Calibration

HELP: Final = "find camera, lens, light plane and stage from photographs of a board, all together"
EXAMPLE: Final = "jaxscan calibrate session -o rig.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("session", type=Path, metavar="SESSION", help="a folder with session.toml, or that file")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("rig.json"),
        metavar="RIG",
        help="the rig to write (default: rig.json)",
    )


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read the session, find corners and stripes, solve, and write the rig."""
    from jaxscan.atomic import check_writable
    from jaxscan.errors import InputError

    if args.output.suffix.lower() != ".json":
        raise InputError(f"{args.output}: a rig is a JSON file: end its name with .json")
    check_writable(args.output)
    calibration = calibrate_session(args.session, args.output)
    from jaxscan.cli.facts import rig_facts

    return {
        **rig_facts(args.output),
        "left_out": list(calibration.left_out),
        "notes": list(calibration.notes),
    }


def calibrate_session(path: Path, output: Path) -> "Calibration":
    """Calibrate with progress bars, and write the rig."""
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.calibration import calibrate
    from jaxscan.calibration.observe import observe, photograph_count
    from jaxscan.cli.progress import progress
    from jaxscan.files.rig_file import write_rig
    from jaxscan.files.session import read_session

    session = read_session(path)
    with progress("finding boards and stripes", photograph_count(session)) as advance:
        observations = observe(session, advance)
    with progress("solving", 1, "rig") as advance:
        calibration = calibrate(observations, lens=session.camera.lens, principal_point=session.camera.principal_point)
        advance(1)
    write_rig(output, calibration.rig_file())
    return calibration


def describe(result: dict[str, Any]) -> str:
    """The rig in words, then what was left out."""
    from jaxscan.cli.words import in_words

    lines = [in_words(result)]
    for title, key in (("left out", "left_out"), ("note", "notes")):
        lines += [f"{title}: {line}" for line in result[key]]
    return "\n".join(lines)
