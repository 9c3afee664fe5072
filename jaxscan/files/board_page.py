"""A calibration board on paper, true to size: a page with the pattern, a ruler and a caption, as SVG or as PDF.

Both formats are written here, in a page of code each: filled rectangles, circles and one line of text need no library.
SVG has millimetres; PDF counts in points of 1/72 inch from the lower left corner (ISO 32000-1, 8.3).
"""

import os
from dataclasses import dataclass
from typing import Final
from xml.sax.saxutils import escape

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.images import Board
from jaxscan.images.board_marks import Disc, Mark, Rectangle, board_marks, circle_diameter, pattern_size

# Width and height on their sides, mm.
PAGES: Final = {"A4": (297.0, 210.0), "letter": (279.4, 215.9)}
# Most printers leave this much of a page white, mm.
_MARGIN: Final = 7.0
# White around the pattern, which the corner finder needs, in parts of a square; and what ruler and caption take, mm.
_QUIET: Final = 0.4
_FOOT: Final = 13.0
_RULER_MM: Final = 100
_TEXT_MM: Final = 3.2
_POINTS_PER_MM: Final = 72 / 25.4
# A circle by four Bézier curves: how far the inner points stand from the outer ones, in radii.
_BEZIER: Final = 0.5522847498


@dataclass(frozen=True)
class BoardPage:
    """A page to print.

    Attributes:
        size: width and height, mm.
        marks: what is printed on it: the board and the ruler, x to the right and y down from the top left corner, mm.
        texts: x, y of the left end of the baseline, mm, and what is written there.
    """

    size: tuple[float, float]
    marks: tuple[Mark, ...]
    texts: tuple[tuple[float, float, str], ...]


def board_page(board: Board, paper: str = "A4") -> BoardPage:
    """A board on a page, with a ruler of 100 mm under it.

    Args:
        board: any kind.
        paper: a name in `PAGES`; the longer side lies across.

    Raises:
        InputError: the board is larger than the page; the text says how large its squares may be.
    """
    width, height = PAGES[paper]
    across, down = pattern_size(board)
    # What grows with the squares may take this much of the page.
    room = width - 2 * _MARGIN, height - 2 * _MARGIN - _FOOT
    needed = across + 2 * _QUIET * board.pitch_mm, down + 2 * _QUIET * board.pitch_mm
    fits = min(room[0] / needed[0], room[1] / needed[1])
    if fits < 1:
        what = "pitch" if board.kind == "circles" else "squares"
        raise InputError(
            f"the board is {across:.4g} x {down:.4g} mm, too large for {paper} with its margins: "
            f"give {what} of {int(10 * fits * board.pitch_mm) / 10:g} mm or less, fewer of them, or a larger --page"
        )
    left, top = (width - across) / 2, (height - _FOOT - down) / 2
    marks: list[Mark] = []
    for mark in board_marks(board):
        marks.append(mark._replace(x=left + mark.x, y=top + mark.y))
    foot = height - _MARGIN - _FOOT + 4.0
    marks += _ruler(_MARGIN + 3.0, foot)
    texts = (
        (_MARGIN + 3.0 + _RULER_MM + 4.0, foot + 3.0, "100 mm: print at 100 %, then measure this ruler"),
        (_MARGIN + 3.0, foot + 8.0, f"{in_words(board)}, {paper}"),
    )
    return BoardPage((width, height), tuple(marks), texts)


def in_words(board: Board) -> str:
    """The board in one line, as it is printed on the page."""
    columns, rows = board.counts
    if board.kind == "circles":
        diameter = f"diameter {circle_diameter(board):g} mm"
        return f"circles {columns} x {rows}, pitch_mm = {board.pitch_mm:g}, {diameter} (jaxscan)"
    if board.kind == "charuco":
        return (
            f"ChArUco, squares {columns + 1} x {rows + 1}, square_mm = {board.pitch_mm:g}, "
            f"marker_mm = {board.marker_mm:g}, {board.dictionary} (jaxscan)"
        )
    return f"checkerboard, inner_corners {columns} x {rows}, square_mm = {board.pitch_mm:g} (jaxscan)"


