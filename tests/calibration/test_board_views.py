"""Corners that another program found: calibrated, started from that program's camera, and with that camera held."""

from dataclasses import replace
from pathlib import Path

import cv2
import jax
import numpy as np
import pytest
import scipy.io

from jaxscan import Camera, calibrate, read_camera, read_rig, write_camera
from jaxscan.calibration import Observations
from jaxscan.calibration.board_views import observations_from
from jaxscan.cli.main import main
from jaxscan.errors import InputError
from jaxscan.files.cameras import read_camera_file, write_camera_file
from jaxscan.rig.camera import camera_parameters, lens_parameters
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
    for name, one, other in zip(
        camera_parameters("radial1"), *(jax.tree.leaves(x.camera) for x in (read_rig(rig).rig, free.rig)), strict=True
    ):
        assert abs(one - other) < 1e-3 * (free.covariance.sigma(name) or 0)
    assert main(["calibrate", str(saved), "-o", str(rig), "--camera", str(camera), "--hold-camera"]) == 0
    held, asked = read_rig(rig), read_camera(camera)
    assert [float(x) for x in held.rig.camera.focal] == [float(x) for x in asked.focal]
    assert [float(x) for x in held.rig.camera.lens.radial] == [float(x) for x in asked.lens.radial]
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
        (lambda v: v | {"X_2": 2 * v["X_2"]}, r"9 x 6 corners at 16 mm, but not image 2 \(9 x 6 corners at 32 mm\)"),
        (
            lambda v: v | {f"{a}_{i}": v[f"{a}_{i}"][:, :45] for a in "Xx" for i in (3, 5)},
            r"not image 3 \(9 x 5 corners at 16 mm\), image 5",
        ),
        (lambda v: v | {"active_images": np.ones((1, 5))}, "active_images must be 0 or 1 for each of the 6 images"),
        (lambda v: v | {"active_images": np.full((1, 6), 2)}, "active_images must be 0 or 1"),
        (lambda v: v | {"n_ima": 4}, "n_ima = .*, but it must be the number of images, here 6"),
        (
            lambda v: v | {"active_images": np.zeros((1, 6))},
            r"none of its photographs takes part: make some active(.|\n)*image 6: it is not",
        ),
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


@pytest.fixture
def example(tmp_path: Path, seen: Observations) -> tuple[Path, Observations]:
    """Six photographs in the structure of the toolbox's own example, and what of them takes part, in our order.

    In image 5 the board's rows were counted as columns, image 2 is not active, image 7 has no corners. The board was
    turned by a quarter before its fifth photograph, so that the toolbox's first corner is again the top left one.
    """
    P = seen.board.points()
    up = np.stack([P[:, 0], P[:, 1].max() - P[:, 1], 0 * P[:, 2]])
    nothing = np.full((2, 1), np.nan)
    variables = {"nx": 640.0, "ny": 480.0, "n_ima": 7.0, "active_images": np.array([[1, 0, 1, 1, 1, 1, 1.0]])}
    variables |= {"X_7": np.full((3, 1), np.nan), "x_7": nothing, "n_sq_x_7": np.nan, "dX": 16.0, "dY": 16.0}
    for i, view in enumerate(seen.views, start=1):
        columns, rows = seen.board.counts
        X, x = up, view.corners.T
        if i == 5:
            # Down the last column first, then down the one before it: six in a row, nine rows.
            order = np.arange(P.shape[0]).reshape(rows, columns)[:, ::-1].T.ravel()
            X, x = np.stack([P[order, 1], P[order, 0], 0 * P[:, 2]]), view.corners[order].T
        variables |= {f"X_{i}": X, f"x_{i}": x, f"n_sq_x_{i}": np.ptp(X[0]) / 16, f"n_sq_y_{i}": np.ptp(X[1]) / 16}
    scipy.io.savemat(tmp_path / "calib_data.mat", variables)
    taking_part = tuple(replace(view, stripes=()) for i, view in enumerate(seen.views, start=1) if i != 2)
    return tmp_path / "calib_data.mat", replace(seen, lasers=(), views=taking_part)


def test_an_image_whose_counts_are_exchanged_is_the_board_turned_by_a_quarter(example):
    path, ours = example
    found = observations_from(read_camera_file(path), path)
    assert found.board == ours.board
    assert found.left_out == (
        "image 7: no corners were found in it",
        "image 2: it is not among the active_images",
    )
    for own, theirs in zip(ours.views, found.views, strict=True):
        # Either quarter turn is right: the other one counts the board's points from the last to the first.
        assert (own.corners == theirs.corners).all() or (own.corners[::-1] == theirs.corners).all()


def test_what_is_active_comes_back(example, tmp_path):
    path, _ = example
    content = read_camera_file(path)
    write_camera_file(tmp_path / "again.mat", content, format="bouguet")
    assert [view.active for view in read_camera_file(tmp_path / "again.mat").views] == [True, False] + 4 * [True]


@pytest.mark.parametrize(("hold", "flags"), [((), 0), (("camera.radial.2",), cv2.CALIB_FIX_K3)])
def test_plain_least_squares_is_opencvs_minimum_whatever_is_held(example, hold, flags):
    """OpenCV's default lens, and that of the toolbox."""
    path, _ = example
    found = observations_from(read_camera_file(path), path)
    # OpenCV takes corners in float32.
    found = replace(found, views=tuple(replace(v, corners=v.corners.astype(np.float32) * 1.0) for v in found.views))
    # Weights do not count, nor does where a corner is: this one is no outlier that could be left out.
    found.views[0].corners[7] += np.float32(2.0)
    weighted = tuple(replace(view, weights=np.linspace(0.5, 2.0, 54)) for view in found.views)
    result = calibrate(replace(found, views=weighted), lens="brown", hold=hold, plain=True)
    rms, K, terms, _, _ = cv2.calibrateCamera(
        [found.board.points().astype(np.float32)] * len(found.views),
        [view.corners.astype(np.float32)[:, None] for view in found.views],
        found.image_size,
        None,
        None,
        flags=flags,
        criteria=(3, 1000, 1e-15),
    )
    camera = result.rig.camera
    np.testing.assert_allclose(camera.focal, [K[0, 0], K[1, 1]], rtol=1e-6)
    np.testing.assert_allclose(camera.principal, K[:2, 2], rtol=1e-6)
    k1, k2, p1, p2, k3 = terms.ravel()
    # In units of each one's σ: k3 is found to a few tenths at best.
    for name, ours, theirs in zip(
        lens_parameters("brown"), jax.tree.leaves(camera.lens), (k1, k2, k3, p1, p2), strict=True
    ):
        assert abs(ours - theirs) <= 1e-4 * (result.covariance.sigma(name) or 0)
    assert result.corner_rms_px == pytest.approx(rms, rel=1e-8)
    assert all(fit.corner_kept.all() for fit in result.fits)
    assert set(camera_parameters("brown")) - set(result.covariance.names) == set(hold)
    assert any("plain least squares" in note for note in result.notes)
