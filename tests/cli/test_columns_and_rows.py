"""COLUMNSxROWS is read in one way by every command."""

import argparse

import pytest

from hardware.cli.options import board_of
from jaxscan.cli.camera_options import image_size
from jaxscan.cli.options import columns_and_rows
from jaxscan.errors import InputError

WRONG = [
    "",
    "9",
    "x",
    "9x",
    "x6",
    "9x²",
    "9x٣",
    "9x6x2",
    "-9x6",
    "9.0x6",
    "0x6",
    "9x0",
    "9 6",
    "9 x 6",
    "+9x6",
    "9_0x6",
]


@pytest.mark.parametrize("text", WRONG)
def test_what_is_none(text: str) -> None:
    assert columns_and_rows(text) is None
    with pytest.raises(argparse.ArgumentTypeError, match="write columns and rows"):
        image_size(text)
    with pytest.raises(InputError, match="give columns and rows of inner corners, as 9x6"):
        board_of(argparse.Namespace(board=text, square=10.0))


def test_what_is_read() -> None:
    assert columns_and_rows("9x6") == columns_and_rows("9X6") == columns_and_rows("09x6") == (9, 6)
    assert image_size("640x480") == (640, 480)
    assert board_of(argparse.Namespace(board="12x9", square=10.0)).counts == (12, 9)
