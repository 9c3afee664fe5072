"""`[poses]` of a session and `poses` of a scan: what the format allows, and every mistake with its fix."""

from pathlib import Path

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.scan import read_scan, write_scan
from jaxscan.files.session import Session, read_session, write_session
from jaxscan.rig import given_poses

BOARD = "[board]\ninner_corners = [9, 6]\nsquare_mm = 10.0\n"
VIEWS = '[views]\nboards = "boards/*.png"\n'
POSES = '[poses]\nimages = "poses/*.png"\nfile = "poses.csv"\nmoves = "head"\n'
TABLE = "".join(f"v{i}.png,{i},2,3,0.6,0.8,0,0\n" for i in (1, 2, 10, 11))


@pytest.fixture
def folder(tmp_path: Path, photographs) -> Path:
    for kind in ("boards", "stripes", "poses", "lit", "stage"):
        photographs(tmp_path / kind, ["v10.png", "v2.png", "v1.png", "v11.png"])
    (tmp_path / "poses.csv").write_text(TABLE)
    return tmp_path


def session(folder: Path, *parts: str) -> Session:
    (folder / "session.toml").write_text("\n".join(parts), encoding="utf-8")
    return read_session(folder)


def test_posed_photographs_are_the_last_views(folder: Path):
    read = session(folder, BOARD, VIEWS, POSES, "sigma_mm = 0.1\nsigma_deg = 0.02")
    assert read.poses is not None
    assert read.poses.images == read.views.boards[4:]
    assert [path.parent.name for path in read.views.boards] == ["boards"] * 4 + ["poses"] * 4
    assert (read.poses.moves, read.poses.sigma_mm, read.poses.sigma_deg) == ("head", 0.1, 0.02)
    np.testing.assert_allclose(read.poses.poses.translation[:, 0], [1, 2, 10, 11])
    assert read.views.stripes is None


def test_poses_alone(folder: Path):
    read = session(folder, BOARD, POSES)
    assert read.poses is not None
    assert read.views.boards == read.poses.images
    assert len(read.photographs()) == 4


STRIPES = {
    "of the views alone": ('stripes = "stripes/*.png"', "", ["stripes"] * 4 + [None] * 4),
    "of both": ('stripes = "stripes/*.png"', 'stripes = "lit/*.png"', ["stripes"] * 4 + ["lit"] * 4),
    "of the poses alone": ("", 'stripes = "lit/*.png"', ["boards"] * 4 + ["lit"] * 4),
}


@pytest.mark.parametrize("which", STRIPES)
def test_stripes_are_paired_in_order(folder: Path, which: str):
    of_views, of_poses, expected = STRIPES[which]
    read = session(folder, BOARD, VIEWS, of_views, POSES, of_poses, "[laser]")
    assert read.views.stripes is not None
    assert [path and path.parent.name for path in read.views.stripes[""]] == expected


@pytest.mark.parametrize("stripes", ["", 'stripes = "lit/*.png"'])
def test_what_is_written_is_read(folder: Path, stripes: str):
    before = 'stripes = "stripes/*.png"' if stripes else ""
    read = session(folder, BOARD, VIEWS, before, POSES, stripes, "sigma_mm = 0.1\n[laser]")
    write_session(read)
    again = read_session(folder)
    assert again.views == read.views
    assert again.poses is not None
    assert read.poses is not None
    assert (again.poses.images, again.poses.moves, again.poses.sigma_mm) == (read.poses.images, "head", 0.1)


BAD = {
    "no table": (POSES.replace("poses.csv", "other.csv"), ['[poses] file = "other.csv"', "is no file"]),
    "moves what": (POSES.replace('"head"', '"table"'), ['[poses] moves = "table"', "one of head, object"]),
    "moves missing": (POSES.replace('moves = "head"', ""), ["[poses] moves", "missing"]),
    "no error": (POSES + "sigma_mm = 0", ["[poses] sigma_mm = 0", "above 0"]),
    "a key too many": (POSES + "steps = [1, 2]", ["[poses] steps", "unknown key"]),
    "too few": (POSES.replace('"poses/*.png"', '["poses/v1.png"]'), ["[poses] images", "three or more"]),
    "a stage too": (POSES + '[stage]\nimages = "stage/*.png"\nsteps_per_image = 100', ["[poses] and [stage]", "apart"]),
    "stripes without a laser": (POSES + 'stripes = "lit/*.png"', ["[poses] stripes", "add [laser]"]),
}


@pytest.mark.parametrize("name", BAD)
def test_mistakes_are_named_with_their_fix(folder: Path, name: str):
    text, expected = BAD[name]
    with pytest.raises(InputError) as caught:
        session(folder, BOARD, VIEWS, text)
    for part in (str(folder), *expected):
        assert part in str(caught.value)


def test_a_photograph_of_two_poses(folder: Path):
    with pytest.raises(InputError, match="for two poses"):
        session(folder, BOARD, VIEWS, POSES.replace("poses/*", "boards/*"))


def test_a_scan_with_poses(folder: Path):
    (folder / "scan.toml").write_text('[scan]\nframes = "poses/*.png"\nposes = "poses.csv"\n')
    read = read_scan(folder)
    assert (read.moving, read.listed) == (("poses",), 4)
    poses = given_poses({axis: np.array(n, float) for axis, n in read.axes.items()})
    np.testing.assert_allclose(poses.translation, [[1, 2, 3], [2, 2, 3], [10, 2, 3], [11, 2, 3]])
    np.testing.assert_allclose(poses.rotation[:, 0], 2 * np.arctan2(0.8, 0.6), rtol=1e-9)
    write_scan(read)
    assert read_scan(folder) == read


BAD_SCANS = {
    "steps too": ("steps = [1, 2, 3, 4]", ["[scan] steps", "either poses or motor steps"]),
    "axes too": ("[scan.axes]\nstage = 1", ["[scan] axes", "either poses or motor steps"]),
}


@pytest.mark.parametrize("name", BAD_SCANS)
def test_mistakes_of_a_scan(folder: Path, name: str):
    text, expected = BAD_SCANS[name]
    (folder / "scan.toml").write_text(f'[scan]\nframes = "poses/*.png"\nposes = "poses.csv"\n{text}\n')
    with pytest.raises(InputError) as caught:
        read_scan(folder)
    for part in expected:
        assert part in str(caught.value)


def test_a_video_has_no_names(folder: Path):
    (folder / "v.avi").write_bytes(b"any")
    (folder / "scan.toml").write_text('[scan]\nframes = "v.avi"\nposes = "poses.csv"\n')
    with pytest.raises(InputError, match="not a video"):
        read_scan(folder)