def write_board_page(path: str | os.PathLike[str], page: BoardPage) -> None:
    """Write a page as `.svg` or `.pdf`.

    Raises:
        InputError: another ending, or the file cannot be written.
    """
    ending = os.path.splitext(path)[1].lower()
    writers = {".svg": to_svg, ".pdf": to_pdf}
    if ending not in writers:
        raise InputError(f"{os.fspath(path)}: a board is written as .svg or .pdf: end its name with one of them")
    with replacing(path) as file:
        file.write(writers[ending](page))


def to_svg(page: BoardPage) -> bytes:
    """The page as SVG."""
    width, height = page.size
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}" shape-rendering="crispEdges">',
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
    ]
    for mark in page.marks:
        if isinstance(mark, Disc):
            lines.append(f'<circle cx="{mark.x:.6g}" cy="{mark.y:.6g}" r="{mark.radius:.6g}"/>')
        else:
            fill = "" if mark.dark else ' fill="white"'
            box = f'x="{mark.x:.6g}" y="{mark.y:.6g}" width="{mark.width:.6g}" height="{mark.height:.6g}"'
            lines.append(f"<rect {box}{fill}/>")
    for x, y, text in page.texts:
        lines.append(
            f'<text x="{x:.6g}" y="{y:.6g}" font-family="Helvetica, Arial, sans-serif" font-size="{_TEXT_MM:g}">'
            f"{escape(text)}</text>"
        )
    return "\n".join([*lines, "</svg>", ""]).encode()


def to_pdf(page: BoardPage) -> bytes:
    """The page as PDF 1.4, with the built-in font Helvetica."""
    k, (width, height) = _POINTS_PER_MM, page.size
    drawn = []
    for mark in page.marks:
        if isinstance(mark, Disc):
            drawn.append(_pdf_disc(k * mark.x, k * (height - mark.y), k * mark.radius))
        else:
            box = k * mark.x, k * (height - mark.y - mark.height), k * mark.width, k * mark.height
            drawn.append(f"{0 if mark.dark else 1} g " + " ".join(f"{v:.4f}" for v in box) + " re f")
    drawn += [
        f"BT 0 g /F1 {k * _TEXT_MM:.3f} Tf {k * x:.4f} {k * (height - y):.4f} Td ({_pdf_text(text)}) Tj ET"
        for x, y, text in page.texts
    ]
    content = "\n".join(drawn).encode("latin-1")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        (
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {k * width:.4f} {k * height:.4f}] /Contents 4 0 R "
            "/Resources << /Font << /F1 5 0 R >> >> >>"
        ).encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
    ]
    out, places = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, start=1):
        places.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % place for place in places)
    size = len(objects) + 1
    tail = b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (size, len(out))
    return out + b"xref\n0 %d\n0000000000 65535 f \n" % size + table + tail


def _ruler(x: float, y: float) -> list[Mark]:
    """A ruler of 100 mm with a line for each 10 mm; its outer lines stand inside its ends."""
    line, tick = 0.25, 2.5
    marks: list[Mark] = [Rectangle(x, y, float(_RULER_MM), line)]
    for mm in range(0, _RULER_MM + 1, 10):
        at = x + mm - line * mm / _RULER_MM
        marks.append(Rectangle(at, y, line, tick if mm % 50 else 1.6 * tick))
    return marks


def _pdf_disc(x: float, y: float, r: float) -> str:
    c = _BEZIER * r
    turns = [
        (x + r, y + c, x + c, y + r, x, y + r),
        (x - c, y + r, x - r, y + c, x - r, y),
        (x - r, y - c, x - c, y - r, x, y - r),
        (x + c, y - r, x + r, y - c, x + r, y),
    ]
    curves = " ".join(" ".join(f"{v:.4f}" for v in turn) + " c" for turn in turns)
    return f"0 g {x + r:.4f} {y:.4f} m {curves} f"


def _pdf_text(text: str) -> str:
    return text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
