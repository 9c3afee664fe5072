"""`jaxscan simulate`: a calibration session, a scan, and what is true of both."""

import argparse
import shlex
from pathlib import Path
from typing import Any, Final

from jaxscan.cli.simulate_options import add_world_arguments, check_world, sliding
from jaxscan.cli.simulated_world import photographs_of_a_pose, simulate_into
from jaxscan.errors import InputError
from jaxscan.extras import extra

HELP: Final = "photographs of a known world: a calibration session, a scan, and their truth"
EXAMPLE: Final = "jaxscan simulate world --seed 3"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("out", type=Path, metavar="OUT", help="the folder to make, with session, scan and truth in it")
    parser.add_argument("--force", action="store_true", help="replace a simulation that is in OUT already")
    parser.add_argument("--seed", type=int, default=0, help="of rig, poses and noise (default: 0)")
    add_world_arguments(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Render the photographs and write them with their truth."""
    check_folder(args.out, args.seed, replaced=args.force)
    check_world(args)
    if (warning := sliding(args)) is not None:
        from jaxscan.cli.progress import say

        say(f"warning: {warning}")
    bodies, name = _bodies(args)
    from jaxscan.simulation.folders import scan_name
    from jaxscan.simulation.hand import Hand
    from jaxscan.simulation.light import Sensor
    from jaxscan.simulation.photographs import JPEG_QUALITY
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
        "photographs": len(session.boards.rotation) * photographs_of_a_pose(args.lasers, args.stripes, swept=args.swept)
        + len(session.stage_steps)
        + len(session.turntable_steps)
        + sum(len(scan.position) for scan in scans),
        "sides": args.sides,
        "steps_apart": STEPS_PER_TURN / args.sides if args.turntable and args.sides > 1 else None,
        "scans": [scan_name(scan.which) for scan in scans],
        "true_points": sum(int((scan.position == scan.position).sum()) for scan in scans),
        "warnings": [] if warning is None else [warning],
    }


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


def _bodies(args: argparse.Namespace) -> tuple[Any, str]:
    """The bodies to scan, and what they are called."""
    from jaxscan.simulation import shapes
    from jaxscan.simulation.rig_2003 import OBJECT_Y

    if args.mesh is not None:
        extra("mesh-scenes")
        return (shapes.mesh(OBJECT_Y, shapes.mesh_to_scan(args.mesh)),), args.mesh.stem
    bodies = getattr(shapes, args.object)(OBJECT_Y)
    return bodies if isinstance(bodies, tuple) else (bodies,), args.object
