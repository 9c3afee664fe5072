"""A part's reference mesh, moved to where the part lies in this scan: its colours mark regions there."""

from dataclasses import replace
from typing import Final

import numpy as np
import trimesh
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.files.coloured_faces import ColouredFaces
from jaxscan.files.part_file import Part
from jaxscan.measurement.fit import few
from jaxscan.surface.fit import rigid_fit_to
from jaxscan.surface.reference import MeshReference

# Of this many points the median distance from the mesh is taken.
_ASKED: Final = 5_000


def placed(part: Part, points: Float[np.ndarray, "points 3"]) -> tuple[Part, tuple[str, ...]]:
    """The part with its coloured regions where they are on a surface, and a sentence that says how far they moved.

    Without `fit`, the part as it is. Only regions move: which points belong to a feature, not what they measure.

    Raises:
        InputError: the mesh does not fit the surface.
    """
    coloured = [feature.region for feature in part.features if isinstance(feature.region, ColouredFaces)]
    if not part.fit or not coloured:
        return part, ()
    mesh, within = coloured[0].mesh, coloured[0].within
    if part.where is not None:
        points = points[part.where.holds(points)]
    surface = trimesh.Trimesh(**trimesh.triangles.to_kwargs(mesh.triangles), process=False)
    surface.merge_vertices()
    reference = MeshReference(surface)
    try:
        onto_mesh = rigid_fit_to(reference, points)
    except InputError as error:
        raise InputError(f"{mesh.path}: moved onto the surface: {error}") from None
    inverse = onto_mesh.inverse()
    there = mesh.moved(inverse)
    some = points[few(len(points), _ASKED)]
    away = np.linalg.norm(there.closest(some)[0] - some, axis=1)
    if np.median(away) > within:
        raise InputError(
            f"{mesh.path}: half of the surface is {np.median(away):.3g} mm or more from the mesh, wherever that is "
            f"moved, and within = {within:g} mm: say where the part lies by box = or ball = under [part], or scale the "
            "mesh"
        )
    features = tuple(
        replace(each, region=replace(each.region, mesh=there)) if isinstance(each.region, ColouredFaces) else each
        for each in part.features
    )
    middle = mesh.triangles.reshape(-1, 3).mean(axis=0)
    moved = float(np.linalg.norm(inverse.apply(middle[None]) - middle))
    turned = float(np.degrees(np.linalg.norm(inverse.rotation)))
    sentence = f"the reference mesh was moved by {moved:.3g} mm and turned by {turned:.3g}° onto the surface"
    return replace(part, features=features), (sentence,)
