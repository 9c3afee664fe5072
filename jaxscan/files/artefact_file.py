"""`artefact.toml`: what a scanner is tested by: balls, distances between them, planes, and the maker's limits."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from jaxscan.files.settings import toml_in
from jaxscan.files.table import Table
from jaxscan.files.text import read_toml
from jaxscan.files.units import UNITS

ARTEFACT_FILE: Final = "artefact.toml"
# The figures that have limits; and those that are the width of a band, which is never below 0.
FIGURES: Final = ("probing_form", "probing_size", "distance", "flatness")
FORMS: Final = ("probing_form", "flatness")
_MOST_BALLS: Final = 6
# Balls are no smaller and no larger than this, mm: no stripe shows them, or no scanner sees them whole.
_BALLS_MM: Final = (0.5, 3000.0)


@dataclass(frozen=True)
class CertifiedBall:
    """A ball.

    Attributes:
        name: of the ball.
        diameter: certified, mm.
        uncertainty: of this, expanded (95 %), mm.
        form: how far it is from round, mm.
    """

    name: str
    diameter: float
    uncertainty: float
    form: float = 0.0


@dataclass(frozen=True)
class CertifiedDistance:
    """A distance between the centres of two balls.

    Attributes:
        of: their names.
        length: certified, mm.
        uncertainty: of this, expanded (95 %), mm.
    """

    of: tuple[str, str]
    length: float
    uncertainty: float


@dataclass(frozen=True)
class CertifiedPlane:
    """A plane.

    Attributes:
        name: of the plane.
        flatness: how far it is from flat, mm.
    """

    name: str
    flatness: float


@dataclass(frozen=True)
class Artefact:
    """What every scan of a test shows.

    Attributes:
        path: the file.
        name: under which its history is kept.
        balls: all different in name.
        distances: between them.
        plane: the one plane; None without one.
        limits: the maker's, of those figures in `FIGURES` that have one, mm.
    """

    path: Path
    name: str
    balls: tuple[CertifiedBall, ...]
    distances: tuple[CertifiedDistance, ...]
    plane: CertifiedPlane | None
    limits: dict[str, float]


def read_artefact(path: str | os.PathLike[str]) -> Artefact:
    """Read and check `artefact.toml`.

    Args:
        path: of the file, or of the folder that it lies in.

    Raises:
        InputError: whatever is wrong with it: the file, the key, and how to fix it.
    """
    top = read_toml(toml_in(Path(path), ARTEFACT_FILE), f"the {ARTEFACT_FILE} that describes what was scanned")
    top.only("artefact", "ball", "distance", "plane", "limits")
    about = top.optional_table("artefact", "[artefact] ")
    about.only("name", "units")
    scale = UNITS[about.string("units", "mm", tuple(UNITS))]
    name = about.string("name") if "name" in about else top.path.stem
    balls: dict[str, CertifiedBall] = {}
    for table in top.tables("ball"):
        ball = _ball(table, scale)
        if ball.name in balls:
            raise table.error("name", "two balls have this name: give each its own")
        balls[ball.name] = ball
    if len(balls) > _MOST_BALLS:
        raise top.error("ball", f"there are {len(balls)}, and at most {_MOST_BALLS} can be told apart in a scan")
    distances = tuple(_distance(table, balls, scale) for table in top.tables("distance"))
    planes = top.tables("plane")
    if len(planes) > 1:
        raise top.error("plane", "there are two: a scan is searched for one; test the others by files of their own")
    plane = None
    if planes:
        planes[0].only("name", "flatness")
        plane = CertifiedPlane(planes[0].string("name", "plane"), scale * _positive(planes[0], "flatness", zero=True))
    if not balls and plane is None:
        raise top.error("ball", "is missing, and [[plane]] too: describe what was scanned, [[ball]] or [[plane]]")
    table = top.optional_table("limits", "[limits] ").only(*FIGURES)
    limits = {figure: scale * _positive(table, figure) for figure in FIGURES if figure in table}
    return Artefact(top.path, name, tuple(balls.values()), distances, plane, limits)


def _ball(table: Table, scale: float) -> CertifiedBall:
    table.only("name", "diameter", "uncertainty", "form")
    diameter, uncertainty = scale * _positive(table, "diameter"), scale * _positive(table, "uncertainty", zero=True)
    if not _BALLS_MM[0] <= diameter <= _BALLS_MM[1]:
        own = table.number("diameter")
        units = [unit for unit, mm in UNITS.items() if mm != scale and _BALLS_MM[0] <= mm * own <= _BALLS_MM[1]]
        meant = ", or ".join(f'units = "{unit}"' for unit in units)
        fix = f"if the file's numbers are in another unit, write {meant} under [artefact]" if meant else "correct it"
        raise table.error("diameter", f"is {diameter:g} mm, which no scanner of this kind sees: {fix}")
    if uncertainty > 0.1 * diameter:
        raise table.error("uncertainty", "is more than a tenth of the diameter: give both in one unit")
    form = scale * _positive(table, "form", zero=True) if "form" in table else 0.0
    return CertifiedBall(table.string("name"), diameter, uncertainty, form)


def _distance(table: Table, balls: dict[str, CertifiedBall], scale: float) -> CertifiedDistance:
    table.only("of", "length", "uncertainty")
    of = table.sequence("of", "the names of two balls")
    if len(of) != 2 or of[0] == of[1]:
        raise table.error("of", "must name two balls")
    for name in of:
        if not isinstance(name, str) or name not in balls:
            raise table.error("of", f"no ball is called {name!r}: there are {', '.join(balls) or 'none'}")
    length, uncertainty = scale * _positive(table, "length"), scale * _positive(table, "uncertainty", zero=True)
    least = sum(balls[name].diameter for name in of) / 2
    if length < least:
        raise table.error("length", f"the balls touch at {least:g} mm: give the distance of their centres, in one unit")
    return CertifiedDistance((of[0], of[1]), length, uncertainty)


def _positive(table: Table, key: str, zero: bool = False) -> float:
    value = table.number(key)
    if not (value > 0 or (zero and value == 0)):
        raise table.error(key, "must be 0 or more" if zero else "must be more than 0")
    return value
