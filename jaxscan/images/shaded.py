"""A shaded surface as a picture, by OpenCV: triangles drawn from the farthest to the nearest."""

import cv2
import numpy as np
from jaxtyping import Float, Int

from jaxscan.images.overlay import Picture

# The picture is drawn this many times as large and then reduced, which smooths its edges.
_FINER = 3
# OpenCV draws at fractions of a pixel: number of bits of the fraction.
_BITS = 4
# Light that reaches what is turned away from the lamp, and what the lamp adds.
_AMBIENT, _LAMP = 0.35, 0.75


def draw_surface(
    corners: Float[np.ndarray, "vertices 2"],
    depth: Float[np.ndarray, "vertices"],
    normals: Float[np.ndarray, "vertices 3"],
    triangles: Int[np.ndarray, "triangles 3"],
    colours: Float[np.ndarray, "vertices 3"],
    light: Float[np.ndarray, "3"],
    size: tuple[int, int],
    background: int = 128,
) -> Picture:
    """Draw a surface with Lambert's shading (J. H. Lambert 1760).

    Args:
        corners: where each vertex is in the picture (u, v), px.
        depth: how far each vertex is from the viewer; any unit.
        normals: unit normals, on the side that is seen.
        triangles: three vertices each.
        colours: red, green and blue of each vertex, 0 to 255.
        light: unit vector towards the lamp.
        size: columns and rows of the picture.
        background: grey level of what is empty.
    """
    brightness = _AMBIENT + _LAMP * np.clip(normals @ light, 0.0, 1.0)
    lit = np.clip(colours * brightness[:, None], 0, 255)[triangles].mean(axis=1)
    places = np.rint((_FINER * (corners + 0.5) - 0.5) * (1 << _BITS)).astype(np.int32)[triangles]
    fine = np.full((_FINER * size[1], _FINER * size[0], 3), background, np.uint8)
    for i in np.argsort(-depth[triangles].mean(axis=1)):
        cv2.fillConvexPoly(fine, places[i], lit[i].tolist(), cv2.LINE_8, _BITS)
    return cv2.resize(fine, size, interpolation=cv2.INTER_AREA)


def beside(left: Picture, right: Picture) -> Picture:
    """Two pictures of equal height side by side."""
    return np.concatenate([left, right], axis=1)


def cut_out(
    picture: Picture, low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"], size: tuple[int, int]
) -> Picture:
    """The part of a picture around a box from (u, v) to (u, v), enlarged to a size; the part keeps the size's shape."""
    middle, extent = (low + high) / 2, high - low
    scale = min(size[0] / max(extent[0], 1.0), size[1] / max(extent[1], 1.0))
    half = np.array(size) / scale / 2
    move = np.array([[scale, 0.0, -scale * (middle[0] - half[0])], [0.0, scale, -scale * (middle[1] - half[1])]])
    how = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    return cv2.warpAffine(picture, move, size, flags=how, borderMode=cv2.BORDER_REPLICATE)
