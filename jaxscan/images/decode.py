"""Photographs and videos to arrays and back: (rows, columns) grey or (rows, columns, 3) in the order red, green, blue.

OpenCV returns a picture that is half grey for a JPEG that was cut off, and nothing but `None` for a file that is not
there. So the file is read here, its end marker is looked for, and only then is it decoded. The orientation noted by a
camera in the file's metadata is not applied: calibration is about the pixels of the detector.
"""

import contextlib
import io
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import simplejpeg
from jaxtyping import UInt

from jaxscan.atomic import replacing
from jaxscan.errors import InputError

Image = UInt[np.ndarray, "rows columns *rgb"]
# Numbers of a 16-bit photograph for one grey level, a number of an 8-bit one: 65535 / 255.
NUMBERS_PER_LEVEL: Final = 257

_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND\xaeB`\x82"
_NPY_START = b"\x93NUMPY"
_JPEG_START = b"\xff\xd8\xff"
_JPEG_END = b"\xff\xd9"
# Start-of-frame markers hold the size; the codes left out are tables and reserved ones.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_SCAN = 0xDA
# Enough for the metadata and thumbnail that a camera puts before the size.
_HEADER_BYTES = 1 << 18


@dataclass(frozen=True)
class _Header:
    """What a PNG or JPEG says of itself before its pixels begin."""

    size: tuple[int, int]
    channels: int
    pixels_at: int


def read_image(path: str | os.PathLike[str], out: Image | None = None) -> Image:
    """A photograph, uint8 or uint16 as stored; grey stays grey, and an alpha channel is dropped.

    Args:
        path: a PNG, JPEG, TIFF or the like, or an array in NumPy's own format.
        out: where to put it, where its shape and depth are the photograph's; it is then what is returned.

    Raises:
        InputError: the file is missing, is not an image, is cut off, or has pixels that are not 8 or 16 bit integers.
    """
    data = _read_bytes(Path(path))
    header = _whole(path, data)
    image = _decoded(path, data, header, out)
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: its pixels are {image.dtype}: save it with 8 or 16 bits a channel")
    if out is None or image is out or image.shape != out.shape or image.dtype != out.dtype:
        return image
    np.copyto(out, image)
    return out


def _whole(path: str | os.PathLike[str], data: bytes) -> _Header | None:
    """What `_header` returns; an error when there is nothing, or no end."""
    if not data:
        raise InputError(f"{path}: the file is empty: copy or record it again")
    header = _header(data)
    if header is not None:
        end = _PNG_END if data.startswith(_PNG_START) else _JPEG_END
        # Bytes after the end marker are allowed: some cameras append a preview.
        if data.rfind(end) < header.pixels_at:
            raise InputError(f"{path}: the image is cut off after {len(data)} bytes: copy or record it again")
    return header


def _decoded(path: str | os.PathLike[str], data: bytes, header: _Header | None, out: Image | None) -> Image:
    if data.startswith(_JPEG_START) and header is not None and header.channels in (1, 3):
        # Straight to where it is wanted; what this decoder finds fault with, the other may still read.
        with contextlib.suppress(ValueError):
            return _decode_jpeg(data, header, out)
    if data.startswith(_NPY_START):
        return _array(path, data)
    keep = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    known_colour = header is not None and header.channels >= 3
    colour = cv2.IMREAD_COLOR_RGB if known_colour else cv2.IMREAD_ANYCOLOR
    with _quiet():
        image = cv2.imdecode(np.frombuffer(data, np.uint8), keep | colour)
    if image is None:
        raise InputError(f"{path}: is not an image that can be decoded: give a PNG, JPEG, TIFF or the like")
    if image.ndim == 3 and not known_colour:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return image


def _decode_jpeg(data: bytes, header: _Header, out: Image | None) -> Image:
    columns, rows = header.size
    shape = (rows, columns) if header.channels == 1 else (rows, columns, 3)
    if out is None or out.shape != shape or out.dtype != np.uint8 or not out.flags.c_contiguous:
        out = np.empty(shape, np.uint8)
    simplejpeg.decode_jpeg(data, "GRAY" if header.channels == 1 else "RGB", buffer=out)
    return out


def _array(path: str | os.PathLike[str], data: bytes) -> Image:
    try:
        image = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise InputError(f"{path}: is no whole NumPy array ({error}): write it again") from error
    if (image.ndim != 2 and (image.ndim != 3 or image.shape[2] != 3)) or 0 in image.shape:
        raise InputError(f"{path}: is an array of shape {image.shape}: give (rows, columns) or (rows, columns, 3)")
    return image


def image_size(path: str | os.PathLike[str], to_its_end: bool = False) -> tuple[int, int]:
    """Columns and rows of a photograph; a PNG or JPEG is not decoded.

    Args:
        path: as of `read_image`.
        to_its_end: whether a PNG or JPEG that is cut off after its header is refused too, for the price of reading it.

    Raises:
        InputError: as `read_image`.
    """
    header = _whole(path, _read_bytes(Path(path))) if to_its_end else _header(_read_bytes(Path(path), _HEADER_BYTES))
    if header is not None:
        return header.size
    rows, columns = read_image(path).shape[:2]
    return columns, rows


def read_video(path: str | os.PathLike[str]) -> Iterator[UInt[np.ndarray, "rows columns 3"]]:
    """The frames of a video, one by one. The file is opened at once, not with the first frame.

    A video that ends before its header says is warned of: containers estimate how long they are, so it is no error.

    Raises:
        InputError: the file is missing, or is not a video that can be decoded.
    """
    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such file: check the name")
    # FFmpeg under OpenCV has its own voice, which the environment sets alone, and only before the first is opened.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    with _quiet():
        capture = cv2.VideoCapture(os.fspath(path))
        # Some files open that hold no frame.
        there, first = capture.read()
    if not there:
        capture.release()
        raise InputError(f"{path}: is not a video that can be decoded: convert it to MP4 or AVI")
    return _frames(path, capture, first)


def _frames(
    path: str | os.PathLike[str], capture: cv2.VideoCapture, frame: UInt[np.ndarray, "rows columns 3"]
) -> Iterator[UInt[np.ndarray, "rows columns 3"]]:
    promised, count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0
    try:
        there = True
        while there:
            yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
            count += 1
            there, frame = capture.read()
    finally:
        capture.release()
    if count < promised:
        warnings.warn(f"{path}: ends after {count} of {promised} frames: copy it again if it was cut off", stacklevel=2)


def to_grey(image: Image) -> UInt[np.ndarray, "rows columns"]:
    """Luminance of a colour image, in the same depth; a grey image is returned as it is."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def check_image_ending(path: str | os.PathLike[str]) -> None:
    """Refuse a name whose ending is no image format's, before the work that leads to the picture.

    Raises:
        InputError: it is none.
    """
    if not cv2.haveImageWriter(os.fspath(path)):
        raise InputError(f'{path}: "{Path(path).suffix}" is no ending of an image: write .png or .jpg')


def write_image(path: str | os.PathLike[str], image: Image) -> None:
    """Write a grey or RGB image in the format that the name's ending asks for; whole or not at all.

    Raises:
        InputError: the ending is no image format's, the format cannot hold the image, or the place cannot be written.
    """
    check_image_ending(path)
    stored = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    ending = Path(path).suffix
    if image.dtype == np.uint16 and ending.lower() not in (".png", ".tif", ".tiff"):
        raise InputError(f'{path}: "{ending}" does not hold 16 bits a channel: write .png or .tif')
    try:
        with _quiet():
            _, data = cv2.imencode(ending, stored)
    except cv2.error as error:
        raise InputError(f'{path}: "{ending}" cannot hold this image ({error.err}): write .png or .jpg') from error
    with replacing(path) as file:
        file.write(data.tobytes())


def _read_bytes(path: Path, limit: int = -1) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(limit)
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no such file: check the name") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder: name an image in it") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): check its permissions and its disk") from error


def _header(data: bytes) -> _Header | None:
    """Size and channels of a PNG or JPEG; None of any other format, or when the header itself is damaged."""
    if data.startswith(_PNG_START) and len(data) >= 26:
        columns, rows = (int.from_bytes(data[i : i + 4], "big") for i in (16, 20))
        # Colour types 0 and 4 are grey; 2, 3 (palette) and 6 are colour.
        return _Header((columns, rows), 1 if data[25] in (0, 4) else 3, 26)
    return _jpeg_header(data) if data.startswith(_JPEG_START) else None


def _jpeg_header(data: bytes) -> _Header | None:
    """Walk from marker to marker, past a thumbnail's own end marker, to where the pixels begin."""
    at, size, channels = 2, None, 0
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if marker == 0xFF:
            at += 1
            continue
        if marker in _JPEG_FRAMES and at + 10 <= len(data):
            rows, columns = (int.from_bytes(data[at + i : at + i + 2], "big") for i in (5, 7))
            size, channels = (columns, rows), data[at + 9]
        if marker == _JPEG_SCAN:
            break
        at += 2 + length
    return None if size is None else _Header(size, channels, at)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep OpenCV from writing to standard error what an `InputError` is about to say."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)
