"""PLY: what we write is what the format says, and what others write is read or refused with a reason."""

import io

import numpy as np
import pytest
import trimesh

from jaxscan.errors import InputError
from jaxscan.files.cloud import Cloud, check_ending, read_ply, write_ply


def cloud(n: int = 100, sigma: bool = True, colours: bool = True) -> Cloud:
    rng = np.random.default_rng(1)
    return Cloud(
        points=rng.normal(size=(n, 3)).astype(np.float32),
        sigma=rng.random(n, dtype=np.float32) if sigma else None,
        sigma_pixel=rng.random(n, dtype=np.float32) if sigma else None,
        colours=rng.integers(0, 256, (n, 3), dtype=np.uint8) if colours else None,
    )


@pytest.mark.parametrize("sigma", [False, True])
@pytest.mark.parametrize("colours", [False, True])
def test_round_trip_is_exact(tmp_path, sigma, colours):
    written = cloud(sigma=sigma, colours=colours)
    write_ply(tmp_path / "a.ply", written)
    read = read_ply(tmp_path / "a.ply")
    for name in ("points", "sigma", "sigma_pixel", "colours"):
        a, b = getattr(written, name), getattr(read, name)
        assert (a is None) == (b is None)
        if a is not None:
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)


def test_bytes_are_those_of_the_format(tmp_path):
    points = np.array([[1, 2, 3], [4, 5, 6]], np.float32)
    sigma = np.array([0.5, 0.25], np.float32)
    colours = np.array([[1, 2, 3], [4, 5, 6]], np.uint8)
    write_ply(tmp_path / "a.ply", Cloud(points, sigma, sigma, colours))
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    assert header.decode().splitlines() == [
        "ply",
        "format binary_little_endian 1.0",
        "comment units mm",
        "element vertex 2",
        "property float x",
        "property float y",
        "property float z",
        "property float sigma",
        "property float sigma_pixel",
        "property uchar red",
        "property uchar green",
        "property uchar blue",
    ]
    expected = b"".join(
        p.tobytes() + s.tobytes() + s.tobytes() + c.tobytes() for p, s, c in zip(points, sigma, colours, strict=True)
    )
    assert body == expected


def test_another_reader_agrees(tmp_path):
    written = cloud()
    write_ply(tmp_path / "a.ply", written)
    np.testing.assert_array_equal(trimesh.load(tmp_path / "a.ply").vertices, written.points)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_what_another_writer_wrote(tmp_path, encoding):
    mesh = trimesh.creation.icosphere(subdivisions=1)
    (tmp_path / "a.ply").write_bytes(mesh.export(file_type="ply", encoding=encoding))
    np.testing.assert_allclose(read_ply(tmp_path / "a.ply").points, mesh.vertices, atol=1e-6)


def test_big_endian_doubles(tmp_path):
    points = np.arange(12.0).reshape(4, 3)
    header = "ply\r\nformat binary_big_endian 1.0\r\nelement vertex 4\r\n"
    header += "".join(f"property double {axis}\r\n" for axis in "xyz") + "end_header\r\n"
    (tmp_path / "a.ply").write_bytes(header.encode() + points.astype(">f8").tobytes())
    np.testing.assert_array_equal(read_ply(tmp_path / "a.ply").points, points)


def test_the_files_of_other_programs(data):
    """Read or refused with a reason."""
    refused = set()
    for path in sorted((data / "ply").glob("*.ply")):
        try:
            assert np.isfinite(read_ply(path).points).all()
        except InputError as error:
            assert path.name in str(error)  # noqa: PT017
            refused.add(path.stem)
    empty = {"trimesh_empty", *(f"trimesh_emptyIO_ply_empty_{kind}" for kind in ("ascii", "bin", "header"))}
    broken = {"assimp_invalid_empty", "assimp_invalid_crash-30d6d0f7c529b3b66b4131700b7a4580cd7082df"}
    # Its header promises 12 points, and 13 follow.
    lying = {"trimesh_points_emptyascii"}
    assert refused == empty | broken | lying


@pytest.mark.parametrize("change", [-1, 1])
def test_a_header_that_lies_about_the_length(tmp_path, change):
    write_ply(tmp_path / "a.ply", cloud(10))
    content = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(content[:-1] if change < 0 else content + b"\0")
    with pytest.raises(
        InputError, match=r"a\.ply: .*than its header promises|its header promises 10 of element vertex"
    ):
        read_ply(tmp_path / "a.ply")


def test_an_ascii_file_that_ends_early(tmp_path):
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    (tmp_path / "a.ply").write_text(f"ply\nformat ascii 1.0\nelement vertex 3\n{properties}end_header\n1 2 3\n4 5 6\n")
    with pytest.raises(InputError, match=r"a\.ply: its header promises 3 of element vertex, the file ends before"):
        read_ply(tmp_path / "a.ply")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"solid x\n",
        b"\x00\xff" * 100,
        b"ply\n",
        b"ply\nformat ascii 1.0\nelement vertex 2\n",
        b"ply" + b"x" * 99999,
    ],
)
def test_what_is_no_ply(tmp_path, content):
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.ply: "):
        read_ply(tmp_path / "a.ply")


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_ply(tmp_path / "none.ply")
    with pytest.raises(InputError, match="is a folder"):
        read_ply(tmp_path)


def test_nothing_is_written_of_points_that_are_none(tmp_path):
    points = np.zeros((3, 3), np.float32)
    points[1, 2] = np.nan
    with pytest.raises(InputError, match="not a finite number"):
        write_ply(tmp_path / "a.ply", Cloud(points))
    with pytest.raises(InputError, match="no points to write"):
        write_ply(tmp_path / "a.ply", Cloud(points[:0]))
    assert list(tmp_path.iterdir()) == []


def test_endings(tmp_path):
    assert check_ending("a/b.PLY") == ".ply"
    assert check_ending(tmp_path / "x.npz") == ".npz"
    with pytest.raises(InputError, match=r"x\.stl: \.stl holds a surface"):
        check_ending("x.stl")
    with pytest.raises(InputError, match="is not known"):
        check_ending("x")


def test_range_npz_is_not_a_ply(tmp_path):
    buffer = io.BytesIO()
    np.savez(buffer, a=np.zeros(3))
    (tmp_path / "a.ply").write_bytes(buffer.getvalue())
    with pytest.raises(InputError, match="is not a PLY file"):
        read_ply(tmp_path / "a.ply")
