"""A mesh from one side, shaded, as a panel of a matplotlib figure with axes in millimetres."""

from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int

from jaxscan.images.shaded import TextureMap, draw_surface

# From where things are looked at: so far above the floor, and so far to the side of the camera's up.
_ELEVATION: Final = float(np.radians(35.0))
AZIMUTH: Final = float(np.radians(25.0))
# Of a panel's picture, px, and the margin about what is drawn, in parts of its size.
_LARGEST_PX: Final = 720
_MARGIN: Final = 0.03
# Percentile of the levels that are white where photographs are brightened.
_WHITE: Final = 99.0


def look(up: Float[np.ndarray, "3"], turn: float) -> tuple[Float[np.ndarray, "3"], ...]:
    """The directions to the right, up and toward the viewer, at an elevation and turned about `up`, radians."""
    start = np.array([0.0, 1.0, 0.0]) if abs(up[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    start = start - (start @ up) * up
    start /= np.linalg.norm(start)
    level = np.cos(turn) * start + np.sin(turn) * np.cross(up, start)
    toward = np.cos(_ELEVATION) * level + np.sin(_ELEVATION) * up
    across = np.cross(up, toward)
    across /= np.linalg.norm(across)
    return across, np.cross(toward, across), toward


def shaded_panel(
    ax: Any,
    vertices: Float[np.ndarray, "vertices 3"],
    triangles: Int[np.ndarray, "triangles 3"],
    colours: Float[np.ndarray, "vertices 3"] | TextureMap,
    directions: tuple[Float[np.ndarray, "3"], ...],
) -> None:
    """Draw a mesh, its nearer triangles over the farther ones, into a panel.

    Args:
        ax: matplotlib's axes.
        vertices: relative to the middle of what is shown, mm.
        triangles: three vertices each, anticlockwise from outside; the inside is drawn dark.
        colours: red, green and blue of each vertex, 0 to 255; or a texture.
        directions: as `look` returns them.
    """
    across, above, toward = directions
    flat = np.stack([vertices @ across, -vertices @ above], axis=1)
    used = np.zeros(len(vertices), bool)
    used[triangles] = True
    low, high = flat[used].min(axis=0), flat[used].max(axis=0)
    margin = _MARGIN * max(float((high - low).max()), 1e-9)
    low, high = low - margin, high + margin
    pitch = float((high - low).max()) / _LARGEST_PX
    columns, rows = (max(1, int(np.ceil(side / pitch))) for side in high - low)
    light = toward + 0.6 * above - 0.5 * across
    picture = draw_surface(
        (flat - low) / pitch - 0.5,
        -vertices @ toward,
        vertex_normals(vertices, triangles),
        triangles,
        colours,
        light / np.linalg.norm(light),
        (columns, rows),
        background=255,
    )
    right, below = low[0] + pitch * columns, low[1] + pitch * rows
    ax.imshow(picture, extent=(low[0], right, -below, -low[1]), interpolation="nearest")
    ax.set(aspect="equal", xlabel="mm", ylabel="mm")


def brightened(
    colours: Float[np.ndarray, "vertices 3"] | TextureMap,
) -> Float[np.ndarray, "vertices 3"] | TextureMap:
    """Colours of photographs, as bright as a picture shows them well: a hundredth is white, nothing is darker."""
    levels = colours.picture if isinstance(colours, TextureMap) else colours
    gain = max(1.0, 255.0 / max(float(np.percentile(levels, _WHITE)), 1.0))
    if not isinstance(colours, TextureMap):
        return np.minimum(gain * colours, 255.0)
    return TextureMap(colours.pixels, np.rint(np.minimum(gain * colours.picture, 255.0)).astype(np.uint8))


def vertex_normals(
    vertices: Float[np.ndarray, "vertices 3"], triangles: Int[np.ndarray, "triangles 3"]
) -> Float[np.ndarray, "vertices 3"]:
    """Unit normals at the vertices: the mean of those of their triangles, weighted by area; 0 where there are none."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    own = np.cross(b - a, c - a)
    total = np.stack([np.bincount(triangles.ravel(), np.repeat(own[:, k], 3), len(vertices)) for k in range(3)], axis=1)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)
