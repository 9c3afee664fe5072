"""Valid files of every kind that is read, and how each kind is mutated by what it is made of."""

import io
import json
import struct
import tomllib
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np
import scipy.io
import tomli_w
import trimesh

from jaxscan.files.cloud import Cloud, vertices_of
from jaxscan.files.ply import Element, Lists, Ply
from jaxscan.files.ply_write import write_ply_file
from tests import foreign_samples
from tests.fuzz import mutate

Make = Callable[[Random], bytes]
_SIZE = (32, 24)


@dataclass(frozen=True)
class Target:
    """A kind of file.

    Attributes:
        file: its name in the folder of its own that each target has.
        seed: writes a valid one there, and what it goes with; returns its bytes.
        mutants: ways to make another of these bytes.
    """

    file: str
    seed: Callable[[Path], bytes]
    mutants: tuple[Callable[[bytes, Random], bytes], ...]

    def mutant(self, seed: bytes, random: Random) -> bytes:
        """One case."""
        return random.choice(self.mutants)(seed, random)


# Ways to mutate.


def _text(data: bytes, random: Random) -> bytes:
    return mutate.of_text(data.decode("utf-8", "replace"), random).encode("utf-8", "surrogatepass")


def _json(data: bytes, random: Random) -> bytes:
    return mutate.of_json(json.loads(data), random).encode("utf-8", "surrogatepass")


def _toml(data: bytes, random: Random) -> bytes:
    tree = mutate.of_tree(tomllib.loads(data.decode()), random)
    try:
        return tomli_w.dumps(_without_none(tree)).encode("utf-8", "surrogatepass")
    except (TypeError, ValueError, AttributeError, RecursionError):
        return _text(data, random)


def _without_none(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {str(key): _without_none(value) for key, value in tree.items() if value is not None}
    return [_without_none(value) for value in tree if value is not None] if isinstance(tree, list) else tree


def _mat(data: bytes, random: Random) -> bytes:
    arrays = {name: value for name, value in scipy.io.loadmat(io.BytesIO(data)).items() if not name.startswith("_")}
    for _ in range(random.choice((1, 1, 2, 5))):
        name = random.choice(sorted(arrays))
        array = arrays[name]
        match random.randrange(5):
            case 0:
                del arrays[name]
                if not arrays:
                    return data
            case 1:
                arrays[name] = arrays[random.choice(sorted(arrays))]
            case 2 if array.dtype.kind == "f":
                arrays[name] = np.full_like(array, _number(random))
            case 3:
                shape = random.choice(((0, 0), (1, 0), (3, 1), (2, 54), (3, 54), (54, 3), (300, 300), (1, 1)))
                arrays[name] = np.full(shape, _number(random))
            case _ if array.dtype.kind == "f" and array.size:
                array = array.copy()
                array.flat[random.randrange(array.size)] = _number(random)
                arrays[name] = array
    return _savemat(arrays, random.random() < 0.3)


def _number(random: Random) -> float:
    number = random.choice(mutate.NUMBERS)
    return float(number) if abs(number) < 1e308 or number != number else float("inf")


def _savemat(arrays: dict[str, Any], compressed: bool) -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, arrays, do_compression=compressed)
    return file.getvalue()


def _ply_header(data: bytes, random: Random) -> bytes:
    header, end, body = data.partition(b"end_header\n")
    return _text(header, random) + end + body


def _npy(data: bytes, random: Random) -> bytes:
    """Its header's text, with its length corrected or not."""
    length = struct.unpack("<H", data[8:10])[0]
    header, body = data[10 : 10 + length].decode("latin1"), data[10 + length :]
    if random.random() < 0.5:
        shape = ", ".join(str(random.choice(mutate.NUMBERS)) for _ in range(random.choice((0, 1, 2, 3, 40))))
        kind = random.choice(
            ("<f4", "|u1", "<u2", "|O", "<U9", "|S0", "|V0", "<M8[s]", "<f2", ">i8", "x", "<c16", "[('a', 'u1')]")
        )
        header = (
            f"{{'descr': '{kind}', 'fortran_order': {random.choice(('True', 'False', '3'))}, 'shape': ({shape},), }}\n"
        )
    else:
        header = mutate.of_text(header, random)
    raw = header.encode("utf-8", "surrogatepass")
    version = random.choice((1, 1, 1, 2, 3, 9))
    size = struct.pack("<H" if version == 1 else "<I", len(raw) % 65536 if random.random() < 0.9 else 65535)
    return b"\x93NUMPY" + bytes((version, 0)) + size + raw + body


