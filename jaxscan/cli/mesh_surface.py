"""The surface that `jaxscan mesh` makes of points by the method that was asked for, and its vertices' colours."""

import argparse
from typing import TYPE_CHECKING, Any

from jaxscan.errors import InputError
from jaxscan.extras import extra

if TYPE_CHECKING:
    import numpy as np
    import trimesh

    from jaxscan.files.cloud import Cloud
    from jaxscan.reconstruction import RangeImage


def surface_of_image(
    image: "RangeImage", args: argparse.Namespace, result: dict[str, Any]
) -> "tuple[trimesh.Trimesh, Cloud | None, Any]":
    """The mesh of a range image, its vertices where they are points, and its quadrilaterals where it has such.

    Args:
        image: the points.
        args: of the command.
        result: gets what a reader should know of the surface.

    Raises:
        InputError: the method does not go with the scan.
    """
    import numpy as np
    import trimesh

    from jaxscan.files.cloud import Cloud
    from jaxscan.surface.passage_fit import passage_fit
    from jaxscan.surface.passages import passages

    masks = passages(image)
    result["passages"] = times = len(masks)
    if (fit := passage_fit(image, masks)) is not None:
        result["passages_apart_mm"] = fit._asdict()
        result["turned_the_other_way"] = fit.turned_the_other_way
    if times > 1 and args.quads and args.method is None:
        raise InputError(
            f"--quads: the scan has shown the object {times} times, and one surface of all has no quadrilaterals: "
            "leave --quads out, or give --method grid for a layer of each"
        )
    if times > 1 and args.method == "delaunay":
        raise InputError(
            f"--method delaunay: the scan has shown the object {times} times, from all around: leave it out, or give "
            "--method grid or poisson"
        )
    if args.method == "fused" or (args.method is None and times > 1):
        from jaxscan.surface.fused import fused

        found = fused(image)
        result["seen_times"] = float(found.sides.mean())
        result["passages_disagree"] = found.disagreement
        return found.mesh, found.cloud(), None
    if args.method in (None, "grid"):
        from jaxscan.surface.triangles import facing_away, grid_surface

        surface = grid_surface(image)
        result["facing_away"] = facing_away(surface, image)
        known = [getattr(image, name).ravel()[surface.place] for name in ("sigma", "sigma_pixel")]
        sigma, pixel = (values if np.isfinite(values).all() else None for values in known)
        mesh = trimesh.Trimesh(surface.vertices, surface.triangles, process=False)
        painted = (getattr(image, name) for name in ("colours", "albedo"))
        colours, albedo = (None if of is None else of.reshape(-1, *of.shape[2:])[surface.place] for of in painted)
        return mesh, Cloud(surface.vertices, sigma, pixel, colours, albedo=albedo), surface.faces()
    cloud = image.cloud()
    if args.method == "poisson":
        from jaxscan.surface.links import links
        from jaxscan.surface.normals import normals
        from jaxscan.surface.scattered import poisson_surface

        return poisson_surface(cloud.points, normals(image, links(image))[image.valid]), None, None
    return surface_of_cloud(cloud, args), cloud, None


def surface_of_cloud(cloud: "Cloud", args: argparse.Namespace) -> "trimesh.Trimesh":
    """The mesh of points without an order."""
    import numpy as np
    import trimesh

    from jaxscan.surface.scattered import delaunay_surface, light_direction, poisson_surface, scattered_normals

    if args.method == "poisson":
        return poisson_surface(cloud.points, scattered_normals(cloud.points, np.zeros(3)))
    direction = None
    if args.rig:
        from jaxscan.files.rig_file import read_rig

        direction = light_direction(read_rig(args.rig).rig)
    return trimesh.Trimesh(cloud.points, delaunay_surface(cloud.points, direction), process=False)


def simplified(mesh: "trimesh.Trimesh", triangles: int) -> "trimesh.Trimesh":
    """A mesh of at most this number of triangles (Garland and Heckbert 1997, by fast-simplification).

    Raises:
        InputError: the extra is not installed.
    """
    extra("simplify")
    return mesh if triangles >= len(mesh.faces) else mesh.simplify_quadric_decimation(face_count=triangles)


def vertex_colours(mesh: "trimesh.Trimesh", own: "np.ndarray | None", painted: "Cloud") -> "np.ndarray | None":
    """Colours of the mesh's vertices: their own, or where they are no points of the scan those of points nearby."""
    import numpy as np

    from jaxscan.surface.painted import colours_near

    if own is not None:
        return own
    if painted.colours is None:
        return None
    return colours_near(np.asarray(mesh.vertices, np.float32), painted)
