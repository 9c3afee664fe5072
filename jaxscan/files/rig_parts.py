"""Parts of a rig as files have them, by `rig.kinds`.

A light or a motion is an object with its kind, its name and its numbers; a lens has them in the camera's object.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from jaxscan.files.axes import read_axis_name
from jaxscan.files.table import LARGEST, Table
from jaxscan.rig import (
    LENSES,
    LIGHTS,
    MOTIONS,
    AxisMotion,
    HeadPoses,
    Lens,
    Light,
    Motion,
    MovingLight,
    ObjectPoses,
    Screw,
    ScrewOnGuide,
    motion_of,
)
from jaxscan.rig.light import moves


def part_tables(table: Table, key: str, of: str) -> list[Table]:
    """The tables of the parts that are listed under a key; none where it is left out.

    Raises:
        InputError: what is there is no list of objects.
    """
    values = table.values.get(key, [])
    if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
        raise table.error(key, f"must be a list of {of}, each an object with its kind and its numbers")
    return [Table(table.path, f"{table.prefix}{key}.{i}.", value) for i, value in enumerate(values)]


def read_lens(table: Table, beside: Sequence[str], unknown: list[str]) -> Lens:
    """The lens of a camera's table; keys that are not known are added to the unknown ones.

    Args:
        table: with the kind as `lens`, and its numbers.
        beside: what else a camera has.
        unknown: what was not known so far.

    Raises:
        InputError: what is no lens, and why.
    """
    kind = LENSES[table.string("lens", choices=tuple(LENSES))]
    unknown += [table.prefix + key for key in table.unknown((*beside, "lens", *kind.numbers))]
    return kind(**{name: leaves(_coefficients(table, kind, name)) for name in kind.numbers})


def _coefficients(table: Table, kind: type[Any], key: str) -> tuple[float, ...]:
    count = kind.numbers[key]
    values = table.numbers(key) if count or key in table else ()
    if len(values) != count:
        here = f'the lens "{kind.kind}" has {count} {key} coefficients, here are {len(values)}: correct one of them'
        raise table.error(key, here)
    return values


def read_lights(tables: Sequence[Table], unknown: list[str]) -> tuple[Light, ...]:
    """The lights of these tables; keys that are not known are added to the unknown ones.

    Raises:
        InputError: what is no light, and why.
    """
    lights: list[Light] = []
    for table in tables:
        name = table.string("name") if table.values.get("name", "") != "" else ""
        kind = LIGHTS[_kind(table, LIGHTS)]
        axis = {"axis": read_axis_name(table)} if moves(kind) else {}
        lights.append(_part(table, kind, unknown, name=name, **axis))
    names = [light.name for light in lights]
    for i, (table, name) in enumerate(zip(tables, names, strict=True)):
        if len(names) > 1 and (not name or name in names[:i]):
            raise table.error("name", f'of several lasers each needs a "name" of its own; they are {names}')
    return tuple(lights)


def read_motion(tables: Sequence[Table], unknown: list[str]) -> Motion:
    """The motion of the axes of these tables; keys that are not known are added to the unknown ones.

    Raises:
        InputError: what is no motion, and why.
    """
    parts: list[AxisMotion] = []
    for table in tables:
        axis = read_axis_name(table)
        if axis in [part.axis for part in parts]:
            raise table.error("axis", "appears twice: give each axis a name of its own")
        kind = MOTIONS[_kind(table, MOTIONS)]
        parts.append(_part(table, kind, unknown, axis=axis))
        travel = next(iter(kind.numbers))
        if not isinstance(parts[-1], HeadPoses | ObjectPoses) and max(map(abs, table.numbers(travel))) < 1 / LARGEST:
            raise table.error(travel, f"the {axis} does not move: leave it out, or calibrate it")
        if isinstance(parts[-1], Screw | ScrewOnGuide) and table.numbers("period", 1)[0] <= 0:
            raise table.error("period", "must be the steps of one turn of the screw, above 0: calibrate again")
    return motion_of(tuple(parts))


def _kind(table: Table, kinds: Mapping[str, object]) -> str:
    kind = table.string("kind")
    if kind not in kinds:
        raise table.error(
            "kind",
            f"this version of jaxscan knows {', '.join(kinds)}: use the version that wrote the file, or register the "
            "kind before the file is read",
        )
    return kind


def _part(table: Table, kind: type[Any], unknown: list[str], **named: str) -> Any:
    """A light, or the motion of an axis: its numbers as tuples of leaves."""
    unknown += [table.prefix + key for key in table.unknown(("kind", *named, *kind.numbers))]
    return kind(**{name: leaves(table.numbers(name, count)) for name, count in kind.numbers.items()}, **named)


def lights_values(lights: tuple[Light, ...]) -> list[dict[str, Any]]:
    """The inverse of `read_lights`."""
    moved = [{"axis": light.axis} if isinstance(light, MovingLight) else {} for light in lights]
    return [
        {"name": light.name, "kind": light.kind, **axis, **part_numbers(light)}
        for light, axis in zip(lights, moved, strict=True)
    ]


def motion_values(motion: Motion) -> list[dict[str, Any]]:
    """The inverse of `read_motion`."""
    return [{"axis": part.axis, "kind": part.kind, **part_numbers(part)} for part in motion.parts()]


def part_numbers(part: Lens | Light | AxisMotion) -> dict[str, list[float]]:
    """Its numbers by their names."""
    return {name: [float(leaf) for leaf in getattr(part, name)] for name in part.numbers}


def leaves(values: tuple[float, ...]) -> tuple[Array, ...]:
    """Numbers of a part as its leaves."""
    return tuple(jnp.asarray(value, jnp.float64) for value in values)
