"""Files that a reader once did not bear, made small: of which reader, what they are, and how they are refused.

"" in place of a text: the file is read, in time.
"""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.io

from tests import foreign_samples
from tests.fuzz.seeds import ARTEFACT, MOVED, POINTS, RIG_1, RIG_2

_RIG: Any = RIG_2


def _ros(old: str, new: str) -> bytes:
    assert old in foreign_samples.ROS
    return foreign_samples.ROS.replace(old, new, 1).encode()


def _npy(header: str, body: bytes = b"", length: int | None = None) -> bytes:
    size = len(header) if length is None else length
    return b"\x93NUMPY\x01\0" + struct.pack("<H", size) + header.encode() + body


def _shaped(shape: str, kind: str = "<u2", body: bytes = bytes(64)) -> bytes:
    return _npy(f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n", body)


def _zip(**members: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return file.getvalue()


def _flat_positions() -> bytes:
    flat, told = np.zeros((3, 4), np.float32), np.frombuffer(b'{"axes": []}', np.uint8)
    arrays = {"points": np.zeros((3, 4, 3), np.float32), "strength": flat, "sigma": flat, "valid": flat > 0}
    file = io.BytesIO()
    np.savez(file, **arrays, steps=np.arange(3), positions=np.arange(3), scanner=told)  # type: ignore[arg-type]
    return file.getvalue()


def _png(columns: int, rows: int, raw: bytes = bytes(1_000_000)) -> bytes:
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(raw, 9)),
        (b"IEND", b""),
    ]
    whole = [len(c).to_bytes(4, "big") + k + c + zlib.crc32(k + c).to_bytes(4, "big") for k, c in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(whole)


def _jpeg(columns: int, rows: int) -> bytes:
    frame = struct.pack(">BHHBBBB", 8, rows, columns, 1, 1, 0x11, 0)
    start = b"\xff\xd8\xff\xe0\0\x10JFIF\0\1\1\0\0\1\0\1\0\0"
    return start + b"\xff\xc0\0\x0b" + frame + b"\xff\xda\0\x08\1\1\0\0\x3f\0" + bytes(500) + b"\xff\xd9"


def _bmp(columns: int, rows: int) -> bytes:
    info = struct.pack("<IiiHHIIiiII", 40, columns, rows, 1, 24, 0, 0, 0, 0, 0, 0)
    return b"BM" + struct.pack("<IHHI", 54 + 500, 0, 0, 54) + info + bytes(500)


def _tiff(columns: int, rows: int, *more: tuple[int, int]) -> bytes:
    tags = [
        (256, columns),
        (257, rows),
        (258, 8),
        (259, 1),
        (262, 1),
        (273, 8),
        (277, 1),
        (278, rows),
        (279, 64),
        *more,
    ]
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in sorted(tags))
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(100)


def _webp(columns: int, rows: int) -> bytes:
    bits = (columns - 1) | (rows - 1) << 14
    return (
        b"RIFF"
        + struct.pack("<I", 30)
        + b"WEBPVP8L"
        + struct.pack("<I", 18)
        + b"\x2f"
        + struct.pack("<I", bits)
        + bytes(20)
    )


def _avi(columns: int, rows: int) -> bytes:
    def chunk(name: bytes, content: bytes) -> bytes:
        return name + struct.pack("<I", len(content)) + content

    main = struct.pack("<14I", 100_000, 0, 0, 16, 1, 0, 1, 0, columns, rows, 0, 0, 0, 0)
    stream = b"vidsMJPG" + struct.pack("<10I4H", 0, 0, 0, 1, 10, 0, 1, 0, 0, 0, 0, 0, 0, 0)
    form = struct.pack("<IiiHH4sIiiII", 40, columns, rows, 1, 24, b"MJPG", 0, 0, 0, 0, 0)
    lists = b"hdrl" + chunk(b"avih", main) + chunk(b"LIST", b"strl" + chunk(b"strh", stream) + chunk(b"strf", form))
    body = b"AVI " + chunk(b"LIST", lists) + chunk(b"LIST", b"movi" + chunk(b"00dc", _jpeg(columns, rows)))
    return chunk(b"RIFF", body)


