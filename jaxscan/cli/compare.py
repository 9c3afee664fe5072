"""`jaxscan compare`: how far a cloud is from a mesh or from another cloud, and steps and flatness of picked regions."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.options import add_units_argument, check_outputs, check_units, numbers
from jaxscan.cli.progress import step
from jaxscan.errors import InputError
from jaxscan.extras import extra
from jaxscan.missing import listed, names_in, no_such_file

if TYPE_CHECKING:
    import numpy as np

    from jaxscan.simulation.folders import ScanTruth
    from jaxscan.surface.reference import Reference

# A median beyond this part of the reference's size is no difference of form.
_MISFIT: Final = 0.01
# Where the others have less than this part of the RMS, the points that are far off make it.
_STRAYS: Final = 0.8
HELP: Final = "say how far a cloud is from a reference: signed distances, steps, flatness"
EXAMPLE: Final = "jaxscan compare cup.ply cup-cad.stl --fit -o difference.ply --png difference.png"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "cloud",
        type=Path,
        metavar="CLOUD",
        help="points (.ply, .npz, .xyz, .pcd, .e57, .laz), or a mesh, whose corners count",
    )
    parser.add_argument(
        "reference",
        type=Path,
        nargs="?",
        metavar="REFERENCE",
        help="a mesh (.stl, .ply, .obj …), a cloud (.ply, .npz), or the folder truth of a simulated scan",
    )
    add_units_argument(parser, "the cloud")
    add_units_argument(parser, "the reference", "--reference-units")
    parser.add_argument("--fit", action="store_true", help="move the cloud rigidly onto the reference first")
    parser.add_argument(
        "--within", type=float, default=float("inf"), metavar="MM", help="points further away do not count"
    )
    parser.add_argument(
        "--region",
        type=numbers(4),
        action="append",
        default=[],
        metavar="X,Y,Z,R",
        help="a flat piece of the cloud, as a ball around a point (mm): its flatness, and its height above the first "
        "one's plane; may be given more than once, and without a reference",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="PLY", help="write the points, coloured, with `distance`")
    parser.add_argument("--png", type=Path, metavar="OUT", help="draw the distances")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read, compare, and write."""
    if args.reference is None and not args.region:
        raise InputError("give a REFERENCE to compare the cloud with, or a --region to measure")
    if args.reference is None and (args.fit or args.output or args.png):
        raise InputError("--fit, --output and --png need a REFERENCE: name one")
    if args.reference is None and args.reference_units:
        raise InputError(f"--reference-units {args.reference_units} needs a REFERENCE: name one, or leave it out")
    for *_, radius in args.region or []:
        if not radius > 0:
            raise InputError(f"--region: its radius is {radius:g} mm: give X,Y,Z,R with R more than 0")
    if not args.within > 0:
        raise InputError(f"--within {args.within:g}: give a distance that is more than 0")
    if args.output and args.output.suffix.lower() != ".ply":
        raise InputError(f"{args.output}: write .ply")
    if args.png:
        extra("plots")
    read = [path for path in (args.cloud, args.reference) if path]
    for path in read:
        if not path.exists():
            raise no_such_file(path, "file or folder")
    if args.cloud.is_dir():
        raise InputError(_points_of_folder(args.cloud, args.reference))
    check_outputs([args.output] if args.output else [], args.png, read)
    from jaxscan.errors import error_context
    from jaxscan.files.units import in_millimetres
    from jaxscan.surface.compare import region

    check_units(args.cloud, args.units)
    step(f"reading {args.cloud}")
    points = in_millimetres(str(args.cloud), read_points(args.cloud), args.units)
    result: dict[str, Any] = {"kind": "comparison", "path": str(args.cloud)}
    if args.reference is not None:
        result |= _compared(points, args)
    with error_context(args.cloud):
        regions = [region(points, pick[:3], pick[3]) for pick in args.region]
    result["regions"] = [
        {
            "points": found.points,
            "centre_mm": found.centre.tolist(),
            "rms_mm": found.rms_mm,
            "flatness_mm": found.flatness_mm,
            "height_over_first_mm": found.above(regions[0]),
        }
        for found in regions
    ]
    return result


def _points_of_folder(folder: Path, reference: Path | None) -> str:
    """What is said where a folder is given and points are wanted."""
    from jaxscan.files.exchange import CLOUDS

    ending = (".npz", *CLOUDS)
    near = [where / name for where in (folder, folder.parent) for name in names_in(where) if name.endswith(ending)]
    files = f"; of points {'there is' if len(near) == 1 else 'there are'} {listed(near, 'and')}" if near else ""
    name = folder.name or "scan"
    against = f" {reference}" if reference else ""
    if (folder / "scan.toml").is_file():
        return (
            f"{folder}: has the photographs of a scan, and its points are compared: jaxscan reconstruct {folder} "
            f"--rig rig.json -o {name}.npz, then jaxscan compare {name}.npz{against}{files}"
        )
    return (
        f"{folder}: is a folder: give the points first, then what they are compared with, as in jaxscan compare "
        f"cup.npz{against or ' truth'}{files}"
    )


