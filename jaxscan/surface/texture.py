"""The picture that a mesh is covered with: its colours between the vertices too.

Each texel of the atlas (`jaxscan.surface.atlas`) has a place on the surface. Its colour is that which the scan's
photographs show there: those taken nearest to the step at which the scan saw the place, as the colours of points are
found (`jaxscan.reconstruction.scan_colours`), occlusion checked. Where no photograph shows it, and where there are none
at hand, it is interpolated: between the triangle's own corners where these are coloured points of the scan, else from
the coloured points around it.

Numbers are those of the photographs, sRGB as cameras write them.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import trimesh
from jaxtyping import Float, UInt8
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree

from jaxscan.files.cloud import Cloud, shown_colours
from jaxscan.files.scan import Scan
from jaxscan.reconstruction import RangeImage
from jaxscan.reconstruction.scan_colours import colours_at
from jaxscan.rig import Rig
from jaxscan.surface.atlas import GUTTER, Atlas, Texels, make_atlas, texels_of
from jaxscan.surface.painted import colours_near
from jaxscan.surface.passages import passages

# Points that the spacing is taken of.
_SAMPLE: Final = 20_000
# A texel is where a passage has seen the surface if a point of it is no further off than this, in times of the spacing.
_NEAR: Final = 4.0


@dataclass(frozen=True)
class Photographs:
    """Where texels are looked for in photographs.

    Attributes:
        rig: as the scan was reconstructed with.
        scan: its photographs.
        image: all its points, as they were reconstructed.
    """

    rig: Rig
    scan: Scan
    image: RangeImage


@dataclass(frozen=True)
class Texture:
    """A mesh's picture.

    Attributes:
        atlas: where each triangle is on it.
        picture: RGB, 8 bits, sRGB; grey where no colour is known.
        texels: how many show the surface.
        photographed: how many of these have their colour from photographs.
        interpolated: how many have it from points.
    """

    atlas: Atlas
    picture: UInt8[np.ndarray, "rows columns 3"]
    texels: int
    photographed: int
    interpolated: int


def make_texture(
    mesh: trimesh.Trimesh,
    points: Cloud,
    own: UInt8[np.ndarray, "vertices 3"] | None,
    photographs: Photographs | None,
    most_px: int,
) -> Texture | None:
    """The texture of a scan's surface. A texel is as large as points of the scan are apart.

    Args:
        mesh: object frame, mm.
        points: of the scan, with their colours where they are known.
        own: colours of the mesh's vertices where these are points of the scan; 0, 0, 0 for one without.
        photographs: None for colours from points alone.
        most_px: no side of the picture is longer; larger texels make it so.

    Returns:
        The texture; None for a surface so rough that it has none.

    Raises:
        InputError: a photograph cannot be read, or the scan is not that of the points.
    """
    atlas = make_atlas(mesh, spacing(KDTree(points.points.astype(np.float64))), most_px)
    if atlas is None:
        return None
    texels = texels_of(atlas)
    triangles = np.asarray(mesh.faces)[texels.triangle]
    places = (np.asarray(mesh.vertices)[triangles] * texels.weights[..., None]).sum(axis=1)
    colours = np.zeros((len(places), 3), np.uint8)
    if photographs is not None:
        colours = _photographed(mesh, texels, places, photographs)
    left = ~colours.any(axis=1)
    photographed = int((~left).sum())
    if own is not None:
        colours[left] = _between(own[triangles[left]], texels.weights[left])
    elif points.colours is not None:
        colours[left] = colours_near(places[left].astype(np.float32), points)
    known = int(colours.any(axis=1).sum())
    return Texture(atlas, _picture(atlas, texels, colours), len(places), photographed, known - photographed)


def spacing(tree: KDTree) -> float:
    """How far a point of a tree is from the one nearest to it, in the median, mm."""
    sample = np.asarray(tree.data)[:: max(1, tree.n // _SAMPLE)]
    apart = np.asarray(tree.query(sample, k=2)[0])[:, 1]
    apart = apart[(apart > 0) & np.isfinite(apart)]
    return float(np.median(apart)) if len(apart) else 1.0


def _photographed(
    mesh: trimesh.Trimesh, texels: Texels, places: Float[np.ndarray, "texels 3"], photographs: Photographs
) -> UInt8[np.ndarray, "texels 3"]:
    """What the photographs show of the texels that face the camera, about the step of the point nearest to each.

    A turn has seen a place twice, with another light and shade each time. A texel takes the mean of both, as its
    neighbours do: the nearest point alone would be now of the one passage, now of the other.
    """
    image = photographs.image
    normals, cameras = np.asarray(mesh.face_normals)[texels.triangle], image.cameras()
    texel, frame = [], []
    for passage in passages(image):
        steps, _ = np.nonzero(passage)
        seen = KDTree(image.points[passage].astype(np.float64))
        distance, nearest = (np.asarray(each) for each in seen.query(places))
        step = steps[nearest]
        facing = ((cameras[step] - places) * normals).sum(axis=1) > 0
        some = np.flatnonzero(facing & (distance <= _NEAR * spacing(seen)))
        texel.append(some)
        frame.append(step[some])
    texel, frame = np.concatenate(texel), np.concatenate(frame)
    order = np.argsort(frame, kind="stable")
    ends = np.cumsum(np.bincount(frame, minlength=len(image.valid)))[:-1]
    texel = texel[order]
    found = np.concatenate(colours_at(photographs.rig, photographs.scan, image, np.split(places[texel], ends))).astype(
        np.float64
    )
    shown = found.any(axis=1)
    times = np.bincount(texel[shown], minlength=len(places))
    total = np.stack([np.bincount(texel[shown], found[shown, k], len(places)) for k in range(3)], axis=1)
    return np.where(times[:, None] > 0, np.round(total / np.maximum(times, 1)[:, None]), 0).astype(np.uint8)


def _between(
    corners: UInt8[np.ndarray, "texels 3 3"], weights: Float[np.ndarray, "texels 3"]
) -> UInt8[np.ndarray, "texels 3"]:
    """Between the colours of three corners; one without a colour does not count."""
    w = weights.clip(0) * corners.any(axis=2)
    total = w.sum(axis=1, keepdims=True)
    mean = (w[..., None] * corners).sum(axis=1) / np.maximum(total, 1e-9)
    return np.where(total > 0, np.clip(np.round(mean), 1, 255), 0).astype(np.uint8)


def _picture(
    atlas: Atlas, texels: Texels, colours: UInt8[np.ndarray, "texels 3"]
) -> UInt8[np.ndarray, "rows columns 3"]:
    """The texels on their picture; around each chart its colours go on, so that no seam shows what is beside it."""
    columns, rows = atlas.size
    picture = np.zeros((rows, columns, 3), np.uint8)
    empty = np.ones((rows, columns), bool)
    picture[texels.at[:, 1], texels.at[:, 0]] = shown_colours(colours)
    empty[texels.at[:, 1], texels.at[:, 0]] = False
    found: Any = distance_transform_edt(empty, return_indices=True)
    around = empty & (found[0] <= GUTTER)
    row, column = (each[around] for each in found[1])
    picture[around] = picture[row, column]
    return shown_colours(picture.reshape(-1, 3)).reshape(picture.shape)
