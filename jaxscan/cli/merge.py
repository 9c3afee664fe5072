"""`jaxscan merge`: scans of an object from several sides, registered all together, as one surface."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.options import add_outputs_argument, add_units_argument, check_outputs, finite
from jaxscan.errors import InputError
from jaxscan.extras import extra

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jaxscan.geometry import Pose
    from jaxscan.surface.merged import Merged
    from jaxscan.surface.register import Registration
    from jaxscan.surface.side import Side

HELP: Final = "join scans of an object from several sides into one surface"
EXAMPLE: Final = "jaxscan merge front.npz right.npz back.npz left.npz --turn 90 -o model.stl"

_ENDINGS: Final = (".stl", ".obj", ".ply", ".glb")
# Those that have the colours of vertices.
_COLOURED: Final = (".ply", ".obj", ".glb")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "scans",
        type=Path,
        nargs="+",
        metavar="SCAN",
        help="two or more range images (.npz), clouds (.ply) without a floor, or folders of photographs (with --rig)",
    )
    add_outputs_argument(parser, "MESH", ".stl, .obj, .ply or .glb")
    add_units_argument(parser, "clouds (.ply) and --poses")
    parser.add_argument("--rig", type=Path, help="the rig: of folders of photographs, and its turntable")
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--turn",
        type=_some,
        metavar="DEG",
        help="how far the object was turned from scan to scan, within 10 degrees, anticlockwise as seen from above; or "
        "0,DEG,DEG,… for each scan (default: from features of the shape, with the extra features)",
    )
    how.add_argument(
        "--steps",
        type=_some,
        metavar="N",
        help="motor steps of the rig's turntable from scan to scan, or N,N,… for each: its axis gives the start",
    )
    how.add_argument(
        "--poses",
        type=Path,
        metavar="FILE",
        help="rough poses of the scans, by their file names: .json (4 x 4, or position and quaternion w, x, y, "
        "z), or .conf of the Stanford scans",
    )
    parser.add_argument(
        "--as-given",
        action="store_true",
        help="leave the scans where --poses or --steps put them, or else, as with --turn 0, where they are: for two "
        "lasers of one rig, and for round or flat objects, which slide; the report says how they fit",
    )
    parser.add_argument(
        "--fit-turntable",
        type=_some,
        metavar="N",
        help="motor steps from scan to scan, or N,N,… for each: find axis and angle of the turntable they stood on",
    )
    parser.add_argument("--write-rig", type=Path, metavar="OUT", help="write the rig with that turntable")
    parser.add_argument(
        "--floor", choices=("auto", "keep"), default="auto", help="auto (default): found and removed | keep"
    )
    parser.add_argument("--raw", action="store_true", help="keep mixed, grazing and isolated points")
    parser.add_argument(
        "--closed", action="store_true", help="close parts that were not seen, by screened Poisson (extra poisson)"
    )
    parser.add_argument(
        "--cube", type=finite, metavar="MM", help="distance of the vertices (default: 0.7 of the points')"
    )
    parser.add_argument("--simplify", type=int, metavar="N", help="reduce the mesh to N triangles (extra simplify)")
    parser.add_argument("--png", type=Path, metavar="OUT", help="draw the surface")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read, register, merge and write."""
    _check(args)
    check_outputs([*args.output, *([args.write_rig] if args.write_rig else [])], args.png, args.scans)
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.cli.progress import progress, step
    from jaxscan.geometry import Pose
    from jaxscan.surface.coarse_register import check_fits, check_turned, coarse_register
    from jaxscan.surface.free_space import check_free_space
    from jaxscan.surface.merged import merge, merge_closed
    from jaxscan.surface.register import as_given, register

    known, degrees = _start(args)
    with progress("reading", len(args.scans), "scan") as advance:
        sides = [_side(path, args, advance) for path in args.scans]
    with progress("registering", 3, "step") as advance:
        if args.as_given:
            starts = list(known or [Pose.identity() for _ in sides])
            registration = as_given(sides, starts)
            advance(1)
        else:
            starts = coarse_register(sides, degrees, known)
            advance(1)
            registration = register(sides, starts)
            check_fits(sides, registration)
            if degrees:
                check_turned(sides, degrees, registration)
        check_free_space(sides, registration.poses)
        advance(1)
        poses = registration.poses
        merged = merge_closed(sides, poses) if args.closed else merge(sides, poses, cube_mm=args.cube)
        advance(1)
    result: dict[str, Any] = {"kind": "merged", "path": [str(path) for path in args.output]}
    result |= {"as_given": args.as_given, **_registered(sides, starts, registration)}
    if args.fit_turntable:
        result["turntable"] = _turntable(args, registration)
    step("writing")
    return result | _written(args, sides, registration, merged)