def _other_things(cloud: Path, median_mm: float, size_mm: float) -> str:
    """What is said where a fit has not carried the cloud onto the reference."""
    return (
        f"half of the points are more than {median_mm:.3g} mm off after the fit, and the reference is {size_mm:.3g} mm "
        "large: the fit failed, or there are other things in the cloud, such as a floor: compare what "
        f"`jaxscan mesh {cloud.stem}.npz -o object.npz` leaves, or cut the rest away (--crop of jaxscan mesh)"
    )


def _compared(points: "np.ndarray", args: argparse.Namespace) -> dict[str, Any]:
    from jaxscan.errors import error_context
    from jaxscan.surface.compare import compare
    from jaxscan.surface.reference import diagonal

    step(f"reading {args.reference}")
    from jaxscan.simulation.folders import read_truth_file, truth_file

    truth_path = truth_file(args.reference)
    if args.reference.is_dir() and truth_path is None:
        raise InputError(
            f"{args.reference}: is a folder, and not the folder truth of a simulation: name a mesh, a cloud, or that "
            f"folder, as in jaxscan compare {args.cloud} truth"
        )
    truth = None if truth_path is None else read_truth_file(truth_path)
    reference = read_reference(args.reference, args.reference_units) if truth is None else _of_truth(truth)
    step(f"{'fitting' if args.fit else 'comparing'} {len(points)} points")
    with error_context(f"{args.cloud} against {args.reference}"):
        found = compare(points, reference, fit=args.fit, within_mm=args.within)
    figures = found.figures()
    if args.output:
        step(f"writing {args.output}")
        write_coloured(args.output, found.points, found.distance, float(figures["p95_mm"]))
    if args.png:
        from jaxscan.view.surface_plots import draw_comparison

        step(f"drawing {args.png}")
        words = f"{figures['points']} points, {figures['rms_mm']:.3f} mm RMS, median {figures['median_mm']:.3f} mm"
        if figures["points_far"]:
            words += f"; {figures['rms_without_far_mm']:.3f} mm RMS without {figures['points_far']} far off"
        draw_comparison(args.png, found, f"{args.cloud.name} against {args.reference.name}: {words}")
    motion = None
    if found.motion is not None:
        motion = {"rotation": found.motion.matrix().tolist(), "translation_mm": found.motion.translation.tolist()}
    size = diagonal(reference)
    misfit = args.fit and figures["median_mm"] > _MISFIT * size
    return {
        "warnings": [_other_things(args.cloud, float(figures["median_mm"]), size)] if misfit else [],
        "reference": str(args.reference),
        "reference_inside_out": bool(getattr(reference, "inside_out", False)),
        "figures": figures,
        "fit": motion,
        "on_floor": None if misfit else _on_floor(args.cloud),
        "truth": None if truth is None else _against_truth(args.cloud, truth),
        "written": [str(path) for path in (args.output, args.png) if path],
    }


def _on_floor(cloud: Path) -> float | None:
    """Which part of a range image's points lie on its floor; None where there is none, and for other clouds."""
    if cloud.suffix.lower() != ".npz":
        return None
    from jaxscan.reconstruction import read_range_image
    from jaxscan.surface.floor import find_floor

    try:
        return find_floor(read_range_image(cloud)).share
    except InputError:
        return None


def _of_truth(truth: "ScanTruth") -> "Reference":
    """The true points of a scan as a cloud."""
    import numpy as np

    from jaxscan.surface.reference import CloudReference

    return CloudReference(truth.points[np.isfinite(truth.points).all(axis=-1)])


def _against_truth(cloud: Path, truth: "ScanTruth") -> dict[str, Any] | None:
    """What is known of the points of a range image by frame and column; None for another cloud, or parts of one."""
    if cloud.suffix.lower() != ".npz":
        return None
    from jaxscan.errors import error_context
    from jaxscan.reconstruction import read_range_image
    from jaxscan.simulation.accuracy import pair_errors

    image = read_range_image(cloud)
    if image.points.shape != truth.points.shape:
        return None
    with error_context(cloud):
        return pair_errors(truth.points, image.points, image.valid).as_dict()


def read_points(path: Path) -> "np.ndarray":
    """The points of a cloud, of a range image, or the corners of a mesh."""
    import numpy as np

    if path.suffix.lower() == ".npz":
        from jaxscan.reconstruction import read_range_image

        image = read_range_image(path)
        if not image.valid.any():
            raise InputError(f"{path}: has no points: check that the photographs show the stripe")
        return image.points[image.valid].astype(np.float64)
    from jaxscan.files.exchange import CLOUDS, read_cloud

    if path.suffix.lower() in CLOUDS:
        return read_cloud(path).points.astype(np.float64)
    from jaxscan.files.mesh import read_mesh

    return np.asarray(read_mesh(path).vertices)


