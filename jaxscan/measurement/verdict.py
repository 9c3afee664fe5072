"""Verdicts by ISO 14253-1: a tolerance is narrowed by the uncertainty before a part passes, widened before it fails."""

from collections.abc import Iterable
from typing import Final, Literal

from jaxscan.files.part_file import Dimension
from jaxscan.files.units import times_of_units

Verdict = Literal["conforming", "not conforming", "not decided"]

_WORST_FIRST: Final[tuple[Verdict, ...]] = ("not conforming", "not decided", "conforming")


def verdict(interval: tuple[float, float] | None, limits: tuple[float, float]) -> Verdict:
    """Whether a dimension conforms to its limits.

    Args:
        interval: that holds the true value with 95 %; None where it is not known, and nothing is decided.
        limits: the least and the largest value that are allowed.
    """
    if interval is None:
        return "not decided"
    low, high = interval
    if limits[0] <= low and high <= limits[1]:
        return "conforming"
    return "not conforming" if high < limits[0] or low > limits[1] else "not decided"


def worst_of(verdicts: Iterable[Verdict | None]) -> Verdict | None:
    """That of a whole of which each part has a verdict or, with None, has no limits; None where no part has any."""
    found = set(verdicts)
    return next((each for each in _WORST_FIRST if each in found), None)


def another_unit(dimension: Dimension, value: float | None) -> str | None:
    """A note where a length and its nominal value seem to be in two units; None where they do not.

    Args:
        dimension: with its nominal value.
        value: as measured, mm.
    """
    nominal = dimension.nominal
    if value is None or nominal is None or dimension.unit != "mm" or (times := times_of_units(value, nominal)) is None:
        return None
    return (
        f"is {times:g} times its nominal value of {nominal:g} mm: see units of [part], in which the file's numbers are"
    )
