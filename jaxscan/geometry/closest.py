"""The nearest point of a set of triangles to each of many points."""

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.spatial import KDTree

_POINTS_AT_ONCE = 2048


class ClosestOnTriangles:
    """Triangles, made ready to be asked.

    The nearest triangle's centre is no further away than the nearest corner and the largest triangle's radius together,
    so only the triangles within that are looked at.
    """

    def __init__(self, corners: Float[np.ndarray, "triangles 3 3"]):
        self.corners = np.asarray(corners, np.float64)
        centres = self.corners.mean(axis=1)
        self._reach = float(np.linalg.norm(self.corners - centres[:, None], axis=-1).max())
        self._centres, self._corners = KDTree(centres), KDTree(self.corners.reshape(-1, 3))

    def __call__(
        self, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 3"], Int[np.ndarray, "points"]]:
        """The nearest point of the triangles to each point, and the triangle that it lies on."""
        nearest, triangle = np.empty((len(points), 3)), np.empty(len(points), int)
        for start in range(0, len(points), _POINTS_AT_ONCE):
            here = slice(start, start + _POINTS_AT_ONCE)
            some = points[here]
            near = self._centres.query_ball_point(some, self._corners.query(some)[0] * (1 + 1e-9) + self._reach)
            count = np.array([len(ids) for ids in near])
            ids = np.concatenate([np.asarray(ids, int) for ids in near])
            on = trimesh.triangles.closest_point(self.corners[ids], np.repeat(some, count, axis=0))
            away = np.linalg.norm(on - np.repeat(some, count, axis=0), axis=1)
            first = np.cumsum(count) - count
            least = np.repeat(np.minimum.reduceat(away, first), count)
            # Of a point's candidates the first that is as near as any.
            hits = np.flatnonzero(away == least)
            best = hits[np.searchsorted(hits, first)]
            nearest[here], triangle[here] = on[best], ids[best]
        return nearest, triangle
