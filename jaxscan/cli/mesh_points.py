"""The points of a range image that `jaxscan mesh` joins: cropped, cleaned, without the floor, filled and resampled."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxscan.cli.options import numbers
from jaxscan.cli.progress import step
from jaxscan.errors import InputError

if TYPE_CHECKING:
    from jaxscan.reconstruction import RangeImage
    from jaxscan.surface.floor import Floor


def prepared(
    image: "RangeImage", args: argparse.Namespace, result: dict[str, Any], bed: "Floor | None"
) -> "tuple[RangeImage, Floor | None]":
    """Cropped, thinned, cleaned, without the floor, filled and resampled, as was asked for.

    Args:
        image: as it was read.
        args: of the command.
        result: gets what was done.
        bed: the floor of a scan of its own, if one was given.

    Raises:
        InputError: the image has no points, or `--floor` is none.
    """
    from dataclasses import asdict

    import numpy as np

    from jaxscan.surface.bed import ScannedFloor
    from jaxscan.surface.clean import clean
    from jaxscan.surface.floor import stands_on
    from jaxscan.surface.holes import fill_holes
    from jaxscan.surface.links import sampling
    from jaxscan.surface.resample import resample

    if not image.valid.any():
        raise InputError("has no points: check that the photographs show the stripe")
    if args.crop:
        image = image.cropped(args.crop[:3], args.crop[3:])
    if args.every:
        image = image[:: args.every[0], :: args.every[1]]
    result["points_read"] = int(image.valid.sum())
    turns = [(sweep, whole) for sweep in image.sweeps() if len(sweep.valid) > 1 and (whole := sweep.full_turn)]
    apart = [float(np.median(np.abs(sweep.gaps()))) * 360 / whole for sweep, whole in turns]
    result["degrees_apart"] = max(apart, default=None)
    if not args.raw:
        step("cleaning")
        cleaned = clean(image, sampling(image))
        result["removed"] = cleaned.counts()
        image = cleaned.image
    step("finding the floor")
    floor = bed or _floor(image, args.floor)
    if floor is not None and args.plateaus:
        from jaxscan.surface.plateaus import plateaus

        found = plateaus(image, floor, **({"least_mm2": args.plateau_area} if args.plateau_area else {}))
        result["plateaus"] = [asdict(one) | {"centre": one.centre.tolist()} for one in found]
        if not (args.output or args.png):
            return image, floor
    if floor is not None:
        kept = stands_on(image, floor)
        result["floor"] = {
            "sigma_mm": floor.sigma_mm,
            "tolerance_mm": floor.tolerance_mm,
            "flatness_mm": floor.flatness_mm if np.isfinite(floor.flatness_mm) else None,
            "normal": floor.up.tolist(),
            "points": int((image.valid & ~kept).sum()),
        }
        if isinstance(floor, ScannedFloor):
            beside = image.valid & np.isnan(floor.height(image.points))
            result["floor"] |= {"scan": args.floor, "points_beside_the_scan": int(beside.sum())}
        image = image.where(kept)
    if args.fill is not None:
        step("filling holes")
        image = fill_holes(image, args.fill)
    if args.grid is not None:
        step("resampling")
        from jaxscan.geometry.robust_plane import dominant_plane

        frame = floor.frame if floor else dominant_plane(image.points[image.valid])
        image = resample(image, args.grid, frame)
    return image, floor


def scanned_floor(how: str) -> "Floor | None":
    """The floor that a scan of its own shows; None where `--floor` names none.

    Raises:
        InputError: the file is no range image, or shows no floor.
    """
    if Path(how).suffix.lower() != ".npz":
        return None
    from jaxscan.errors import error_context
    from jaxscan.reconstruction import read_range_image
    from jaxscan.surface.bed import floor_from_scan

    with error_context(how):
        return floor_from_scan(read_range_image(how))


def _floor(image: "RangeImage", how: str) -> "Floor | None":
    from jaxscan.surface.floor import find_floor, floor_from_picks

    if how == "keep":
        return None
    if how == "auto":
        return find_floor(image)
    try:
        picks = [numbers(3)(pick) for pick in how.split(":")]
    except argparse.ArgumentTypeError as error:
        raise InputError(f"--floor {how}: is none of auto, keep, a .npz file, or points X,Y,Z:X,Y,Z:X,Y,Z") from error
    return floor_from_picks(image, picks)
