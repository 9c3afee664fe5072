"""`jaxscan simulate`: a calibration session, a scan, and what is true of both."""

import argparse
from pathlib import Path
from typing import Any, Final

HELP: Final = "photographs of a known world: a calibration session, a scan, and their truth"
EXAMPLE: Final = "jaxscan simulate world --seed 3 --object cup"

_OBJECTS: Final = ("cup", "sphere", "box", "stair")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("out", type=Path, metavar="OUT", help="the folder to make, with session, scan and truth in it")
    parser.add_argument("--seed", type=int, default=0, help="of rig, poses and noise (default: 0)")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--object", choices=_OBJECTS, default="cup", help="what is scanned (default: cup)")
    what.add_argument("--mesh", type=Path, metavar="FILE", help="scan this triangle mesh instead, in mm and with z up")
    parser.add_argument("--noise", type=float, default=2.0, help="of the sensor, grey levels (default: 2)")
    parser.add_argument("--blur", type=float, default=0.6, help="of the lens, pixels (default: 0.6)")
    parser.add_argument("--speckle", type=float, default=0.0, help="contrast of the laser's, 0 to 1 (default: 0)")
    parser.add_argument("--stripes", action="store_true", help="photograph boards and stripes separately")
    parser.add_argument("--jpeg", action="store_true", help="write JPEG in place of PNG")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Render the photographs and write them with their truth."""
    _check(args)
    from jaxscan.simulation.light import Sensor
    from jaxscan.simulation.rig_2003 import BOARD_LIGHTING, SCAN_LIGHTING

    sensor = Sensor(blur_px=args.blur, noise=args.noise)
    from dataclasses import replace

    board_light, scan_light = (replace(light, speckle=args.speckle) for light in (BOARD_LIGHTING, SCAN_LIGHTING))
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.cli.progress import progress
    from jaxscan.simulation import folders, rig_2003

    bodies, name = _bodies(args)
    rig = rig_2003.simulated_rig(args.seed)
    scene = rig_2003.scan_scene(rig, bodies)
    common: dict[str, Any] = {"sensor": sensor, "ending": ".jpg" if args.jpeg else ".png"}
    boards = rig_2003.BOARD_VIEWS * (2 if args.stripes else 1)
    total = boards + rig_2003.STAGE_VIEWS + rig_2003.SCAN_FRAMES
    with progress("rendering", total) as advance:
        session = folders.simulate_session(
            args.out / "session",
            args.seed,
            lighting=board_light,
            separate_stripes=args.stripes,
            advance=advance,
            **common,
        )
        scan = folders.simulate_scan(
            args.out / "scan", rig, scene, args.seed, name=name, lighting=scan_light, advance=advance, **common
        )
    folders.write_truth(args.out / "truth", session, scan)
    return {
        "kind": "simulation",
        "path": str(args.out),
        "seed": args.seed,
        "object": name,
        "photographs": total,
        "true_points": int((scan.position == scan.position).sum()),
    }


def describe(result: dict[str, Any]) -> str:
    """What was written, and what to do with it."""
    out = result["path"]
    return (
        f"{result['photographs']} photographs of a {result['object']} and of boards, "
        f"{result['true_points']} true points: {out}/session, {out}/scan, {out}/truth\n"
        f"next: jaxscan calibrate {out}/session -o {out}/rig.json"
    )


def _check(args: argparse.Namespace) -> None:
    """Refuse a folder that holds something else, before any work."""
    from jaxscan.errors import InputError

    if args.seed < 0:
        raise InputError(f"--seed {args.seed}: give 0 or more")
    if args.out.exists() and not args.out.is_dir():
        raise InputError(f"{args.out}: is a file: name a folder that is new or empty")
    if args.out.is_dir() and any(args.out.iterdir()) and not (args.out / "truth" / "rig.json").is_file():
        raise InputError(f"{args.out}: holds something that is no simulation: name a folder that is new or empty")


def _bodies(args: argparse.Namespace) -> tuple[Any, str]:
    """The bodies to scan, and what they are called."""
    from jaxscan.simulation import shapes
    from jaxscan.simulation.rig_2003 import OBJECT_Y

    if args.mesh is not None:
        return (shapes.mesh(OBJECT_Y, shapes.read_mesh(args.mesh)),), args.mesh.stem
    bodies = getattr(shapes, args.object)(OBJECT_Y)
    return bodies if isinstance(bodies, tuple) else (bodies,), args.object
