"""`jaxscan gauge`: scans of objects of known shape put the rig's light planes, and its stage, right."""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.options import add_units_argument, check_rig_name
from jaxscan.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from jaxscan.calibration import Calibration
    from jaxscan.calibration.gauge import GaugeFit
    from jaxscan.calibration.gauge_points import Gauge
    from jaxscan.calibration.gauge_shapes import Shape
    from jaxscan.files.rig_file import RigFile
    from jaxscan.rig import Covariance, Rig

HELP: Final = "correct a rig's light plane and stage by scans of objects of known shape"
EXAMPLE: Final = (
    "jaxscan gauge scans/block --rig rig.json --shape steps:1.48,3.68,8.94,14.00 -o refined.json\n"
    "  jaxscan gauge scans/block scans/turned --shape steps:1.48,14.00 --session session --trust laser stage -o a.json"
)

_OF_THE_LIGHT: Final = re.compile(r"\b(laser|sheet|light plane)", re.IGNORECASE)
# Of how many points of a scan σ is computed; by how many times a gauge may leave it larger without a word.
_POINTS: Final = 2000
_TIMES: Final = 4.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "scan",
        type=Path,
        nargs="+",
        metavar="SCAN",
        help="a gauge's scan: a folder with scan.toml, or that file; several (a gauge in several places, or several "
        "gauges) are solved together",
    )
    boards = parser.add_mutually_exclusive_group(required=True)
    boards.add_argument("--rig", type=Path, help="the rig, as jaxscan calibrate writes it: what its covariance says")
    boards.add_argument(
        "--session",
        type=Path,
        nargs="+",
        metavar="SESSION",
        help="the calibration sessions themselves: boards and gauges in one solve",
    )
    add_units_argument(parser, "a mesh file of --shape")
    parser.add_argument(
        "--shape",
        required=True,
        nargs="+",
        help="plate | steps:H1,H2,… (heights of level faces above the plate that they stand on, mm) | ball:R (radius, "
        "mm) | a mesh file (mm, z up, standing on z = 0); one for all scans, or one for each",
    )
    parser.add_argument(
        "--trust",
        choices=("laser", "stage"),
        nargs="*",
        default=("stage",),
        help="which results of the board calibration are kept, beside the camera (default: stage; the laser is "
        "assumed to have moved since). With laser and stage the gauge only adds information",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="RIG", help="the refined rig to write")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Find the stripe on the gauges, refine the rig, and write it."""
    from jaxscan.atomic import check_writable

    check_rig_name(args.output)
    check_writable(args.output)
    shapes = _shapes(args.shape, len(args.scan), args.units)
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.calibration.gauge import refine_by_gauge
    from jaxscan.cli.progress import progress
    from jaxscan.files.rig_file import read_rig, write_rig
    from jaxscan.files.scan import read_scan

    scans = [read_scan(path) for path in args.scan]
    known: RigFile | Calibration
    if args.session:
        from jaxscan.cli.solve_sessions import solve_sessions

        _, known = solve_sessions(args.session)
        content = known.rig_file()
    else:
        known = content = read_rig(args.rig)
    gauges = [_look(content, scan, shape) for scan, shape in zip(scans, shapes, strict=True)]
    with progress("fitting the gauge", 1, "rig") as advance:
        fit = refine_by_gauge(known, gauges, args.trust)
        advance(1)
    kept = dict(content.fit)
    if "laser" not in args.trust:
        # A light plane that the gauge has found again is not the one that was warned of.
        kept["warnings"] = [words for words in content.warnings if not _OF_THE_LIGHT.search(words)]
    before_mm, now_mm = (_known_to(rig.rig, rig.covariance, gauges) for rig in (content, fit))
    warnings = _doubts(fit, shapes, args.trust, before_mm, now_mm)
    refined = fit.rig_file(kept, warnings)
    write_rig(args.output, refined)
    return {
        "path": str(args.output),
        "gauges": [
            {
                "scan": str(path),
                "points": gauge.points,
                "rejected": gauge.rejected,
                "rms_before_mm": gauge.rms_before_mm,
                "rms_after_mm": gauge.rms_after_mm,
                "stripe_sigma_px": gauge.stripe_sigma_px,
                "levels": [
                    {"known_mm": level.known_mm, "read_mm": level.read_mm if level.points else None}
                    for level in gauge.levels
                ],
            }
            for path, gauge in zip(args.scan, fit.gauges, strict=True)
        ],
        "from_prior_in_sigma": fit.from_prior_in_sigma,
        "by_chance_in_sigma": fit.by_chance_in_sigma,
        "lights": _turned(content.rig, fit.rig, gauges),
        "point_sigma_before_mm": before_mm,
        "point_sigma_mm": now_mm,
        "warnings": list(refined.warnings),
    }


def _shapes(texts: list[str], scans: int, units: str | None) -> "list[Shape]":
    """A shape for each scan."""
    from jaxscan.calibration.gauge_shapes import parse_shape

    shapes = [parse_shape(text, units) for text in texts]
    if len(shapes) not in (1, scans):
        raise InputError(f"--shape: {len(shapes)} shapes for {scans} scans: give one for all of them, or one for each")
    return shapes * (scans // len(shapes))


def _look(content: "RigFile", photographs: Any, shape: "Shape") -> "Gauge":
    """A gauge with what is seen of it in its scan."""
    from jaxscan.calibration.gauge_points import Gauge, GaugeScan
    from jaxscan.cli.progress import progress
    from jaxscan.reconstruction import reconstruct

    with progress("reading frames", len(photographs.frames) or None, "frame") as advance:
        image = reconstruct(content, photographs, advance)
    return Gauge(GaugeScan(image.pixels, image.positions, photographs.laser.columns, photographs.laser.name), shape)


def _pixels(gauge: "Gauge") -> "tuple[np.ndarray, dict[str, np.ndarray]]":
    """Some of the stripe's points in a scan, (u, v), and the steps of the axes at each."""
    import numpy as np

    scan = gauge.scan
    frame, line = np.nonzero(np.isfinite(scan.pixels))
    some = np.linspace(0, len(frame) - 1, min(_POINTS, len(frame))).astype(int)
    frame, line = frame[some], line[some]
    at = line.astype(float), scan.pixels[frame, line].astype(float)
    return np.stack(at if scan.columns else at[::-1], axis=1), {
        axis: np.asarray(steps)[frame] for axis, steps in scan.positions.items()
    }


