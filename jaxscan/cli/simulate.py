"""`jaxscan simulate`: a calibration session, a scan, and what is true of both."""

import argparse
import shlex
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.options import finite
from jaxscan.errors import InputError
from jaxscan.extras import extra

if TYPE_CHECKING:
    from jaxscan.rig import Rig
    from jaxscan.simulation import Body, Scene, Sensor
    from jaxscan.simulation.folders import ScanTruth, SessionTruth
    from jaxscan.simulation.hand import Hand
    from jaxscan.simulation.robot import Robot

HELP: Final = "photographs of a known world: a calibration session, a scan, and their truth"
EXAMPLE: Final = "jaxscan simulate world --seed 3"

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
# What is added to the seed from side to side: their noise has nothing in common.
_SIDES_APART: Final = 1_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("out", type=Path, metavar="OUT", help="the folder to make, with session, scan and truth in it")
    parser.add_argument("--force", action="store_true", help="replace a simulation that is in OUT already")
    parser.add_argument("--seed", type=int, default=0, help="of rig, poses and noise (default: 0)")
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
        "the stripe on what is level; from about 250 on the spot is burnt out (default: 0, matt)",
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
        help="give the stage so much play: what it carries stands so much farther on when it comes back; its "
        "photographs of the board go there and back then, its scans only there (default: 0)",
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


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Render the photographs and write them with their truth."""
    check_folder(args.out, args.seed, replaced=args.force)
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
    if (warning := _sliding(args)) is not None:
        from jaxscan.cli.progress import say

        say(f"warning: {warning}")
    bodies, name = _bodies(args)
    from jaxscan.simulation.folders import JPEG_QUALITY, scan_name
    from jaxscan.simulation.hand import Hand
    from jaxscan.simulation.light import Sensor
    from jaxscan.simulation.rig_2003 import STEPS_PER_TURN
    from jaxscan.simulation.robot import Robot

    _, session, scans = simulate_into(
        args.out,
        args.seed,
        bodies,
        name,
        lasers=args.lasers,
        sides=args.sides,
        apart=args.apart,
        sensor=Sensor(blur_px=args.blur, noise=args.noise, mosaic=args.mosaic),
        light={
            "speckle": args.speckle,
            "speckle_length_px": tuple(args.speckle_length),
            "ambient_colour": tuple(args.ambient_colour),
            "highlight": args.highlight,
            "ghost": args.ghost,
            "laser_profile": args.laser_profile,
            "sheet_sigma_mm": args.sheet_mm,
        },
        hand=Hand(args.shake_mm),
        bow_mm=args.sheet_bow_mm,
        bend_mm=args.board_bend_mm,
        stage={
            "guide_mm": args.guide_mm,
            "screw_mm": args.screw_mm,
            "screw_steps": args.screw_steps,
            "play_mm": args.play_mm,
        },
        turntable=args.turntable,
        separate_stripes=args.stripes,
        robot=Robot(args.robot, args.pose_mm, args.pose_deg) if args.robot else None,
        swept=args.swept,
        ending=".jpg" if args.jpeg or args.quality is not None else ".png",
        quality=args.quality or JPEG_QUALITY,
    )
    return {
        "kind": "simulation",
        "path": str(args.out),
        "seed": args.seed,
        "object": name,
        "photographs": len(session.boards.rotation) * _each_pose(args.lasers, args.stripes, swept=args.swept)
        + len(session.stage_steps)
        + len(session.turntable_steps)
        + sum(len(scan.position) for scan in scans),
        "sides": args.sides,
        "steps_apart": STEPS_PER_TURN / args.sides if args.turntable and args.sides > 1 else None,
        "scans": [scan_name(scan.which) for scan in scans],
        "true_points": sum(int((scan.position == scan.position).sum()) for scan in scans),
        "warnings": [] if warning is None else [warning],
    }


def simulate_into(
    out: Path,
    seed: int,
    bodies: "tuple[Body, ...]",
    name: str,
    *,
    lasers: int = 1,
    sides: int = 1,
    apart: int | None = None,
    sensor: "Sensor | None" = None,
    light: Mapping[str, Any],
    hand: "Hand | None" = None,
    bow_mm: float = 0.0,
    bend_mm: float = 0.0,
    stage: Mapping[str, float] | None = None,
    turntable: bool = False,
    separate_stripes: bool = False,
    robot: "Robot | None" = None,
    swept: bool = False,
    ending: str = ".png",
    quality: int | None = None,
) -> "tuple[Scene, SessionTruth, tuple[ScanTruth, ...]]":
    """Write the session, a scan of some bodies by each laser and from each side, and their truth into a folder.

    A scan goes over the same travel, however many motor steps its frames are apart; by default as the rig of 2003. On a
    turntable a scan of one side goes once all around.
    There is a progress bar. The scene is that of the first side. `light` changes the lighting of the rig of 2003; with
    a highlight the bodies are glossy, and the lamp stands where they mirror it. `stage` has the arguments of
    `rig_2003.with_stage`. A robot takes the place of the stage, and so
    does a light that is swept.
    """
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.atomic import replacing_folders
    from jaxscan.cli.progress import progress, step
    from jaxscan.files.axes import STAGE
    from jaxscan.simulation import folders, rig_2003
    from jaxscan.simulation.hand import STILL

    step("building the scene")
    rig = rig_2003.with_stage(rig_2003.simulated_rig(seed, lasers, bow_mm), **(stage or {}))
    rig = rig_2003.with_turntable(rig, seed) if turntable else rig
    if light.get("highlight"):
        bodies = tuple(replace(body, glossy=True) for body in bodies)
        light = {**light, "direction": rig_2003.mirrored_lamp(rig)}
    turned = [
        rig_2003.turned_on(rig, bodies, rig_2003.STEPS_PER_TURN * k / sides)
        if turntable
        else rig_2003.turned(bodies, 360 * k / sides)
        for k in range(sides)
    ]
    scenes = [rig_2003.scan_scene(rig, each) for each in turned]
    if turntable and sides == 1:
        apart = apart or rig_2003.TURN_APART
        axes = [rig_2003.turning_axes(apart, rig_2003.step_over_axis(rig, i)) for i in range(lasers)]
    else:
        apart = apart or rig_2003.STEPS_APART
        axes = [{STAGE: tuple(range(0, (rig_2003.SCAN_FRAMES - 1) * rig_2003.STEPS_APART + 1, apart))}] * lasers
    frames = len(axes[0][STAGE])
    common: dict[str, Any] = {
        "sensor": sensor or rig_2003.SENSOR,
        "ending": ending,
        "quality": quality or folders.JPEG_QUALITY,
    }
    if robot is not None:
        return _with_robot(out, seed, rig, robot, scenes[0], name, apart, light, common)
    if swept:
        return _with_sweep(out, seed, rig, scenes[0], name, frames, light, common)
    boards = rig_2003.BOARD_VIEWS * _each_pose(lasers, separate_stripes) + turntable * rig_2003.TURNTABLE_VIEWS
    with (
        replacing_folders(out) as folder,
        progress("rendering", boards + rig_2003.STAGE_VIEWS + lasers * sides * frames) as advance,
    ):
        session = folders.simulate_session(
            folder / "session",
            seed,
            rig=rig,
            lighting=replace(rig_2003.BOARD_LIGHTING, **light),
            hand=hand or STILL,
            bend_mm=bend_mm,
            separate_stripes=separate_stripes,
            advance=advance,
            **common,
        )
        scans = []
        for (i, laser), k in product(enumerate(rig.lights), range(sides)):
            side = f"{360 * k / sides:03.0f}" if sides > 1 else ""
            which = "-".join(part for part in (laser.name, side) if part)
            truth = folders.simulate_scan(
                folder / folders.scan_name(which),
                rig,
                scenes[k],
                seed + _SIDES_APART * k,
                laser=i,
                axes=axes[i],
                name=" ".join(part for part in (name, side) if part),
                lighting=replace(rig_2003.SCAN_LIGHTING, **light),
                advance=advance,
                **common,
            )
            scans.append(replace(truth, which=which))
        folders.write_truth(folder / "truth", session, *scans)
    return scenes[0], session, tuple(scans)


def _with_robot(
    out: Path,
    seed: int,
    rig: "Rig",
    robot: "Robot",
    scene: "Scene",
    name: str,
    apart: int,
    light: Mapping[str, Any],
    common: Mapping[str, Any],
) -> "tuple[Scene, SessionTruth, tuple[ScanTruth, ...]]":
    """As `simulate_into`, with a robot in place of the stage, which takes the object over the same travel."""
    import numpy as np

    from jaxscan.atomic import replacing_folders
    from jaxscan.cli.progress import progress
    from jaxscan.simulation import folders, rig_2003
    from jaxscan.simulation.robot import POSED_VIEWS, simulate_robot_scan, simulate_robot_session, with_robot

    steps = np.arange(0, (rig_2003.SCAN_FRAMES - 1) * rig_2003.STEPS_APART + 1, apart)
    travel, moved = rig_2003.stage_travel(rig, steps), with_robot(rig, robot, seed)
    photographs = rig_2003.BOARD_VIEWS + POSED_VIEWS + len(steps)
    with replacing_folders(out) as folder, progress("rendering", photographs) as advance:
        lighting = replace(rig_2003.BOARD_LIGHTING, **light)
        session = simulate_robot_session(
            folder / "session", seed, moved, robot, lighting=lighting, advance=advance, **common
        )
        scan = simulate_robot_scan(
            folder / folders.scan_name(""),
            moved,
            robot,
            scene,
            travel,
            rig_2003.middle_of_object(rig),
            seed,
            name=name,
            lighting=replace(rig_2003.SCAN_LIGHTING, **light),
            advance=advance,
            **common,
        )
        folders.write_truth(folder / "truth", session, scan)
    return scene, session, (scan,)


def _with_sweep(
    out: Path,
    seed: int,
    rig: "Rig",
    scene: "Scene",
    name: str,
    frames: int,
    light: Mapping[str, Any],
    common: Mapping[str, Any],
) -> "tuple[Scene, SessionTruth, tuple[ScanTruth, ...]]":
    """As `simulate_into`, with a light that sweeps over the object in place of the stage."""
    from jaxscan.atomic import replacing_folders
    from jaxscan.cli.progress import progress
    from jaxscan.files.session_sweeps import AXIS
    from jaxscan.simulation import folders, rig_2003, swept

    scene, moved = swept.in_the_middle(rig, scene), swept.with_sweep(rig, seed)
    photographs = rig_2003.BOARD_VIEWS * (1 + swept.STRIPES) + frames
    with replacing_folders(out) as folder, progress("rendering", photographs) as advance:
        lighting = replace(rig_2003.BOARD_LIGHTING, **light)
        session = swept.simulate_swept_session(
            folder / "session",
            seed,
            moved,
            views=rig_2003.BOARD_VIEWS,
            stripes=swept.STRIPES,
            lighting=lighting,
            advance=advance,
            **common,
        )
        scan = folders.simulate_scan(
            folder / folders.scan_name(""),
            moved,
            scene,
            seed,
            axes={AXIS: swept.sweep_of(frames).tolist()},
            name=name,
            lighting=replace(rig_2003.SCAN_LIGHTING, **light),
            advance=advance,
            **common,
        )
        folders.write_truth(folder / "truth", session, scan)
    return scene, session, (scan,)


def _each_pose(lasers: int, separate_stripes: bool, *, swept: bool = False) -> int:
    """How many photographs are taken of a board in one pose."""
    if swept:
        from jaxscan.simulation.swept import STRIPES

        return 1 + STRIPES
    return 1 + lasers if separate_stripes or lasers > 1 else 1


def describe(result: dict[str, Any]) -> str:
    """What was written, and what to do with it."""
    path, sides, scans = result["path"], result["sides"], result["scans"]
    # In a shell's words: a folder's name may have spaces.
    out = shlex.quote(path)
    if len(scans) > 1:
        degrees = 360 / sides if sides > 1 else 0
        turned = f"--steps {result['steps_apart']:g}" if result["steps_apart"] else f"--turn {degrees:g}"
        then = [f"jaxscan merge {out}/scan-* --rig {out}/rig.json {turned} -o {out}/model.stl"]
    else:
        points = f"{out}/{scans[0]}.npz"
        then = [
            f"jaxscan reconstruct {out}/{scans[0]} --rig {out}/rig.json -o {points}",
            f"jaxscan mesh {points} -o {out}/model.stl",
            f"jaxscan compare {points} {out}/truth",
        ]
    return "\n".join(
        [
            f"{result['photographs']} photographs of boards and of a {result['object']}, "
            f"{result['true_points']} true points: "
            f"{', '.join(f'{path}/{folder}' for folder in ('session', *scans, 'truth'))}",
            f"next: jaxscan calibrate {out}/session -o {out}/rig.json",
            *(f"then: {line}" for line in then),
        ]
    )


def check_folder(out: Path, seed: int, *, replaced: bool) -> None:
    """Refuse a folder that holds something else, or a simulation that is not to be replaced, before any work."""
    if seed < 0:
        raise InputError(f"--seed {seed}: give 0 or more")
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file: name a folder that is new or empty")
    if not out.is_dir() or not any(out.iterdir()):
        return
    if not (out / "truth" / "rig.json").is_file():
        raise InputError(f"{out}: holds something that is no simulation: name a folder that is new or empty")
    if not replaced:
        raise InputError(f"{out}: holds a simulation already: name another folder, or replace it with --force")


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


def _sliding(args: argparse.Namespace) -> str | None:
    """What is said before the work of sides that cannot be registered."""
    if args.sides == 1 or args.mesh is not None or args.object not in _SLIDING:
        return None
    return (
        f"jaxscan merge will not join the sides of a {args.object}: flat and round faces slide on each other. Take "
        "--object panda or figure"
    )


def _check_apart(args: argparse.Namespace) -> None:
    """Refuse a way from frame to frame that leaves a scan with one frame."""
    from jaxscan.simulation import rig_2003

    turns = args.turntable and args.sides == 1
    most = rig_2003.STEPS_PER_TURN - 1 if turns else (rig_2003.SCAN_FRAMES - 1) * rig_2003.STEPS_APART
    if args.apart is not None and args.apart > most:
        way = "a turn" if turns else "a scan"
        raise InputError(f"--apart {args.apart}: {way} of {most + turns} steps would have one frame: give 1 to {most}")


def _bodies(args: argparse.Namespace) -> tuple[Any, str]:
    """The bodies to scan, and what they are called."""
    from jaxscan.simulation import shapes
    from jaxscan.simulation.rig_2003 import OBJECT_Y

    if args.mesh is not None:
        extra("mesh-scenes")
        return (shapes.mesh(OBJECT_Y, shapes.mesh_to_scan(args.mesh)),), args.mesh.stem
    bodies = getattr(shapes, args.object)(OBJECT_Y)
    return bodies if isinstance(bodies, tuple) else (bodies,), args.object