def _glb(**accessor: Any) -> bytes:
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"} | accessor,
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 12},
        ],
        "buffers": [{"byteLength": 48}],
    }
    tree["accessors"][1] = {key: value for key, value in tree["accessors"][1].items() if value is not None}  # type: ignore[index]
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    body = np.arange(9, dtype="<f4").tobytes() + np.array([0, 1, 514], "<u4").tobytes()
    whole = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(body), 0x004E4942) + body
    return b"glTF" + struct.pack("<II", 2, 12 + len(whole)) + whole


def _ply(header: str, body: bytes, form: str = "binary_little_endian") -> bytes:
    return f"ply\nformat {form} 1.0\n{header}\nend_header\n".encode() + body


_XYZ = "property float x\nproperty float y\nproperty float z"


def _many_lists() -> bytes:
    lengths = np.random.default_rng(0).integers(0, 2, 6_000_000)
    body = np.zeros(len(lengths) + lengths.sum(), np.uint8)
    body[np.cumsum(1 + lengths) - 1 - lengths] = lengths
    header = f"element vertex 1\n{_XYZ}\nelement face {len(lengths)}\nproperty list uchar uchar vertex_indices"
    return _ply(header, bytes(12) + body.tobytes())


def _long_word() -> bytes:
    return _ply(f"element vertex 1\n{_XYZ}", b"1 2 3 " + b"4" * 1_000_000 + b" 5" * 1_000_000, "ascii")


def _rig(old: Any = _RIG, **changes: Any) -> bytes:
    values = json.loads(json.dumps(old))
    for name, value in changes.items():
        *tables, key = name.split("__")
        inner = values
        for table in tables:
            inner = inner[int(table) if isinstance(inner, list) else table]
        inner[key] = value
    return json.dumps(values).encode()


def _inflating() -> bytes:
    """A Matlab file of 200 variables, each of which unfolds to 60 MB."""
    head = struct.pack("<IIII IIii II", 6, 8, 6, 0, 5, 8, 1, 1, 1, 8) + b"unwanted"
    packed = zlib.compress(struct.pack("<II", 14, len(head) + (60 << 20)) + head + bytes(60 << 20), 9)
    element = struct.pack("<II", 15, len(packed)) + packed
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + element * 200


def _endless_board() -> bytes:
    file, board = io.BytesIO(), foreign_samples.board()
    board[0] = np.inf
    scipy.io.savemat(file, {"nx": 640.0, "ny": 480.0, "X_1": board, "x_1": np.ones((2, 54)), "n_ima": 1.0})
    return file.getvalue()


def _one_key_late() -> bytes:
    keys = ", ".join(f'"k{i}": 0' for i in range(200_000))
    return f'{{{keys}, "k199999": 1}}'.encode()


def _scan(frames: str) -> bytes:
    return f'[scan]\nframes = "{frames}"\nsteps_per_frame = 1\n'.encode()


