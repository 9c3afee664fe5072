"""The organised range image: exact round trips, and what a reader must refuse."""

import dataclasses
import json
import re
import sys

import jax
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.range_npz import RangeArrays, read_range_npz, write_range_npz
from jaxscan.files.range_scanner import scanner_arrays
from jaxscan.precision import as_numpy
from jaxscan.reconstruction.range_image import RangeImage, read_range_image, write_points, writing_points
from jaxscan.rig import Chain, Fixed, LightPlane, Linear, Rotary

SHEET = as_numpy(LightPlane.create([0.0, -0.005, 1 / 300], "left"))
MOTION = as_numpy(
    Chain((Linear.create([1e-4, 1e-3, 1 / 3000]), Rotary.create([0.0, 0.01, 1e-3], [1.5, 0.0, 1000 / 3])))
)


def image(frames: int = 4, columns: int = 7) -> RangeArrays:
    rng = np.random.default_rng(2)
    points = rng.normal(size=(frames, columns, 3)).astype(np.float32)
    valid = rng.random((frames, columns)) > 0.3
    points[~valid] = np.nan
    numbers = rng.random((2, frames, columns), dtype=np.float32)
    return RangeArrays(points, numbers[0], numbers[1], valid, np.arange(frames) * 2000 - 100_000)


def whole(frames: int = 4) -> RangeArrays:
    """With what a file may leave out, an older one's too."""
    rng, bare = np.random.default_rng(3), image(frames)
    pixels, sigma_pixel = rng.random((2, *bare.valid.shape), dtype=np.float32)
    light = rng.random((frames, 4), dtype=np.float32)
    positions, scanner = scanner_arrays({"turntable": np.arange(frames), "stage": bare.steps}, MOTION, (SHEET,))
    known = {"pixels": pixels, "sigma_pixel": sigma_pixel, "per_step": rng.random(3), "light": light}
    known |= {"colours": rng.integers(0, 256, (*bare.valid.shape, 3), np.uint8), "albedo": pixels + 1}
    return dataclasses.replace(bare, positions=positions, scanner=scanner, notes=("σ is wide", "b"), **known)


@pytest.mark.parametrize("frames", [0, 1, 4])
def test_round_trip_is_exact(tmp_path, frames):
    write_range_npz(tmp_path / "a.npz", whole(frames))
    read = read_range_npz(tmp_path / "a.npz")
    for field in dataclasses.fields(RangeArrays):
        a, b = getattr(whole(frames), field.name), getattr(read, field.name)
        assert getattr(a, "dtype", None) == getattr(b, "dtype", None)
        np.testing.assert_array_equal(a, b)


def test_what_is_not_known_is_left_out(tmp_path):
    write_range_npz(tmp_path / "a.npz", image())
    read = read_range_npz(tmp_path / "a.npz")
    assert read.pixels is None
    assert read.sigma_pixel is None
    assert read.per_step is None
    assert read.positions is None
    assert read.scanner is None
    with np.load(tmp_path / "a.npz") as archive:
        assert set(archive) == {"points", "strength", "sigma", "valid", "steps"}


def test_the_scanner_survives_the_file(tmp_path):
    arrays, positions = image(), {"turntable": np.array([0, 8, 16, 24]), "stage": np.full(4, 20000)}
    bare = RangeImage.of("a.npz", arrays)
    for motion, sheets in ((MOTION, (SHEET,)), (MOTION.links[1], ()), (Fixed(), (SHEET,)), (Fixed(), ())):
        write_points(tmp_path / "a.npz", dataclasses.replace(bare, positions=positions, motion=motion, sheets=sheets))
        read = read_range_image(tmp_path / "a.npz")
        assert list(read.positions) == ["turntable", "stage"]
        for axis in positions:
            np.testing.assert_array_equal(read.positions[axis], positions[axis])
        # Of the axis that moves.
        np.testing.assert_array_equal(read.steps, positions["turntable"])
        # To the last bit.
        assert jax.tree.structure((read.motion, read.sheets)) == jax.tree.structure((motion, sheets))
        assert jax.tree.leaves((read.motion, read.sheets)) == jax.tree.leaves((motion, sheets))


