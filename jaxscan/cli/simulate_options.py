"""The options of `jaxscan simulate`, and which of them do not go together."""

import argparse
from pathlib import Path
from typing import Any, Final

from jaxscan.cli.options import finite
from jaxscan.errors import InputError

_OBJECTS: Final = ("panda", "cup", "sphere", "box", "stair", "figure")
_MOST_SIDES: Final = 36
# Their flat or round faces slide on each other: `merge` refuses them (tried with 2, 3, 4 and 6 sides).
_SLIDING: Final = ("cup", "sphere", "box", "stair")
# A line laser's sheet is not off its plane by more at 100 mm to either side.
_MOST_BOW_MM: Final = 5.0
# A board that is bent by more is no board.
_MOST_BEND_MM: Final = 5.0
# A guide or a screw that is worse than this is broken.
_MOST_STAGE_MM: Final = 2.0
# Errors of a robot's poses, mm and degrees.
_POSE_MM, _POSE_DEG = 0.05, 0.02
# A robot that is worse than this, mm or degrees, is broken.
_MOST_POSE: Final = 5.0


def add_world_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what the world is: rig, boards, object, light and noise."""
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--object", choices=_OBJECTS, default="panda", help="what is scanned (default: panda)")
    what.add_argument("--mesh", type=Path, metavar="FILE", help="scan this triangle mesh instead, in mm and with z up")
    parser.add_argument(
        "--sides",
        type=int,
        default=1,
        metavar="N",
        help="scan it N times, turned on by 360/N degrees each time, for `jaxscan merge` (default: 1)",
    )
    parser.add_argument(
        "--apart",
        type=int,
        metavar="STEPS",
        help="motor steps from frame to frame of a scan, 1000 to a millimetre (default: 2000); of a scan that turns, "
        "3200 to a turn (default: 20, 160 frames)",
    )
    parser.add_argument("--noise", type=finite, default=2.0, help="of the sensor, grey levels (default: 2)")
    parser.add_argument("--blur", type=finite, default=0.6, help="of the lens, pixels (default: 0.6)")
    parser.add_argument(
        "--mosaic",
        action="store_true",
        help="each pixel of the camera sees one colour, in the pattern of most colour cameras, and the others are "
        "interpolated",
    )
    parser.add_argument(
        "--speckle",
        type=finite,
        default=0.2,
        metavar="CONTRAST",
        help="grain of the laser's light in the photograph's pixels, standard deviation over mean, 0 to 1; "
        "a laser pointer has 0.1 to 0.3, a line without it 0 (default: 0.2)",
    )
    parser.add_argument(
        "--speckle-length",
        type=finite,
        nargs=2,
        default=(0.0, 0.0),
        metavar=("ALONG", "ACROSS"),
        help="size of a grain along the stripe and across it, pixels: where its correlation has fallen to 0.61; a "
        "small aperture makes grains larger than a pixel (default: 0 0, each pixel by itself)",
    )
    parser.add_argument(
        "--ambient-colour",
        type=finite,
        nargs=3,
        default=(1.0, 1.0, 1.0),
        metavar=("R", "G", "B"),
        help="of the light that is not the laser's, 0 to 1 each; tungsten: 1 0.75 0.45 (default: 1 1 1)",
    )
    parser.add_argument(
        "--highlight",
        type=finite,
        default=0.0,
        metavar="LEVELS",
        help="make the object glossy: grey levels of the lamp's reflection in it at its brightest, which lies under "
        "the stripe on level surfaces; from about 250 on the spot is burnt out (default: 0, matt)",
    )
    parser.add_argument(
        "--ghost",
        type=finite,
        default=0.0,
        metavar="PART",
        help="add a second image of the stripe, turned half around the middle of the photograph, as lens and filter "
        "reflect it; its brightness in parts of the stripe's, 0 to 1 (default: 0)",
    )
    parser.add_argument(
        "--laser-profile",
        default="gaussian",
        metavar="KIND",
        help="cross-section of the laser's light, on boards and object alike: gaussian, a bell, as of one mode; "
        "flat-top, as a Powell lens makes it; two-lobed, as of two modes; skewed; halo, a bell with a tenth of its "
        "height four times as wide about it; side-lobe, with a lower bell beside it (default: gaussian)",
    )
    parser.add_argument(
        "--sheet-mm",
        type=finite,
        default=0.25,
        metavar="SIGMA",
        help="how thick the sheet of light is, standard deviation of the bell, mm; the other profiles scale with it, "
        "and the lens's blur hides the shape of a thin one (default: 0.25, half a pixel)",
    )
    parser.add_argument(
        "--sheet-bow-mm",
        type=finite,
        default=0.0,
        metavar="MM",
        help="curve the sheet of light, as a line lens does that is not square to its beam: off its plane by MM at "
        "100 mm to either side, 350 mm away, and along each of its rays in proportion to the distance from "
        "the laser (default: 0, flat)",
    )
    parser.add_argument(
        "--board-bend-mm",
        type=finite,
        default=0.0,
        metavar="MM",
        help="bend the board like a sheet of paper, its middle by MM off the line between the ends of its rows, 30 "
        "degrees askew: 0.3 is a board of cardboard, 0.05 a good print (default: 0, flat)",
    )
    parser.add_argument(
        "--guide-mm",
        type=finite,
        default=0.0,
        metavar="MM",
        help="bow the guide of the stage: its middle by MM off the line through the ends of the photographs' "
        "60 mm, and the carriage turns as it follows (default: 0, straight)",
    )
    parser.add_argument(
        "--screw-mm",
        type=finite,
        default=0.0,
        metavar="MM",
        help="let the screw of the stage be ahead of its steps and behind them by up to MM in each of its "
        "turns (default: 0)",
    )
    parser.add_argument(
        "--screw-steps",
        type=finite,
        default=3200.0,
        metavar="STEPS",
        help="motor steps of one turn of that screw (default: 3200)",
    )
    parser.add_argument(
        "--play-mm",
        type=finite,
        default=0.0,
        metavar="MM",
        help="give the stage so much play: its load is this much farther on when it comes back; the board is "
        "then photographed in both directions, and scans go in one (default: 0)",
    )
    parser.add_argument(
        "--shake-mm",
        type=finite,
        default=0.0,
        metavar="MM",
        help="hold the boards by hand: while a photograph is exposed the board moves and turns by up to MM, in "
        "a direction of its own in each, so that corners and stripe are smeared; with --stripes or --lasers 2 it moves "
        "on from one photograph of a pose to the next. At 10 mm/s that is 0.1 in 1/100 s, 0.3 in 1/30 s; boards on "
        "stage and turntable stay still (default: 0)",
    )
    parser.add_argument(
        "--lasers", type=int, choices=(1, 2), default=1, help="2: a second one, and a scan by each (default: 1)"
    )
    parser.add_argument(
        "--turntable",
        action="store_true",
        help="photograph the board on a turntable too, and scan while it turns, once all around; with --sides, turn it "
        "from side to side and scan along the stage",
    )
    parser.add_argument(
        "--swept",
        action="store_true",
        help="let the light turn in place of the stage: it sweeps over object and boards, which stand still",
    )
    parser.add_argument(
        "--robot",
        choices=("head", "object"),
        help="let a robot move camera and laser, or the object, in place of the stage; it gives a pose for each "
        "photograph",
    )
    parser.add_argument(
        "--pose-mm",
        type=finite,
        default=_POSE_MM,
        metavar="SIGMA",
        help=f"error of the positions that --robot gives, standard deviation along each axis (default: {_POSE_MM})",
    )
    parser.add_argument(
        "--pose-deg",
        type=finite,
        default=_POSE_DEG,
        metavar="SIGMA",
        help=f"error of the rotations that --robot gives, standard deviation about each axis (default: {_POSE_DEG})",
    )
    parser.add_argument("--stripes", action="store_true", help="photograph boards and stripes separately")
    parser.add_argument(
        "--jpeg",
        action="store_true",
        help="write JPEG with colour at half the resolution (4:2:0), as webcams and phones do, in place of PNG",
    )
    parser.add_argument(
        "--quality", type=int, metavar="Q", help="of the JPEG, 1 to 100; implies --jpeg (default: 95; many webcams: 75)"
    )


def check_world(args: argparse.Namespace) -> None:
    """Refuse what cannot be simulated, before any work.

    Raises:
        InputError: an option is out of its range, or goes without another that is given.
    """
    if not 1 <= args.sides <= _MOST_SIDES:
        raise InputError(f"--sides {args.sides}: give 1 to {_MOST_SIDES}")
    if args.apart is not None and args.apart < 1:
        raise InputError(f"--apart {args.apart}: give 1 or more")
    _check_apart(args)
    if args.quality is not None:
        from jaxscan.images.jpeg import check_quality

        check_quality(args.quality, "--quality")
    if abs(args.sheet_bow_mm) > _MOST_BOW_MM:
        raise InputError(f"--sheet-bow-mm {args.sheet_bow_mm:g}: give {-_MOST_BOW_MM:g} to {_MOST_BOW_MM:g}")
    if abs(args.board_bend_mm) > _MOST_BEND_MM:
        raise InputError(f"--board-bend-mm {args.board_bend_mm:g}: give {-_MOST_BEND_MM:g} to {_MOST_BEND_MM:g}")
    for option, value in (("--guide-mm", args.guide_mm), ("--screw-mm", args.screw_mm)):
        if abs(value) > _MOST_STAGE_MM:
            raise InputError(f"{option} {value:g}: give {-_MOST_STAGE_MM:g} to {_MOST_STAGE_MM:g}")
    if not 0 <= args.play_mm <= _MOST_STAGE_MM:
        raise InputError(f"--play-mm {args.play_mm:g}: give 0 to {_MOST_STAGE_MM:g}")
    if args.screw_steps <= 0:
        raise InputError(f"--screw-steps {args.screw_steps:g}: give the steps of one turn, above 0")
    _check_robot(args)
    _check_swept(args)


def _check_swept(args: argparse.Namespace) -> None:
    """Refuse what a light that is swept goes without."""
    others = _of_a_stage(args) | {"--sheet-bow-mm": args.sheet_bow_mm, "--robot": args.robot, "--apart": args.apart}
    if args.swept and (also := [option for option, given in others.items() if given]):
        raise InputError(f"--swept goes without {', '.join(also)}: leave one of them out")


def _of_a_stage(args: argparse.Namespace) -> dict[str, Any]:
    """Options that need a stage, a second laser, or photographs of their own."""
    return {
        "--turntable": args.turntable,
        "--sides": args.sides > 1,
        "--lasers 2": args.lasers > 1,
        "--stripes": args.stripes,
        "--guide-mm": args.guide_mm,
        "--screw-mm": args.screw_mm,
        "--play-mm": args.play_mm,
        "--shake-mm": args.shake_mm,
        "--board-bend-mm": args.board_bend_mm,
    }


def _check_robot(args: argparse.Namespace) -> None:
    """Refuse what a robot takes the place of, and errors that are none."""
    if not args.robot:
        if (args.pose_mm, args.pose_deg) != (_POSE_MM, _POSE_DEG):
            raise InputError("--pose-mm and --pose-deg are of a robot's poses: add --robot head or --robot object")
        return
    if also := [option for option, given in _of_a_stage(args).items() if given]:
        raise InputError(f"--robot {args.robot} goes without {', '.join(also)}: leave one of them out")
    for option, sigma in (("--pose-mm", args.pose_mm), ("--pose-deg", args.pose_deg)):
        if not 0 <= sigma <= _MOST_POSE:
            raise InputError(f"{option} {sigma:g}: give 0 to {_MOST_POSE:g}")


def _check_apart(args: argparse.Namespace) -> None:
    """Refuse a way from frame to frame that leaves a scan with one frame."""
    from jaxscan.simulation import rig_2003

    turns = args.turntable and args.sides == 1
    most = rig_2003.STEPS_PER_TURN - 1 if turns else (rig_2003.SCAN_FRAMES - 1) * rig_2003.STEPS_APART
    if args.apart is not None and args.apart > most:
        way = "a turn" if turns else "a scan"
        raise InputError(f"--apart {args.apart}: {way} of {most + turns} steps would have one frame: give 1 to {most}")


def sliding(args: argparse.Namespace) -> str | None:
    """What is said before the work of sides that cannot be registered."""
    if args.sides == 1 or args.mesh is not None or args.object not in _SLIDING:
        return None
    return (
        f"jaxscan merge will not join the sides of a {args.object}: flat and round faces slide on each other. Take "
        "--object panda or figure"
    )