def _npz(data: bytes, random: Random) -> bytes:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for _ in range(random.choice((1, 1, 2))):
        name = random.choice(sorted(members))
        match random.randrange(7):
            case 0:
                del members[name]
                if not members:
                    return data
            case 1:
                members[name] = members[random.choice(sorted(members))]
            case 2:
                members[name] = random.randbytes(random.choice((0, 5, 300)))
            case 3 if "scanner.npy" in members:
                with np.errstate(all="ignore"):
                    told = np.load(io.BytesIO(data))["scanner"].tobytes()
                members["scanner.npy"] = _saved(np.frombuffer(_json(told, random), np.uint8))
            case 4:
                members[name] = mutate.of_bytes(members[name], random)
            case _:
                members[name] = _npy(members[name], random) if members[name][:6] == b"\x93NUMPY" else b""
    file = io.BytesIO()
    with zipfile.ZipFile(
        file, "w", random.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA))
    ) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def _saved(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _glb(data: bytes, random: Random) -> bytes:
    length = struct.unpack("<I", data[12:16])[0]
    tree, rest = json.loads(data[20 : 20 + length]), data[20 + length :]
    text = mutate.of_json(tree, random).encode("utf-8", "surrogatepass")
    text += b" " * (-len(text) % 4)
    if random.random() < 0.3:
        rest = rest[:8] + mutate.of_bytes(rest[8:], random)
    whole = struct.pack("<II", len(text), 0x4E4F534A) + text + rest
    return b"glTF" + struct.pack("<II", 2, 12 + len(whole)) + whole


def _png(data: bytes, random: Random) -> bytes:
    """Chunks others, with right checksums."""
    chunks, at = [], 8
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    for _ in range(random.choice((1, 1, 2))):
        i = random.randrange(len(chunks))
        kind, content = chunks[i]
        match random.randrange(7):
            case 0 | 1:
                content = bytearray(data[16:29])
                for place in random.sample((0, 4), random.choice((1, 2))):
                    edge = random.choice((0, 1, 33, 5000, 30_000, 65_535, 1_000_000, 2**31 - 1, 2**32 - 1))
                    content[place : place + 4] = edge.to_bytes(4, "big")
                chunks[0] = (b"IHDR", bytes(content))
            case 2:
                content = bytearray(data[16:29])
                content[8 + random.randrange(5)] = random.choice((0, 1, 2, 3, 4, 6, 8, 16, 255))
                chunks[0] = (b"IHDR", bytes(content))
            case 3:
                chunks[i] = (kind, mutate.of_bytes(content, random))
            case 4:
                chunks[i:i] = [chunks[random.randrange(len(chunks))]] * random.choice((1, 50))
            case 5:
                raw = b"\0" * random.choice((10, 1000, 10_000_000))
                text = random.choice(
                    (b"IDAT", b"zTXt", b"iCCP", b"iTXt", b"eXIf", b"PLTE", b"tRNS", b"acTL", b"fcTL", b"fdAT")
                )
                front = b"a\0\0" if text in (b"zTXt", b"iCCP") else b"\0\0\0\1" * random.choice((0, 2, 7))
                chunks.insert(random.choice((1, len(chunks) - 1)), (text, front + zlib.compress(raw)))
            case _:
                chunks.pop(i)
                if not chunks:
                    return data[:8]
    whole = [len(c).to_bytes(4, "big") + k + c + zlib.crc32(k + c).to_bytes(4, "big") for k, c in chunks]
    return data[:8] + b"".join(whole)


def _fields(*places: int) -> Callable[[bytes, Random], bytes]:
    """Numbers of a header at these places others: sizes, depths, counts."""

    def mutant(data: bytes, random: Random) -> bytes:
        out = bytearray(data)
        for place in random.sample(places, random.choice((1, 1, 2))):
            size = random.choice((1, 2, 4))
            edge = random.choice(
                (0, 1, 2, 3, 7, 16, 24, 32, 255, 4096, 65_535, 2**20, 2**30, 2**31 - 1, 2**31, 2**32 - 1)
            )
            out[place : place + size] = (edge % (1 << 8 * size)).to_bytes(size, random.choice(("little", "big")))
        return bytes(out)

    return mutant


def _jpeg(data: bytes, random: Random) -> bytes:
    """The frame header's precision, size and components others, or a segment doubled or gone."""
    at, segments = 2, []
    while data[at + 1] != 0xDA:
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        segments.append(data[at : at + 2 + length])
        at += 2 + length
    for _ in range(random.choice((1, 1, 2))):
        i = random.randrange(len(segments))
        frame = next((k for k, s in enumerate(segments) if 0xC0 <= s[1] <= 0xC2), i)
        match random.randrange(5):
            case 0:
                segments[i:i] = [segments[i]] * random.choice((1, 200))
            case 1:
                segments[i] = segments[i][:2] + mutate.of_bytes(segments[i][2:], random)
            case 2:
                segments[frame] = (
                    segments[frame][:1]
                    + bytes([random.choice((0xC0, 0xC1, 0xC2, 0xC3, 0xC9, 0xCA))])
                    + segments[frame][2:]
                )
            case _:
                out = bytearray(segments[frame])
                for place in random.sample(range(4, len(out)), min(2, len(out) - 4)):
                    out[place] = random.choice((0, 1, 2, 4, 0x11, 0x22, 0x44, 0xFF))
                segments[frame] = bytes(out)
    return data[:2] + b"".join(segments) + data[at:]


# Seeds.


def _photographs(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(folder / name), np.zeros(_SIZE[::-1], np.uint8))


def _session(folder: Path) -> bytes:
    names = [f"{kind}/{i}.png" for kind in ("boards", "stripes", "stage", "turns", "lit") for i in range(3)]
    _photographs(folder, *names)
    return b"""[board]
kind = "checkerboard"
inner_corners = [9, 6]
square_mm = 10.0
shape = "flat"
[camera]
lens = "brown"
principal_point = "free"
hold = ["camera.radial.2"]
tilt = false
[views]
boards = "boards/*.png"
stripes = ["stripes/0.png", "", "stripes/2.png"]
[stage]
images = "stage/*.png"
steps = [0, 2000, 4000]
stripes = "lit/*.png"
motion = "linear"
screw_steps = 800.0
[turntable]
images = ["turns/0.png", "turns/1.png", "turns/2.png"]
steps_per_image = 100
stage_step = 0
[laser]
color = "red"
columns = true
sheet = "plane"
name = "left"
"""


def _scan(folder: Path) -> bytes:
    _photographs(folder, *(f"frames/{i}.png" for i in range(3)), "dark.png")
    return b"""[scan]
frames = "frames/*.png"
background = "dark.png"
exposures_s = [0.01, 0.04, 0.01]
name = "cup"
[scan.axes]
turntable = { start = 0, per_frame = 8 }
stage = 20000
other = [1, 2, 3]
[laser]
color = "red"
columns = true
name = "left"
"""


def _scanner(folder: Path) -> bytes:
    return b"""[camera]
kind = "opencv"
source = 0
exposure_s = 0.01
gain = 1.0
size = [640, 480]
[stage]
kind = "bistep"
port = "/dev/ttyUSB0"
rate_steps_s = 800
ramp_steps_s2 = 2000
first = 0
last = 72000
backlash = 10
reference = "switch"
[axes.turntable]
kind = "grbl"
port = "/dev/ttyUSB1"
axis = "Y"
steps_per_mm = 8.888889
steps_per_turn = 3200
reference = "here"
[laser]
kind = "rts"
color = "red"
columns = true
"""


def _plan(folder: Path) -> bytes:
    from hardware.scan_plan import Plan, ScanFolder

    ScanFolder.create(folder, Plan({"stage": (0, 10, 20)}, exposure_s=0.01))
    return (folder / "plan.json").read_bytes()


_CAMERA = {
    "image_size": [640, 480],
    "focal": [697.7, 690.4],
    "principal": [310.3, 228.1],
    "lens": "radial1",
    "radial": [-0.134],
    "tangential": [],
}
_FIT = {
    "corner_rms_px": 0.08,
    "stripe_rms_px": 0.11,
    "views": 12,
    "stripe_depths_mm": [200.0, 400.0],
    "sheet_sigma_mm": [0.25],
    "sigma_over_noise_alone": {"camera.focal.0": 1.5},
    "warnings": ["a"],
    "board_shape": "flat",
    "board_bent_mm": 0.1,
    "board_bent_sigma_mm": 0.02,
}
RIG_1 = {
    "format": "jaxscan-rig/1",
    "units": "mm",
    "camera": _CAMERA,
    "laser": {"plane": [0.0, -0.00494, 0.00303]},
    "stage": {"per_step": [0.00003, 0.00092, -0.00039]},
    "turntable": {"per_step": [0.0, 0.0157, 0.0], "centre": [1.2, 0.0, 331.0]},
    "covariance": {"parameters": ["camera.focal.0", "laser.plane.2"], "matrix": [[0.25, 1e-7], [1e-7, 1e-12]]},
    "fit": _FIT,
}
RIG_2 = {
    "format": "jaxscan-rig/2",
    "units": "mm",
    "camera": {**_CAMERA, "tilt": [0.01, 0.0]},
    "lights": [{"name": "", "kind": "plane", "plane": [0.0, -0.00494, 0.00303]}],
    "motion": [
        {"axis": "stage", "kind": "linear", "per_step": [0.00003, 0.00092, -0.00039]},
        {"axis": "turntable", "kind": "rotary", "per_step": [0.0, 0.0157, 0.0], "centre": [1.2, 0.0, 331.0]},
    ],
    "covariance": {"parameters": ["camera.focal.0", "lights.0.plane.2"], "matrix": [[0.25, 1e-7], [1e-7, 1e-12]]},
    "fit": _FIT,
}


def _bouguet(folder: Path) -> bytes:
    pixels = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), -1).reshape(-1, 2).T * 30 + 50
    changes = {f"x_{i}": pixels + i for i in (1, 3)}
    return foreign_samples.bouguet(folder / "seed.mat", **changes).read_bytes()


