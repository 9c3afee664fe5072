"""Points in the formats of other programs: what is written comes back within the format's step."""

from pathlib import Path

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.cloud import Cloud
from jaxscan.files.exchange import CLOUDS, read_cloud, write_cloud, writing_cloud

# Step of a coordinate, mm: half of it is the largest error beside float32's own at 500 mm.
STEPS = {".ply": 0.0, ".xyz": 1e-5, ".pcd": 0.0, ".e57": 0.0, ".laz": 1e-4, ".las": 1e-4}
KEPT = {
    ".ply": ("sigma", "sigma_pixel", "strength", "colours", "albedo"),
    ".xyz": (),
    ".pcd": ("sigma", "sigma_pixel", "strength", "colours", "albedo"),
    ".e57": ("strength", "colours"),
    ".laz": ("sigma", "sigma_pixel", "strength", "colours", "albedo"),
    ".las": ("sigma", "sigma_pixel", "strength", "colours", "albedo"),
}


def cloud(n: int = 5000, seed: int = 1) -> Cloud:
    random = np.random.default_rng(seed)
    return Cloud(
        points=random.uniform([-150, -100, 250], [150, 100, 500], (n, 3)).astype(np.float32),
        sigma=random.random(n, dtype=np.float32),
        sigma_pixel=random.random(n, dtype=np.float32),
        colours=random.integers(0, 256, (n, 3), dtype=np.uint8),
        strength=250 * random.random(n, dtype=np.float32),
        albedo=random.random(n, dtype=np.float32),
    )


def needs(ending: str) -> None:
    if ending in (".e57", ".laz", ".las"):
        pytest.importorskip("pye57", reason="the extra exchange is not installed")
        pytest.importorskip("laspy", reason="the extra exchange is not installed")


def check(path: Path, written: Cloud) -> None:
    read = read_cloud(path)
    ending = path.suffix
    step = np.spacing(np.float32(500.0)) if ending != ".ply" else 0.0
    np.testing.assert_allclose(read.points, written.points, rtol=0, atol=STEPS[ending] / 2 + step)
    for name in KEPT["." + ending.removeprefix(".")]:
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    assert read.points.dtype == np.float32


@pytest.mark.parametrize("ending", CLOUDS)
def test_there_and_back(ending: str, tmp_path: Path) -> None:
    needs(ending)
    written = cloud()
    write_cloud(tmp_path / f"a{ending}", written)
    check(tmp_path / f"a{ending}", written)
    assert [path.name for path in tmp_path.iterdir()] == [f"a{ending}"]


@pytest.mark.parametrize("ending", CLOUDS)
def test_points_that_come_some_at_a_time(ending: str, tmp_path: Path) -> None:
    needs(ending)
    parts = [cloud(n, seed) for seed, n in enumerate((700, 0, 1300, 1))]
    with writing_cloud(tmp_path / f"a{ending}") as add:
        for part in parts:
            add(part)
    names = ("points", "sigma", "sigma_pixel", "colours", "strength", "albedo")
    check(tmp_path / f"a{ending}", Cloud(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names}))


@pytest.mark.parametrize("ending", CLOUDS)
def test_what_cannot_be_written_leaves_nothing(ending: str, tmp_path: Path) -> None:
    needs(ending)
    bad = cloud(10)
    bad.points[3, 1] = np.nan
    with pytest.raises(InputError, match="not a finite number"):
        write_cloud(tmp_path / f"a{ending}", bad)
    with pytest.raises(InputError, match="no points to write"):
        write_cloud(tmp_path / f"b{ending}", cloud(0))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", CLOUDS)
def test_what_is_damaged_is_refused_by_name(ending: str, tmp_path: Path) -> None:
    needs(ending)
    path = tmp_path / f"a{ending}"
    for content in (b"", b"no such thing\nat all", b"\x00\xff" * 300):
        path.write_bytes(content)
        with pytest.raises(InputError, match=rf"a\{ending}"):
            read_cloud(path)
    write_cloud(path, cloud(200))
    whole = path.read_bytes()
    if ending != ".xyz":  # A text that ends early is a shorter text.
        path.write_bytes(whole[: len(whole) * 2 // 3])
        with pytest.raises(InputError, match=rf"a\{ending}"):
            read_cloud(path)
    with pytest.raises(InputError, match="no such file"):
        read_cloud(tmp_path / f"none{ending}")


def test_the_pcd_is_that_of_the_format(tmp_path: Path) -> None:
    write_cloud(tmp_path / "a.pcd", Cloud(np.array([[1, 2, 3], [4, 5, 6]], np.float32)))
    head, _, body = (tmp_path / "a.pcd").read_bytes().partition(b"DATA binary\n")
    lines = [line.split() for line in head.decode().splitlines() if not line.startswith("#")]
    assert dict((line[0], line[1:]) for line in lines) == {
        "VERSION": ["0.7"],
        "FIELDS": ["x", "y", "z"],
        "SIZE": ["4"] * 3,
        "TYPE": ["F"] * 3,
        "COUNT": ["1"] * 3,
        "WIDTH": ["2"],
        "HEIGHT": ["1"],
        "VIEWPOINT": ["0", "0", "0", "1", "0", "0", "0"],
        "POINTS": ["2"],
    }
    assert body == np.arange(1, 7, dtype="<f4").tobytes()


def test_an_e57_is_in_metres(tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57", reason="the extra exchange is not installed")
    write_cloud(tmp_path / "a.e57", Cloud(np.array([[100.0, -50.0, 350.0]], np.float32)))
    file = pye57.E57(str(tmp_path / "a.e57"))
    scan = file.read_scan_raw(0)
    file.close()
    np.testing.assert_allclose([scan[f"cartesian{axis}"][0] for axis in "XYZ"], [0.1, -0.05, 0.35])
