"""Which points of a grid a section goes through: not those at the end of a surface along its stripe."""

import numpy as np
import pytest

from jaxscan.measurement.section import _inner


def inner(text: str) -> str:
    """Of a line of points, a letter for each height and a dot for none, those that count."""
    there = np.array([letter != "." for letter in text])
    number = np.full((3, len(text)), -1)
    number[:, there] = np.arange(3 * there.sum()).reshape(3, -1)
    column = np.flatnonzero(there)
    height = np.array([10.0 * (ord(text[c]) - ord("a")) for c in column])
    line = np.stack([0.5 * column, np.zeros(len(column)), height], axis=-1)
    points = np.concatenate([line + np.array([0.0, y, 0.0]) for y in range(3)])
    kept = _inner(number, points)
    assert (kept == kept[0]).all()
    return "".join(letter if is_kept else "." for letter, is_kept in zip(text, kept[0], strict=True))


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        ("aaaaaaaaaaaaaaaaaaaa", "..aaaaaaaaaaaaaaaa.."),
        # An edge of depth ends a surface as a gap does.
        ("aaaaaaaaaabbbbbbbbbb", "..aaaaaa....bbbbbb.."),
        ("aaaaaaaaaa.aaaaaaaaa", "..aaaaaa....aaaaaaa."),
        # Of a narrow one less is left out, and two points are no surface.
        ("aaaaaaa...aaaa....aa", ".aaaaa....aaaa......"),
    ],
)
def test_the_ends_of_surfaces_are_left_out(text: str, kept: str) -> None:
    assert inner(text) == kept
