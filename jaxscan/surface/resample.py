"""A range image on a regular grid of millimetres, seen straight from above: the highest surface at each node."""

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE
from jaxscan.geometry import Pose
from jaxscan.reconstruction import RangeImage
from jaxscan.surface.triangles import grid_surface

_LARGEST = 1 << 26
_TRIANGLES_AT_ONCE = 1 << 18


def resample(image: RangeImage, spacing_mm: float, frame: Pose) -> RangeImage:
    """The surface of a range image at the nodes of a grid, by linear interpolation within its triangles.

    The result is a range image too: its frames are the rows of the grid, its steps count them, its columns run along x.
    Points are in the object frame still; strength and σ are interpolated. What no triangle covers is not there.

    Args:
        image: the range image.
        spacing_mm: from node to node.
        frame: T_object_grid, as of a floor: z, up, is the direction it is seen from.

    Raises:
        InputError: the spacing is not positive, or makes more nodes than there is memory for.
    """
    if not spacing_mm > 0:
        raise InputError(f"a grid of {spacing_mm:g} mm: give a spacing that is more than 0")
    surface = grid_surface(image)
    local = frame.inverse().apply(surface.vertices.astype(np.float64))
    low = np.floor(local[:, :2].min(axis=0) / spacing_mm)
    nodes_along = np.floor(local[:, :2].max(axis=0) / spacing_mm) - low + 1
    if nodes_along.prod() > _LARGEST:
        raise InputError(
            f"a grid of {spacing_mm:g} mm has {nodes_along[1]:.0f} x {nodes_along[0]:.0f} nodes here: give a wider "
            "spacing"
        )
    columns, rows = nodes_along.astype(int)
    nodes = local[:, :2] / spacing_mm - low
    height = np.full(rows * columns, -np.inf)
    owner = np.full(rows * columns, -1)
    weights = np.zeros((rows * columns, 3))
    for start in range(0, len(surface.triangles), _TRIANGLES_AT_ONCE):
        some = surface.triangles[start : start + _TRIANGLES_AT_ONCE]
        node, triangle, weight = _covered(nodes[some], int(columns))
        z = (weight * local[some[triangle], 2]).sum(axis=1)
        # The highest at each node, written last.
        order = np.argsort(z, kind="stable")
        order = order[z[order] > height[node[order]]]
        height[node[order]], owner[node[order]], weights[node[order]] = z[order], start + triangle[order], weight[order]
    there = owner >= 0
    corners = surface.place[surface.triangles[owner]]
    row, column = np.divmod(np.arange(rows * columns), columns)
    at = np.stack([(column + low[0]) * spacing_mm, (row + low[1]) * spacing_mm, np.where(there, height, 0.0)], axis=1)

    def interpolated(values: Float[np.ndarray, "frames columns"]) -> Float[np.ndarray, "rows columns"]:
        mean = (values.ravel()[corners] * weights).sum(axis=1)
        return np.where(there, mean, np.nan).astype(np.float32).reshape(rows, columns)

    points = np.where(there[:, None], frame.apply(at), np.nan)
    return RangeImage(
        points=points.astype(np.float32).reshape(rows, columns, 3),
        pixels=np.full((rows, columns), np.nan, np.float32),
        strength=interpolated(image.strength),
        sigma=interpolated(image.sigma),
        sigma_pixel=interpolated(image.sigma_pixel),
        valid=there.reshape(rows, columns),
        positions={STAGE: np.arange(rows)},
    )


def _covered(
    corners: Float[np.ndarray, "triangles 3 2"], columns: int
) -> tuple[Int[np.ndarray, "nodes"], Int[np.ndarray, "nodes"], Float[np.ndarray, "nodes 3"]]:
    """Every node within each triangle: its number, the triangle, and the weights of the three corners there.

    Nodes are whole numbers; those of a triangle's bounding box are tried.
    """
    first = np.ceil(corners.min(axis=1)).astype(int)
    size = np.maximum(np.floor(corners.max(axis=1)).astype(int) - first + 1, 0)
    count = size.prod(axis=1)
    triangle = np.repeat(np.arange(len(corners)), count)
    number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    dy, dx = np.divmod(number, np.maximum(size[triangle, 0], 1))
    p = first[triangle] + np.stack([dx, dy], axis=1)
    a, b, c = corners[triangle].swapaxes(0, 1)
    whole = _cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)], axis=1) / whole[:, None]
    inside = (weight >= -1e-9).all(axis=1)
    return p[inside, 1] * columns + p[inside, 0], triangle[inside], weight[inside]


def _cross(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
