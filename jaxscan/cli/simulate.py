"""`jaxscan simulate`: a calibration session, a scan, and what is true of both."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from jaxscan.simulation import Body, Scene, Sensor
    from jaxscan.simulation.folders import ScanTruth, SessionTruth

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
    parser.add_argument(
        "--lasers", type=int, choices=(1, 2), default=1, help="2: a second one, and a scan by each (default: 1)"
    )
    parser.add_argument("--stripes", action="store_true", help="photograph boards and stripes separately")
    parser.add_argument("--jpeg", action="store_true", help="write JPEG in place of PNG")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Render the photographs and write them with their truth."""
    check_folder(args.out, args.seed)
    bodies, name = _bodies(args)
    from jaxscan.simulation.folders import scan_name
    from jaxscan.simulation.light import Sensor

    _, session, scans = simulate_into(
        args.out,
        args.seed,
        bodies,
        name,
        lasers=args.lasers,
        sensor=Sensor(blur_px=args.blur, noise=args.noise),
        speckle=args.speckle,
        separate_stripes=args.stripes,
        ending=".jpg" if args.jpeg else ".png",
    )
    return {
        "kind": "simulation",
        "path": str(args.out),
        "seed": args.seed,
        "object": name,
        "photographs": len(session.boards.rotation) * _each_pose(args.lasers, args.stripes)
        + len(session.stage_steps)
        + sum(len(scan.steps) for scan in scans),
        "scans": [scan_name(scan.laser) for scan in scans],
        "true_points": sum(int((scan.position == scan.position).sum()) for scan in scans),
    }


def simulate_into(
    out: Path,
    seed: int,
    bodies: "tuple[Body, ...]",
    name: str,
    *,
    lasers: int = 1,
    sensor: "Sensor | None" = None,
    speckle: float = 0.0,
    separate_stripes: bool = False,
    ending: str = ".png",
) -> "tuple[Scene, SessionTruth, tuple[ScanTruth, ...]]":
    """Write the session, a scan of some bodies by each laser, and their truth into a folder, with a progress bar."""
    from dataclasses import replace

    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.atomic import replacing_folders
    from jaxscan.cli.progress import progress
    from jaxscan.simulation import folders, rig_2003

    rig = rig_2003.simulated_rig(seed, lasers)
    scene = rig_2003.scan_scene(rig, bodies)
    common: dict[str, Any] = {"sensor": sensor or rig_2003.SENSOR, "ending": ending}
    boards = rig_2003.BOARD_VIEWS * _each_pose(lasers, separate_stripes)
    with (
        replacing_folders(out) as folder,
        progress("rendering", boards + rig_2003.STAGE_VIEWS + lasers * rig_2003.SCAN_FRAMES) as advance,
    ):
        session = folders.simulate_session(
            folder / "session",
            seed,
            rig=rig,
            lighting=replace(rig_2003.BOARD_LIGHTING, speckle=speckle),
            separate_stripes=separate_stripes,
            advance=advance,
            **common,
        )
        scans = tuple(
            folders.simulate_scan(
                folder / folders.scan_name(laser.name),
                rig,
                scene,
                seed,
                laser=i,
                frames=rig_2003.SCAN_FRAMES,
                name=name,
                lighting=replace(rig_2003.SCAN_LIGHTING, speckle=speckle),
                advance=advance,
                **common,
            )
            for i, laser in enumerate(rig.lasers)
        )
        folders.write_truth(folder / "truth", session, *scans)
    return scene, session, scans


def _each_pose(lasers: int, separate_stripes: bool) -> int:
    """How many photographs are taken of a board in one pose."""
    return 1 + lasers if separate_stripes or lasers > 1 else 1


def describe(result: dict[str, Any]) -> str:
    """What was written, and what to do with it."""
    out = result["path"]
    return (
        f"{result['photographs']} photographs of boards and of a {result['object']}, "
        f"{result['true_points']} true points: "
        f"{', '.join(f'{out}/{folder}' for folder in ('session', *result['scans'], 'truth'))}\n"
        f"next: jaxscan calibrate {out}/session -o {out}/rig.json"
    )


def check_folder(out: Path, seed: int) -> None:
    """Refuse a folder that holds something else, before any work."""
    from jaxscan.errors import InputError

    if seed < 0:
        raise InputError(f"--seed {seed}: give 0 or more")
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file: name a folder that is new or empty")
    if out.is_dir() and any(out.iterdir()) and not (out / "truth" / "rig.json").is_file():
        raise InputError(f"{out}: holds something that is no simulation: name a folder that is new or empty")


def _bodies(args: argparse.Namespace) -> tuple[Any, str]:
    """The bodies to scan, and what they are called."""
    from jaxscan.simulation import shapes
    from jaxscan.simulation.rig_2003 import OBJECT_Y

    if args.mesh is not None:
        return (shapes.mesh(OBJECT_Y, shapes.mesh_to_scan(args.mesh)),), args.mesh.stem
    bodies = getattr(shapes, args.object)(OBJECT_Y)
    return bodies if isinstance(bodies, tuple) else (bodies,), args.object
