"""Objects of known shape to calibrate from: flat plates, step blocks, balls, and any triangle mesh.

A shape has a frame of its own, z up, and answers one question: where on it is the point nearest to a given one, and
which way does the surface face there. It also says where, roughly, it stands in a cloud.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol, runtime_checkable

import numpy as np
import trimesh
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.files.mesh import read_mesh
from jaxscan.files.units import in_millimetres
from jaxscan.geometry import Pose
from jaxscan.geometry.closest import ClosestOnTriangles
from jaxscan.geometry.robust_plane import dominant_plane

_TRIALS: Final = 400
_SAMPLE: Final = 1500
_SEED: Final = 2003
# How far a cloud may be off before the refinement: this share of its size, and so much more, mm.
_ROUGHLY_SHARE, _ROUGHLY_MM = 0.08, 0.3
# What is smaller than this, mm, is given in other units.
_SMALLEST_MM: Final = 0.5
# Turns about the vertical that are tried for a mesh, and rounds of nearest points for each.
_TURNS, _ROUNDS = 24, 12


@runtime_checkable
class Shape(Protocol):
    """An object of known shape."""

    @property
    def size(self) -> float:
        """What a wrong scale would be a share of: its height, its radius (mm)."""
        ...

    @property
    def turns(self) -> bool:
        """Whether it looks different when it is turned."""
        ...

    def nearest(
        self, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
        """For points of the shape's frame (mm): the nearest points of its surface, and the unit normals there."""
        ...

    def stand(self, cloud: Float[np.ndarray, "points 3"]) -> Pose:
        """Roughly where the shape stands in a cloud seen from the origin: T_object_shape.

        Raises:
            InputError: it is not found there.
        """
        ...