def _known_to(rig: "Rig", covariance: "Covariance | None", gauges: "list[Gauge]") -> float | None:
    """σ along its ray that the rig leaves in a point of the scans, mm, the median; None without a covariance."""
    import numpy as np

    from jaxscan.reconstruction.point_sigma import point_sigma

    if covariance is None:
        return None
    each = [point_sigma(rig, g.scan.laser, covariance, 0.0, *_pixels(g), g.scan.columns)[0] for g in gauges]
    return float(np.median(np.concatenate(each)))


def _turned(before: "Rig", now: "Rig", gauges: "list[Gauge]") -> list[dict[str, Any]]:
    """By how much each sheet that lit a gauge has turned, degrees, and moved along the rays of the scan, mm."""
    import numpy as np

    from jaxscan.rig.light import inverse_depths
    from jaxscan.rig.projection import pixel_rays

    found = {}
    for gauge in gauges:
        one, other = (rig.light(gauge.scan.laser) for rig in (before, now))
        rays = np.asarray(pixel_rays(before.camera, _pixels(gauge)[0]))
        depths = [1 / inverse_depths(light, rays)[0] for light in (one, other)]
        middle = np.median(rays * depths[0][:, None], axis=0)
        normals = [np.asarray(light.gradient(middle), np.float64) for light in (one, other)]
        normals = [n / np.linalg.norm(n) for n in normals]
        angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(*normals)), abs(np.dot(*normals))))
        found[one.name] = {
            "laser": one.name,
            "turned_deg": float(angle),
            "moved_mm": float(np.median(np.abs(depths[1] - depths[0]))),
        }
    return list(found.values())


def _doubts(
    fit: "GaugeFit", shapes: "list[Shape]", trust: Sequence[str], before_mm: float | None, now_mm: float | None
) -> list[str]:
    """What the refined rig must not be used without knowing, beside contradictions."""
    from jaxscan.calibration.gauge_shapes import Steps

    found = [
        f"Of a plate's scan {gauge.rejected} points lie elsewhere, and {gauge.points} on it: the scan shows more than "
        "a plate. Give its shape, as steps:H1,H2"
        for gauge, shape in zip(fit.gauges, shapes, strict=True)
        if isinstance(shape, Steps) and not shape.size and gauge.rejected > gauge.points
    ]
    enough = max([_TIMES * (before_mm or 0.0), *(gauge.rms_after_mm for gauge in fit.gauges)])
    if now_mm is not None and now_mm > enough:
        was = "" if before_mm is None else f", and was known to {before_mm:.3f} mm if nothing had moved"
        add = "" if set(trust) >= {"laser", "stage"} else ". Where the laser has not moved, add --trust laser stage"
        where = "A gauge in one place determines" if len(fit.gauges) == 1 else "Gauges in these places determine"
        found.append(
            f"By the refined rig a point of the scan is known to {now_mm:.2f} mm only (σ along its ray, median){was}. "
            f"{where} heights there, and little else: scan more places, higher ones and lower ones, turned by half a "
            f"turn too, and give all scans{add}"
        )
    return found


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    lines = [f"rig {result['path']}"]
    for gauge in result["gauges"]:
        before, after = gauge["rms_before_mm"], gauge["rms_after_mm"]
        lines += [
            f"  gauge      {gauge['scan']}: {gauge['points']} stripe points on it, {gauge['rejected']} elsewhere",
            f"  distance   {before:.3f} mm RMS from its surface before, {after:.3f} mm now",
        ]
        seen = [(level["known_mm"], level["read_mm"]) for level in gauge["levels"] if level["read_mm"] is not None]
        if seen:
            lines.append(f"  levels     {', '.join(f'{known:g} reads {read:.3f}' for known, read in seen)} mm")
    for light in result["lights"]:
        name = f'"{light["laser"]}" ' if light["laser"] else ""
        lines.append(
            f"  laser      {name}turned by {light['turned_deg']:.2f}°, points moved by {light['moved_mm']:.2f} mm "
            "(along their rays, median)"
        )
    if result["point_sigma_mm"] is not None:
        before = result["point_sigma_before_mm"]
        was = "" if before is None else f"; before {before:.3f} mm, if nothing had moved"
        lines.append(
            f"  a point    known to {result['point_sigma_mm']:.3f} mm by the rig (σ along its ray, median){was}"
        )
    agreement, chance = result["from_prior_in_sigma"], result["by_chance_in_sigma"]
    lines.append(
        f"  agreement  {agreement:.1f} standard deviations from what was trusted; by chance up to {chance:.1f}"
    )
    return "\n".join([*lines, *(f"warning: {words}." for words in result["warnings"])])
