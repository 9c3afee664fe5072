"""The profile of a surface: how far it is from a mesh, patch by patch (ISO 1101), twice the largest distance."""

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import InputError
from jaxscan.files.mesh import read_mesh
from jaxscan.files.part_file import Dimension
from jaxscan.measurement.alike import how_alike
from jaxscan.measurement.fit import few
from jaxscan.measurement.form import LEAST_OF_SURFACE, Form, deviation, patches
from jaxscan.measurement.scanned import Scanned
from jaxscan.surface.fit import rigid_fit_to
from jaxscan.surface.reference import MeshReference

_Moved = tuple[Int[np.ndarray, "some"], Float[np.ndarray, "some leaves"]]
_OF_RIG = 2000
# How much larger a mesh may be than the surface that is moved onto it, and a surface, its errors and all, than a mesh.
# Where units differ sizes do by ten or more.
_OTHER_SCALE, _LARGER = 5.0, 1.5


def profile_of(scanned: Scanned, dimension: Dimension) -> tuple[Form, float, tuple[str, ...]]:
    """The deviation of a surface from the mesh, the largest distance of a point (mm), and sentences about it.

    Raises:
        InputError: the mesh is refused, is of another scale, or lies elsewhere.
    """
    assert dimension.reference is not None
    mesh = read_mesh(dimension.reference)
    reference, points = MeshReference(mesh), scanned.points
    notes = () if mesh.is_watertight else ("the mesh has holes: where one is, the distance is that to its rim",)
    size, own = (float(np.linalg.norm(np.ptp(x, axis=0))) for x in (np.asarray(mesh.vertices), points))
    if own > _LARGER * size or (dimension.fit and size > _OTHER_SCALE * own):
        raise InputError(
            f"the mesh is {size:.4g} mm across and the surface {own:.4g} mm: scale the mesh to mm, or choose the region"
        )
    if dimension.fit:
        points = rigid_fit_to(reference, points).apply(points)
    foot, normal = reference.nearest(points)
    off = ((points - foot) * normal).sum(axis=1)
    if np.median(np.abs(off)) > 0.1 * size:
        raise InputError(
            f"the surface lies {np.median(np.abs(off)):.4g} mm from the mesh: bring them into one frame, or set "
            "fit = true"
        )
    patch = patches(points, False)
    noise = np.zeros(len(points))
    moved: _Moved | None = None
    if scanned.by_rig is not None and scanned.stripe is not None and scanned.sigma is not None and not dimension.fit:
        across = np.maximum(np.abs((normal * scanned.stripe).sum(axis=1)), 0.3 * scanned.sigma)
        count = np.maximum(np.bincount(patch, minlength=patch.max() + 1), 1)
        rest = off - (np.bincount(patch, off, minlength=len(count)) / count)[patch]
        scale = float(np.sqrt(((rest / across) ** 2).mean()))
        tau = how_alike([(scanned.place, rest / across, len(count))]).tau() if scanned.place is not None else 1.0
        noise = scale * np.sqrt(tau) * across
        some = few(len(points), _OF_RIG)
        moved = some, np.einsum("pi,pil->pl", normal[some], scanned.by_rig(some))
    elif dimension.fit and scanned.by_rig is not None:
        notes = (*notes, "fitted to the mesh: without an interval; for one give the mesh in the scan's frame")
    form = deviation(scanned, off, patch, noise, moved, _zone, LEAST_OF_SURFACE)
    return form, float(2 * np.abs(off).max()), notes


def _zone(means: Float[np.ndarray, "*drawings patches"], axis: int) -> Float[np.ndarray, "*drawings"]:
    return 2 * np.abs(means).max(axis=axis)
