"""`part.toml`: what is to be measured on a part: features, where their points lie, and dimensions with tolerances."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from jaxscan.files.region import OF_REFERENCE, REGIONS, AnyRegion, Region, RegionReader, triple
from jaxscan.files.settings import toml_in
from jaxscan.files.table import Table
from jaxscan.files.text import read_toml
from jaxscan.files.units import UNITS

PART_FILE: Final = "part.toml"

FITTED: Final = ("plane", "ball", "cylinder", "cone")
IN_A_SECTION: Final = ("circle", "line")
OF_TWO_PLANES: Final = ("edge", "slot")
# What a feature can stand for where distances and angles are taken.
_PLACES: Final = ("plane", "slot", "ball", "circle", "cylinder", "cone", "line", "edge")
_DIRECTED: Final = ("plane", "slot", "cylinder", "cone", "line", "edge")
_FLAT: Final = ("plane", "slot")
# The keys of a feature of any kind; each kind has some of them.
_FEATURE_KEYS: Final = ("name", "kind", "of", "point", "normal", "section", *REGIONS, "grow")
_ROUND: Final = ("ball", "cylinder", "circle")

# Of each kind of dimension: which kinds of feature it is of, one tuple for each feature.
DIMENSIONS: Final[dict[str, tuple[tuple[str, ...], ...]]] = {
    "radius": (_ROUND,),
    "diameter": (_ROUND,),
    "cone_angle": (("cone",),),
    "width": (("slot",),),
    "distance": (_PLACES, _PLACES),
    "angle": (_DIRECTED, _DIRECTED),
    "step": (_FLAT, _FLAT),
    "flush": (("plane",), ("plane",)),
    "gap": (("plane", "edge", "line"), ("plane", "edge", "line")),
    "flatness": (("plane",),),
    "roundness": (("ball", "cylinder", "cone", "circle"),),
    "straightness": (("line",),),
    "volume": (("surface",), ("plane",)),
    "profile": (("surface",),),
}
ANGLES: Final = ("angle", "cone_angle")
# What has no nominal value but 0.
FORMS: Final = ("flatness", "roundness", "straightness", "profile")
# What may be below 0.
SIGNED: Final = ("step", "flush", "volume")


@dataclass(frozen=True)
class Feature:
    """A feature of a part.

    Attributes:
        name: by which dimensions call it.
        kind: plane, ball, cylinder, cone, surface, section, circle, line, edge or slot.
        region: where its points lie; None for what is made of other features.
        grow: whether it takes in what goes on beyond the region.
        of: the two planes of an edge or a slot; the section of a circle or a line.
        point: of a section's plane, mm.
        normal: of a section's plane.
    """

    name: str
    kind: str
    region: AnyRegion | None = None
    grow: bool = False
    of: tuple[str, ...] = ()
    point: tuple[float, float, float] | None = None
    normal: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Dimension:
    """A dimension of a part.

    Attributes:
        name: of the dimension.
        kind: one of `DIMENSIONS`.
        of: the features.
        nominal: mm, degrees or mm³; None where nothing is asked of it.
        tolerance: how far below and above the nominal it may be; None without one.
        reference: of a profile, the mesh.
        fit: of a profile, whether the points are moved onto the mesh first.
    """

    name: str
    kind: str
    of: tuple[str, ...]
    nominal: float | None = None
    tolerance: tuple[float, float] | None = None
    reference: Path | None = None
    fit: bool = False

    @property
    def unit(self) -> str:
        """The unit of its value: mm, ° or mm³."""
        return "°" if self.kind in ANGLES else "mm³" if self.kind == "volume" else "mm"


@dataclass(frozen=True)
class Part:
    """What is to be measured.

    Attributes:
        path: the file.
        name: of the part.
        features: in an order in which each comes after those that it is made of.
        dimensions: in the file's order.
        fit: whether the mesh whose colours mark regions is moved onto the surface first.
        where: the points onto which it is moved; None for all.
    """

    path: Path
    name: str
    features: tuple[Feature, ...]
    dimensions: tuple[Dimension, ...]
    fit: bool = False
    where: Region | None = None


def read_part(path: str | os.PathLike[str]) -> Part:
    """Read and check `part.toml`.

    Args:
        path: of the file, or of the folder that it lies in.

    Raises:
        InputError: whatever is wrong with it: the file, the key, and how to fix it.
    """
    top = read_toml(toml_in(Path(path), PART_FILE), f"the {PART_FILE} that lists features and dimensions")
    top.only("part", "feature", "dimension")
    about = top.optional_table("part", "[part] ")
    about.only("name", "units", *OF_REFERENCE)
    scale = UNITS[about.string("units", "mm", tuple(UNITS))]
    name = about.string("name") if "name" in about else top.path.resolve().parent.name or "part"
    regions = RegionReader.of(about, scale)
    features: dict[str, Feature] = {}
    for table in top.tables("feature"):
        feature = _feature(table, features, regions)
        features[feature.name] = feature
    if not features:
        raise top.error("feature", "is missing: add a table [[feature]] with name, kind and box, ball or colour")
    dimensions: dict[str, Dimension] = {}
    for table in top.tables("dimension"):
        dimension = _dimension(table, features, scale)
        if dimension.name in dimensions:
            raise table.error("name", "two dimensions have this name: give each its own")
        dimensions[dimension.name] = dimension
    return Part(top.path, name, tuple(features.values()), tuple(dimensions.values()), regions.fit, regions.where)


def _feature(table: Table, known: dict[str, Feature], regions: RegionReader) -> Feature:
    kinds = (*FITTED, "surface", "section", *IN_A_SECTION, *OF_TWO_PLANES)
    table.only(*_FEATURE_KEYS)
    kind = table.string("kind", choices=kinds)
    name = table.string("name")
    if name in known:
        raise table.error("name", "two features have this name: give each its own")
    if kind in OF_TWO_PLANES:
        table.only("name", "kind", "of")
        return Feature(name, kind, of=_features(table, known, (("plane",), ("plane",))))
    if kind == "section":
        table.only("name", "kind", "point", "normal", *REGIONS)
        normal = table.numbers("normal", 3)
        if not any(normal):
            raise table.error("normal", "has no direction: give that in which the section's plane faces")
        point = triple(table.numbers("point", 3), regions.scale)
        region = regions.read(table) if any(key in table for key in REGIONS) else None
        return Feature(name, kind, region, point=point, normal=triple(normal))
    if kind in IN_A_SECTION:
        table.only("name", "kind", "section", *REGIONS)
        of = table.string("section")
        if of not in known or known[of].kind != "section":
            raise table.error("section", "no section of this name stands above: write the section first")
        region = regions.read(table) if any(key in table for key in REGIONS) else None
        return Feature(name, kind, region, of=(of,))
    table.only("name", "kind", *REGIONS, *(("grow",) if kind != "surface" else ()))
    return Feature(name, kind, regions.read(table), table.boolean("grow", False))


def _dimension(table: Table, features: dict[str, Feature], scale: float) -> Dimension:
    table.only("name", "kind", "of", "nominal", "tolerance", "reference", "fit")
    kind, name = table.string("kind", choices=tuple(DIMENSIONS)), table.string("name")
    of_profile = ("reference", "fit") if kind == "profile" else ()
    table.only("name", "kind", "of", "nominal", "tolerance", *of_profile)
    of = _features(table, features, DIMENSIONS[kind])
    factor = 1.0 if kind in ANGLES else scale**3 if kind == "volume" else scale
    form = kind in FORMS
    if form and "nominal" in table:
        raise table.error("nominal", f"a {kind} has none, it is 0: leave it out, and give the tolerance alone")
    nominal = 0.0 if form else factor * table.number("nominal") if "nominal" in table else None
    if nominal is not None:
        _check_nominal(table, kind, nominal, tuple(features[name] for name in of))
    tolerance = None
    if "tolerance" in table:
        if nominal is None:
            raise table.error("nominal", "is missing: a tolerance is about a nominal value, so give both")
        tolerance = _tolerance(table, form)
        tolerance = factor * tolerance[0], factor * tolerance[1]
    reference = None
    if kind == "profile":
        reference = table.path.parent / table.string("reference")
        if not reference.is_file():
            raise table.error("reference", f"there is no file {reference}: give the mesh, relative to the part file")
    fit = kind == "profile" and table.boolean("fit", False)
    return Dimension(name, kind, of, nominal, tolerance, reference, fit)


def _check_nominal(table: Table, kind: str, nominal: float, of: tuple[Feature, ...]) -> None:
    """Refuse a nominal value that no shape can have."""
    if kind not in SIGNED and nominal < 0:
        raise table.error("nominal", f"a {kind} is never below 0: give 0 or more")
    if kind in ANGLES:
        most = 180.0 if kind == "cone_angle" or all(each.kind in _FLAT for each in of) else 90.0
        if nominal > most:
            raise table.error("nominal", f"this angle is never more than {most:g}°: give degrees, from 0 to {most:g}")


def _tolerance(table: Table, form: bool) -> tuple[float, float]:
    """Below and above; one number is for both."""
    value = table.values["tolerance"]
    if isinstance(value, list) and not form:
        low, high = table.numbers("tolerance", 2)
    else:
        high = table.number("tolerance")
        low = 0.0 if form else -high
    if not low < high:
        raise table.error("tolerance", "must be a number above 0, or two of which the second is larger")
    return low, high


def _features(table: Table, known: dict[str, Feature], kinds: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """The features that `of` names, one of each of these kinds."""
    value = table.values.get("of")
    names = [value] if isinstance(value, str) else table.sequence("of", "names of features")
    if len(names) != len(kinds):
        raise table.error("of", f"must name {len(kinds)} feature{'s' if len(kinds) > 1 else ''}")
    for name, allowed in zip(names, kinds, strict=True):
        if not isinstance(name, str) or name not in known:
            there = ", ".join(known) or "none"
            raise table.error("of", f"no feature above is called {name!r}: those above are {there}")
        if known[name].kind not in allowed:
            raise table.error("of", f'"{name}" is a {known[name].kind}, but one of {", ".join(allowed)} is needed')
    if len(set(names)) < len(names):
        raise table.error("of", "names one feature twice: name two")
    return tuple(names)
