"""Colours of a surface's vertices from coloured points near them: of surfaces that were merged, resampled, reduced."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float32, UInt8
from scipy.spatial import KDTree

from jaxscan.files.cloud import Cloud
from jaxscan.geometry import Pose
from jaxscan.surface.side import Side

# Points whose colours are averaged, and how far they may be, in times of the points' usual distance from each other.
_NEAREST: Final = 4
_FARTHEST: Final = 3.0
# Points that the usual distance is taken of.
_SAMPLE: Final = 2000


def painted_sides(sides: Sequence[Side], poses: Sequence[Pose]) -> Cloud | None:
    """All coloured points of some sides together; None where no side has any.

    Args:
        sides: any number.
        poses: T_first_side of each.
    """
    points, colours = [], []
    for side, T in zip(sides, poses, strict=True):
        if side.painted is not None and side.painted.colours is not None:
            points.append(T.apply(side.painted.points.astype(np.float64)).astype(np.float32))
            colours.append(side.painted.colours)
    return Cloud(np.concatenate(points), colours=np.concatenate(colours)) if points else None


def colours_near(vertices: Float32[np.ndarray, "vertices 3"], painted: Cloud) -> UInt8[np.ndarray, "vertices 3"]:
    """The mean colour of the four coloured points nearest to each vertex; 0, 0, 0 where none is near.

    Args:
        vertices: object frame, mm.
        painted: points with colours, in the same frame.
    """
    colours = np.zeros((len(vertices), 3), np.uint8)
    if painted.colours is None or not painted.colours.any():
        return colours
    some = painted.colours.any(axis=1)
    points, paint = painted.points[some].astype(np.float64), painted.colours[some].astype(np.float64)
    tree, near = KDTree(points), min(_NEAREST, len(points))
    if len(points) > 1:
        sample = points[:: max(1, len(points) // _SAMPLE)]
        reach = _FARTHEST * float(np.median(np.asarray(tree.query(sample, k=near)[0]).reshape(len(sample), -1)[:, -1]))
    else:
        reach = np.inf
    distance, which = (np.asarray(each).reshape(-1, near) for each in tree.query(vertices, k=near))
    weight = (distance <= reach).astype(np.float64)
    total = weight.sum(axis=1)
    mean = (weight[..., None] * paint[which]).sum(axis=1) / np.maximum(total, 1.0)[:, None]
    return np.where(total[:, None] > 0, np.clip(np.round(mean), 1, 255), 0).astype(np.uint8)
