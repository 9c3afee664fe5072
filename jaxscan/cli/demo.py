"""`jaxscan demo`: the whole way on a simulated scanner, with no hardware and nothing to prepare."""

import argparse
from pathlib import Path
from typing import Any, Final

from jaxscan.extras import extra

HELP: Final = "simulate a scanner, calibrate it, scan a cup, and compare with the truth"
EXAMPLE: Final = "jaxscan demo -o jaxscan-demo"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("jaxscan-demo"), metavar="DIR", help="default: ./jaxscan-demo"
    )
    parser.add_argument(
        "--turntable", action="store_true", help="scan a figure once all around on a turntable, in place of a cup"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the simulated rig, poses and noise (default: 0)")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Simulate, calibrate, reconstruct, compare, draw."""
    import time

    extra("plots")
    begin = time.monotonic()
    from jaxscan.cli.simulate import check_folder, simulate_into

    check_folder(args.output, args.seed)
    from jaxscan.simulation.rig_2003 import OBJECT_Y, SPECKLE
    from jaxscan.simulation.shapes import cup, figure

    out, name = args.output, "figure" if args.turntable else "cup"
    bodies = figure(OBJECT_Y) if args.turntable else cup(OBJECT_Y)
    light = {"speckle": SPECKLE}
    scene, _, (truth,) = simulate_into(out, args.seed, bodies, name, light=light, turntable=args.turntable)
    from jaxscan.cli.calibrate import calibrate_session
    from jaxscan.cli.reconstruct import reconstruct_scan
    from jaxscan.images import draw_stripe, read_image
    from jaxscan.reconstruction import read_range_image
    from jaxscan.simulation.accuracy import cloud_errors
    from jaxscan.simulation.distance import distance
    from jaxscan.view.plots import draw_scan

    calibrate_session([out / "session"], out / "rig.json")
    reconstruct_scan(out / "scan", out / "rig.json", [out / f"{name}.ply", out / f"{name}.npz"])
    image = read_range_image(out / f"{name}.npz")
    errors = cloud_errors(scene, truth.points, image.points, image.valid)
    off = distance(scene, image.points.reshape(-1, 3)).reshape(image.valid.shape)
    title = f"{int(image.valid.sum())} points, {errors.absolute:.3f} mm RMS from the true surface"
    frame = len(image.valid) // 2
    photograph = draw_stripe(read_image(out / "scan" / "frames" / f"{frame:03d}.png"), image.pixels[frame], True)
    draw_scan(out / f"{name}.png", photograph, image.points, image.valid, off, title)
    return {
        "kind": "demo",
        "path": str(out),
        "object": name,
        "points": int(image.valid.sum()),
        "errors": errors.as_dict(),
        "seconds": time.monotonic() - begin,
    }


def describe(result: dict[str, Any]) -> str:
    """What came out, and where it is."""
    errors, out, name = result["errors"], result["path"], result["object"]
    return "\n".join(
        [
            f"a {name} of {result['points']} points, scanned by a simulated scanner that was calibrated from "
            "photographs:",
            f"  {errors['absolute']:.3f} mm RMS from the true surface, "
            f"{errors['absolute_after_fit']:.3f} mm after a rigid fit",
            f"  {100 * errors['completeness']:.1f} % of what an ideal camera sees",
            f"  {out}/rig.json, {out}/{name}.ply, {out}/{name}.npz; look at {out}/{name}.png",
            f"  {result['seconds']:.0f} s",
        ]
    )
