"""A board on paper: the finder finds what is printed, and its squares have the size that is written on it."""

import math
import re
import xml.etree.ElementTree as ET

import cv2
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.board_page import PAGES, board_page, in_words, to_pdf, to_svg, write_board_page
from jaxscan.images import Board, find_board
from jaxscan.images.board_marks import Disc, Rectangle

BOARDS = {
    "checkerboard": Board.checkerboard((9, 6), 16.0),
    "circles": Board.circles((7, 6), 22.0, 9.0),
    "charuco": Board.charuco((10, 7), 22.0, 15.0, "DICT_4X4_50"),
    "charuco of an even number of rows": Board.charuco((9, 6), 20.0, 15.0, "DICT_5X5_100"),
}
# Samples for each mm, and pixels of the photograph for each mm: edges are averaged.
FINE, PX = 24, 4


def photograph_of(svg: bytes) -> np.ndarray:
    """What a camera would see of a page that lies square before it, from the shapes in the SVG."""
    root = ET.fromstring(svg)
    width, height = (float(root.attrib[name].removesuffix("mm")) for name in ("width", "height"))
    # To whole millimetres, so that the photograph has exactly PX pixels for each.
    width, height = math.ceil(width), math.ceil(height)
    page = np.full((FINE * height, FINE * width), 255, np.uint8)
    for shape in root:
        name, at = shape.tag.rpartition("}")[2], shape.attrib
        grey = 255 if at.get("fill") == "white" else 0
        if name == "rect":
            x, y, w, h = (float(at.get(key, 0)) for key in ("x", "y", "width", "height"))
            page[round(FINE * y) : round(FINE * (y + h)), round(FINE * x) : round(FINE * (x + w))] = grey
        elif name == "circle":
            x, y, r = (float(at[key]) for key in ("cx", "cy", "r"))
            centre = tuple(round(256 * (FINE * value - 0.5)) for value in (x, y))
            cv2.circle(page, centre, round(256 * FINE * r), grey, cv2.FILLED, cv2.LINE_8, 8)
    size = PX * width, PX * height
    return cv2.resize(page, size, interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize("paper", PAGES)
@pytest.mark.parametrize("name", BOARDS)
def test_what_is_printed_is_found_with_its_size(name: str, paper: str) -> None:
    board = BOARDS[name]
    view = find_board(board, cv2.GaussianBlur(photograph_of(to_svg(board_page(board, paper))), (0, 0), 0.7))
    assert view is not None
    assert np.isfinite(view.corners).all()
    columns, rows = board.counts
    grid = view.corners.reshape(rows, columns, 2) / PX
    # Right and down: no turn, no mirror image.
    across, down = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    for long, count, along in ((across, columns, 0), (down, rows, 1)):
        np.testing.assert_allclose(long[:, along], (count - 1) * board.pitch_mm, atol=0.03)
        np.testing.assert_allclose(long[:, 1 - along], 0.0, atol=0.03)


@pytest.mark.parametrize("name", BOARDS)
def test_pdf_and_svg_are_one_page(name: str) -> None:
    page = board_page(BOARDS[name], "letter")
    text = to_pdf(page).decode("latin-1")
    k = 72 / 25.4
    assert "/MediaBox [0 0 792.0000 612.0000]" in text
    boxes = np.array([line.split()[2:6] for line in text.splitlines() if line.endswith(" re f")], float) / k
    boxes[:, 1] = page.size[1] - boxes[:, 1] - boxes[:, 3]
    np.testing.assert_allclose(boxes, [mark[:4] for mark in page.marks if isinstance(mark, Rectangle)], atol=1e-3)
    greys = [line[0] for line in text.splitlines() if line.endswith(" re f")]
    assert greys == ["0" if mark.dark else "1" for mark in page.marks if isinstance(mark, Rectangle)]
    discs = [line for line in text.splitlines() if line.startswith("0 g") and line.endswith(" f") and " c " in line]
    assert len(discs) == sum(isinstance(mark, Disc) for mark in page.marks)
    for line, mark in zip(discs, (mark for mark in page.marks if isinstance(mark, Disc)), strict=True):
        right, top = (float(value) / k for value in line.split()[2:4])
        assert (right - mark.radius, page.size[1] - top) == pytest.approx((mark.x, mark.y), abs=1e-3)
    # The places of the objects are where the table says.
    table = text[int(text.split("startxref\n")[1].split()[0]) :]
    for number, place in enumerate(re.findall(r"(\d{10}) 00000 n", table), start=1):
        assert text[int(place) :].startswith(f"{number} 0 obj")
    assert in_words(BOARDS[name]).split(",")[0] in text.replace("\\", "")


@pytest.mark.parametrize("paper", PAGES)
def test_the_ruler_has_its_length_and_all_is_within_the_margins(paper: str) -> None:
    page = board_page(BOARDS["checkerboard"], paper)
    ruler = [mark for mark in page.marks if isinstance(mark, Rectangle) and mark.height < 5]
    left, right = min(mark.x for mark in ruler), max(mark.x + mark.width for mark in ruler)
    assert right - left == pytest.approx(100.0)
    squares = [mark for mark in page.marks if isinstance(mark, Rectangle) and mark.height > 5]
    assert max(mark.y + mark.height for mark in squares) + 5 < min(mark.y for mark in ruler)
    for mark in page.marks:
        assert isinstance(mark, Rectangle)
        assert min(mark.x, mark.y) > 5
        assert mark.x + mark.width < page.size[0] - 5
        assert mark.y + mark.height < page.size[1] - 5


def test_a_board_that_is_too_large_is_refused_with_what_fits(tmp_path) -> None:
    with pytest.raises(InputError, match=r"too large for A4 .* give squares of 23\.\d mm or less"):
        board_page(Board.checkerboard((9, 6), 30.0))
    board_page(Board.checkerboard((9, 6), 23.3))
    with pytest.raises(InputError, match=r"board\.png: a board is written as \.svg or \.pdf"):
        write_board_page(tmp_path / "board.png", board_page(BOARDS["circles"]))