def _cloud() -> Cloud:
    random = np.random.default_rng(0)
    points = random.uniform(0, 100, (40, 3)).astype(np.float32)
    sigma = random.uniform(0, 1, 40).astype(np.float32)
    return Cloud(points, sigma, sigma, random.integers(0, 256, (40, 3)).astype(np.uint8))


def _ply(form: Any, mesh: bool) -> Callable[[Path], bytes]:
    def seed(folder: Path) -> bytes:
        elements = {"vertex": vertices_of(_cloud())}
        if mesh:
            counts = np.array([3, 4, 3, 5], np.uint8)
            faces = Lists(counts, np.arange(counts.sum(), dtype=np.int32))
            elements["face"] = Element(4, {"vertex_indices": faces})
        write_ply_file(folder / "seed.ply", Ply(elements, form, ("comment units mm",)))
        return (folder / "seed.ply").read_bytes()

    return seed


def _range(folder: Path) -> bytes:
    points = np.zeros((3, 4, 3), np.float32)
    flat = np.ones((3, 4), np.float32)
    told = {"axes": ["stage"], "lights": RIG_2["lights"], "motion": RIG_2["motion"][:1]}  # type: ignore[index]
    file = io.BytesIO()
    np.savez(
        file,
        points=points,
        strength=flat,
        sigma=flat,
        valid=np.ones((3, 4), bool),
        steps=np.arange(3),
        pixels=flat,
        sigma_pixel=flat,
        light=np.ones((3, 4), np.float32),
        positions=np.arange(3)[:, None],
        scanner=np.frombuffer(json.dumps(told).encode(), np.uint8),
    )
    return file.getvalue()


