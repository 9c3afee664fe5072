"""A shaded surface as a picture, by OpenCV: triangles drawn from the farthest to the nearest."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxscan.images.overlay import Picture
from jaxscan.images.sampled import sampled

# The picture is drawn this many times as large and then reduced, which smooths its edges.
_FINER = 3
# OpenCV draws at fractions of a pixel: number of bits of the fraction.
_BITS = 4
# Number of pixels that are coloured at a time.
_AT_ONCE = 1 << 18
# Light that reaches what is turned away from the lamp, what the lamp adds, and all that reaches the back of a surface.
_AMBIENT, _LAMP, _BEHIND = 0.35, 0.75, 0.2


@dataclass(frozen=True)
class TextureMap:
    """A picture that covers a surface.

    Attributes:
        pixels: of each vertex (u, v) on the picture; (0, 0) is the centre of its top left pixel.
        picture: RGB, 0 to 255.
    """

    pixels: Float[np.ndarray, "vertices 2"]
    picture: UInt8[np.ndarray, "rows columns 3"]


def draw_surface(
    corners: Float[np.ndarray, "vertices 2"],
    depth: Float[np.ndarray, "vertices"],
    normals: Float[np.ndarray, "vertices 3"],
    triangles: Int[np.ndarray, "triangles 3"],
    colours: Float[np.ndarray, "vertices 3"] | TextureMap,
    light: Float[np.ndarray, "3"],
    size: tuple[int, int],
    background: int = 128,
) -> Picture:
    """Draw a surface with Lambert's shading (J. H. Lambert 1760); colours and normals run on between the vertices.

    Args:
        corners: where each vertex is in the picture (u, v), px.
        depth: how far each vertex is from the viewer; any unit.
        normals: unit normals, on the side from which the triangles run anticlockwise.
        triangles: three vertices each; what is seen from the other side is dark.
        colours: red, green and blue of each vertex, 0 to 255; or a texture.
        light: unit vector towards the lamp.
        size: columns and rows of the picture.
        background: grey level of what is empty.

    Returns:
        The picture, RGB.
    """
    fine = _FINER * (corners + 0.5) - 0.5
    places = np.rint(fine * (1 << _BITS)).astype(np.int32)[triangles]
    # First which triangle is seen in each pixel, then its colour there.
    seen = np.full((_FINER * size[1], _FINER * size[0]), -1, np.int32)
    for i in np.argsort(-depth[triangles].mean(axis=1)):
        cv2.fillConvexPoly(seen, places[i], int(i), cv2.LINE_8, _BITS)
    picture = np.full((*seen.shape, 3), background, np.uint8)
    rows, columns = np.nonzero(seen >= 0)
    for some in range(0, len(rows), _AT_ONCE):
        v, u = rows[some : some + _AT_ONCE], columns[some : some + _AT_ONCE]
        own = triangles[seen[v, u]]
        weights, area = _weights(np.stack([u, v], axis=1), fine[own])
        n = np.einsum("pk,pkc->pc", weights, normals[own])
        lit = n @ light / np.maximum(np.linalg.norm(n, axis=1), 1e-300)
        # Rows run down: anticlockwise is a negative area.
        brightness = np.where(area <= 0, _AMBIENT + _LAMP * np.clip(lit, 0.0, 1.0), _BEHIND)
        if isinstance(colours, TextureMap):
            paint = sampled(colours.picture, np.einsum("pk,pkc->pc", weights, colours.pixels[own]))
        else:
            paint = np.einsum("pk,pkc->pc", weights, colours[own])
        picture[v, u] = np.clip(paint * brightness[:, None], 0, 255)
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def _weights(
    places: Int[np.ndarray, "pixels 2"], corners: Float[np.ndarray, "pixels 3 2"]
) -> tuple[Float[np.ndarray, "pixels 3"], Float[np.ndarray, "pixels"]]:
    """The barycentric coordinates of each pixel in its triangle, not beyond its border, and twice the signed area."""
    a, b, c = (corners[:, k] - places for k in range(3))
    parts = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    area = parts.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.clip(parts / area[:, None], 0.0, 1.0)
    # A triangle that is seen edge on has one colour.
    weights = np.where((area != 0)[:, None] & (weights.sum(axis=1, keepdims=True) > 0), weights, 1.0)
    return weights / weights.sum(axis=1, keepdims=True), area


def _cross(a: Float[np.ndarray, "pixels 2"], b: Float[np.ndarray, "pixels 2"]) -> Float[np.ndarray, "pixels"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


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
