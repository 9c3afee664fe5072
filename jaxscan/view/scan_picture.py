"""A scan beside the photograph that it came from: one picture, without any extra."""

import os
from typing import TYPE_CHECKING, Final

import numpy as np
from jaxtyping import Float

from jaxscan.images import draw_stripe, write_image
from jaxscan.images.decode import Image
from jaxscan.images.shaded import beside, cut_out, draw_surface
from jaxscan.reconstruction import RangeImage
from jaxscan.view.mesh_picture import vertex_normals

if TYPE_CHECKING:
    import trimesh

_SIZE: Final = (640, 560)
_MARGIN: Final = 0.12
# From where the surface is looked at: this far above the floor, and this far round from the camera's own side.
_ELEVATION, _AZIMUTH = np.radians(60.0), np.radians(-4.0)
# Clay, for what no photograph gives a colour.
_CLAY: Final = (205.0, 190.0, 170.0)


def draw_scan(
    path: str | os.PathLike[str],
    photograph: Image,
    stripe: Float[np.ndarray, "columns"],
    image: RangeImage,
    surface: "trimesh.Trimesh",
    up: Float[np.ndarray, "3"],
    colours: Float[np.ndarray, "vertices 3"],
) -> None:
    """Draw a photograph of the scan, with its stripe, and beside it the surface of the scan, shaded.

    Args:
        path: the PNG to write.
        photograph: one frame.
        stripe: the row in which its stripe was found in each column, NaN for none, px.
        image: the points of the object alone.
        surface: its triangles, object frame, mm.
        up: unit vector, object frame: what is up in the picture of the surface.
        colours: red, green and blue of each vertex, 0 to 255; NaN where not known, which becomes clay.

    Raises:
        InputError: the file cannot be written.
    """
    vertices = np.asarray(surface.vertices, np.float64)
    paint = np.where(np.isfinite(colours), colours, _CLAY)
    right = np.array([1.0, 0.0, 0.0])
    right = np.cos(_AZIMUTH) * _across(right, up) + np.sin(_AZIMUTH) * np.cross(up, _across(right, up))
    toward = np.sin(_ELEVATION) * up + np.cos(_ELEVATION) * np.cross(right, up)
    above = np.cross(toward, right)
    flat = np.stack([vertices @ right, -vertices @ above], axis=-1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = (1 - 2 * _MARGIN) * min(np.array(_SIZE) / (high - low))
    corners = scale * (flat - (low + high) / 2) + np.array(_SIZE) / 2
    light = toward + 0.7 * above - 0.6 * right
    triangles = np.asarray(surface.faces)
    normals = vertex_normals(vertices, triangles)
    if (normals @ toward).mean() < 0:
        normals, triangles = -normals, triangles[:, ::-1]
    shaded = draw_surface(corners, -vertices @ toward, normals, triangles, paint, light / np.linalg.norm(light), _SIZE)
    shown = draw_stripe(photograph, np.full_like(stripe, np.nan), True)
    found = image.pixels[image.valid]
    across = np.flatnonzero(image.valid.any(axis=0))
    box = np.array([[across[0], found.min()], [across[-1], found.max()]], float)
    grown = _MARGIN / (1 - 2 * _MARGIN) * (box[1] - box[0])
    write_image(path, beside(cut_out(shown, box[0] - grown, box[1] + grown, _SIZE), shaded))


def _across(vector: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The unit vector at right angles to `up` that is nearest to a vector."""
    level = vector - (vector @ up) * up
    return level / np.linalg.norm(level)