def _truth(folder: Path) -> bytes:
    file = io.BytesIO()
    np.savez(file, position=np.zeros((3, 4)), points=np.zeros((3, 4, 3)), stage=np.arange(3))
    return file.getvalue()


def _exported(kind: str) -> Callable[[Path], bytes]:
    def seed(folder: Path) -> bytes:
        content = trimesh.creation.box((10, 20, 30)).export(file_type=kind)
        return content.encode() if isinstance(content, str) else bytes(content)

    return seed


def _picture(ending: str, *, colour: bool = True) -> Callable[[Path], bytes]:
    def seed(folder: Path) -> bytes:
        shape = (*_SIZE[::-1], 3) if colour else _SIZE[::-1]
        image = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
        return cv2.imencode(ending, image)[1].tobytes()

    return seed


def _npy_seed(folder: Path) -> bytes:
    return _saved(np.zeros(_SIZE[::-1], np.uint16))


def _video(ending: str, fourcc: str) -> Callable[[Path], bytes]:
    def seed(folder: Path) -> bytes:
        path = folder / f"seed{ending}"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*fourcc), 10, (64, 48))
        for i in range(5):
            writer.write(np.full((48, 64, 3), 40 * i, np.uint8))
        writer.release()
        return path.read_bytes()

    return seed


