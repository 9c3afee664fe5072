"""`jaxscan demo`: the whole way on a simulated scanner, with no hardware and nothing to prepare."""

import argparse
import shlex
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    import numpy as np
    import trimesh

    from jaxscan.reconstruction import RangeImage
    from jaxscan.rig import Rig
    from jaxscan.surface.floor import Floor

HELP: Final = "simulate a scanner, calibrate it, scan a panda, and compare with the truth"
EXAMPLE: Final = "jaxscan demo -o jaxscan-demo"

_STEPS: Final = 5
# Motor steps from frame to frame: 1 mm.
_APART: Final = 1000
# How many photographs of a full turn give the points their colours.
_LOOKS: Final = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("jaxscan-demo"), metavar="DIR", help="default: ./jaxscan-demo"
    )
    parser.add_argument("--force", action="store_true", help="replace a simulation that is in DIR already")
    parser.add_argument("--turntable", action="store_true", help="scan it once all around on a turntable")
    parser.add_argument("--seed", type=int, default=0, help="of the simulated rig, poses and noise (default: 0)")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Simulate, calibrate, reconstruct, compare, draw."""
    import time

    begin = time.monotonic()
    out, name = args.output, "panda"
    from jaxscan.cli.simulate import check_folder
    from jaxscan.cli.simulated_world import simulate_into

    # A demo of before is replaced without being asked for.
    check_folder(out, args.seed, replaced=args.force or (out / f"{name}.npz").is_file())
    _say(1, f"photograph a calibration board, and a {name} as it passes through the laser's light (simulated)")
    from jaxscan.simulation.rig_2003 import OBJECT_Y, SPECKLE
    from jaxscan.simulation.shapes import panda

    scene, _, (truth,) = simulate_into(
        out,
        args.seed,
        panda(OBJECT_Y),
        name,
        light={"speckle": SPECKLE},
        turntable=args.turntable,
        apart=None if args.turntable else _APART,
    )
    from jaxscan.cli.calibrate import calibrate_session
    from jaxscan.cli.progress import progress
    from jaxscan.cli.reconstruct import reconstruct_scan

    _say(2, "calibrate: find camera, lens, laser plane and motion from the photographs of the board, all together")
    calibration = calibrate_session([out / "session"], out / "rig.json")
    _say(3, f"reconstruct: turn the photographs of a {name} into points, each with its uncertainty")
    reconstruct_scan(out / "scan", out / "rig.json", [out / f"{name}.ply", out / f"{name}.npz"])
    from jaxscan.files.mesh import write_trimesh
    from jaxscan.reconstruction import read_range_image
    from jaxscan.simulation.accuracy import cloud_errors

    image = read_range_image(out / f"{name}.npz")
    _say(4, "compare the points with the true surface, which only a simulation knows")
    with progress("comparing", unit="part") as advance:
        errors = cloud_errors(scene, truth.points, image.points, image.valid)
        advance()
    _say(5, f"join the points to a surface, and draw it beside a photograph: {out / f'{name}.png'}")
    with progress("joining and drawing", 3, "part") as advance:
        image, floor = object_alone(image)
        advance()
        surface = joined(image)
        write_trimesh(out / f"{name}.stl", surface, floor=floor.note())
        advance()
        draw_picture(out, name, image, surface, floor, calibration.rig)
        advance()
    return {
        "kind": "demo",
        "path": str(out),
        "object": name,
        "points": int(image.valid.sum()),
        "errors": errors.as_dict(),
        "seconds": time.monotonic() - begin,
    }


def _say(step: int, what: str) -> None:
    """Say what is done next, on standard error, where the progress bars are."""
    from jaxscan.cli.progress import say

    say(f"{step}/{_STEPS} {what}")


def object_alone(image: "RangeImage") -> "tuple[RangeImage, Floor]":
    """The scan without stray points and without the floor, and the floor."""
    from jaxscan.surface.clean import clean
    from jaxscan.surface.floor import find_floor, stands_on
    from jaxscan.surface.links import sampling

    cleaned = clean(image, sampling(image)).image
    floor = find_floor(cleaned)
    return cleaned.where(stands_on(cleaned, floor)), floor


def joined(image: "RangeImage") -> "trimesh.Trimesh":
    """The triangles of a scan; one surface of what a turn has shown twice."""
    import trimesh

    from jaxscan.surface.fused import fused
    from jaxscan.surface.passages import passages
    from jaxscan.surface.triangles import grid_surface

    if len(passages(image)) > 1:
        return fused(image).mesh
    surface = grid_surface(image)
    return trimesh.Trimesh(surface.vertices, surface.triangles, process=False)


def draw_picture(
    out: Path, name: str, image: "RangeImage", surface: "trimesh.Trimesh", floor: "Floor", rig: "Rig"
) -> None:
    """Draw the surface of a scan beside the photograph from the middle of it."""
    from scipy.spatial import KDTree

    from jaxscan.images import read_image
    from jaxscan.view.scan_picture import draw_scan

    frames = sorted((out / "scan" / "frames").iterdir())
    frame = int(image.valid.sum(axis=1).argmax())
    nearest = KDTree(image.points[image.valid]).query(surface.vertices)[1]
    draw_scan(
        out / f"{name}.png",
        read_image(frames[frame]),
        image.pixels[frame],
        image,
        surface,
        floor.up,
        _colours(frames, image, rig)[nearest],
    )


def _colours(frames: list[Path], image: "RangeImage", rig: "Rig") -> "np.ndarray":
    """The valid points' colours: their mean over the photographs that show them beside the stripe.

    Of a travel the first and the last are looked at, of a turn some all around. In a turn the stripe never leaves what
    is close to the axis: this gets the colours of the nearest points that have some.
    """
    import numpy as np
    from scipy.spatial import KDTree

    from jaxscan.images import read_image
    from jaxscan.precision import as_numpy
    from jaxscan.reconstruction.point_colours import point_colours

    total, times = np.zeros((2, int(image.valid.sum()), 3))
    whole = image.full_turn is not None
    for i in np.arange(0, len(frames), len(frames) // _LOOKS) if whole else (0, len(frames) - 1):
        pose = as_numpy(rig.pose({axis: np.float64(steps[i]) for axis, steps in image.positions.items()}))
        own = point_colours(rig.camera, pose, image.points[image.valid], read_image(frames[i]), image.pixels[i])
        total += np.nan_to_num(own)
        times += np.isfinite(own)
    with np.errstate(invalid="ignore"):
        found = total / times
    known = times[:, 0] > 0
    if whole and known.any():
        points = image.points[image.valid]
        found[~known] = found[known][KDTree(points[known]).query(points[~known])[1]]
    brightest = np.nanpercentile(found, 99) if np.isfinite(found).any() else 255.0
    return np.clip(235.0 / brightest * found, 0.0, 255.0)


def describe(result: dict[str, Any]) -> str:
    """What came out, and where it is."""
    import shutil

    errors, out, name = result["errors"], result["path"], result["object"]
    command = "jaxscan" if shutil.which("jaxscan") else sys.argv[0]
    surface, picture = (shlex.quote(f"{out}/{name}{ending}") for ending in (".stl", "-mesh.png"))
    return "\n".join(
        [
            f"the {name}: {result['points']} points, {errors['absolute']:.3f} mm RMS from the true surface "
            f"({errors['absolute_after_fit']:.3f} mm after a rigid fit), "
            f"{100 * errors['completeness']:.1f} % of what an ideal camera sees, in {result['seconds']:.0f} s",
            f"files: {out}/{name}.png (look at this first), {out}/{name}.stl, {out}/{name}.ply, {out}/rig.json",
            *_last_commands(command, surface, picture),
        ]
    )


def _last_commands(command: str, surface: str, picture: str) -> list[str]:
    """What to do with the surface next; the last line is a command that works with what is installed."""
    if find_spec("viser"):
        return [f"see it in the browser: {command} view {surface}"]
    later = f"see it in the browser: pip install viser, then {command} view {surface}"
    if find_spec("matplotlib"):
        return [
            later,
            f"see it now, as a picture: {command} view {surface} --png {picture}",
        ]
    return [later, f"see what it holds: {command} inspect {surface}"]
