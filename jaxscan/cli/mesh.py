"""`jaxscan mesh`: from the points of a scan to a surface, without what is no part of the object."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.mesh_points import prepared, scanned_floor
from jaxscan.cli.mesh_surface import simplified, surface_of_cloud, surface_of_image, vertex_colours
from jaxscan.cli.options import add_outputs_argument, add_units_argument, check_outputs, check_units, finite, numbers
from jaxscan.cli.progress import step
from jaxscan.cli.texture_options import add_texture_arguments, check_texture, texture_asked, texture_in_words
from jaxscan.errors import InputError
from jaxscan.extras import extra
from jaxscan.missing import no_such_file

if TYPE_CHECKING:
    import numpy as np
    import trimesh

    from jaxscan.files.cloud import Cloud
    from jaxscan.reconstruction import RangeImage
    from jaxscan.surface.floor import Floor
    from jaxscan.surface.texture import Texture

HELP: Final = "make a surface of a scan's points: cleaned, without the floor, as STL, OBJ, PLY or GLB"
EXAMPLE: Final = "jaxscan mesh cup.npz -o cup.stl --png cup.png"

# A part of the surface that faces away from the camera, beyond which it is folded.
_FOLDED: Final = 0.01
# Passages that are this many times as far apart as their σ lets expect are spoken of.
_DISAGREE: Final = 1.1
_ENDINGS: Final = (".stl", ".obj", ".ply", ".glb", ".npz")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "points", type=Path, metavar="POINTS", help="a range image (.npz), or a cloud (.ply, .xyz, .pcd, .e57, .laz)"
    )
    add_outputs_argument(parser, "MESH", ".stl, .obj, .ply, .glb, or what is left of the range image, .npz", False)
    add_units_argument(parser, "a cloud (.ply)")
    parser.add_argument(
        "--floor",
        default="auto",
        metavar="FLOOR",
        help="auto (default): found and removed | keep | a scan of the bare stage (.npz): heights are above its "
        "points, flat or not | three or more points of it, X,Y,Z:X,Y,Z:X,Y,Z (mm)",
    )
    parser.add_argument(
        "--plateaus",
        action="store_true",
        help="list level pieces with their heights above the floor; needs no -o",
    )
    parser.add_argument("--plateau-area", type=finite, metavar="MM2", help="of the smallest plateau (default: 20 mm²)")
    parser.add_argument("--raw", action="store_true", help="keep mixed, grazing and isolated points")
    parser.add_argument("--crop", type=numbers(6), metavar="X,Y,Z,X,Y,Z", help="only the points within this box (mm)")
    parser.add_argument(
        "--every", type=numbers(2, int), metavar="F,C", help="only every F-th frame and every C-th column"
    )
    parser.add_argument("--grid", type=finite, metavar="MM", help="resample from above on a regular grid")
    parser.add_argument("--fill", type=finite, metavar="MM", help="fill holes of up to this size")
    parser.add_argument(
        "--method",
        choices=("grid", "fused", "delaunay", "poisson"),
        help="grid: neighbours in frame and column (default for .npz) | fused: what a turn has shown several times as "
        "one surface, each point by its sigma (default for it) | delaunay: seen along the light (default for .ply) | "
        "poisson: closed over what was not seen, and open beyond the rim of the scan, by the extra poisson",
    )
    parser.add_argument(
        "--rig",
        type=Path,
        help="whose light delaunay looks along (default: at right angles to the floor), and whose camera took "
        "--photographs",
    )
    add_texture_arguments(parser)
    parser.add_argument("--quads", action="store_true", help="write .ply with quadrilaterals where the grid has them")
    parser.add_argument("--simplify", type=int, metavar="N", help="reduce the mesh to N triangles (extra simplify)")
    parser.add_argument("--png", type=Path, metavar="OUT", help="draw the mesh")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read, clean, take the floor away, join and write."""
    _check(args)
    check_outputs(args.output, args.png, [args.points])
    from jaxscan.errors import error_context

    result: dict[str, Any] = {"kind": "mesh", "path": [str(path) for path in args.output]}
    meshed = bool(args.output or args.png)
    # The floor's own file is named by what is wrong with it, and not the scan's.
    bed = scanned_floor(args.floor)
    step(f"reading {args.points}")
    with error_context(args.points):
        if args.points.suffix.lower() == ".npz":
            from jaxscan.reconstruction import read_range_image

            scanned = read_range_image(args.points)
            image, floor = prepared(scanned, args, result, bed)
            if not meshed:
                return result
            step("joining the points")
            result["points_left"] = int(image.valid.sum())
            painted = scanned.cloud()
            mesh, cloud, quads = surface_of_image(image, args, result)
        else:
            from jaxscan.files.exchange import read_cloud
            from jaxscan.files.units import cloud_in_millimetres

            scanned, image, floor, quads = None, None, None, None
            cloud = cloud_in_millimetres(str(args.points), read_cloud(args.points), args.units)
            step("joining the points")
            mesh, painted = surface_of_cloud(cloud, args), cloud
            if args.floor != "keep":
                result["note"] = "a floor and stray points are kept: they are searched only in a range image (.npz)"
        if args.simplify is not None:
            step(f"reducing {len(mesh.faces)} triangles")
            mesh = simplified(mesh, args.simplify)
            cloud, quads = None, None
    step("colouring")
    own = None if cloud is None else cloud.colours
    texture = texture_asked(args, mesh, own, painted, scanned, result)
    colours = vertex_colours(mesh, own, painted)
    result["coloured"] = None if colours is None else int(colours.any(axis=1).sum())
    for path in args.output:
        step(f"writing {path}")
        _write(path, mesh, cloud, quads if args.quads else None, image, colours, texture, floor)
    if args.png:
        import numpy as np

        from jaxscan.geometry.robust_plane import dominant_plane
        from jaxscan.view.surface_plots import draw_mesh

        step(f"drawing {args.png}")
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        up = floor.up if floor else dominant_plane(vertices).matrix()[:, 2]
        height = floor.height(vertices) if floor and "scan" in result["floor"] else None
        draw_mesh(args.png, vertices, faces, up, f"{len(faces)} triangles", height, colours)
        result["picture"] = str(args.png)
    return result | {
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.faces),
        "area_mm2": float(mesh.area),
        "closed": bool(mesh.is_watertight),
        "volume_mm3": float(mesh.volume) if mesh.is_watertight else None,
    }