def _said(text: str) -> Callable[[Path], bytes]:
    return lambda folder: text.encode()


def _profiles(file: str, *more: str) -> Callable[[Path], bytes]:
    """The listing of four profiles in one file."""

    def seed(folder: Path) -> bytes:
        said = "\n".join((f'[profiles]\nfiles = "{file}"\nunits = "mm"\nsteps_per_frame = 20', *more, MOVED))
        (folder / "profiles.toml").write_text(said)
        (folder / "lines.csv").write_text(_LINES)
        return said.encode()

    return seed


def _beside(listing: Callable[[Path], bytes], content: bytes) -> Callable[[Path], bytes]:
    """A file that a listing beside it names."""

    def seed(folder: Path) -> bytes:
        listing(folder)
        return content

    return seed


MOVED = '[[motion]]\naxis = "stage"\nkind = "linear"\nper_step = [0.0, 0.005, 0.0]\n'
_ALONG = "[profiles.a]\nscale = 0.1\noffset = -0.5"
_AWAY = "[profiles.c]\nscale = 0.002\noffset = 150.0"
_LINES = "\n".join(",".join(f"{150 + i + 0.5 * j}" for j in range(6)) for i in range(4)) + "\n"
POINTS = "x;z;intensity;profile\n" + "".join(f"{j};{150 + i};{9 * j};{i}\n" for i in range(4) for j in range(6))
_RAW = np.arange(48, dtype="<u2").reshape(4, 6, 2) + np.uint16(100)
_PART = """[part]
name = "block"
[[feature]]
name = "dome"
kind = "ball"
ball = [-30.3, -7.4, 350.0, 8.5]
[[feature]]
name = "low"
kind = "plane"
ball = [9.6, -6.9, 355.2, 8.0]
[[dimension]]
name = "radius"
kind = "radius"
of = "dome"
nominal = 9.0
tolerance = [-0.1, 0.2]
[[dimension]]
name = "between"
kind = "distance"
of = ["dome", "low"]
tolerance = 0.3
nominal = 4.0
"""
ARTEFACT = """[artefact]
name = "plate"
[[ball]]
name = "left"
diameter = 14.0
uncertainty = 0.01
form = 0.002
[[ball]]
name = "right"
diameter = 14.0
uncertainty = 0.01
[[distance]]
of = ["left", "right"]
length = 50.0
uncertainty = 0.02
[[plane]]
flatness = 0.01
[limits]
probing_form = 0.8
distance = 0.25
"""
_FIGURE = {"figure": "distance", "of": "left, right", "mean": 0.01, "worst": 0.02, "uncertainty": 0.005, "scans": 3}
_HISTORY = {
    "format": "jaxscan-acceptance/1", "date": "2026-01-01", "artefact": "plate", "certificate": "c", "rig": None,
    "verdict": None, "figures": [_FIGURE | {"sigma": 0.001, "sigma_rig": None}],
}  # fmt: skip
_POSE = [[1.0, 0.0, 0.0, 5.0], [0.0, 1.0, 0.0, 6.0], [0.0, 0.0, 1.0, 7.0], [0.0, 0.0, 0.0, 1.0]]
_POSES = {"a.ply": _POSE, "b.ply": {"position": [1.0, 2.0, 3.0], "quaternion": [1.0, 0.0, 0.0, 0.0]}}
_CONF = "camera 0 0 0 0 0 0 1\nbmesh a.ply 0 0 0 0 0 0 1\nbmesh b.ply 1 2 3 0.6 0 0 0.8\n"

