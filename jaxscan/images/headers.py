"""How large a photograph is, from its header: known before anything is allocated for its pixels.

A decoder trusts what a header says: one of 2 kB can ask for gigabytes. So the formats are those whose size is read
here, PNG, JPEG, TIFF, BMP, PNM and WebP, and a photograph has at most `MOST_PIXELS`.

Source: the W3C's PNG specification; ITU T.81 (JPEG); Adobe's TIFF 6.0, and BigTIFF; Microsoft's BITMAPINFOHEADER;
Netpbm's PNM; Google's WebP container.
"""

import os
import re
import struct
from dataclasses import dataclass
from typing import Final

from jaxscan.errors import InputError

# The largest sensors of cameras that one can buy have 150 million.
MOST_PIXELS: Final = 200_000_000

PNG_START: Final = b"\x89PNG\r\n\x1a\n"
JPEG_START: Final = b"\xff\xd8\xff"
_JPEG_END: Final = b"\xff\xd9"
# Start-of-frame markers hold the size; the codes left out are tables and reserved ones.
_JPEG_FRAMES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_SCAN: Final = 0xDA
# Each block of 8 × 8 pixels takes a bit or more in these: baseline, extended and progressive; and half of that again.
_JPEG_HUFFMAN: Final = (0xC0, 0xC1, 0xC2)
_JPEG_PIXELS_A_BYTE: Final = 1024
_PNG_SAMPLES: Final = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
# Deflate expands one byte to at most this number of bytes.
_DEFLATED_AT_MOST: Final = 1032
_PNM: Final = re.compile(rb"P[1-6]\s(?:\s|#[^\n]*\n)*(\d{1,9})\s(?:\s|#[^\n]*\n)*(\d{1,9})\s")


@dataclass(frozen=True)
class Header:
    """What a photograph says of itself before its pixels begin.

    Attributes:
        size: columns and rows.
        channels: of a PNG or JPEG: 1 for grey, 3 or more for colour; 0 of other formats, whose decoder knows.
        pixels_at: of a PNG or JPEG, where the pixels begin; 0 of other formats.
        least_bytes: fewer than which the whole file cannot have.
    """

    size: tuple[int, int]
    channels: int = 0
    pixels_at: int = 0
    least_bytes: int = 0


def read_header(data: bytes) -> Header | None:
    """The header of a photograph; None of any other file, or where the header is damaged or goes on beyond the data."""
    if data.startswith(JPEG_START):
        return _jpeg(data)
    if data.startswith(PNG_START):
        return _png(data)
    size = None
    if data.startswith(b"BM"):
        size = _bmp(data)
    elif data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        size = _tiff(data)
    elif data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        size = _webp(data)
    elif found := _PNM.match(data):
        size = int(found[1]), int(found[2])
    return None if size is None else Header(size)


def is_whole(data: bytes, header: Header) -> bool:
    """Whether a PNG or JPEG ends where it says, and is as long as its pixels take; of other formats nothing is known.

    Bytes after the end are allowed: some cameras append a preview.
    """
    if data.startswith(PNG_START):
        ended = _png_ends(data)
    else:
        ended = not header.channels or data.rfind(_JPEG_END) >= header.pixels_at
    return ended and len(data) >= header.least_bytes


def _png_ends(data: bytes) -> bool:
    """Whether chunk follows chunk up to the last: libpng allocates what a chunk says of its length."""
    at = len(PNG_START)
    while at + 12 <= len(data):
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        at += 12 + length
        if kind == b"IEND":
            return at <= len(data)
    return False


def check_size(path: str | os.PathLike[str], size: tuple[int, int]) -> None:
    """Refuse a photograph without pixels, or with more than any camera takes.

    Raises:
        InputError: it is one.
    """
    columns, rows = size
    if not 0 < columns * rows <= MOST_PIXELS:
        raise InputError(
            f"{path}: its header says {columns} × {rows} pixels, a photograph has 1 to {MOST_PIXELS // 10**6} million: "
            "copy or record it again"
        )


def _png(data: bytes) -> Header | None:
    if len(data) < 26 or data[12:16] != b"IHDR":
        return None
    columns, rows = (int.from_bytes(data[i : i + 4], "big") for i in (16, 20))
    depth, colours = data[24], data[25]
    row_bytes = (columns * depth * _PNG_SAMPLES.get(colours, 1) + 7) // 8
    # Colour types 0 and 4 are grey; 2, 3 (palette) and 6 are colour.
    return Header((columns, rows), 1 if colours in (0, 4) else 3, 26, rows * row_bytes // _DEFLATED_AT_MOST)


def _jpeg(data: bytes) -> Header | None:
    """Walk from marker to marker, past a thumbnail's own end marker, to where the pixels begin."""
    at, size, channels, least = 2, None, 0, 0
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if marker == 0xFF:
            at += 1
            continue
        if marker in _JPEG_FRAMES and at + 10 <= len(data):
            rows, columns = (int.from_bytes(data[at + i : at + i + 2], "big") for i in (5, 7))
            size, channels = (columns, rows), data[at + 9]
            least = columns * rows // _JPEG_PIXELS_A_BYTE if marker in _JPEG_HUFFMAN else 0
        if marker == _JPEG_SCAN:
            break
        at += 2 + length
    return None if size is None else Header(size, channels, at, least)


def _bmp(data: bytes) -> tuple[int, int] | None:
    if len(data) < 26:
        return None
    form = "<HH" if data[14:18] == b"\x0c\0\0\0" else "<ii"  # of OS/2, and of all others
    columns, rows = struct.unpack_from(form, data, 18)
    return abs(columns), abs(rows)  # rows below 0 stand from the top down


def _tiff(data: bytes) -> tuple[int, int] | None:
    """The larger of the image's and its tiles' size: both are allocated."""
    order = "<" if data.startswith(b"II") else ">"
    big = data[2:4] in (b"+\0", b"\0+")
    count, value, entry = ("Q", "Q", 20) if big else ("H", "I", 12)
    try:
        (at,) = struct.unpack_from(order + value, data, 8 if big else 4)
        (entries,) = struct.unpack_from(order + count, data, at)
        at += struct.calcsize(count)
        found: dict[int, int] = {}
        for place in range(at, at + entry * min(entries, 4096), entry):
            tag, kind = struct.unpack_from(order + "HH", data, place)
            form = {3: "H", 4: "I", 16: "Q"}.get(kind)
            if tag in (256, 257, 322, 323) and form is not None:
                (number,) = struct.unpack_from(order + form, data, place + entry - struct.calcsize(value))
                found[tag] = max(found.get(tag, 0), number)
    except (struct.error, OverflowError):  # beyond the data
        return None
    if 256 not in found or 257 not in found:
        return None
    if found.get(322, 0) * found.get(323, 0) > MOST_PIXELS:
        return found[322], found[323]
    return found[256], found[257]


def _webp(data: bytes) -> tuple[int, int] | None:
    if len(data) < 30:
        return None
    if data[12:16] == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if data[12:16] == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    columns, rows = struct.unpack_from("<HH", data, 26)
    return columns & 0x3FFF, rows & 0x3FFF
