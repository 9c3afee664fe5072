"""`jaxscan measure`: dimensions of a part, with their intervals, from its surface."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.atomic import make_folder
from jaxscan.cli.options import add_units_argument, check_outputs, check_units
from jaxscan.cli.progress import step
from jaxscan.errors import InputError
from jaxscan.extras import extra

if TYPE_CHECKING:
    from jaxscan.measurement.measure import Measurement
    from jaxscan.measurement.scanned import Scanned

HELP: Final = "measure dimensions of a part, each with its 95 % interval and, by its tolerance, a verdict"
EXAMPLE: Final = "jaxscan measure cup.npz part.toml --rig rig.json --csv cup.csv --report report"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "surface",
        type=Path,
        metavar="SURFACE",
        help="a range image (.npz); or a cloud or mesh (.ply, .stl, .obj …), which is measured without intervals",
    )
    parser.add_argument("part", type=Path, metavar="PART", help="part.toml: its features, dimensions and tolerances")
    parser.add_argument("--rig", type=Path, help="the rig of the scan: its covariance is what intervals are made of")
    add_units_argument(parser, "a cloud or mesh")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write a table with a line for each dimension")
    parser.add_argument(
        "--report", type=Path, metavar="DIR", help="write DIR/report.html, ready to print, and report.json"
    )
    parser.add_argument("--png", type=Path, metavar="OUT", help="draw the features over the surface")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read, measure, and write."""
    if args.png or args.report:
        extra("plots")
    if args.report:
        make_folder(args.report)
    check_units(args.surface, args.units)
    outputs = [args.csv] if args.csv else []
    check_outputs(outputs, args.png, [path for path in (args.surface, args.part, args.rig) if path])
    if args.rig and args.surface.suffix.lower() != ".npz":
        raise InputError(
            f"--rig {args.rig}: {args.surface} does not say how its points were made, so that a rig says nothing about "
            "them: measure the range image (.npz), or leave --rig out"
        )
    from jaxscan.files.part_file import read_part

    part = read_part(args.part)
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.files.measured_csv import write_csv
    from jaxscan.measurement.measure import measure
    from jaxscan.measurement.rows import rows_of

    step(f"reading {args.surface}")
    scanned, warnings = read_surface(args.surface, args.rig, args.units)
    step(f"measuring {len(part.dimensions)} dimensions")
    found = measure(scanned, part)
    rows = rows_of(found)
    if args.csv:
        write_csv(args.csv, rows)
    written = [str(path) for path in (args.csv, args.png) if path]
    if args.png or args.report:
        step("drawing")
        written += _drawn(args, scanned, found)
    return as_result(args.surface, found, rows) | {"written": written, "warnings": warnings}


def read_surface(path: Path, rig: Path | None = None, units: str | None = None) -> "tuple[Scanned, list[str]]":
    """A surface to measure, and what is known against its rig.

    Raises:
        InputError: a file is refused, or the rig is not that of the scan.
    """
    import numpy as np

    from jaxscan.errors import error_context
    from jaxscan.files.units import in_millimetres
    from jaxscan.measurement.scanned import scanned_image, scanned_points

    if path.suffix.lower() == ".npz":
        from jaxscan.files.rig_file import read_rig
        from jaxscan.reconstruction import read_range_image

        known = read_rig(rig) if rig else None
        with error_context(path):
            scanned = scanned_image(read_range_image(path), known)
        return scanned, [f"{rig}: {warning}" for warning in known.warnings] if known else []
    if path.suffix.lower() == ".ply":
        from jaxscan.files.cloud import cloud_of
        from jaxscan.files.mesh import has_faces, mesh_of
        from jaxscan.files.ply_read import read_ply_file

        content = read_ply_file(path)
        if not has_faces(content):
            points = in_millimetres(str(path), cloud_of(path, content).points.astype(np.float64), units)
            return scanned_points(points), []
        mesh = mesh_of(path, content)
    else:
        from jaxscan.files.mesh import read_mesh

        mesh = read_mesh(path)
    mesh.vertices = in_millimetres(str(path), np.asarray(mesh.vertices), units)
    return scanned_points(np.asarray(mesh.vertices), mesh), []


def as_result(surface: Path, found: "Measurement", rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What `--json` prints of a measurement."""
    return {
        "kind": "measurement",
        "path": str(surface),
        "part": found.part.name,
        "verdict": found.verdict,
        "dimensions": rows,
        "features": [
            {
                "name": each.feature.name,
                "kind": each.feature.kind,
                "points": each.points,
                "left_out": each.left_out,
                "rms_mm": None if each.fit is None else each.fit.rms_mm,
                "form_mm": None if each.fit is None else each.fit.form_mm,
                "notes": list(each.notes),
                "problem": each.problem or None,
            }
            for each in found.features
        ],
        "notes": list(found.notes),
        "failed": list(found.problems),
    }


def _drawn(args: argparse.Namespace, scanned: "Scanned", found: "Measurement") -> list[str]:
    from jaxscan.view.measured_part import draw_measurement, measurement_report, write_measurement_png

    if args.png:
        write_measurement_png(args.png, draw_measurement(scanned, found))
    if not args.report:
        return []
    from jaxscan.view.report import write_report

    files = {"surface": [args.surface], "part": [args.part], "rig": [args.rig] if args.rig else []}
    return write_report(args.report, measurement_report(scanned, found, args.surface.name).recorded(files))


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    from jaxscan.measurement.rows import in_words

    rows = result["dimensions"]
    wide = max([len(row["name"]) for row in rows], default=0)
    open_rows = [row["name"] for row in rows if row["value"] is None]
    count = f"; {len(rows) - len(open_rows)} of {len(rows)} dimensions could be measured" if open_rows else ""
    lines = [f"{result['path']}: {result['part']}" + (f", {result['verdict']}" if result["verdict"] else "") + count]
    for row in rows:
        lines.append(f"  {row['name']:{wide}}  {in_words(row)}")
        lines += [f"  {'':{wide}}  note: {note}" for note in row["notes"]]
    lines += [f"note: {note}" for note in result["notes"]]
    # Of a dimension it was said in its line.
    lines += [
        f"not measured: {each['name']}: {each['problem']}"
        for each in result["features"]
        if each["problem"] and each["name"] not in open_rows
    ]
    lines += [f"warning: {warning}." for warning in result.get("warnings", [])]
    if result.get("written"):
        lines.append(f"written: {', '.join(result['written'])}")
    return "\n".join(lines)
