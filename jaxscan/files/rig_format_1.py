"""Rig files of format 1, which had a light plane, a stage and a turntable by these names.

Their parts are given as format 2 has them, by tables that say in errors where they stand in the file.
"""

from collections.abc import Iterator
from typing import Final

from jaxscan.files.table import Table
from jaxscan.rig import Rig
from jaxscan.rig.rig import parameter_names

FORMAT_1: Final = "jaxscan-rig/1"
_MOTIONS: Final = {"stage": ("linear", ("per_step",)), "turntable": ("rotary", ("per_step", "centre"))}
PARTS_1: Final = ("laser", *_MOTIONS)


def light_tables_1(table: Table, unknown: list[str]) -> list[Table]:
    """The lights; keys that are not known are added to the unknown ones.

    Raises:
        InputError: what is there is no laser, nor a list of them.
    """
    return [_with_kind(laser, ("name", "plane"), {"kind": "plane"}, unknown) for laser in _lasers(table)]


def axis_tables_1(table: Table, unknown: list[str]) -> list[Table]:
    """The stage and the turntable on it; keys that are not known are added to the unknown ones.

    Raises:
        InputError: one of them is no object.
    """
    return [
        _with_kind(table.table(axis, f"{axis}."), numbers, {"axis": axis, "kind": kind}, unknown)
        for axis, (kind, numbers) in _MOTIONS.items()
        if axis in table
    ]


def parameter_names_1(rig: Rig) -> list[str]:
    """The names of the rig's leaves in their order: `laser.plane.0`, or `laser.left.plane.0` where it has a name."""
    return [_name(name, rig) for name in parameter_names(rig)]


def _name(name: str, rig: Rig) -> str:
    part, _, rest = name.partition(".")
    if part == "lights":
        i, _, number = rest.partition(".")
        light = rig.lights[int(i)].name
        return ".".join(["laser", light, number] if light else ["laser", number])
    return rest if part == "motion" else name


def _lasers(table: Table) -> Iterator[Table]:
    if "laser" not in table:
        return
    if isinstance(table.values["laser"], dict):
        yield table.table("laser", "laser.")
        return
    for i, value in enumerate(table.sequence("laser", "lasers, each an object with name and plane")):
        if not isinstance(value, dict):
            raise table.error("laser", f"entry {i} must be an object with name and plane")
        yield Table(table.path, f"laser.{i}.", value)


def _with_kind(table: Table, known: tuple[str, ...], of_format_2: dict[str, str], unknown: list[str]) -> Table:
    unknown += [table.prefix + key for key in table.unknown(known)]
    values = {key: table.values[key] for key in known if key in table}
    return Table(table.path, table.prefix, values | of_format_2)
