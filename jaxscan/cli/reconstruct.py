"""`jaxscan reconstruct`: photographs of an object and a rig in, its points out."""

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.detector_options import add_choice_argument, add_depths_argument, add_detector_argument, depths_of
from jaxscan.cli.options import add_outputs_argument, check_outputs, numbers
from jaxscan.detectors import DEFAULT, DEFAULT_CHOICE, Choice, Detector
from jaxscan.errors import InputError

if TYPE_CHECKING:
    from jaxscan.files.scan import Scan
    from jaxscan.reconstruction import RangeImage, Scanner, Written
    from jaxscan.rig import Rig

HELP: Final = "turn the photographs of a scan into points"
EXAMPLE: Final = "jaxscan reconstruct scans/cup --rig rig.json -o cup.ply"
# More burnt-out colours are worth a word.
_MANY_FULL: Final = 0.01
# Why points have no albedo, in words that follow their number.
_GAPS: Final = {
    "no_strength": "have no strength",
    "burnt_out": "are burnt out in the stripe",
    "alone": "have no neighbours on the surface",
    "oblique": "are lit or seen more obliquely than 60°",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("scan", type=Path, metavar="SCAN", help="a folder with scan.toml, or that file")
    parser.add_argument("--rig", type=Path, required=True, help="the rig, as jaxscan calibrate writes it")
    add_outputs_argument(
        parser,
        "POINTS",
        ".ply (points) or .npz (the organised range image); also .xyz, .pcd, and with the extra exchange .e57 and .laz",
    )
    add_detector_argument(parser)
    add_choice_argument(parser)
    parser.add_argument(
        "--spacetime",
        action="store_true",
        help="measure when the light passes over each point of the surface, instead of where it is in each "
        "frame: right at borders of prints and of the object too; needs a scan in small, equal steps",
    )
    add_depths_argument(parser)
    parser.add_argument(
        "--colour",
        choices=("auto", "frames", "none"),
        default="auto",
        help="of each point: auto (default): from the laser-off photograph of its own step, where background in "
        "scan.toml lists one for each frame | frames: from the photographs of other steps, in which the stripe is "
        "elsewhere (the light of the room must be seen in them; they are read twice, and all points are in memory) | "
        "none",
    )
    parser.add_argument(
        "--albedo",
        action="store_true",
        help="add how much light each point reflects, relative to the scan's median, from the stripe's strength, "
        "corrected for slope and distance; all points are in memory",
    )
    parser.add_argument(
        "--laser-at",
        type=numbers(3),
        metavar="X,Y,Z",
        help="where the laser stands, camera frame, mm, for --albedo (default: where its sheet meets the camera's "
        "vertical axis, or horizontal axis)",
    )


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read rig and scan, find the stripe in every frame, triangulate, and write the points."""
    from jaxscan.files.cloud import check_ending
    from jaxscan.files.exchange import check_exchange

    for path in args.output:
        check_ending(path)
        check_exchange(path)
    check_outputs(args.output)
    if args.laser_at and not args.albedo:
        raise InputError("--laser-at: only --albedo uses the place of the laser: add it, or leave --laser-at out")
    paint = Paint(args.colour, args.albedo, args.laser_at)
    done, scanner = reconstruct_scan(
        args.scan, args.rig, args.output, args.detector, args.stripe, args.spacetime, depths_of(args), paint
    )
    return {
        "kind": "points",
        "path": [str(path) for path in args.output],
        "frames": done.frames,
        "frames_without_stripe": done.empty,
        "spacetime": args.spacetime,
        "points": done.points,
        "points_with_colour": done.coloured,
        "points_with_full_colour": done.full,
        "points_with_albedo": done.reflecting,
        "without_albedo": paint.without_albedo if args.albedo else None,
        "left_out": scanner.left_out,
        "notes": scanner.notes,
        "warnings": [f"{args.rig}: {warning}" for warning in scanner.warnings],
    }


@dataclass(frozen=True)
class Paint:
    """What of the points' looks is asked for.

    Attributes:
        colour: auto, frames or none, as `--colour` has them.
        albedo: whether it is asked for.
        laser: where it stands, camera frame, mm; None for where it is taken to stand.
        without_albedo: how many points have none for each reason; filled where it is asked for.
    """

    colour: str = "auto"
    albedo: bool = False
    laser: tuple[float, ...] | None = None
    without_albedo: dict[str, int] = field(default_factory=dict)

    def of(self, parts: "Iterable[RangeImage]", rig: "Rig", scan: "Scan") -> "Iterator[RangeImage]":
        """The parts of a scan with it: in their turn, or at once where it takes all of them."""
        if self.colour != "frames" and not self.albedo:
            yield from (replace(part, colours=None) if self.colour == "none" else part for part in parts)
            return
        import numpy as np

        from jaxscan.reconstruction import RangeImage
        from jaxscan.reconstruction.scan_colours import check_photographs, neighbour_colours
        from jaxscan.surface.albedo import albedo_and_gaps

        if self.colour == "frames":
            check_photographs(scan)
        image = RangeImage.joined(list(parts))
        if self.colour != "auto":
            image = replace(image, colours=neighbour_colours(rig, scan, image) if self.colour == "frames" else None)
        if self.albedo:
            laser = None if self.laser is None else np.asarray(self.laser)
            found, gaps = albedo_and_gaps(image, laser=laser, columns=scan.laser.columns)
            self.without_albedo.update(gaps)
            image = replace(image, albedo=found)
        yield image


def reconstruct_scan(
    scan: Path,
    rig: Path,
    outputs: list[Path],
    detector: Detector = DEFAULT,
    choice: Choice = DEFAULT_CHOICE,
    spacetime: bool = False,
    depths_mm: tuple[float, float] | None = None,
    paint: Paint | None = None,
) -> tuple["Written", "Scanner"]:
    """Reconstruct with a progress bar, writing the points to each output; what was written, and what did it."""
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.cli.progress import progress
    from jaxscan.files.rig_file import read_rig
    from jaxscan.files.scan import read_scan
    from jaxscan.reconstruction import Scanner, write_stream

    calibrated, photographs = read_rig(rig), read_scan(scan)
    with progress("reading frames", len(photographs.frames) or None, "frame") as advance:
        scanner = Scanner(calibrated, detector, choice, spacetime, depths_mm)
        parts = (paint or Paint()).of(scanner.scan(photographs, advance), calibrated.rig, photographs)
        return write_stream(outputs, parts, lambda: scanner.notes), scanner


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    empty = result["frames_without_stripe"]
    return (
        f"{result['points']} points from {result['frames']} frames"
        + (f" ({empty} without a {'point' if result['spacetime'] else 'stripe'})" if empty else "")
        + f": {', '.join(result['path'])}"
        + _looks_in_words(result)
        + "".join(f"\nnote: {note}" for note in result["notes"])
        + "".join(f"\nwarning: {warning}." for warning in result["warnings"])
    )


def _looks_in_words(result: dict[str, Any]) -> str:
    """A line each on how many points have a colour and an albedo."""
    points, coloured, lines = result["points"], result["points_with_colour"], ""
    if coloured is not None:
        lines += f"\ncolour: {coloured} points have one" + (
            f"; {points - coloured} have none, and are black (0 0 0)" if coloured < points else ""
        )
        full = result["points_with_full_colour"]
        if full > _MANY_FULL * points:
            lines += (
                f"\nnote: the colours of {100 * full / points:.0f} % of the points are burnt out: expose the "
                "photographs that they come from shorter"
            )
    if result["points_with_albedo"] is not None:
        gaps = [f"{count} {_GAPS[reason]}" for reason, count in result["without_albedo"].items() if count]
        lines += f"\nalbedo: of {result['points_with_albedo']} points" + (
            f"; of the others {', '.join(gaps)}" if gaps else ""
        )
    return lines