def _check(args: argparse.Namespace) -> None:
    """Refuse options that do not go together, before any work."""
    if not (args.output or args.plateaus):
        raise InputError("give -o MESH for what is to be written, or --plateaus")
    if args.plateau_area is not None and not (args.plateaus and args.plateau_area > 0):
        raise InputError(f"--plateau-area {args.plateau_area:g}: give an area that is more than 0, and --plateaus")
    if args.plateaus and args.floor == "keep":
        raise InputError("--plateaus: heights are above the floor: leave --floor keep out")
    ending = args.points.suffix.lower()
    from jaxscan.files.exchange import CLOUDS

    if ending != ".npz" and ending not in CLOUDS:
        if args.points.is_dir() or not (ending or args.points.exists()):
            raise no_such_file(args.points)
        raise InputError(f"{args.points}: give a range image (.npz) or a cloud ({', '.join(CLOUDS)})")
    check_units(args.points, args.units)
    for path in args.output:
        if path.suffix.lower() not in _ENDINGS:
            raise InputError(f"{path}: the ending is not known: write {', '.join(_ENDINGS)}")
    if ending != ".npz":
        given = [name for name in ("crop", "every", "grid", "fill", "raw", "quads", "plateaus") if getattr(args, name)]
        given += ["floor"] if args.floor not in ("auto", "keep") else []
        given += ["-o .npz"] if any(path.suffix.lower() == ".npz" for path in args.output) else []
        if given:
            raise InputError(
                f"{args.points}: --{given[0].removeprefix('--')} needs the order of a range image: give the .npz"
            )
        if args.method in ("grid", "fused"):
            raise InputError(f"{args.points}: a cloud has no grid: give the .npz, or --method delaunay")
    if args.every and min(args.every) < 1:
        raise InputError(f"--every {args.every[0]},{args.every[1]}: give whole numbers from 1")
    if args.simplify is not None and args.simplify < 4:
        raise InputError(f"--simplify {args.simplify}: give 4 triangles or more")
    if args.quads and args.method not in (None, "grid"):
        raise InputError("--quads: only the grid has quadrilaterals: leave --method out")
    check_texture(args)
    # Without --method a cloud is joined by delaunay.
    delaunay = args.method == "delaunay" or (args.method is None and ending != ".npz")
    if args.rig and not delaunay and args.photographs is None:
        raise InputError(
            "--rig: only --method delaunay looks along the light of a rig, and only --photographs needs its camera: "
            "add one of them, or leave --rig out"
        )
    if args.quads and not any(path.suffix.lower() == ".ply" for path in args.output):
        raise InputError("--quads: only .ply has quadrilaterals: write -o NAME.ply, or leave --quads out")
    needed = {"plots": args.png, "poisson": args.method == "poisson", "simplify": args.simplify is not None}
    for name in [name for name, asked in needed.items() if asked]:
        extra(name)


