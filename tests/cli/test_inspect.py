"""`jaxscan inspect`, through the command line: every kind of file in words and as JSON, and its refusals."""

import dataclasses
import json
import math
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.files.cloud import Cloud, write_ply
from jaxscan.files.range_npz import RangeArrays, write_range_npz

RIG = {
    "format": "jaxscan-rig/1",
    "units": "mm",
    "camera": {"image_size": [641, 481], "focal": [700, 690], "principal": [320, 240], "lens": "none"},
    # A sheet through (0, 0, 300) that contains the u axis and leans by 30° from the camera's axis.
    "laser": {"plane": [0.0, -1 / 300 / math.tan(math.radians(30)), 1 / 300]},
    "stage": {"per_step": [0.0, 0.0006, -0.0008]},
    "covariance": {"parameters": ["camera.focal.0", "camera.focal.1"], "matrix": [[0.25, 0.0], [0.0, 0.0]]},
    "fit": {"corner_rms_px": 0.0812345, "views": 12},
}


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(RIG))
    return path


def words(capsys, *argv: object) -> str:
    assert main(["inspect", *map(str, argv)]) == 0
    return capsys.readouterr().out


def summary(capsys, *argv: object) -> dict:
    return json.loads(words(capsys, *argv, "--json"))


def refusal(capsys, *argv: object) -> str:
    assert main(["inspect", *map(str, argv)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    return err


def test_a_rig_in_numbers(rig, capsys):
    found = summary(capsys, rig)
    (laser,) = found["lights"]
    assert (laser["name"], laser["kind"], laser["plane"]["value"]) == ("", "plane", RIG["laser"]["plane"])
    assert laser["angle_to_axis_deg"] == pytest.approx(30)
    assert laser["distance_mm"] == pytest.approx(300 * math.sin(math.radians(30)))
    assert laser["depth_in_the_middle_mm"] == pytest.approx(300)
    assert laser["triangulation_angle_deg"] == pytest.approx(30)
    low, high = laser["triangulation_angles_deg"]
    # Straight up and down the image the angle grows and shrinks by that of the pixel's ray.
    half_height = math.degrees(math.atan(240.5 / 690))
    assert high == pytest.approx(30 + half_height, abs=1e-6)
    assert low < 30 - half_height + 1e-6
    (stage,) = found["motion"]
    assert (stage["axis"], stage["kind"], stage["per_step"]["sigma"]) == ("stage", "linear", [None] * 3)
    assert stage["mm_per_1000_steps"] == pytest.approx(1.0)
    assert stage["direction"] == pytest.approx([0, 0.6, -0.8])
    assert found["camera"]["focal"] == {"value": [700.0, 690.0], "sigma": [0.5, 0.0]}
    assert found["camera"]["principal"]["sigma"] == [None, None]
    assert found["fit"] == RIG["fit"]


def test_a_rig_in_words(rig, capsys):
    text = words(capsys, rig)
    for part in (
        "641 × 481 pixels, lens none",
        "700 ± 0.5, 690 px",
        "150.0 mm from the camera, 30.0° to its axis",
        "in the middle of the image 300.0 mm away",
        "1 mm for 1000 steps, down and towards the camera, along (0.0000, 0.6000, -0.8000)",
        "0.08123",
    ):
        assert part in text


def test_a_rig_with_a_turntable(tmp_path, capsys):
    known = {f"turntable.{part}.{i}": s for part, s in (("per_step", 1e-6), ("centre", 0.01)) for i in range(3)}
    path = tmp_path / "rig.json"
    turntable = {"per_step": [0.0, 0.0, -2 * math.pi / 3200], "centre": [3.0, 4.0, 0.0]}
    covariance = {"parameters": list(known), "matrix": np.diag(np.square(list(known.values()))).tolist()}
    path.write_text(json.dumps(RIG | {"turntable": turntable, "covariance": covariance}))
    said = words(capsys, path)
    assert "0.1125° ± 5.7e-05° a step, 3200 steps a turn, anticlockwise as the camera sees it" in said
    # Where the sheet meets the camera's axis, 300 mm away: σ of the direction times that, and of the centre.
    assert "axis (0.00000, 0.00000, -1.00000) ± 0.029° through (3.000, 4.000, 300.000) mm ± 0.15 mm" in said
    path.write_text(json.dumps(RIG | {"turntable": turntable}))
    assert "through (3.000, 4.000, 300.000) mm\n" in words(capsys, path)
    found = summary(capsys, path)["motion"]
    assert [(axis["axis"], axis["kind"]) for axis in found] == [("stage", "linear"), ("turntable", "rotary")]
    assert found[1]["through_sigma_mm"] is None


def test_the_least_rig(rig, capsys):
    rig.write_text(json.dumps({key: RIG[key] for key in ("format", "units", "camera")}))
    assert "light plane      none" in words(capsys, rig)


def test_an_unknown_key_is_said_on_standard_error(rig, capsys):
    rig.write_text(json.dumps({**RIG, "colour": 1}))
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert main(["inspect", str(rig)]) == 0
    assert "jaxscan: warning: " in capsys.readouterr().err


def test_a_cloud(tmp_path, capsys):
    points = np.array([[0, 0, 1], [3, -2, 5]], np.float32)
    write_ply(tmp_path / "cup.ply", Cloud(points, sigma=np.array([0.25, 0.75], np.float32)))
    found = summary(capsys, tmp_path / "cup.ply")
    assert found["points"] == 2
    assert found["box_mm"] == [[0, -2, 1], [3, 0, 5]]
    assert found["sigma_mm"] == 0.5
    assert "x 0.0 … 3.0, y -2.0 … 0.0, z 1.0 … 5.0 mm" in words(capsys, tmp_path / "cup.ply")


def test_a_range_image(tmp_path, capsys):
    valid = np.array([[True, False, True]])
    points = np.where(valid[..., None], np.full(3, 2, np.float32), np.float32(np.nan))
    unknown = np.full((1, 3), np.nan, np.float32)
    write_range_npz(tmp_path / "cup.npz", RangeArrays(points, unknown + 1, unknown, valid, np.array([-100_000])))
    found = summary(capsys, tmp_path / "cup.npz")
    assert found["points"] == 2
    assert found["sigma_mm"] is None
    assert "2, 66.7 % of frames × lines" in words(capsys, tmp_path / "cup.npz")


def test_what_a_range_image_knows_of_its_light(tmp_path, capsys):
    one = np.ones((2, 3), np.float32)
    light = np.array([[2, 0.5, 0.18, 252], [np.nan] * 4], np.float32)
    points = np.ones((2, 3, 3), np.float32)
    write_range_npz(tmp_path / "cup.npz", RangeArrays(points, one, one, one > 0, np.arange(2), light=light))
    assert summary(capsys, tmp_path / "cup.npz")["light"]["gain"] == 0.5
    assert "read noise 2 grey levels, gain 0.5 grey levels for each electron, speckle contrast 0.18" in words(
        capsys, tmp_path / "cup.npz"
    )


def test_how_near_a_range_image_comes_to_the_limit_of_speckle(tmp_path, rig, capsys):
    # The point (0, 0, 300) of the sheet, seen at step 1000: f = 695 px of 5 µm, f/4, θ = 30°, contrast 0.2.
    one = np.ones((1, 1), np.float32)
    points = np.array([[[0, -0.6, 300.8]]], np.float32)
    arrays = RangeArrays(
        points,
        one,
        one,
        one > 0,
        np.array([1000]),
        sigma_pixel=one / 10,
        per_step=np.array([0.0, 0.0006, -0.0008]),
        light=np.array([[2, 0, 0.2, 252]], np.float32),
    )
    write_range_npz(tmp_path / "cup.npz", arrays)
    optics = ("--f-number", 4, "--wavelength-nm", 650, "--pixel-um", 5)
    found = summary(capsys, tmp_path / "cup.npz", "--rig", rig, *optics)["speckle_limit"]
    expected = 0.2 * 0.00065 / (2 * math.pi * (3.475 / 8 / 300) * 0.5)
    assert found["limit_mm"] == pytest.approx(expected, rel=1e-4)
    assert found["times"] == pytest.approx(0.1 / expected, rel=1e-4)
    said = words(capsys, tmp_path / "cup.npz", "--rig", rig, *optics)
    assert "0.0286 mm at a contrast of 0.20" in said
    assert "give all four" in refusal(capsys, tmp_path / "cup.npz", "--rig", rig)
    write_range_npz(tmp_path / "far.npz", dataclasses.replace(arrays, points=points * 1.1))
    assert "do not lie on the light" in refusal(capsys, tmp_path / "far.npz", "--rig", rig, *optics)


def test_an_empty_range_image(tmp_path, capsys):
    none = np.zeros((0, 3), np.float32)
    arrays = RangeArrays(np.zeros((0, 3, 3), np.float32), none, none, none > 0, np.zeros(0, np.int64))
    write_range_npz(tmp_path / "cup.npz", arrays)
    said = words(capsys, tmp_path / "cup.npz")
    assert "frames  0\n" in said
    assert "stage   no steps\n" in said


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    folder = tmp_path / "cup"
    folder.mkdir()
    for i in range(3):
        image = np.zeros((48, 64, 3), np.uint8)
        image[20 + i] = (40, 40, 250)  # OpenCV writes blue first
        assert cv2.imwrite(str(folder / f"f{i}.png"), image)
    (folder / "scan.toml").write_text('[scan]\nname = "cup"\nframes = "f*.png"\nsteps_per_frame = -500\n')
    return folder


def test_a_scan(scan, capsys):
    found = summary(capsys, scan)
    assert found["frames"] == 3
    assert found["axes"] == {"stage": {"count": 3, "first_step": 0, "last_step": -1000, "spacing": -500}}
    assert found["image_size"] == [64, 48]
    assert "stage        steps 0 to -1000, -500 apart" in words(capsys, scan / "scan.toml")


def test_a_scan_on_several_axes(scan, capsys):
    def write(of: str, *axes: str) -> None:
        (scan / "scan.toml").write_text("\n".join([f'[scan]\nframes = "{of}"\n[scan.axes]', *axes]))

    write("f*.png", "turntable = { start = 4, per_frame = 8 }", "stage = 20000", "lift = [0, 5, 0]")
    assert summary(capsys, scan)["axes"] == {
        "turntable": {"count": 3, "first_step": 4, "last_step": 20, "spacing": 8},
        "stage": {"count": 3, "first_step": 20000, "last_step": 20000, "spacing": 0},
        "lift": {"count": 3, "first_step": 0, "last_step": 0, "spacing": None},
    }
    said = words(capsys, scan)
    for line in (
        "turntable    steps 4 to 20, 8 apart\n",
        "stage        step 20000\n",
        "lift         from step 0 and back to it\n",
    ):
        assert line in said
    (scan / "v.mp4").write_bytes(b"any")
    write("v.mp4", "turntable = { start = 4, per_frame = 8 }", "stage = 20000")
    found = summary(capsys, scan)
    assert found["frames"] is None
    assert found["axes"]["turntable"] == {"count": None, "first_step": 4, "last_step": None, "spacing": 8}
    said = words(capsys, scan)
    for line in ("turntable   from step 4, 8 motor steps from one frame to the next\n", "stage       step 20000\n"):
        assert line in said


def test_frames_of_different_size_are_refused(scan, capsys):
    assert cv2.imwrite(str(scan / "f1.png"), np.zeros((64, 48), np.uint8))
    assert "f1.png: is 48 × 64 pixels" in refusal(capsys, scan)


def test_a_real_session(data, capsys):
    text = words(capsys, data / "etna-2")
    assert "checkerboard, 7 × 6 inner corners, 10 mm apart" in text
    assert "8 photographs of 1280 × 1024 pixels" in text
    assert "grey, one point for each image row, in the photographs of the board" in text
    assert "none: the rig will have none" in words(capsys, data / "opencv-left")


def green(path: Path) -> np.ndarray:
    """Rows and columns of the pixels that carry the stripe's mark, which is green."""
    picture = cv2.imread(str(path)).astype(int)
    return np.argwhere((picture[..., 1] > 200) & (picture[..., 2] < 60))


def test_the_stripe_is_drawn_where_it_is(scan, tmp_path, capsys):
    found = summary(capsys, scan, "--frame", 2, "--png", tmp_path / "f2.png")
    assert found["picture"] == {"path": str(tmp_path / "f2.png"), "stripe_points": 64, "of_columns": 64, "notes": []}
    rows = green(tmp_path / "f2.png")[:, 0]
    assert abs(rows.mean() - 22) < 0.2
    assert "a stripe in 64 of 64 columns" in words(capsys, scan, "--png", tmp_path / "f0.png")


def test_the_background_is_subtracted(scan, tmp_path, capsys):
    """A lamp brighter than the stripe is found in its place, unless a photograph without the laser takes it away."""
    dark = np.zeros((48, 64, 3), np.uint8)
    dark[8, :, 2] = 250
    lit = dark.copy()
    lit[30, :, 2] = 150
    for name, image in (("dark", dark), ("lit", lit)):
        assert cv2.imwrite(str(scan / f"{name}.png"), image)
    for background, row in (("", 8), ('background = "dark.png"\n', 30)):
        (scan / "scan.toml").write_text(f'[scan]\nframes = "lit.png"\nsteps = [0]\n{background}')
        assert summary(capsys, scan, "--png", tmp_path / "a.png")["picture"]["stripe_points"] == 64
        assert abs(green(tmp_path / "a.png")[:, 0].mean() - row) < 0.2


def test_the_picture_is_named_after_folder_and_frame(scan, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    assert summary(capsys, scan, "--frame", 1, "--png")["picture"]["path"] == "cup-1.png"
    assert (tmp_path / "cup-1.png").is_file()


def test_corners_and_stripe_of_a_real_view(data, tmp_path, capsys):
    picture = summary(capsys, data / "etna-2", "--frame", 0, "--png", tmp_path / "v.png")["picture"]
    assert (picture["corners"], picture["of_corners"]) == (42, 42)
    assert picture["lasers"][0]["stripe_points"] > 300
    assert cv2.imread(str(tmp_path / "v.png")).shape == (1024, 1280, 3)


def test_frames_that_are_not_there(scan, tmp_path, capsys):
    for frame in (3, -1):
        error = refusal(capsys, scan, "--frame", frame, "--png", tmp_path / "a.png")
        assert f"--frame {frame}: it has 3 frames, counted from 0 to 2" in error
    assert "no folder" in refusal(capsys, scan, "--png", tmp_path / "nowhere" / "a.png")
    (scan / "f1.png").write_bytes((scan / "f1.png").read_bytes()[:60])
    assert "f1.png" in refusal(capsys, scan, "--frame", 1, "--png", tmp_path / "a.png")
    assert not (tmp_path / "a.png").exists()


def test_no_photograph_is_drawn_over(scan, capsys):
    before = (scan / "f0.png").read_bytes()
    assert '"" is no ending of an image: write .png' in refusal(capsys, scan, "--png", scan / "picture")
    assert "is a photograph of this session or scan" in refusal(capsys, scan, "--png", scan / "f0.png")
    assert (scan / "f0.png").read_bytes() == before


def test_what_cannot_be_inspected(tmp_path, rig, scan, capsys):
    assert "no such file or folder" in refusal(capsys, tmp_path / "none")
    assert "neither session.toml nor scan.toml nor profiles.toml" in refusal(capsys, tmp_path)
    (tmp_path / "scan.toml.txt").write_text("")
    assert "rename it to scan.toml" in refusal(capsys, tmp_path)
    (scan / "session.toml").write_text("")
    assert "both session.toml and scan.toml" in refusal(capsys, scan)
    (tmp_path / "a.docx").write_text("")
    assert 'the ending ".docx"' in refusal(capsys, tmp_path / "a.docx")
    assert "a rig has none" in refusal(capsys, rig, "--png")
    assert "add --png" in refusal(capsys, scan / "scan.toml", "--frame", "1")
