"""`jaxscan profiles`: what a laser profiler has measured, as the points of a scan."""

import argparse
from pathlib import Path
from typing import Any, Final

from jaxscan.cli.options import add_outputs_argument, check_outputs
from jaxscan.cli.progress import step

HELP: Final = "turn the profiles of a laser profiler (CSV, range maps, GenICam Coord3D) into points"
EXAMPLE: Final = "jaxscan profiles scans/gear -o gear.npz"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "profiles", type=Path, metavar="PROFILES", help="a folder with profiles.toml, or that file (docs/profiles.md)"
    )
    add_outputs_argument(
        parser,
        "POINTS",
        ".npz (the organised range image, for jaxscan mesh) or .ply; also .xyz, .pcd, and with the extra exchange "
        ".e57 and .laz",
    )


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read the profiles, carry them by the motion, and write the points."""
    from jaxscan.files.cloud import check_ending
    from jaxscan.files.exchange import check_exchange

    for path in args.output:
        check_ending(path)
        check_exchange(path)
    check_outputs(args.output)
    import numpy as np

    from jaxscan.files.profiles import read_profiles
    from jaxscan.reconstruction import write_points
    from jaxscan.reconstruction.profiles import range_image_of_profiles

    step(f"reading {args.profiles}")
    profiles = read_profiles(args.profiles)
    image = range_image_of_profiles(profiles)
    for path in args.output:
        step(f"writing {path}")
        write_points(path, image)
    points = image.points[image.valid]
    return {
        "kind": "points",
        "path": [str(path) for path in args.output],
        "profiles": len(image.valid),
        "points_of_a_profile": image.valid.shape[1],
        "points": len(points),
        "invalid": int((~image.valid).sum()),
        "size_mm": np.ptp(points, axis=0).tolist(),
        "motion": list(image.moving),
    }


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    size = " x ".join(f"{length:.4g}" for length in result["size_mm"])
    return (
        f"{result['points']} points from {result['profiles']} profiles of {result['points_of_a_profile']} "
        f"({result['invalid']} invalid): {', '.join(result['path'])}\n"
        f"  size       {size} mm (x along the profile, y, z away from the profiler)\n"
        f"  motion     {', '.join(result['motion'])}"
    )
