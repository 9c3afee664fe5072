"""`[laser]` of a session, or several `[[laser]]`, and the photographs of their stripes wherever they stand."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from jaxscan.errors import InputError
from jaxscan.files.listing import files_or_gaps
from jaxscan.files.session_sweeps import STEPS, Sweep, read_light_axis, read_sweeps
from jaxscan.files.settings import read_stripe_settings, relative_name
from jaxscan.files.table import Table, show
from jaxscan.images import StripeSettings
from jaxscan.rig import LIGHTS, LightPlane

_LASER_KEYS: Final = ("name", "color", "columns", "stripes", STEPS, "sheet", "axis")

# For each laser by name, the photograph of its stripe that is paired with each of a table, None where there is none.
Stripes = Mapping[str, tuple[Path | None, ...]]


def read_lasers(
    table: Table, views: Table, boards: tuple[Path, ...]
) -> tuple[
    tuple[StripeSettings, ...], tuple[str, ...], dict[str, str], Stripes | None, Mapping[str, tuple[Sweep, ...]]
]:
    """The lasers, the kind of each one's sheet, what moves them, and the photographs of each one's stripe.

    Args:
        table: of the session.
        views: its table `[views]`, where the stripes of a single laser may stand.
        boards: the photographs of the board in the hand, with which the stripes are paired.

    Raises:
        InputError: key, value, and how to fix it.
    """
    tables = _laser_tables(table)
    lasers = tuple(read_stripe_settings(laser) for laser in tables)
    sheets = tuple(laser.string("sheet", LightPlane.kind, tuple(LIGHTS)) for laser in tables)
    moved = [read_light_axis(laser, sheet) for laser, sheet in zip(tables, sheets, strict=True)]
    sheets = sheets if set(sheets) - {LightPlane.kind} else ()
    if len(lasers) > 1:
        _check_names(table, lasers)
        for key in ("stripes", STEPS):
            if key in views:
                raise views.error(key, f"there are several lasers: give each [[laser]] its own {key} instead")
    axes = {laser.name: axis for laser, axis in zip(lasers, moved, strict=True) if axis}
    places = dict(zip([laser.name for laser in lasers], tables, strict=True))
    if len(lasers) <= 1:
        own = [inner for inner in tables if "stripes" in inner or STEPS in inner]
        if own and ("stripes" in views or STEPS in views):
            raise views.error("stripes", f"{own[0].prefix}stripes is given too: keep one of them")
        # Photographs of a stripe mean a laser, even if there is nothing to say about it.
        lasers = lasers or ((StripeSettings(),) if "stripes" in views else ())
        places = {laser.name: own[0] if own else views for laser in lasers}
    for name, place in places.items():
        if name not in axes and STEPS in place:
            raise place.error(STEPS, 'the light stands still: leave it out, or set sheet = "swept" under [laser]')
    sweeps = {name: read_sweeps(places[name], boards, axis) for name, axis in axes.items()}
    still = {name: place for name, place in places.items() if name not in axes}
    if len(lasers) <= 1 and not any("stripes" in place for place in still.values()):
        return lasers, sheets, axes, {} if axes else None, sweeps
    return lasers, sheets, axes, {name: _paired(place, len(boards)) for name, place in still.items()}, sweeps


def _laser_tables(table: Table) -> list[Table]:
    """One table for each laser, from `[laser]` or from several `[[laser]]`."""
    value = table.values.get("laser", [])
    if isinstance(value, dict):
        return [table.table("laser", "[laser] ").only(*_LASER_KEYS)]
    if not isinstance(value, list) or not all(isinstance(inner, dict) for inner in value):
        raise table.error("laser", "must be a table, [laser], or several, each under [[laser]]")
    return [Table(table.path, f"[[laser]] {i + 1}: ", inner).only(*_LASER_KEYS) for i, inner in enumerate(value)]


def _check_names(table: Table, lasers: tuple[StripeSettings, ...]) -> None:
    names = [laser.name for laser in lasers]
    if "" in names or len(set(names)) < len(names):
        raise InputError(f"{table.path}: [[laser]] name: each of several lasers needs its own; they are {show(names)}")


def _paired(table: Table, n_boards: int, key: str = "stripes") -> tuple[Path | None, ...]:
    paths = files_or_gaps(table, key)
    if len(paths) != n_boards:
        raise table.error(
            key,
            f"{len(paths)} photographs of the stripe for {n_boards} of the board: they are paired in order, "
            'so give as many, in a list with "" where there is none',
        )
    return paths


def read_stripes(table: Table, lasers: Sequence[StripeSettings], n_images: int) -> Stripes:
    """The photographs of each laser's stripe that are paired with those of a table.

    Raises:
        InputError: key, value, and how to fix it.
    """
    if "stripes" not in table:
        return {}
    if not lasers:
        raise table.error("stripes", "the session has no laser whose stripe this could be: add [laser]")
    if len(lasers) == 1:
        return {lasers[0].name: _paired(table, n_images)}
    names = [laser.name for laser in lasers]
    inner = table.table("stripes", f"{table.prefix}stripes.").only(*names)
    return {name: _paired(inner, n_images, name) for name in names if name in inner}


def stripes_values(stripes: Stripes, folder: Path) -> dict[str, list[str]]:
    """By laser, the names of the photographs of its stripe; "" where there is none."""
    return {laser: [relative_name(path, folder) if path else "" for path in paths] for laser, paths in stripes.items()}


def of_lasers(values: Mapping[str, Any], lasers: int) -> Any:
    """What stands in the file: a table by laser, and of one laser its own value alone."""
    return values if lasers > 1 else next(iter(values.values()))
