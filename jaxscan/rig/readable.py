"""What a rig and its parts look like when they are printed: their numbers with units, and no types of arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, ClassVar, Final

import equinox as eqx
import numpy as np

# Of more numbers than these their count and their range are shown.
_MOST_NUMBERS: Final = 12


class Readable(eqx.Module):
    """A part of a rig whose `repr` has its numbers, each name with its unit.

    Attributes:
        units: of its numbers, by their names; a number that has none is not among them.
    """

    units: ClassVar[Mapping[str, str]] = {}

    def __repr__(self) -> str:
        try:
            return f"{type(self).__name__}({', '.join(self._said())})"
        except (TypeError, ValueError):
            # Under a transformation, or in a tree of something else, there are no numbers.
            return eqx.Module.__repr__(self)

    def _said(self) -> list[str]:
        """The fields, one text each; those that are empty are left out."""
        said = []
        for each in fields(self):
            value: Any = getattr(self, each.name)
            if isinstance(value, str):
                said += [f'{each.name} "{value}"'] if value else []
            elif isinstance(value, tuple):
                said += [in_units(each.name, value, self.units.get(each.name, ""))] if value else []
            else:
                said.append(repr(value))
        return said


def in_units(name: str, values: Sequence[Any], unit: str) -> str:
    """A name with its numbers and their unit, as "focal 701.2 699.8 px".

    Raises:
        TypeError: a value is no number.
        ValueError: one is an array of several.
    """
    numbers = np.array([float(value) for value in values])
    if len(numbers) > _MOST_NUMBERS:
        said = f"of {len(numbers)} numbers from {numbers.min():.4g} to {numbers.max():.4g}"
    else:
        said = " ".join(f"{number:.6g}" for number in numbers)
    return f"{name} {said} {unit}".rstrip()