def read_reference(path: Path, units: str | None = None) -> "Reference":
    """A mesh where the file holds one, else a cloud; in millimetres, as `in_millimetres`."""
    check_units(path, units, "--reference-units")
    import numpy as np

    from jaxscan.files.units import in_millimetres
    from jaxscan.surface.reference import CloudReference, MeshReference

    def in_mm(points: np.ndarray) -> np.ndarray:
        return in_millimetres(str(path), points, units, "--reference-units")

    from jaxscan.files.exchange import EXCHANGE

    if path.suffix.lower() == ".npz":
        return CloudReference(read_points(path))
    if path.suffix.lower() in EXCHANGE:
        return CloudReference(in_mm(read_points(path)))
    if path.suffix.lower() == ".ply":
        from jaxscan.files.cloud import cloud_of
        from jaxscan.files.mesh import has_faces, mesh_of
        from jaxscan.files.ply_read import read_ply_file

        content = read_ply_file(path)
        if not has_faces(content):
            return CloudReference(in_mm(cloud_of(path, content).points))
        mesh = mesh_of(path, content)
    else:
        from jaxscan.files.mesh import read_mesh

        mesh = read_mesh(path)
    mesh.vertices = in_mm(np.asarray(mesh.vertices))
    return MeshReference(mesh)


def write_coloured(path: Path, points: "np.ndarray", distance: "np.ndarray", limit: float) -> None:
    """The points with their signed distance, blue behind the reference and red in front of it."""
    import numpy as np

    from jaxscan.files.cloud import Cloud, vertices_of
    from jaxscan.files.ply import Element, Ply
    from jaxscan.files.ply_write import write_ply_file
    from jaxscan.surface.colours import diverging

    vertices = vertices_of(Cloud(points.astype(np.float32), colours=diverging(distance, max(limit, 1e-12))))
    columns = {**vertices.columns, "distance": distance.astype(np.float32)}
    comments = ("comment units mm", f"comment blue and red are {limit:.4g} mm behind and in front of the reference")
    write_ply_file(path, Ply({"vertex": Element(vertices.count, columns)}, comments=comments))


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    lines = []
    if "figures" in result:
        figures = result["figures"]
        fitted = "after a rigid fit" if result["fit"] else "as they stand"
        lines += [
            f"{result['path']} against {result['reference']}, {fitted}: {figures['points']} points"
            + (f", {figures['points_beyond']} beyond" if figures["points_beyond"] else ""),
            f"  distance   {figures['rms_mm']:.4f} mm RMS, median {figures['median_mm']:.4f}, "
            f"95 % {figures['p95_mm']:.4f}, largest {figures['largest_mm']:.4f} mm",
            f"  mean       {figures['mean_mm']:+.4f} mm, positive in front of the reference",
        ]
        if figures["points_far"]:
            lines.append(
                f"  without    {figures['points_far']} points that are far off, more than {figures['far_mm']:.3g} mm "
                f"(ten times the median): {figures['rms_without_far_mm']:.4f} mm RMS"
            )
            scan = result["path"].lower().endswith(".npz")
            if scan and figures["rms_without_far_mm"] < _STRAYS * figures["rms_mm"]:
                lines[-1] += "; `jaxscan mesh` removes stray points"
        if truth := result["truth"]:
            lines.append(
                f"  true point {truth['to_true_point']:.4f} mm RMS from that of the same frame and column "
                f"({truth['to_true_point_after_fit']:.4f} after a rigid fit), {truth['far_points']} points far off, "
                f"{100 * truth['completeness']:.1f} % of what an ideal camera sees of object and floor"
            )
        lines += [f"warning: {words}" for words in result["warnings"]]
        if result["reference_inside_out"]:
            lines.append("  reference  is inside out, and was turned")
        if result["on_floor"]:
            lines.append(
                f"  floor      {100 * result['on_floor']:.0f} % of the points lie on one plane, apparently the floor, "
                f"and count; without it: jaxscan mesh {result['path']} -o object.npz, then compare object.npz"
            )
        if result["written"]:
            lines.append(f"  written    {', '.join(result['written'])}")
    for number, found in enumerate(result["regions"], 1):
        lines.append(
            f"  region {number}   {found['points']} points, {found['rms_mm']:.4f} mm RMS about a plane, flat within "
            f"{found['flatness_mm']:.4f} mm, {found['height_over_first_mm']:+.4f} mm over region 1"
        )
    return "\n".join(lines)