def _check(args: argparse.Namespace) -> None:
    """Refuse options that do not go together, before any work."""
    if len(args.scans) < 2:
        raise InputError(f"{args.scans[0]}: one scan has nothing to be joined with: give two or more")
    twice = sorted({str(path) for path in args.scans if args.scans.count(path) > 1})
    if twice:
        raise InputError(f"{', '.join(twice)}: is given twice: give each scan once")
    for path in args.output:
        if path.suffix.lower() not in _ENDINGS:
            raise InputError(f"{path}: the ending is not known: write {', '.join(_ENDINGS)}")
    for path in args.scans:
        if path.suffix.lower() not in (".npz", ".ply") and not args.rig:
            raise InputError(
                f"{path}: give a range image (.npz), a cloud (.ply), or a folder of photographs with --rig"
            )
    if args.units and not args.poses and not any(path.suffix.lower() == ".ply" for path in args.scans):
        raise InputError(
            f"--units {args.units}: no scan is a cloud (.ply), and range images and photographs are in millimetres: "
            "leave it out"
        )
    if args.steps and not args.rig:
        raise InputError("--steps: are those of a rig's turntable: give --rig too, or --turn")
    if args.as_given and args.fit_turntable:
        raise InputError(
            "--as-given: the poses are not measured, so --fit-turntable would find what was given: leave one out"
        )
    if args.as_given and args.turn and any(args.turn):
        raise InputError(
            "--as-given: --turn says how far the object was turned, and not about which axis: give --steps with the "
            "rig of the turntable, or --poses; --turn 0 is for scans in one frame"
        )
    if args.write_rig and not (args.rig and args.fit_turntable):
        raise InputError("--write-rig: writes --rig with the turntable of --fit-turntable: give both")
    if args.cube is not None and (args.closed or not args.cube > 0):
        raise InputError(f"--cube {args.cube:g}: give a size that is more than 0, and not with --closed")
    if args.simplify is not None and args.simplify < 4:
        raise InputError(f"--simplify {args.simplify}: give 4 triangles or more")
    needed = {
        "plots": args.png,
        "poisson": args.closed,
        "simplify": args.simplify is not None,
        "features": not (args.turn or args.steps or args.poses or args.as_given),
    }
    for name in [name for name, asked in needed.items() if asked]:
        extra(name)
    for name in ("turn", "steps", "fit_turntable"):
        values = getattr(args, name)
        if values:
            setattr(args, name, _for_each(f"--{name.replace('_', '-')}", values, len(args.scans)))


def _some(text: str) -> list[float]:
    """A number, or several with commas between them."""
    try:
        return [finite(word) for word in text.split(",")]
    except (ValueError, argparse.ArgumentTypeError) as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no number, nor numbers with commas between them") from error


def _for_each(option: str, values: list[float], count: int) -> list[float]:
    """A number for each scan: those given, or multiples of the only one."""
    if len(values) == 1:
        return [k * values[0] for k in range(count)]
    if len(values) != count:
        raise InputError(f"{option}: {len(values)} numbers for {count} scans: give one, or one for each")
    return values


def _start(args: argparse.Namespace) -> "tuple[Sequence[Pose] | None, Sequence[float] | None]":
    """Poses as they are given or by the rig's turntable, or angles."""
    if args.poses:
        from jaxscan.files.scan_poses import read_scan_poses
        from jaxscan.files.units import UNITS
        from jaxscan.geometry import Pose

        scale = UNITS[args.units or "mm"]
        poses = [Pose(T.rotation, scale * T.translation) for T in read_scan_poses(args.poses, args.scans)]
        return [poses[0].inverse() @ T for T in poses], None
    if not args.steps:
        return None, args.turn
    from jaxscan.errors import error_context
    from jaxscan.files.rig_file import read_rig
    from jaxscan.surface.turntable import turntable_of, turntable_poses

    rig = read_rig(args.rig).rig
    with error_context(args.rig):
        return turntable_poses(turntable_of(rig), args.steps), None


