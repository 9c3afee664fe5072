"""A part from clicks on a surface: each click is a feature, measured from another one that was clicked before."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from jaxscan.errors import InputError
from jaxscan.files.part_file import DIMENSIONS, FITTED, PART_FILE, Dimension, Feature, Part
from jaxscan.files.region import Region

# What is measured of a feature by itself, and of two.
_OF_ONE: Final = {"plane": "flatness", "ball": "diameter", "cylinder": "diameter", "cone": "cone_angle"}
_OF_TWO: Final = ("distance", "angle")


@dataclass(frozen=True)
class Click:
    """A click on a face.

    Attributes:
        kind: plane, ball, cylinder or cone.
        place: where the surface was clicked, object frame, mm.
        radius: within which points are looked at, mm.
        grow: whether the face goes on beyond them.
        measured_from: the number of the click, from 0, to which distance and angle are taken; None for none.
    """

    kind: str
    place: tuple[float, float, float]
    radius: float
    grow: bool = False
    measured_from: int | None = None


def part_of_clicks(clicks: Sequence[Click], name: str = "part") -> Part:
    """Features named by their kind and their number, and dimensions of each and of pairs.

    A plane has its flatness, a ball and a cylinder the diameter, a cone its angle. Two features have their distance,
    and their angle where both have a direction.

    Raises:
        InputError: a click is of no such kind, has no radius, or is measured from one that is not before it.
    """
    features: list[Feature] = []
    dimensions: list[Dimension] = []
    for number, click in enumerate(clicks):
        if click.kind not in FITTED:
            raise InputError(f'"{click.kind}" cannot be clicked: choose {", ".join(FITTED)}')
        if not 0 < click.radius < np.inf:
            raise InputError(f"a radius of {click.radius:g} mm holds no points: give a number above 0")
        x, y, z = map(float, click.place)
        if not np.isfinite([x, y, z]).all():
            raise InputError(f"{click.kind} {number + 1}: its place is not finite: give x, y, z in mm")
        region = Region((x, y, z), None, float(click.radius))
        own = Feature(f"{click.kind} {number + 1}", click.kind, region, click.grow)
        kind = _OF_ONE[click.kind]
        dimensions.append(Dimension(f"{own.name}, {kind.replace('_', ' ')}", kind, (own.name,)))
        if click.measured_from is not None:
            if not 0 <= click.measured_from < number:
                raise InputError(f"{own.name} is measured from click {click.measured_from}: name one before it, from 0")
            other = features[click.measured_from]
            for kind in _OF_TWO:
                if all(one.kind in of for one, of in zip((other, own), DIMENSIONS[kind], strict=True)):
                    of = (other.name, own.name)
                    dimensions.append(Dimension(f"{other.name} to {own.name}, {kind}", kind, of))
        features.append(own)
    return Part(Path(PART_FILE), name, tuple(features), tuple(dimensions))
