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
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import simplejpeg
from jaxtyping import UInt, UInt8

from jaxscan.atomic import replacing
from jaxscan.errors import InputError, error_context
from jaxscan.images.headers import JPEG_START, MOST_PIXELS, Header, check_size, is_whole, read_header
from jaxscan.missing import no_such_file
from jaxscan.npy import NPY_START, NpyHeader, read_npy, read_npy_header

Image = UInt[np.ndarray, "rows columns *rgb"]
# Numbers of a 16-bit photograph for one grey level, a number of an 8-bit one: 65535 / 255.
NUMBERS_PER_LEVEL: Final = 257

# Enough for the metadata and thumbnail that a camera puts before the size.
_HEADER_BYTES = 1 << 18
# Among this number of bytes, any video has one that does not occur in text in ASCII or UTF-8.
_OF_A_HEADER = 64
_OF_TEXT = {*b"\t\n\f\r", *range(0x20, 0x7F), *b"\xef\xbb\xbf"}
_FORMATS: Final = "a PNG, JPEG, TIFF, BMP, PNM or WebP"


def read_image(path: str | os.PathLike[str], out: Image | None = None) -> Image:
    """A photograph, uint8 or uint16 as stored; grey stays grey, and an alpha channel is dropped.

    Args:
        path: a PNG, JPEG, TIFF, BMP, PNM or WebP, or an array in NumPy's own format, of at most `MOST_PIXELS`.
        out: where to put it, where its shape and depth are the photograph's; it is then what is returned.

    Raises:
        InputError: the file is missing, is not an image, is cut off, has more pixels than a photograph has, or has
            pixels that are not 8 or 16 bit integers.
    """
    return decode_image(path, _read_bytes(Path(path)), out)


def decode_image(path: str | os.PathLike[str], data: bytes, out: Image | None = None) -> Image:
    """As `read_image`, of a file's bytes; `path` names it in errors."""
    image = _array(path, data) if data.startswith(NPY_START) else _decoded(path, data, _whole(path, data), out)
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: its pixels are {image.dtype}: save it with 8 or 16 bits a channel")
    if out is None or image is out or image.shape != out.shape or image.dtype != out.dtype:
        return image
    np.copyto(out, image)
    return out


def eight_bits(image: Image) -> UInt8[np.ndarray, "rows columns *rgb"]:
    """A photograph in grey levels of 8 bits: as it is, or of 16 bits rounded."""
    return image if image.dtype == np.uint8 else np.round(image / np.float32(NUMBERS_PER_LEVEL)).astype(np.uint8)


def _whole(path: str | os.PathLike[str], data: bytes) -> Header:
    """The header; an error where there is nothing, no photograph, one too large, or no end."""
    if not data:
        raise InputError(f"{path}: the file is empty: copy or record it again")
    header = read_header(data)
    if header is None:
        raise InputError(f"{path}: is not an image that can be decoded: give {_FORMATS}")
    check_size(path, header.size)
    if not is_whole(data, header):
        raise InputError(f"{path}: the image is cut off after {len(data)} bytes: copy or record it again")
    return header


def _decoded(path: str | os.PathLike[str], data: bytes, header: Header, out: Image | None) -> Image:
    if data.startswith(JPEG_START) and header.channels in (1, 3):
        # Straight to where it is wanted; what this decoder finds fault with, the other may still read.
        with contextlib.suppress(ValueError):
            return _decode_jpeg(data, header, out)
    keep = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    known_colour = header.channels >= 3
    colour = cv2.IMREAD_COLOR_RGB if known_colour else cv2.IMREAD_ANYCOLOR
    try:
        with _quiet():
            image = cv2.imdecode(np.frombuffer(data, np.uint8), keep | colour)
    except cv2.error as error:
        raise InputError(f"{path}: is not an image that can be decoded ({error.err}): give {_FORMATS}") from error
    if image is None or image.shape[1::-1] != header.size:
        raise InputError(f"{path}: is not an image that can be decoded: give {_FORMATS}")
    if image.ndim == 3 and not known_colour:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return image


def _decode_jpeg(data: bytes, header: Header, out: Image | None) -> Image:
    columns, rows = header.size
    shape = (rows, columns) if header.channels == 1 else (rows, columns, 3)
    if out is None or out.shape != shape or out.dtype != np.uint8 or not out.flags.c_contiguous:
        out = np.empty(shape, np.uint8)
    simplejpeg.decode_jpeg(data, "GRAY" if header.channels == 1 else "RGB", buffer=out)
    return out