def _side(path: Path, args: argparse.Namespace, advance: Any) -> "Side":
    from jaxscan.errors import error_context
    from jaxscan.surface.side import side_of_cloud, side_of_image

    name = str(path)
    if path.suffix.lower() == ".ply":
        from jaxscan.files.cloud import read_ply
        from jaxscan.files.units import cloud_in_millimetres

        side = side_of_cloud(name, cloud_in_millimetres(name, read_ply(path), args.units))
    else:
        image = _image(path, args)
        with error_context(path):
            if not image.valid.any():
                raise InputError("has no points: check that the photographs show the stripe")
            side = side_of_image(name, image, cleaned=not args.raw, on_floor=args.floor == "auto")
    advance(1)
    return side


def _image(path: Path, args: argparse.Namespace) -> Any:
    from jaxscan.reconstruction import read_range_image, reconstruct

    if path.suffix.lower() == ".npz":
        return read_range_image(path)
    from jaxscan.files.rig_file import read_rig
    from jaxscan.files.scan import read_scan

    return reconstruct(read_rig(args.rig), read_scan(path))


def _registered(sides: "list[Side]", starts: "list[Pose]", found: "Registration") -> dict[str, Any]:
    import numpy as np

    from jaxscan.surface.coarse_register import fits
    from jaxscan.surface.register import moved_apart

    return {
        "scans": [
            {
                "path": side.name,
                "points": len(side.points),
                "rotation": T.rotation.tolist(),
                "translation_mm": T.translation.tolist(),
                "sigma_deg": float(np.degrees(found.sigma(k)[0])) if k == 0 or found.rounds else None,
                "sigma_mm": found.sigma(k)[1] if k == 0 or found.rounds else None,
                "from_chain_mm": moved_apart(side, starts[k], T),
            }
            for k, (side, T) in enumerate(zip(sides, found.poses, strict=True))
        ],
        "centre_mm": found.centre.tolist(),
        "residual_in_sigma": float(np.sqrt(found.variance)) if found.pairs else None,
        "closure_mm": found.closure_mm if found.pairs else None,
        "do_not_fit": [[pair.first, pair.second] for pair in found.pairs if not fits(pair)],
        "converged": found.converged,
        "rounds": found.rounds,
        "pairs": [
            {
                "scans": [pair.first, pair.second],
                "matches": pair.matches,
                "overlap": pair.overlap,
                "residual_in_sigma": pair.scale,
                "rms_mm": pair.rms_mm,
                "apart_mm": pair.apart_mm,
            }
            for pair in found.pairs
        ],
    }


def _turntable(args: argparse.Namespace, registration: "Registration") -> dict[str, Any]:
    from dataclasses import asdict

    from jaxscan.rig.turn_summary import turn_summary
    from jaxscan.surface.turntable import fit_turntable

    fit = fit_turntable(registration, args.fit_turntable)
    if args.write_rig:
        from jaxscan.files.rig_file import read_rig, write_rig

        write_rig(args.write_rig, fit.on(read_rig(args.rig)))
    return {
        **asdict(turn_summary(fit.turntable, fit.covariance, registration.centre)),
        "misfit_in_sigma": fit.misfit,
        "rig": str(args.write_rig) if args.write_rig else None,
    }


