"""A range image on a regular grid of millimetres, seen straight from above: the highest surface at each node."""

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE
from jaxscan.geometry import Pose
from jaxscan.reconstruction import RangeImage
from jaxscan.reconstruction.point_sigma import rig_part
from jaxscan.surface.links import sampling
from jaxscan.surface.mean_sigma import mean_sigma
from jaxscan.surface.triangles import Surface, grid_layers

_LARGEST = 1 << 26
_TRIANGLES_AT_ONCE = 1 << 18
# Layers within this number of σ of the highest are the same surface: 3 σ of the difference of two.
_SIGMAS = 3 * np.sqrt(2)


def resample(image: RangeImage, spacing_mm: float, frame: Pose) -> RangeImage:
    """The surface of a range image at the nodes of a grid, by linear interpolation within its triangles.

    The result is a range image too: its frames are the rows of the grid, its steps count them, its columns run along x.
    Points are in the object frame still; strength and σ are interpolated. What no triangle covers is not there. The
    layers of a turn that has shown the surface several times are averaged where they are level with the highest.

    Args:
        image: the range image.
        spacing_mm: from node to node.
        frame: T_object_grid, as of a floor: z, up, is the direction it is seen from.

    Raises:
        InputError: the spacing is not positive, or makes more nodes than there is memory for.
    """
    if not spacing_mm > 0:
        raise InputError(f"a grid of {spacing_mm:g} mm: give a spacing that is more than 0")
    how = sampling(image)
    surfaces = grid_layers(image, how)
    places = [frame.inverse().apply(surface.vertices.astype(np.float64)) for surface in surfaces]
    low = np.floor(np.min([local[:, :2].min(axis=0) for local in places], axis=0) / spacing_mm)
    nodes_along = np.floor(np.max([local[:, :2].max(axis=0) for local in places], axis=0) / spacing_mm) - low + 1
    if nodes_along.prod() > _LARGEST:
        raise InputError(
            f"a grid of {spacing_mm:g} mm has {nodes_along[1]:.0f} x {nodes_along[0]:.0f} nodes here: give a wider "
            "spacing"
        )
    columns, rows = (int(n) for n in nodes_along)
    values = np.stack([image.strength.ravel(), image.sigma.ravel(), image.sigma_pixel.ravel()], axis=1)
    layers = []
    for surface, local in zip(surfaces, places, strict=True):
        nodes = local[:, :2] / spacing_mm - low
        height, owner, weights = _highest(surface, nodes, local[:, 2], columns, rows)
        corners = surface.place[surface.triangles[owner]]
        layers.append(np.column_stack([height, (values[corners] * weights[..., None]).sum(axis=1)]))
    height, strength, sigma, sigma_pixel = _mean_of_layers(np.stack(layers), _SIGMAS * how.noise_mm).T
    there = np.isfinite(height)
    row, column = np.divmod(np.arange(rows * columns), columns)
    at = np.stack([(column + low[0]) * spacing_mm, (row + low[1]) * spacing_mm, np.where(there, height, 0.0)], axis=1)

    def grid(values: Float[np.ndarray, "nodes"]) -> Float[np.ndarray, "rows columns"]:
        return np.where(there, values, np.nan).astype(np.float32).reshape(rows, columns)

    points = np.where(there[:, None], frame.apply(at), np.nan)
    return RangeImage(
        points=points.astype(np.float32).reshape(rows, columns, 3),
        pixels=np.full((rows, columns), np.nan, np.float32),
        strength=grid(strength),
        sigma=grid(sigma),
        sigma_pixel=grid(sigma_pixel),
        valid=there.reshape(rows, columns),
        positions={STAGE: np.arange(rows)},
    )


def _highest(
    surface: Surface,
    nodes: Float[np.ndarray, "vertices 2"],
    height: Float[np.ndarray, "vertices"],
    columns: int,
    rows: int,
) -> tuple[Float[np.ndarray, "nodes"], Int[np.ndarray, "nodes"], Float[np.ndarray, "nodes 3"]]:
    """At each node the height of the highest triangle (NaN without one), which it is, and its corners' weights."""
    highest = np.full(rows * columns, -np.inf)
    owner = np.zeros(rows * columns, int)
    weights = np.zeros((rows * columns, 3))
    for start in range(0, len(surface.triangles), _TRIANGLES_AT_ONCE):
        some = surface.triangles[start : start + _TRIANGLES_AT_ONCE]
        node, triangle, weight = _covered(nodes[some], columns)
        z = (weight * height[some[triangle]]).sum(axis=1)
        # The highest at each node, written last.
        order = np.argsort(z, kind="stable")
        order = order[z[order] > highest[node[order]]]
        highest[node[order]], owner[node[order]], weights[node[order]] = (
            z[order],
            start + triangle[order],
            weight[order],
        )
    return np.where(np.isfinite(highest), highest, np.nan), owner, weights


def _mean_of_layers(
    layers: Float[np.ndarray, "layers nodes values"], tolerance_mm: float
) -> Float[np.ndarray, "nodes values"]:
    """Height, strength and the two σ of the highest layer at each node and of those that are level with it.

    They weigh by the pixel's σ where it is known.
    """
    if len(layers) == 1:
        return layers[0]
    height, strength, sigma, sigma_pixel = np.moveaxis(layers, -1, 0)
    level = height >= np.max(np.where(np.isfinite(height), height, -np.inf), axis=0) - tolerance_mm
    known = np.isfinite(sigma_pixel) & (sigma_pixel > 0)
    weight = np.where(known, 1 / np.where(known, sigma_pixel, 1.0) ** 2, 1.0)
    weight = np.where(level & (known | ~(known & level).any(axis=0)), weight, 0.0)
    weight /= np.maximum(weight.sum(axis=0), np.finfo(float).tiny)

    def mean(values: Float[np.ndarray, "layers nodes"]) -> Float[np.ndarray, "nodes"]:
        return np.where(weight > 0, weight * values, 0.0).sum(axis=0)

    rig = rig_part(sigma, sigma_pixel)
    result = np.stack([mean(height), mean(strength), *mean_sigma(weight.T, sigma_pixel.T, rig.T)], axis=-1)
    return np.where(weight.any(axis=0)[:, None], result, np.nan)


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
