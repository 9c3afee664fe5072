"""`jaxscan convert`, and `inspect` of other programs' cameras, through the command line."""

import json
import warnings
from pathlib import Path

import foreign_samples as samples
import numpy as np
import pytest
import scipy.io

from jaxscan import read_camera, read_rig
from jaxscan.cli.main import main

RIG = {
    "format": "jaxscan-rig/1",
    "units": "mm",
    "camera": {"image_size": [640, 480], "focal": [700.25, 690], "principal": [320, 240], "lens": "none"},
    "laser": {"plane": [0.0, -0.005, 0.003]},
    "stage": {"per_step": [0.0, 0.0006, -0.0008]},
    "covariance": {"parameters": ["camera.focal.0", "laser.plane.0"], "matrix": [[0.25, 0.0], [0.0, 1e-12]]},
}


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    (tmp_path / "rig.json").write_text(json.dumps(RIG))
    return tmp_path / "rig.json"


def run(*argv: object) -> int:
    """The command, with warnings said and not raised."""
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        return main([*map(str, argv)])


def refusal(capsys, *argv: object) -> str:
    assert main([*map(str, argv)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    return err


def test_a_rig_for_a_format_of_cameras_says_what_stays_behind(rig, tmp_path, capsys):
    assert run("convert", rig, tmp_path / "a.cameramodel", "--json") == 0
    out, err = capsys.readouterr()
    left = ["the light", "the stage", "the covariances", "the standard deviations"]
    assert json.loads(out)["left_out"] == left
    assert (
        f"jaxscan: warning: {tmp_path / 'a.cameramodel'}: mrcal's .cameramodel has no place for {', '.join(left)}"
        in err
    )
    assert float(read_camera(tmp_path / "a.cameramodel").focal[0]) == 700.25
    assert run("convert", rig, tmp_path / "a.mat") == 0
    capsys.readouterr()
    raw = scipy.io.loadmat(tmp_path / "a.mat")
    assert raw["fc_error"][0] == 3 * 0.5  # three standard deviations
    assert np.isnan(raw["fc_error"][1])


def test_a_camera_becomes_a_rig_without_laser_and_stage(tmp_path, capsys):
    path = samples.bouguet(tmp_path / "Calib_Results.mat")
    assert run("convert", path, tmp_path / "rig.json") == 0
    out, err = capsys.readouterr()
    assert "532.795 ± 0.5" not in out
    assert "no place for the standard deviations, 2 photographs of the board" in err
    found = read_rig(tmp_path / "rig.json")
    assert (found.rig.lights, found.rig.axes(), found.covariance) == ((), {}, None)
    assert found.rig.camera.lens.kind == "brown"
    assert float(found.rig.camera.lens.radial[2]) == samples.TERMS[4]


def test_every_pair_of_formats(tmp_path, capsys):
    """Round the circle through all of them, with a lens that all of them have."""
    first = samples.bouguet(tmp_path / "a.mat", kc=np.array([[*samples.TERMS[:4], 0.0]]).T)
    path = first
    for target, form in (
        ("b.yml", "opencv"),
        ("c.yaml", "ros"),
        ("d.yaml", "kalibr"),
        ("e.cameramodel", None),
        ("f.json", "rig"),
        ("g.xml", None),
        ("h.mat", None),
    ):
        options = ["--format", form] if form else []
        assert run("convert", path, tmp_path / target, *options) == 0
        path = tmp_path / target
    capsys.readouterr()
    raw, again = scipy.io.loadmat(first), scipy.io.loadmat(path)
    for name in ("fc", "cc", "kc", "KK", "alpha_c"):
        np.testing.assert_array_equal(raw[name], again[name])


def test_what_has_no_counterpart_is_named_and_nothing_is_written(tmp_path, capsys):
    path = samples.bouguet(tmp_path / "a.mat")
    error = refusal(capsys, "convert", path, tmp_path / "b.yaml", "--format", "kalibr")
    assert "b.yaml: the lens term k3 = 0.1634 has no counterpart in Kalibr's radtan" in error
    assert [file.name for file in tmp_path.iterdir()] == ["a.mat"]


def test_usage_is_checked_before_work(rig, tmp_path, capsys):
    assert "give the format, opencv or ros or kalibr" in refusal(capsys, "convert", rig, tmp_path / "a.yaml")
    assert "no format of cameras is known" in refusal(capsys, "convert", rig, tmp_path / "a.txt")
    assert "copy the file" in refusal(capsys, "convert", rig, tmp_path / "b.json")
    assert "no folder" in refusal(capsys, "convert", rig, tmp_path / "none" / "a.mat")
    assert "no such file" in refusal(capsys, "convert", tmp_path / "none.mat", tmp_path / "a.json")
    assert "is a camera of 640 x 480 pixels" in refusal(
        capsys, "convert", rig, tmp_path / "a.mat", "--image-size", "1280x960"
    )
    assert main(["convert", str(rig), str(tmp_path / "a.mat"), "--image-size", "wide"]) == 2
    assert "such as 640x480" in capsys.readouterr().err


def test_what_is_read_is_not_replaced(tmp_path, capsys):
    """A format that has no place for a term would take it from the only file that has it."""
    path = tmp_path / "a.yml"
    path.write_text(samples.OPENCV)
    assert "is read, and writing to it would replace it" in refusal(capsys, "convert", path, path, "--format", "ros")
    (tmp_path / "link.yaml").symlink_to(path)
    assert "would replace it" in refusal(capsys, "convert", path, tmp_path / "link.yaml", "--format", "ros")
    assert path.read_text() == samples.OPENCV


def test_the_size_of_the_image_where_the_file_has_none(tmp_path, capsys):
    path = tmp_path / "a.yml"
    path.write_text(samples.OPENCV.replace("image_width: 640\nimage_height: 480\n", ""))
    assert "image_width: is missing" in refusal(capsys, "convert", path, tmp_path / "a.json")
    assert main(["convert", str(path), str(tmp_path / "a.json"), "--image-size", "640x480"]) == 0
    assert read_rig(tmp_path / "a.json").rig.camera.image_size == (640, 480)


@pytest.mark.parametrize("name", [*samples.TEXTS, "Calib_Results.mat"])
def test_inspect_says_what_a_camera_is(tmp_path, capsys, name):
    path = tmp_path / name
    if name in samples.TEXTS:
        path.write_text(samples.TEXTS[name])
    else:
        samples.bouguet(path)
    assert main(["inspect", str(path)]) == 0
    text = capsys.readouterr().out
    assert "640 × 480 pixels, lens brown" in text
    assert ("532.795 ± 0.5, 532.919 ± 0.6 px" in text) == (name == "Calib_Results.mat")
    assert ("2 photographs of the board, 2 of them with their pose" in text) == (name == "Calib_Results.mat")


def test_inspect_asks_for_the_camera_of_a_camchain(rig, tmp_path, capsys):
    path = tmp_path / "camchain.yaml"
    path.write_text(samples.KALIBR + samples.KALIBR.replace("cam0:", "cam1:"))
    assert "cam0, cam1: give the name" in refusal(capsys, "inspect", path)
    assert main(["inspect", str(path), "--name", "cam1"]) == 0
    capsys.readouterr()
    assert "not for a rig" in refusal(capsys, "inspect", rig, "--name", "cam1")
    assert "a camera has none" in refusal(capsys, "inspect", path, "--png")
