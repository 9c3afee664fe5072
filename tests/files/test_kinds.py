"""A file instead of another: the error says what it is, what is expected, and which to name."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from hardware.devices import read_scanner
from jaxscan.errors import InputError
from jaxscan.files.rig_file import read_rig
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session

SESSION = "the session.toml that lists the photographs"
SCAN = "the scan.toml that lists the photographs"
RIG = "the rig.json that `jaxscan calibrate` wrote"
SCANNER = "the scanner.toml that describes the scanner"


@pytest.fixture
def files(tmp_path: Path, photographs) -> Path:
    """One of each kind."""
    photographs(tmp_path, ["p.png", "p.jpg", "p.tif", "p.bmp"])
    assert cv2.imwrite(str(tmp_path / "taken.png"), np.zeros((24, 32), np.uint8))
    (tmp_path / "taken.png").rename(tmp_path / "taken")
    np.savez(tmp_path / "cup.npz", points=np.zeros((2, 3, 3)))
    (tmp_path / "cup.ply").write_text("ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")
    (tmp_path / "cup.mat").write_bytes(b"MATLAB 5.0 MAT-file".ljust(126) + b"\x00\x01IM\xff\xff")
    (tmp_path / "cup.mp4").write_bytes(b"\x00\x00\x00\x20ftypisom\xff\xfe")
    (tmp_path / "cup.stl").write_text("solid cup\nendsolid cup\n")
    (tmp_path / "rig.json").write_text('{"format": "jaxscan-rig/1"}')
    (tmp_path / "scan.toml").write_text('[scan]\nframes = ["p.png"]\nsteps = [0]\n')
    (tmp_path / "session.toml").write_text('[board]\n[views]\nboards = ["p.png"]\n')
    return tmp_path


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "a photograph") for name in ("p.png", "p.jpg", "p.tif", "p.bmp", "taken")),
        ("cup.npz", "a range image or other arrays of NumPy"),
        ("cup.ply", "a cloud or a mesh"),
        ("cup.mat", "a file of MATLAB"),
        ("cup.mp4", "a video"),
        ("cup.stl", "a mesh"),
    ],
)
def test_what_is_no_text_of_ours_is_called_what_it_is(files, name, kind):
    for read, expected, wanted in (
        (read_session, "TOML", SESSION),
        (read_scan, "TOML", SCAN),
        (read_rig, "JSON", RIG),
        (read_scanner, "TOML", SCANNER),
    ):
        with pytest.raises(InputError) as refused:
            read(files / name)
        assert str(refused.value) == f"{files / name}: is {kind}, but a {expected} file is expected: name {wanted}"


def test_our_own_files_in_the_place_of_one_another(files):
    for read, name, said in (
        (read_session, "rig.json", f"is a JSON file, but a TOML file is expected: name {SESSION}"),
        (read_rig, "scan.toml", f"is a TOML file, but a JSON file is expected: name {RIG}"),
        (read_session, "scan.toml", f"is a scan.toml, but a session.toml is expected: name {SESSION}"),
        (read_scan, "session.toml", f"is a session.toml, but a scan.toml is expected: name {SCAN}"),
    ):
        with pytest.raises(InputError) as refused:
            read(files / name)
        assert str(refused.value) == f"{files / name}: {said}"


def test_a_file_of_the_kind_expected_is_told_where_it_is_wrong(tmp_path):
    (tmp_path / "session.toml").write_text("[board\n")
    with pytest.raises(InputError, match=rf"is not valid TOML: .*line 1.*: correct it there, or name {SESSION}"):
        read_session(tmp_path)
    (tmp_path / "rig.json").write_text("{")
    with pytest.raises(InputError, match=rf"is not valid JSON: .*line 1.*: correct it there, or name {RIG}"):
        read_rig(tmp_path / "rig.json")