@dataclass(frozen=True)
class Steps:
    """Level faces, one above the other: a step block on a plate, or a plate alone.

    Attributes:
        heights: of the faces above the plate that they stand on, mm; the plate itself, 0, is one of them.
    """

    heights: tuple[float, ...] = (0.0,)

    @property
    def size(self) -> float:
        """Distance from the lowest level to the highest, mm."""
        return max(self.heights) - min(self.heights)

    @property
    def turns(self) -> bool:
        """Whether the shape can be recognised when it is turned about the vertical: true."""
        return True

    def nearest(
        self, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
        """The nearest points on the levels, and the normals there."""
        levels = np.asarray(self.heights)
        on = points.copy()
        on[:, 2] = levels[np.abs(points[:, 2:] - levels).argmin(axis=1)]
        return on, np.broadcast_to([0.0, 0.0, 1.0], points.shape)

    def stand(self, cloud: Float[np.ndarray, "points 3"]) -> Pose:
        """The plane with the most points is one of the levels: the one that explains the others best."""
        plane = dominant_plane(cloud)
        height = plane.inverse().apply(cloud)[:, 2]
        levels = np.asarray(self.heights)

        def misfit(level: float) -> float:
            away = np.abs((height + level)[:, None] - levels).min(axis=1)
            return float(np.minimum(away, _ROUGHLY_MM + _ROUGHLY_SHARE * self.size).sum())

        return plane @ Pose(np.zeros(3), np.array([0.0, 0.0, -min(levels, key=misfit)]))


@dataclass(frozen=True)
class Ball:
    """A ball, its frame in its middle.

    Attributes:
        radius: mm.
    """

    radius: float

    @property
    def size(self) -> float:
        """The radius."""
        return self.radius

    @property
    def turns(self) -> bool:
        """False: a ball looks the same after any rotation."""
        return False

    def nearest(
        self, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
        """Along the radius."""
        normal = points / np.maximum(np.linalg.norm(points, axis=1), 1e-12)[:, None]
        return self.radius * normal, normal

    def stand(self, cloud: Float[np.ndarray, "points 3"]) -> Pose:
        """The middle from which most points are a radius away, of balls through random triples."""
        rng = np.random.default_rng(_SEED)
        # Points of one ball are near to each other: two of a triple are drawn from around the first.
        sample = cloud[rng.permutation(len(cloud))[:_SAMPLE]]
        first = rng.integers(len(sample), size=4 * _TRIALS)
        near = np.linalg.norm(sample[first][:, None] - sample[None], axis=-1) < 1.5 * self.radius
        others = [rng.choice(np.flatnonzero(row), 2) for row in near]
        a, b, c = (sample[i] for i in (first, *np.transpose(others)))
        middles = self._middles(a, b, c)
        away = np.abs(np.linalg.norm(sample[None] - middles[:, None], axis=-1) - self.radius)
        tolerance = _ROUGHLY_MM + 0.5 * _ROUGHLY_SHARE * self.radius
        inliers = np.where(np.isfinite(middles).all(axis=1), (away < tolerance).sum(axis=1), 0)
        if inliers.max() < 30:
            raise InputError(f"no ball of radius {self.radius:g} mm is seen in the scan: check the radius (mm)")
        return Pose(np.zeros(3), middles[int(inliers.argmax())])

    def _middles(
        self, a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"], c: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Middles, beyond the points as seen from the origin, of balls through three points; NaN where none is."""
        u, v = b - a, c - a
        w = np.cross(u, v)
        ww = (w**2).sum(axis=1)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            to_centre = ((v**2).sum(1)[:, None] * np.cross(w, u) + (u**2).sum(1)[:, None] * np.cross(v, w)) / (2 * ww)
            up = w / np.sqrt(ww)
            lift = np.sqrt(self.radius**2 - (to_centre**2).sum(axis=1))[:, None]
        centre = a + to_centre
        away = np.where((up * centre).sum(axis=1)[:, None] > 0, 1.0, -1.0)
        return centre + away * lift * up


@dataclass(frozen=True)
class Solid:
    """A triangle mesh that stands on the stage as it stands on z = 0 of its frame.

    Attributes:
        mesh: in millimetres, z up, normals outwards.
    """

    mesh: trimesh.Trimesh

    def __post_init__(self) -> None:
        """Make the triangles ready."""
        object.__setattr__(self, "_closest", ClosestOnTriangles(np.asarray(self.mesh.triangles)))

    @property
    def size(self) -> float:
        """The height."""
        return float(self.mesh.bounds[1, 2] - self.mesh.bounds[0, 2])

    @property
    def turns(self) -> bool:
        """Whether the shape can be recognised when it is turned about the vertical: true."""
        return True

    def nearest(
        self, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
        """The nearest points on the triangles, and the normals there."""
        on, triangle = self._closest(points)  # pyright: ignore[reportAttributeAccessIssue]
        return on, np.asarray(self.mesh.face_normals)[triangle]

    def stand(self, cloud: Float[np.ndarray, "points 3"]) -> Pose:
        """The pose on the dominant plane, turned about its normal so that the points above it fit best."""
        plane = dominant_plane(cloud)
        local = plane.inverse().apply(cloud)
        tall = float(self.mesh.bounds[1, 2])
        above = local[(local[:, 2] > _ROUGHLY_MM + _ROUGHLY_SHARE * tall) & (local[:, 2] < 1.2 * tall)]
        if len(above) < 30:
            raise InputError("nothing stands on the plane that the scan shows: scan the gauge on a flat support")
        rng = np.random.default_rng(_SEED)
        above = above[rng.permutation(len(above))[:_SAMPLE]]
        trials = [self._turned(above, 2 * np.pi * i / _TURNS) for i in range(_TURNS)]
        _, T_plane_shape = min(trials, key=lambda trial: trial[0])
        return plane @ T_plane_shape

    def _turned(self, points: Float[np.ndarray, "points 3"], angle: float) -> tuple[float, Pose]:
        """Rounds of nearest points from one turn about z: the misfit, and T_plane_shape."""
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        move = np.append(points[:, :2].mean(axis=0) - turn[:2, :2] @ self.mesh.bounds[:, :2].mean(axis=0), 0.0)
        away = np.full(len(points), np.inf)
        for _ in range(_ROUNDS):
            local = (points - move) @ turn
            on, _ = self.nearest(local)
            away = np.linalg.norm(on - local, axis=1)
            near = away <= np.quantile(away, 0.9)
            # The rigid motion in the plane that carries the nearest points to the cloud (Kabsch, in two dimensions).
            a, b = on[near, :2], points[near, :2]
            U, _, Vt = np.linalg.svd((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
            turn[:2, :2] = U @ np.diag([1.0, np.linalg.det(U @ Vt)]) @ Vt
            move[:2] = b.mean(axis=0) - turn[:2, :2] @ a.mean(axis=0)
        return float(np.minimum(away, np.quantile(away, 0.9)).mean()), Pose.from_matrix(turn, move)


def parse_shape(text: str, units: str | None = None) -> Shape:
    """A shape as the command line names it: `plate`, `steps:1.48,3.68,8.94`, `ball:22`, or a mesh file.

    Args:
        text: how it is named.
        units: of a mesh, as `in_millimetres` has them.

    Raises:
        InputError: it names none of these, something too small to be one, or a file that holds no mesh.
    """
    numbers = r"\d+(?:\.\d+)?"
    if text == "plate":
        return Steps()
    if re.fullmatch(rf"steps:{numbers}(?:,{numbers})*", text):
        heights = {float(h) for h in text.split(":")[1].split(",")}
        _in_millimetres(text, max(heights))
        return Steps((0.0, *sorted(heights - {0.0})))
    if re.fullmatch(rf"ball:{numbers}", text) and (radius := float(text.split(":")[1])) > 0:
        _in_millimetres(text, radius)
        return Ball(radius)
    path = Path(text)
    if not path.is_file():
        raise InputError(
            f'"{text}": is no shape and no file: give plate, steps:1.48,3.68,8.94 (heights in mm above the plate), '
            "ball:22 (radius in mm), or a mesh file (.stl, .ply, .obj)"
        )
    mesh = read_mesh(path)
    mesh.vertices = in_millimetres(text, np.asarray(mesh.vertices), units)
    return Solid(mesh)


def _in_millimetres(text: str, size: float) -> None:
    if 0 < size < _SMALLEST_MM:
        raise InputError(
            f'"{text}": is {size:g} mm in size, which no stripe shows: give millimetres '
            f"({size:g} m are {1000 * size:g})"
        )