def test_notes_are_asked_once_all_frames_have_come(tmp_path):
    parts, came = [dataclasses.replace(RangeImage.of("a.npz", image()), notes=(note,)) for note in "aba"], []

    def at_last() -> list[str]:
        return [f"{len(came)} parts", "b"]

    with writing_points(tmp_path / "a.npz", at_last) as add:
        for part in parts:
            add(part)
            came.append(part)
    assert read_range_image(tmp_path / "a.npz").notes == ("a", "b", "3 parts")
    assert RangeImage.joined(parts).notes == ("a", "b")
    with writing_points(tmp_path / "a.ply", at_last) as add:
        add(parts[0])


def test_broken_notes_are_refused(tmp_path):
    arrays = {name: array for name, array in vars(image()).items() if isinstance(array, np.ndarray)}
    for broken, text in {
        b"": '"notes" is no JSON',
        b"[" * 100_000: '"notes" is no JSON',
        b"{}": '"notes" is no list of sentences',
        b"[1]": '"notes" is no list of sentences',
    }.items():
        np.savez(tmp_path / "a.npz", **arrays, notes=np.frombuffer(broken, np.uint8))
        with pytest.raises(InputError, match=rf"a\.npz: {text}"):
            read_range_npz(tmp_path / "a.npz")
    np.savez(tmp_path / "a.npz", **arrays, notes=np.zeros((2, 2), np.uint8))
    with pytest.raises(InputError, match='"notes" has the shape'):
        read_range_npz(tmp_path / "a.npz")


def test_older_files_have_a_stage(tmp_path):
    per_step = np.array([1e-4, 1e-3, 1 / 3000])
    write_range_npz(tmp_path / "a.npz", dataclasses.replace(image(), per_step=per_step))
    read = read_range_image(tmp_path / "a.npz")
    assert list(read.positions) == ["stage"]
    np.testing.assert_array_equal(read.positions["stage"], image().steps)
    assert isinstance(read.motion, Linear)
    assert [float(x) for x in read.motion.per_step] == per_step.tolist()
    assert read.sheets == ()
    np.testing.assert_allclose(read.cameras(), -image().steps[:, None] * per_step, rtol=1e-12)
    for still in (image(), dataclasses.replace(image(), per_step=np.zeros(3))):
        write_range_npz(tmp_path / "a.npz", still)
        assert read_range_image(tmp_path / "a.npz").motion == Fixed()


def test_a_broken_scanner_is_refused_by_name(tmp_path):
    good = whole()
    values = json.loads(good.scanner.tobytes())
    axis, light = values["motion"][0], values["lights"][0]

    def said(**changes: object) -> bytes:
        return json.dumps({**values, **changes}).encode()

    for broken, text in {
        b"": '"scanner" is no JSON',
        b"\xff\xfe{": '"scanner" is no JSON',
        b"[" * 100_000: '"scanner" is no JSON',
        b"[]": '"scanner" is no object',
        said(axes=["stage"]): r"scanner\.axes.* 1 names for 2",
        said(axes=["stage", "stage"]): r"scanner\.axes.* twice",
        said(axes=["stage", "täble"]): r"scanner\.axes.* letters, digits",
        said(axes=["stage", 1]): r"scanner\.axes.* letters, digits",
        said(
            axes=[a if a == "stage" else "spin" for a in values["axes"]]
        ): r"the spin moves, but the motion is that of",
        said(lights=[{**light, "name": name} for name in "ab"]): r"scanner\.lights.* 2 lights",
        said(axes=2): r"scanner\.axes = 2: .*list",
        said(motion=[{**axis, "kind": "robot"}]): r'scanner\.motion\.0\.kind = "robot"',
        said(motion=[{**axis, "per_step": [0, np.nan, 0]}]): r"scanner\.motion\.0\.per_step.*finite",
        said(lights=[{"kind": "plane"}]): r"scanner\.lights\.0\.plane: is missing",
    }.items():
        write_range_npz(tmp_path / "a.npz", dataclasses.replace(good, scanner=np.frombuffer(broken, np.uint8)))
        with pytest.raises(InputError, match=rf"a\.npz: .*{text}"):
            read_range_image(tmp_path / "a.npz")
    for half in ("scanner", "positions"):
        write_range_npz(tmp_path / "a.npz", dataclasses.replace(good, **{half: None}))
        with pytest.raises(InputError, match=r'a\.npz: has one of "scanner" and "positions"'):
            read_range_image(tmp_path / "a.npz")