KEPT: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "yaml, an empty whole number": ("ros", lambda: _ros("640", "!!int ''"), "has the tag"),
    "yaml, a yes that is none": ("ros", lambda: _ros("640", "!!bool q"), "has the tag"),
    "yaml, a time that is none": ("ros", lambda: _ros("640", "!!timestamp z"), "has the tag"),
    "yaml, a number without digits": ("ros", lambda: _ros("640", "!!float ''"), "has the tag"),
    "yaml, a date that is none": ("ros", lambda: _ros("640", "2001-99-99"), "finite number"),
    "yaml, merged keys": ("ros", lambda: _ros("camera_name: narrow_stereo", "<<: 3"), ""),
    "yaml, a list for a key": ("ros", lambda: _ros("camera_name:", "[a]:"), "for a key"),
    "yaml, 800 kB": ("ros", lambda: _ros("narrow_stereo", "[" + "1.0, " * 160_000 + "1]"), ""),
    "yaml, 400 000 deep": ("ros", lambda: _ros("narrow_stereo", "[" * 400_000), "nested too deeply"),
    "text without end": ("ros", lambda: b"a: 1 # " + b"x" * (9 << 20), "longer than 8 million letters"),
    "json, the last of many keys twice": ("rig 2", _one_key_late, "appears twice"),
    "mrcal, four million numbers": (
        "mrcal",
        lambda: b"{'a': [" + b"1," * 4_000_000 + b"]}",
        "more than 500000 letters outside of quotes",
    ),
    "npy, a header that is cut off": ("npy", lambda: _npy("{'descr': '<u2', 'fort"), "plain numbers"),
    "npy, a header of nothing": ("npy", lambda: _npy("", length=9), "cut off"),
    "npy, a file of eight bytes": ("npy", lambda: b"\x93NUMPY\1\0", "cut off"),
    "npy, 9 TB": ("npy", lambda: _shaped("(3000000, 3000000)"), "200 million"),
    "npy, more than there is": ("npy", lambda: _shaped("(9000, 9000)"), "promises 162000000 bytes"),
    "npy, a size beyond whole numbers": ("npy", lambda: _shaped(f"({10**30}, 0)"), "a shape that no array has"),
    "npy, objects": ("npy", lambda: _shaped("(2, 2)", "|O"), "plain numbers"),
    "npz, a member that is no array": ("range image", lambda: _zip(points=b"no array"), '"points": is no NumPy array'),
    "npz, positions of no axes": ("range image", _flat_positions, '"positions" has the shape (3,)'),
    "npz, 9 TB": ("truth", lambda: _zip(points=_shaped("(3000000, 3000000)")), "promises"),
    "truth, no archive": ("truth", lambda: b"PK nothing", "not a whole NPZ file"),
    "png, 2 GB": ("png", lambda: _png(26_000, 26_000), "200 million"),
    "png, more than the file can hold": ("png", lambda: _png(10_000, 10_000), "cut off"),
    "png, a chunk of 4 GB": (
        "png",
        lambda: (whole := _png(32, 24, bytes(97 * 24)))[:33] + b"\xff\xff\0\1" + whole[37:],
        "cut off",
    ),
    "png, no pixels": ("png", lambda: _png(0, 5), "0 × 5 pixels"),
    "jpeg, 65535 × 65535": ("jpeg", lambda: _jpeg(65_535, 65_535), "200 million"),
    "jpeg, more than the file can hold": ("jpeg", lambda: _jpeg(10_000, 10_000), "cut off"),
    "bmp, 2^31 columns": ("bmp", lambda: _bmp(2**31 - 1, 2**31 - 1), "200 million"),
    "bmp, from the top down": ("bmp", lambda: _bmp(40_000, -40_000), "200 million"),
    "tiff, 100 000 × 100 000": ("tiff", lambda: _tiff(100_000, 100_000), "200 million"),
    "tiff, a tile of a gigabyte": ("tiff", lambda: _tiff(64, 64, (322, 32_768), (323, 32_768)), "200 million"),
    "webp, 16 384 × 16 384": ("webp", lambda: _webp(16_384, 16_384), "200 million"),
    "pgm, 99 999 × 99 999": ("pgm", lambda: b"P5\n# a\n99999 99999\n255\n" + bytes(99), "200 million"),
    "folder camera, 2 GB": ("folder camera", lambda: _png(26_000, 26_000), "200 million"),
    "avi, 60 000 × 60 000": ("avi", lambda: _avi(60_000, 60_000), "not a video that can be decoded"),
    "avi, 20 000 × 10 500": ("avi", lambda: _avi(20_000, 10_500), "200 million"),
    "glb, an index out of range": ("glb", _glb, "names vertex 514"),
    "glb, a count of 10^9": ("glb", lambda: _glb(bufferView=None, count=10**9), "a.glb"),
    "ply, a list of 4 billion": (
        "ply binary",
        lambda: _ply("element face 1\nproperty list uint double vertex_indices", b"\xff" * 30),
        "the file ends before",
    ),
    "ply, six million lists": ("ply mesh", _many_lists, "holds no triangles"),
    "ply, a word of a million letters": ("ply ascii", _long_word, "other than numbers"),
    "ply, beyond float32": (
        "ply ascii",
        lambda: _ply(f"element vertex 1\n{_XYZ}".replace("float", "double"), b"1e300 2 3\n", "ascii"),
        "not a finite number",
    ),
    "ply, a signalling NaN": (
        "ply binary",
        lambda: _ply(f"element vertex 1\n{_XYZ}".replace("float", "double"), b"\1\0\0\0\0\0\xf0\x7f" * 3),
        "not a finite number",
    ),
    "stl, a vertex at 1e30": (
        "stl ascii",
        lambda: (
            b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1e30 0 0\nvertex 0 1 0\nendloop\n"
            b"endfacet\nendsolid"
        ),
        "not a finite number",
    ),
    "mat, a board that ends nowhere": ("bouguet", _endless_board, "its X has a number that is not finite"),
    "mat, 200 variables of 60 MB": ("bouguet", _inflating, "unfold to more than"),
    "artefact, a ball whose name is a list": (
        "artefact",
        lambda: ARTEFACT.replace('of = ["left", "right"]', 'of = [["left"], "right"]').encode(),
        "no ball is called ['left']",
    ),
    "profiles, of no files": (
        "profiles",
        lambda: b'[profiles]\nfiles = []\nunits = "mm"\nsteps_per_frame = 20\n' + MOVED.encode(),
        "names none: give the CSV files or the range map",
    ),
    "profiles, a point 1e300 mm away": (
        "profiles csv",
        lambda: POINTS.replace("0;150;0;0", "0;1e300;0;0").encode(),
        "no profiler sees so far",
    ),
    "profiles, an intensity of 1e300": (
        "profiles csv",
        lambda: POINTS.replace("0;150;0;0", "0;150;1e300;0").encode(),
        "an intensity is more than",
    ),
    "rig, a focal length of 1e-320": ("rig 2", lambda: _rig(camera__focal=[1e-320, 690.0]), "from 0.001 to 1e+09"),
    "rig 1, a focal length of 1e-320": ("rig 1", lambda: _rig(RIG_1, camera__focal=[700.0, 1e-320]), "from 0.001"),
    "rig, a focal length of 1e17": ("rig 2", lambda: _rig(camera__focal=[1e17, 690.0]), "from 0.001 to 1e+09"),
    "rig, a whole number of 1e300": ("rig 2", lambda: _rig(camera__focal=[10**300, 690]), "camera.focal.0"),
    "rig, a stage of 1e-320": ("rig 2", lambda: _rig(motion__0__per_step=[1e-320, 0, 0]), "does not move"),
    "rig, a sheet 1e320 mm away": ("rig 2", lambda: _rig(lights__0__plane=[0, 0, 1e-320]), "lights.0.plane"),
    "rig, 10^18 pixels": ("rig 2", lambda: _rig(camera__image_size=[10**9, 10**9]), "200 million"),
    "opencv, a focal length of 1e-320": (
        "opencv yaml",
        lambda: foreign_samples.OPENCV.replace("5.32795e+02", "1e-320").encode(),
        "from 0.001 to 1e+09",
    ),
    "poses, 1e300": ("poses json", lambda: json.dumps([[[1e300] * 4] * 3] * 2).encode(), "matrix of 4 × 4"),
    "poses, a quaternion of 1e300": ("poses conf", lambda: b"bmesh a.ply 0 0 0 1e300 0 0 1\n", "finite numbers"),
    "plan, a color that is none": (
        "plan",
        lambda: json.dumps(
            {
                "format": "jaxscan-plan/2",
                "axes": {"stage": [0]},
                "laser": {"color": "mauve", "columns": True, "name": ""},
            }
        ).encode(),
        "color",
    ),
    "scan, a glob through everything, again and again": ("scan", lambda: _scan("**/" * 12 + "*"), "more than one **"),
}
