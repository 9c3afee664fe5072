"""Where the points of a feature lie: in a box, in a ball, or near the faces of one colour of a reference mesh."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.errors import InputError
from jaxscan.files.coloured_faces import ColouredFaces, ColouredMesh, read_coloured_mesh
from jaxscan.files.table import Table

# The keys of a feature that say where its points lie, and those of [part] about the mesh whose colours are named.
REGIONS: Final = ("box", "ball", "colour")
OF_REFERENCE: Final = ("reference", "within", "fit", "box", "ball")
_WITHIN_MM: Final = 1.0


@dataclass(frozen=True)
class Region:
    """Where points are looked for, object frame, mm: a box, or a ball.

    Attributes:
        low: the box's corner of least coordinates; the ball's centre.
        high: the box's other corner; None for a ball.
        radius: of the ball.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float] | None = None
    radius: float = 0.0

    def bounds(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The corners of the box around it."""
        if self.high is not None:
            return self.low, self.high
        return tuple(x - self.radius for x in self.low), tuple(x + self.radius for x in self.low)

    def wider(self, by: float) -> "Region":
        """The region, grown by this distance (mm) on all sides."""
        if self.high is None:
            return replace(self, radius=self.radius + by)
        return Region(triple([x - by for x in self.low]), triple([x + by for x in self.high]))

    def scaled(self, by: float) -> "Region":
        """The region with all its numbers times a factor."""
        return Region(triple(self.low, by), self.high and triple(self.high, by), by * self.radius)

    def holds(self, points: Float[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        """Which points lie in it."""
        if self.high is not None:
            return np.asarray(((points >= self.low) & (points <= self.high)).all(axis=1))
        off = points - np.asarray(self.low)
        return np.einsum("pi,pi->p", off, off) <= self.radius**2


AnyRegion = Region | ColouredFaces


@dataclass(frozen=True)
class RegionReader:
    """What the regions of one `part.toml` have in common.

    Attributes:
        scale: mm in the file's unit of length.
        mesh: whose colours regions are marked by, mm; None without one.
        within: how far points may be from its faces, mm.
        fit: whether the mesh is moved onto the surface first.
        where: the points onto which it is moved; None for all.
    """

    scale: float
    mesh: ColouredMesh | None = None
    within: float = _WITHIN_MM
    fit: bool = False
    where: Region | None = None

    @classmethod
    def of(cls, part: Table, scale: float) -> "RegionReader":
        """The reader that the table [part] describes; its mesh, in mm, is read.

        Raises:
            InputError: the mesh is missing or has no colours, or a key needs it.
        """
        if "reference" not in part:
            for key in OF_REFERENCE:
                if key in part:
                    raise part.error(key, "is about a reference mesh: add reference = with the name of its file")
            return cls(scale)
        path = part.path.parent / part.string("reference")
        try:
            mesh = read_coloured_mesh(path)
        except InputError as error:
            raise part.error("reference", str(error)) from None
        within = scale * part.number("within") if "within" in part else _WITHIN_MM
        if not within > 0:
            raise part.error("within", "must be more than 0: how far points may be from the mesh")
        reader = cls(scale, mesh, within, part.boolean("fit", False))
        given = [key for key in ("box", "ball") if key in part]
        if len(given) == 2 or (given and not reader.fit):
            raise part.error(
                given[0], "is where the points lie onto which the mesh is moved: give one, and with it fit = true"
            )
        return replace(reader, where=reader._shape(part)) if given else reader

    def read(self, table: Table) -> AnyRegion:
        """The region of a feature.

        Raises:
            InputError: it has none or two, or the values are no region.
        """
        if sum(key in table for key in REGIONS) != 1:
            key = next((key for key in REGIONS if key in table), "box")
            raise table.error(
                key,
                "give one of box = [[x, y, z], [x, y, z]], ball = [x, y, z, radius], in mm, and colour = "
                '"#rrggbb", that of faces of the reference mesh',
            )
        if "colour" in table:
            return self._coloured(table)
        return self._shape(table)

    def _shape(self, table: Table) -> Region:
        return self._ball(table) if "ball" in table else self._box(table)

    def _coloured(self, table: Table) -> ColouredFaces:
        if self.mesh is None:
            raise table.error("colour", "there is no mesh whose faces have it: add reference = under [part]")
        digits = re.fullmatch("#([0-9a-fA-F]{6})", table.string("colour"))
        if digits is None:
            raise table.error("colour", 'is no colour: write "#rrggbb", six digits of 0 to f')
        red, green, blue = bytes.fromhex(digits[1])
        try:
            self.mesh.faces_of((red, green, blue))
        except InputError as error:
            raise table.error("colour", str(error)) from None
        return ColouredFaces(self.mesh, (red, green, blue), self.within)

    def _ball(self, table: Table) -> Region:
        *centre, radius = table.numbers("ball", 4)
        if not radius > 0:
            raise table.error("ball", "its radius, the fourth number, must be more than 0")
        return Region(triple(centre, self.scale), None, self.scale * radius)

    def _box(self, table: Table) -> Region:
        corners = table.sequence("box", "two corners")
        inner = Table(table.path, f"{table.prefix}box: ", {f"corner {i}": each for i, each in enumerate(corners, 1)})
        if len(corners) != 2:
            raise table.error("box", "must hold two corners, [x, y, z] each: that of the least numbers, then the other")
        low, high = inner.numbers("corner 1", 3), inner.numbers("corner 2", 3)
        if not all(a < b for a, b in zip(low, high, strict=True)):
            raise table.error("box", "each number of the second corner must be more than that of the first")
        return Region(triple(low, self.scale), triple(high, self.scale))


def triple(values: Sequence[float], scale: float = 1.0) -> tuple[float, float, float]:
    """Three numbers, each times a factor."""
    x, y, z = (scale * value for value in values)
    return x, y, z
