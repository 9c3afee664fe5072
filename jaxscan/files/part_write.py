"""`part.toml` as it is written."""

from pathlib import Path
from typing import Any

import tomli_w

from jaxscan.files.coloured_faces import ColouredFaces, written_colour
from jaxscan.files.part_file import FORMS, IN_A_SECTION, Dimension, Feature, Part
from jaxscan.files.region import Region
from jaxscan.files.settings import relative_name

# Digits of a length after the point, mm, and of a direction's.
_DIGITS, _OF_DIRECTIONS = 4, 12


def part_text(part: Part) -> str:
    """A part as the text of its file, in mm, regions with four digits after the point; `read_part` reads it."""
    values: dict[str, Any] = {
        "part": {"name": part.name} | _reference(part),
        "feature": [_feature(each) for each in part.features],
    }
    if part.dimensions:
        values["dimension"] = [_dimension(each, part.path.parent) for each in part.dimensions]
    return tomli_w.dumps(values)


def _reference(part: Part) -> dict[str, Any]:
    """The mesh whose colours mark regions."""
    for feature in part.features:
        if isinstance(feature.region, ColouredFaces):
            mesh = relative_name(feature.region.mesh.path, part.path.parent)
            values: dict[str, Any] = {"reference": mesh, "within": feature.region.within}
            values |= {"fit": True} if part.fit else {}
            return values | (_region(part.where) if part.where is not None else {})
    return {}


def _feature(feature: Feature) -> dict[str, Any]:
    values: dict[str, Any] = {"name": feature.name, "kind": feature.kind}
    if feature.of:
        values |= {"section": feature.of[0]} if feature.kind in IN_A_SECTION else {"of": list(feature.of)}
    for key in ("point", "normal"):
        if getattr(feature, key) is not None:
            digits = _DIGITS if key == "point" else _OF_DIRECTIONS
            values[key] = [round(c, digits) for c in getattr(feature, key)]
    if isinstance(feature.region, ColouredFaces):
        values["colour"] = written_colour(feature.region.colour)
    elif feature.region is not None:
        values |= _region(feature.region)
    return values | ({"grow": True} if feature.grow else {})


def _region(region: Region) -> dict[str, Any]:
    corners = [[round(c, _DIGITS) for c in corner] for corner in (region.low, region.high) if corner]
    return {"box": corners} if region.high is not None else {"ball": [*corners[0], round(region.radius, _DIGITS)]}


def _dimension(dimension: Dimension, folder: Path) -> dict[str, Any]:
    values: dict[str, Any] = {"name": dimension.name, "kind": dimension.kind, "of": list(dimension.of)}
    form = dimension.kind in FORMS
    if dimension.nominal is not None and not form:
        values["nominal"] = dimension.nominal
    if dimension.tolerance is not None:
        values["tolerance"] = dimension.tolerance[1] if form else list(dimension.tolerance)
    if dimension.reference is not None:
        values["reference"] = relative_name(dimension.reference, folder)
    return values | ({"fit": True} if dimension.fit else {})