def _written(
    args: argparse.Namespace, sides: "list[Side]", registration: "Registration", merged: "Merged"
) -> dict[str, Any]:
    import numpy as np

    from jaxscan.cli.mesh_surface import simplified
    from jaxscan.files.cloud import Cloud
    from jaxscan.files.mesh import write_mesh_ply, write_trimesh
    from jaxscan.surface.painted import colours_near, painted_sides

    mesh, known = merged.mesh, merged.sides > 0
    note = sides[0].floor.note() if sides[0].floor else None
    if args.simplify is not None:
        mesh = simplified(mesh, args.simplify)
    painted = painted_sides(sides, registration.poses)
    colours = painted and colours_near(np.asarray(mesh.vertices, np.float32), painted)
    for path in args.output:
        if path.suffix.lower() == ".ply":
            cloud = merged.cloud() if mesh is merged.mesh else Cloud(np.asarray(mesh.vertices, np.float32))
            normals = np.asarray(mesh.vertex_normals, np.float32)
            cloud = replace(cloud, colours=colours)
            write_mesh_ply(path, cloud, np.asarray(mesh.faces), normals=normals, floor=note)
        else:
            write_trimesh(path, mesh, colours, note)
    if args.png:
        from jaxscan.geometry.robust_plane import dominant_plane
        from jaxscan.view.surface_plots import draw_mesh

        vertices = np.asarray(mesh.vertices)
        floor = sides[0].floor
        up = floor.up if floor else dominant_plane(vertices).matrix()[:, 2]
        title = f"{len(mesh.faces)} triangles of {len(sides)} scans"
        draw_mesh(args.png, vertices, np.asarray(mesh.faces), up, title, colours=colours)
    sigma = merged.sigma[known]
    return {
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.faces),
        "area_mm2": float(mesh.area),
        "closed": bool(mesh.is_watertight),
        "volume_mm3": float(mesh.volume) if mesh.is_watertight else None,
        "seen": float(known.mean()),
        "sides_in_the_mean": float(merged.sides[known].mean()),
        "scans_disagree": merged.disagreement,
        "sigma_vertex_mm": float(np.median(sigma)) if np.isfinite(sigma).all() else None,
        "sigma_pixel_vertex_mm": float(np.median(merged.sigma_pixel[known])),
        "coloured": None if colours is None else int(colours.any(axis=1).sum()),
        "picture": str(args.png) if args.png else None,
    }


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    scans = result["scans"]
    closed = f"closed, {result['volume_mm3']:.6g} mm³" if result["closed"] else "open"
    noise, sigma = f"{result['sigma_pixel_vertex_mm']:.4f} mm", result["sigma_vertex_mm"]
    sigma = f"σ of the noise {noise}" if sigma is None else f"σ {sigma:.4f} mm, of which noise {noise}"
    unseen = f"; {100 * (1 - result['seen']):.0f} % of it was not seen" if result["seen"] < 1 else ""
    lines = [
        f"{result['triangles']} triangles of {len(scans)} scans: {', '.join(result['path'])}",
        f"  surface    {result['area_mm2']:.6g} mm², {closed}; {result['sides_in_the_mean']:.1f} scans on each vertex, "
        f"{sigma}{unseen}",
        *_pairs_in_words(result),
    ]
    kept = [ending for ending in _COLOURED if any(path.lower().endswith(ending) for path in result["path"])]
    if result["coloured"] and kept:
        lines.insert(2, f"  colours    of {result['coloured']} of its points, in {' and '.join(kept)}")
    if not result["converged"]:
        lines.append(f"  not settled: {result['rounds']} rounds did not suffice; do not rely on the poses or their σ")
    for scan in scans[1:]:
        known = "as given"
        if scan["sigma_mm"] is not None:
            known = f"within {scan['sigma_mm']:.4f} mm and {scan['sigma_deg']:.4f}°"
        lines.append(f"  {scan['path']}: {scan['points']} points, pose {known}")
    if "turntable" in result:
        from jaxscan.cli.format_summary import format_turn

        found = result["turntable"]
        lines.append(
            f"  turntable  {', '.join(format_turn(found))}; the poses are off it by {found['misfit_in_sigma']:.1f} σ"
        )
    if result["picture"]:
        lines.append(f"  picture    {result['picture']}")
    return "\n".join(lines)


def _pairs_in_words(result: dict[str, Any]) -> list[str]:
    """How the scans fit each other."""
    scans, pairs = result["scans"], result["pairs"]
    if not pairs:
        return ["  pairs      no two overlap, so the poses cannot be checked"]
    apart = f"{result['closure_mm']:.3f} mm: the furthest that a pair alone would"
    lines = [
        f"  pairs      {len(pairs)} overlap; distances scatter by {result['residual_in_sigma']:.2f} σ, "
        f"{max(pair['rms_mm'] for pair in pairs):.3f} mm RMS at most",
        f"  as given   {apart} move" if result["as_given"] else f"  closure    {apart} stand apart",
    ]
    if result["as_given"]:
        lines += [
            f"  {scans[a]['path']} and {scans[b]['path']} do not fit as given, by far more than their σ: check the "
            "poses and the rig, and whether something moved"
            for a, b in result["do_not_fit"]
        ]
    return lines