def _array(path: str | os.PathLike[str], data: bytes) -> Image:
    file = io.BytesIO(data)
    header = read_npy_header(os.fspath(path), file)
    check_size(path, _array_size(path, header))
    return read_npy(os.fspath(path), file, header, len(data) - file.tell())


def _array_size(path: str | os.PathLike[str], header: NpyHeader) -> tuple[int, int]:
    """Columns and rows."""
    shape = header.shape
    if (len(shape) != 2 and (len(shape) != 3 or shape[2] != 3)) or 0 in shape:
        raise InputError(f"{path}: is an array of shape {shape}: give (rows, columns) or (rows, columns, 3)")
    return shape[1], shape[0]


def image_size(path: str | os.PathLike[str], to_its_end: bool = False) -> tuple[int, int]:
    """Columns and rows of a photograph; it is not decoded.

    Args:
        path: as of `read_image`.
        to_its_end: whether a PNG or JPEG that is cut off after its header is refused too, for the price of reading it.

    Raises:
        InputError: as `read_image`.
    """
    data = _read_bytes(Path(path), -1 if to_its_end else _HEADER_BYTES)
    if data.startswith(NPY_START):
        size = _array_size(path, read_npy_header(os.fspath(path), io.BytesIO(data)))
        check_size(path, size)
        return size
    if not to_its_end and (header := read_header(data)) is not None:
        check_size(path, header.size)
        return header.size
    # What has its header further on, as a TIFF may, is read whole.
    return _whole(path, data if to_its_end or len(data) < _HEADER_BYTES else _read_bytes(Path(path))).size


def read_video(path: str | os.PathLike[str]) -> Iterator[UInt[np.ndarray, "rows columns 3"]]:
    """The frames of a video, one by one. The file is opened at once, not with the first frame.

    A video that ends before its header says is warned of: containers estimate how long they are, so it is no error.

    Raises:
        InputError: the file is missing, or is not a video that can be decoded.
    """
    if not Path(path).is_file():
        raise no_such_file(Path(path))
    # FFmpeg would go on to the files and addresses that a playlist names, whatever the playlist is called.
    if _is_text(path):
        raise InputError(f"{path}: is not a video that can be decoded, but text: convert it to MP4 or AVI")
    # FFmpeg under OpenCV has its own voice, which the environment sets alone, and only before the first is opened.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    with _quiet():
        capture = cv2.VideoCapture(os.fspath(path))
        # The size is known before the first frame is decoded; some files open that hold none.
        size = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        fits = 0 <= size[0] * size[1] <= MOST_PIXELS
        there, first = capture.read() if fits else (False, np.zeros((0, 0, 3), np.uint8))
    if not fits:
        capture.release()
        check_size(path, size)
    if not there:
        capture.release()
        raise InputError(f"{path}: is not a video that can be decoded: convert it to MP4 or AVI")
    return _frames(path, capture, first)


def _is_text(path: str | os.PathLike[str]) -> bool:
    """Whether a file begins as text does; no container of a video does."""
    begin = _read_bytes(Path(path), _OF_A_HEADER)
    return bool(begin) and set(begin) <= _OF_TEXT


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


def encoded(ending: str, image: Image) -> bytes:
    """A grey or RGB image in the format of an ending, such as ".png".

    Raises:
        InputError: the format cannot hold the image.
    """
    stored = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    if image.dtype == np.uint16 and ending.lower() not in (".png", ".tif", ".tiff"):
        raise InputError(f'"{ending}" does not hold 16 bits a channel: write .png or .tif')
    try:
        with _quiet():
            _, data = cv2.imencode(ending, stored)
    except cv2.error as error:
        raise InputError(f'"{ending}" cannot hold this image ({error.err}): write .png or .jpg') from error
    return data.tobytes()


def write_image(path: str | os.PathLike[str], image: Image) -> None:
    """Write a grey or RGB image in the format that the name's ending asks for; whole or not at all.

    Raises:
        InputError: the ending is no image format's, the format cannot hold the image, or the place cannot be written.
    """
    check_image_ending(path)
    with error_context(path):
        data = encoded(Path(path).suffix, image)
    with replacing(path) as file:
        file.write(data)


def _read_bytes(path: Path, limit: int = -1) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(limit)
    except FileNotFoundError as error:
        raise no_such_file(Path(path)) from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder: name an image in it") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}): check its permissions and its disk") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep OpenCV from writing to standard error what an `InputError` is about to say."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)
