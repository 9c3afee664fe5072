"""Every valid PLY file is read and written back the same; one that lies, or is something else, is refused."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import trimesh

from jaxscan.errors import InputError
from jaxscan.files.mesh import read_mesh
from jaxscan.files.ply import Element, Format, Lists, Ply
from jaxscan.files.ply_read import read_ply_file
from jaxscan.files.ply_write import write_ply_file


def assert_same(a: Ply, b: Ply) -> None:
    assert (a.format, a.comments, list(a.elements)) == (b.format, b.comments, list(b.elements))
    for x, y in zip(a.elements.values(), b.elements.values(), strict=True):
        assert (x.count, list(x.columns)) == (y.count, list(y.columns))
        for p, q in zip(x.columns.values(), y.columns.values(), strict=True):
            assert type(p) is type(q)
            for u, v in [(p.counts, q.counts), (p.values, q.values)] if isinstance(p, Lists) else [(p, q)]:
                assert u.dtype == v.dtype
                np.testing.assert_array_equal(u, v)


@pytest.fixture(scope="module")
def everything() -> Ply:
    """All types, lists of equal and of different length, an element without rows, one without properties."""
    rng = np.random.default_rng(4)
    floats = rng.normal(size=5) * 10.0 ** rng.integers(-30, 30, 5)
    numbers = {f"p{code}": np.array([0, 1, 2, 3, 127], code) for code in ("i1", "u1", "i2", "u2", "i4", "u4")}
    numbers["pu4"][4] = 2**32 - 1
    counts = np.array([3, 0, 4, 1, 5], np.uint16)
    return Ply(
        {
            "face": Element(5, {"l": Lists(counts, np.arange(13, dtype=np.int32)), "a": floats.astype(np.float32)}),
            "vertex": Element(5, {"x": floats, "y": floats.astype(np.float32), **numbers}),
            "quads": Element(2, {"n": Lists.equal(np.arange(8.0).reshape(2, 4)), "i": np.array([7, -8], np.int8)}),
            "none": Element(0, {"x": np.zeros(0), "l": Lists(np.zeros(0, np.uint8), np.zeros(0, np.int32))}),
            "bare": Element(3),
        },
        comments=("comment made by hand", "obj_info of no use"),
    )


@pytest.mark.parametrize("form", get_args(Format))
def test_round_trip_is_exact(tmp_path, everything, form):
    written = replace(everything, format=form)
    write_ply_file(tmp_path / "a.ply", written)
    assert_same(written, read_ply_file(tmp_path / "a.ply"))


def test_round_trip_of_the_files_of_other_programs(tmp_path, data):
    read = 0
    for path in sorted((data / "ply").glob("*.ply")):
        try:
            content = read_ply_file(path)
        except InputError:
            continue
        read += 1
        for form in get_args(Format):
            write_ply_file(tmp_path / "a.ply", replace(content, format=form))
            assert_same(replace(content, format=form), read_ply_file(tmp_path / "a.ply"))
    assert read == 38


def test_meshes_of_other_programs_are_what_trimesh_reads(data):
    compared = 0
    for path in sorted((data / "ply").glob("*.ply")):
        try:
            ours = read_mesh(path)
        except InputError:
            continue
        try:
            theirs = trimesh.load(path, process=False, skip_materials=True)
        except ValueError:
            continue  # trimesh cannot read faces that stand before the vertices
        if isinstance(theirs, trimesh.Trimesh) and np.isfinite(theirs.vertices).all() and "shelf" not in path.stem:
            compared += 1
            assert ours.area == pytest.approx(theirs.area, rel=1e-5)
            np.testing.assert_allclose(ours.bounds, theirs.bounds, atol=1e-6)
    assert compared > 15


@pytest.mark.parametrize("form", get_args(Format))
def test_a_file_that_lies_about_its_length(tmp_path, everything, form):
    write_ply_file(tmp_path / "a.ply", replace(everything, format=form))
    content = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(content + b"1 2 3\n")
    with pytest.raises(InputError, match=r"a\.ply: more follows than its header promises"):
        read_ply_file(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(content.replace(b"element vertex 5", b"element vertex 999999999999"))
    with pytest.raises(InputError, match=r"a\.ply: its header promises 999999999999 of element vertex"):
        read_ply_file(tmp_path / "a.ply")
    for cut in range(content.index(b"end_header"), len(content) - 2, 7):
        (tmp_path / "a.ply").write_bytes(content[:cut])
        with pytest.raises(InputError, match=r"a\.ply: "):
            read_ply_file(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("element vertex 1\nproperty uchar x\nend_header\n300\n", "property x of element vertex is uchar, and 300"),
        ("element vertex 1\nproperty uchar x\nend_header\nabc\n", "something other than numbers"),
        ("element face 1\nproperty list uchar int i\nend_header\n1.5 1\n", "has the length 1.5"),
        ("element face 1\nproperty list uchar int i\nend_header\n-2 1\n", "has the length -2"),
        ("element vertex 1\nproperty float x\nproperty float x\nend_header\n1 2\n", "two properties of one name"),
        ("element vertex 1\nproperty half x\nend_header\n1\n", "'property half x', which is no part"),
        ("element vertex -1\nend_header\n", "'element vertex -1'"),
        ("property float x\nend_header\n", "'property float x'"),
        ("element vertex 1\n", "does not end with the line end_header"),
    ],
)
def test_what_is_no_ply(tmp_path, text, problem):
    (tmp_path / "a.ply").write_text(f"ply\nformat ascii 1.0\n{text}")
    with pytest.raises(InputError, match=rf"a\.ply: .*{problem}"):
        read_ply_file(tmp_path / "a.ply")


def test_a_list_of_negative_length(tmp_path):
    header = b"ply\nformat binary_little_endian 1.0\nelement face 2\nproperty list char int i\nend_header\n"
    (tmp_path / "a.ply").write_bytes(header + b"\xff" + b"\0" * 20)
    with pytest.raises(InputError, match=r"a\.ply: element face has a list of negative length"):
        read_ply_file(tmp_path / "a.ply")


def test_types_that_ply_has_no_word_for_are_not_written(tmp_path):
    with pytest.raises(InputError, match=r"a\.ply: property x of element vertex has 2 rows of int64"):
        write_ply_file(tmp_path / "a.ply", Ply({"vertex": Element(2, {"x": np.arange(2)})}))
    with pytest.raises(InputError, match=r"has 3 rows"):
        write_ply_file(tmp_path / "a.ply", Ply({"vertex": Element(2, {"x": np.arange(3.0)})}))
    assert list(tmp_path.iterdir()) == []


def test_faces_that_name_no_vertex(tmp_path):
    corners = {axis: np.zeros(3, np.float32) for axis in "xyz"}
    faces = Element(1, {"vertex_indices": Lists.equal(np.array([[0, 1, 3]], np.int32))})
    write_ply_file(tmp_path / "a.ply", Ply({"vertex": Element(3, dict(corners)), "face": faces}))
    with pytest.raises(InputError, match=r"a\.ply: a face names vertex 3, there are 3"):
        read_mesh(tmp_path / "a.ply")
    corners["y"][1] = np.nan
    faces = Element(1, {"vertex_indices": Lists.equal(np.array([[0, 1, 2]], np.int32))})
    write_ply_file(tmp_path / "a.ply", Ply({"vertex": Element(3, dict(corners)), "face": faces}))
    with pytest.raises(InputError, match=r"a\.ply: 1 of 3 points have a coordinate that is not a finite number"):
        read_mesh(tmp_path / "a.ply")
