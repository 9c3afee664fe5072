"""Corners that another program found: calibrated, started from that program's camera, and with that camera held."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from jaxscan import Camera, calibrate, read_camera, read_rig, write_camera
from jaxscan.calibration import Observations
from jaxscan.calibration.board_views import observations_from
from jaxscan.cli.main import main
from jaxscan.errors import InputError
from jaxscan.files.cameras import read_camera_file
from tests.calibration import synthetic


@pytest.fixture(scope="module")
def seen() -> Observations:
    return synthetic.observations(seed=4, n_views=6, n_stage=0)


@pytest.fixture
def saved(tmp_path: Path, seen: Observations) -> Path:
    """`calib_data.mat`: the toolbox's y points up, so it decreases from row to row."""
    P = seen.board.points()
    variables = {"nx": 640.0, "ny": 480.0, "n_ima": float(len(seen.views))}
    for i, view in enumerate(seen.views, start=1):
        variables |= {f"X_{i}": np.stack([P[:, 0], P[:, 1].max() - P[:, 1], 0 * P[:, 2]]), f"x_{i}": view.corners.T}
    scipy.io.savemat(tmp_path / "calib_data.mat", variables)
    return tmp_path / "calib_data.mat"


def test_the_toolboxs_order_is_ours(saved, seen):
    found = observations_from(read_camera_file(saved), saved)
    assert found.board == seen.board
    assert found.image_size == seen.image_size
    for ours, theirs in zip(seen.views, found.views, strict=True):
        np.testing.assert_array_equal(ours.corners, theirs.corners)


def test_a_camera_to_start_from_and_one_to_hold(saved, seen, tmp_path, capsys):
    free = calibrate(seen_corners(seen))
    rig, camera = tmp_path / "rig.json", tmp_path / "camera.yml"
    started = Camera.create((640, 480), (720.0, 720.0), (319.5, 239.5), "radial1", [-0.1])
    write_camera(camera, started, format="opencv")
    assert main(["calibrate", str(saved), "-o", str(rig), "--camera", str(camera)]) == 0
    for name in synthetic.TRUTH:
        if name.startswith("camera"):
            part, i = name.split(".")[1:]
            one, other = (float(getattr(x.camera, part)[int(i)]) for x in (read_rig(rig).rig, free.rig))
            assert abs(one - other) < 1e-3 * (free.covariance.sigma(name) or 0)
    assert main(["calibrate", str(saved), "-o", str(rig), "--camera", str(camera), "--hold-camera"]) == 0
    held, asked = read_rig(rig), read_camera(camera)
    assert [float(x) for x in held.rig.camera.focal] == [float(x) for x in asked.focal]
    assert [float(x) for x in held.rig.camera.radial] == [float(x) for x in asked.radial]
    assert held.covariance is None or held.covariance.names == ()
    assert held.fit["corner_rms_px"] > 2 * free.corner_rms_px  # a wrong camera shows in the residuals
    capsys.readouterr()


def seen_corners(seen: Observations) -> Observations:
    """Without the stripes, which `calib_data.mat` has not."""
    return replace(seen, lasers=(), views=tuple(replace(view, stripes=()) for view in seen.views))


def test_a_camera_that_cannot_have_taken_the_photographs(saved, tmp_path, capsys):
    camera = tmp_path / "camera.yml"
    write_camera(camera, Camera.create((1280, 960), (720.0, 720.0), (319.5, 239.5)), format="opencv")
    argv = ["calibrate", str(saved), "-o", str(tmp_path / "rig.json")]
    assert main([*argv, "--camera", str(camera)]) == 2
    assert "camera.yml: is a camera of 1280 x 960 pixels, but 640 x 480 are wanted" in capsys.readouterr().err
    assert main([*argv, "--hold-camera"]) == 2
    assert "name it with --camera FILE" in capsys.readouterr().err
    assert not (tmp_path / "rig.json").exists()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda v: {k: x for k, x in v.items() if not k.startswith("X_")}, "has 54 corners, X_1 has 0"),
        (lambda v: v | {"X_2": 2 * v["X_2"]}, "image 2 shows other points of the board than image 1"),
        (lambda v: {k: x * [[1], [2], [1]] if k.startswith("X_") else x for k, x in v.items()}, "no grid of squares"),
        (lambda v: {k: x[:, ::-1] if k.startswith("X_") else x for k, x in v.items()}, "no grid"),
        (lambda v: {k: x[:, :2] if k[1] == "_" else x for k, x in v.items()}, "no grid of three by three"),
    ],
)
def test_what_is_no_board(saved, change, text):
    variables = {k: v for k, v in scipy.io.loadmat(saved).items() if not k.startswith("__")}
    scipy.io.savemat(saved, change(variables))
    with pytest.raises(InputError, match=text):
        observations_from(read_camera_file(saved), saved)