def _write(
    path: Path,
    mesh: "trimesh.Trimesh",
    cloud: "Cloud | None",
    quads: Any,
    image: "RangeImage | None",
    colours: "np.ndarray | None",
    texture: "Texture | None",
    floor: "Floor | None",
) -> None:
    import numpy as np

    from jaxscan.files.cloud import Cloud
    from jaxscan.files.mesh import write_mesh_ply, write_trimesh

    ending, note = path.suffix.lower(), floor.note() if floor else None
    if ending == ".npz" and image is not None:
        from jaxscan.reconstruction import write_points

        write_points(path, image)
    elif ending == ".ply":
        triangles, four = quads if quads is not None else (np.asarray(mesh.faces), None)
        vertices = replace(cloud or Cloud(np.asarray(mesh.vertices, np.float32)), colours=colours)
        write_mesh_ply(path, vertices, triangles, four, np.asarray(mesh.vertex_normals, np.float32), note)
    elif ending == ".glb" and texture is not None:
        from jaxscan.files.glb import write_textured_glb

        place, atlas = texture.atlas.place, texture.atlas
        P, normals = (np.asarray(of)[place] for of in (mesh.vertices, mesh.vertex_normals))
        write_textured_glb(path, P, atlas.triangles, normals, atlas.pixels, texture.picture)
    else:
        write_trimesh(path, mesh, colours, note)


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    from jaxscan.reconstruction.range_image import WIDE_APART_DEG

    lines = _plateaus_in_words(result) if "plateaus" in result else []
    if "triangles" not in result:
        return "\n".join(lines)
    closed = f"closed, {result['volume_mm3']:.6g} mm³" if result["closed"] else "open"
    images = [path for path in result["path"] if path.lower().endswith(".npz")]
    surfaces = [path for path in result["path"] if path not in images]
    if images:
        lines.append(f"{result['points_left']} of {result['points_read']} points: {', '.join(images)}")
    lines += [
        f"{result['triangles']} triangles between {result['vertices']} points"
        + (f": {', '.join(surfaces)}" if surfaces else ", which no file has"),
        f"  surface    {result['area_mm2']:.6g} mm², {closed}",
    ]
    kept = [ending for ending in (".ply", ".obj") if any(path.lower().endswith(ending) for path in result["path"])]
    if result.get("coloured") and kept:
        lines.append(f"  colours    of {result['coloured']} of its points, in {' and '.join(kept)}")
    if "note" in result:
        lines.append(f"  note       {result['note']}")
    if "texture" in result:
        lines.append(texture_in_words(result["texture"]))
    if "removed" in result:
        words = ", ".join(f"{count} {rule}" for rule, count in result["removed"].items())
        lines.append(f"  removed    {words}, of {result['points_read']} points")
    if "floor" in result:
        floor = result["floor"]
        flat = floor["flatness_mm"]
        lines.append(
            f"  floor      {floor['points']} points within {floor['tolerance_mm']:.3f} mm or loose above it; "
            f"σ {floor['sigma_mm']:.3f} mm{'' if flat is None else f', flat within {flat:.3f} mm'}"
        )
        if floor.get("points_beside_the_scan"):
            lines.append(
                f"             {floor['points_beside_the_scan']} points lie beside the scan of the stage: "
                "they were compared with the plane through it"
            )
    if (result.get("degrees_apart") or 0.0) > WIDE_APART_DEG:
        lines.append(
            f"  coarse     the frames are {result['degrees_apart']:.1f} degrees of a turn apart, and the surface "
            f"between them is a guess: scan in steps of {WIDE_APART_DEG:g} degrees or less"
        )
    if "seen_times" in result:
        lines.append(
            f"  fused      of {result['passages']} passages through the light, {result['seen_times']:.1f} on each "
            f"vertex{_disagreeing(result['passages_disagree'])}"
        )
    elif result.get("passages", 1) > 1:
        lines.append(f"  layers     {result['passages']}: the scan has shown the object as often")
    if result.get("turned_the_other_way"):
        apart = result["passages_apart_mm"]
        lines.append(
            f"  backwards  the two passages of the turn are {apart['as_said']:.2f} mm apart, and would be "
            f"{apart['other_way']:.2f} mm apart if the table had turned the other way: check the order of the "
            "photographs and the sign of their motor steps in scan.toml"
        )
    if result.get("facing_away", 0.0) > _FOLDED:
        lines.append(
            f"  folded     {100 * result['facing_away']:.0f} % of the surface face away from the camera, as when the "
            "object moves the other way than the motion of the rig says"
        )
    if "picture" in result:
        lines.append(f"  picture    {result['picture']}")
    return "\n".join(lines)


def _disagreeing(by: float | None) -> str:
    """What is said of passages that are further apart than their σ."""
    if by is None or by < _DISAGREE:
        return ""
    return f"; they are {by:.1f} times as far apart as their σ says, and σ is as much wider"


def _plateaus_in_words(result: dict[str, Any]) -> list[str]:
    found = result["plateaus"]
    if not found:
        return ["no plateaus: nothing that stands on the floor is level and large enough"]
    lines = [f"{len(found)} plateau{'s' if len(found) > 1 else ''}, heights above the floor with 95 % intervals"]
    lines += [
        f"  {one['height_mm']:10.4f} ± {one['interval_mm']:.4f} mm (σ {one['sigma_mm']:.4f}), spread "
        f"{one['spread_mm']:.4f} mm, {one['points']} points, {one['area_mm2']:.0f} mm², "
        f"tilted by {one['tilt_deg']:.2f}°, at {', '.join(f'{c:.1f}' for c in one['centre'])}"
        for one in found
    ]
    return lines