def test_arrays_that_do_not_fit_are_not_written(tmp_path):
    good = image()
    for bad in (
        dataclasses.replace(good, steps=good.steps[1:]),
        dataclasses.replace(good, points=good.points[:, 1:]),
        dataclasses.replace(good, valid=np.ones_like(good.valid)),
    ):
        with pytest.raises(InputError, match=r"a\.npz: "):
            write_range_npz(tmp_path / "a.npz", bad)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_range_image(tmp_path):
    path = tmp_path / "a.npz"
    write_range_npz(path, image())
    whole = path.read_bytes()
    arrays = {name: array for name, array in vars(image()).items() if isinstance(array, np.ndarray)}
    np.savez(tmp_path / "some.npz", points=arrays["points"])
    np.savez(tmp_path / "types.npz", **{**arrays, "valid": arrays["valid"].astype(float)})
    np.savez(tmp_path / "travel.npz", **arrays, per_step=np.zeros(2))
    np.savez(tmp_path / "objects.npz", **{**arrays, "steps": np.array([{}] * 4)})
    np.save(tmp_path / "plain.npy", arrays["points"])
    (tmp_path / "plain.npy").rename(tmp_path / "plain.npz")
    (tmp_path / "short.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "flipped.npz").write_bytes(whole[:300] + b"\xff" * 20 + whole[320:])
    np.savez_compressed(tmp_path / "packed.npz", **arrays)
    packed = (tmp_path / "packed.npz").read_bytes()
    (tmp_path / "packed.npz").write_bytes(packed[:60] + b"\xff" * 10 + packed[70:])
    # The flags of each entry, the lowest of which says that it is encrypted.
    flagged = re.sub(rb"(PK\x03\x04..|PK\x01\x02....).", lambda entry: entry[1] + b"\x01", whole, flags=re.S)
    (tmp_path / "locked.npz").write_bytes(flagged)
    (tmp_path / "empty.npz").write_bytes(b"")
    (tmp_path / "binary.npz").write_bytes(bytes(range(256)) * 10)
    for name, text in {
        "some": 'no array "',
        "types": '"valid" is float64',
        "travel": '"per_step" has the shape',
        "objects": "no NumPy array of plain numbers",
        "plain": "not a whole NPZ",
        "short": "not a whole NPZ",
        "flipped": "not a whole NPZ",
        "packed": "not a whole NPZ",
        "locked": "not a whole NPZ",
        "empty": "not a whole NPZ",
        "binary": "not a whole NPZ",
        "none": "no such file",
    }.items():
        with pytest.raises(InputError, match=rf"{name}\.npz: .*{text}"):
            read_range_npz(tmp_path / f"{name}.npz")
    with pytest.raises(InputError, match="is a folder"):
        read_range_npz(tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on the size of files")
@pytest.mark.parametrize("ending", [".npz", ".ply"])
def test_a_disk_that_is_full_half_way_leaves_what_was_there(tmp_path, ending):
    import resource

    path = tmp_path / f"out{ending}"
    path.write_bytes(b"before")
    points = np.random.default_rng(0).random((400, 3)).astype(np.float32)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def write():
        with writing_points(path) as add:
            for i in range(20):
                add(range_image_of(points, i))

    # Every write beyond it fails, as on a disk without room.
    resource.setrlimit(resource.RLIMIT_FSIZE, (20000, limits[1]))
    try:
        with pytest.raises(InputError, match=r"cannot be written .*make room") as refusal:
            write()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert str(path) in str(refusal.value)
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def range_image_of(points, step):
    shape = (1, len(points))
    one = np.ones(shape, np.float32)
    return RangeImage(points[None], one, one, one, one, np.ones(shape, bool), {"stage": np.asarray([step])})