_IN_TEXT = (_text, _text, _text, mutate.of_bytes)
_IN_BYTES = (mutate.of_bytes,)
TARGETS: dict[str, Target] = {
    "session": Target("session.toml", _session, (_toml, _toml, _toml, _text)),
    "scan": Target("scan.toml", _scan, (_toml, _toml, _toml, _text)),
    "scanner": Target("scanner.toml", _scanner, (_toml, _toml, _toml, _text)),
    "plan": Target("plan.json", _plan, (_json, _json, _text)),
    "rig 1": Target("rig.json", _said(json.dumps(RIG_1)), (_json, _json, _json, _text)),
    "rig 2": Target("rig.json", _said(json.dumps(RIG_2)), (_json, _json, _json, _text)),
    "opencv yaml": Target("camera.yml", _said(foreign_samples.OPENCV), _IN_TEXT),
    "opencv xml": Target("camera.xml", _said(foreign_samples.OPENCV_XML), _IN_TEXT),
    "ros": Target("camera.yaml", _said(foreign_samples.ROS), _IN_TEXT),
    "ros message": Target("camera.yaml", _said(foreign_samples.ROS_MESSAGE), _IN_TEXT),
    "kalibr": Target("camera.yaml", _said(foreign_samples.KALIBR), _IN_TEXT),
    "mrcal": Target("camera.cameramodel", _said(foreign_samples.MRCAL), _IN_TEXT),
    "bouguet": Target("Calib_Results.mat", _bouguet, (_mat, _mat, mutate.of_bytes)),
    "ply ascii": Target("a.ply", _ply("ascii", True), _IN_TEXT),
    "ply binary": Target("a.ply", _ply("binary_big_endian", False), (_ply_header, mutate.of_bytes)),
    "ply mesh": Target("a.ply", _ply("binary_little_endian", True), (_ply_header, mutate.of_bytes)),
    "range image": Target("a.npz", _range, (_npz, _npz, mutate.of_bytes)),
    "truth": Target("scan.npz", _truth, (_npz, _npz, mutate.of_bytes)),
    "stl": Target("a.stl", _exported("stl"), (mutate.of_bytes, _fields(80, 84, 96))),
    "stl ascii": Target("a.stl", _exported("stl_ascii"), _IN_TEXT),
    "obj": Target("a.obj", _exported("obj"), _IN_TEXT),
    "glb": Target("a.glb", _exported("glb"), (_glb, _glb, mutate.of_bytes)),
    "off": Target("a.off", _exported("off"), _IN_TEXT),
    "png": Target("a.png", _picture(".png"), (_png, _png, mutate.of_bytes)),
    "jpeg": Target("a.jpg", _picture(".jpg"), (_jpeg, _jpeg, mutate.of_bytes)),
    "bmp": Target("a.bmp", _picture(".bmp"), (_fields(2, 10, 14, 18, 22, 26, 28, 30, 34, 46), mutate.of_bytes)),
    "tiff": Target("a.tif", _picture(".tif"), _IN_BYTES),
    "pgm": Target("a.pgm", _picture(".pgm", colour=False), (_text, mutate.of_bytes)),
    "webp": Target("a.webp", _picture(".webp"), (_fields(4, 12, 16, 21, 23, 25, 27), mutate.of_bytes)),
    "npy": Target("a.npy", _npy_seed, (_npy, _npy, mutate.of_bytes)),
    "folder camera": Target("a.png", _picture(".png"), (_png, _png, mutate.of_bytes)),
    "avi": Target("a.avi", _video(".avi", "MJPG"), _IN_BYTES),
    "mp4": Target("a.mp4", _video(".mp4", "mp4v"), _IN_BYTES),
    "part": Target("part.toml", _said(_PART), (_toml, _toml, _toml, _text)),
    "artefact": Target("artefact.toml", _said(ARTEFACT), (_toml, _toml, _toml, _text)),
    "history": Target("history.jsonl", _said(json.dumps(_HISTORY) + "\n"), (_json, _json, _text)),
    "profiles": Target(
        "profiles.toml", _profiles("lines.csv", "invalid = -9999", _ALONG), (_toml, _toml, _toml, _text)
    ),
    "profiles csv": Target("points.csv", _beside(_profiles("points.csv"), POINTS.encode()), _IN_TEXT),
    "profiles lines": Target("lines.csv", _beside(_profiles("lines.csv", _ALONG), _LINES.encode()), _IN_TEXT),
    "profiles raw": Target(
        "map.raw",
        _beside(_profiles("map.raw", 'pixel_format = "Coord3D_AC16"\nwidth = 6', _ALONG, _AWAY), _RAW.tobytes()),
        _IN_BYTES,
    ),
    "poses json": Target("poses.json", _said(json.dumps(_POSES)), (_json, _json, _text)),
    "poses conf": Target("poses.conf", _said(_CONF), _IN_TEXT),
}
