"""The fisheye: against OpenCV's pixels and OpenCV's minimum, found, written and triangulated."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration import Observations, StripePoints, View, calibrate
from jaxscan.calibration.diagnostics import diagnose
from jaxscan.calibration.diagnostics.ladder import climb
from jaxscan.calibration.diagnostics.missing_terms import missing_terms
from jaxscan.calibration.first_camera import first_camera
from jaxscan.errors import InputError
from jaxscan.files.rig_file import read_rig, write_rig
from jaxscan.precision import float64
from jaxscan.reconstruction import Kernel, triangulate
from jaxscan.reconstruction.triangulate import FramePoses
from jaxscan.rig import Camera
from jaxscan.rig.projection import pixel_rays, project_points
from jaxscan.rig.rig import parameter_names
from jaxscan.view.calibration_report import calibration_report
from tests.calibration import synthetic
from tests.view.test_report import check

FISHEYE_FOCAL, FISHEYE_PRINCIPAL, ANGULAR = (322.0, 318.0), (312.3, 244.8), (-0.03, 0.012, -0.006, 0.001)
FISHEYE_OMEGA = np.array([0.0, -0.0085, 0.0035])
FISHEYE_TRUTH = [*FISHEYE_FOCAL, *FISHEYE_PRINCIPAL, *ANGULAR, *FISHEYE_OMEGA]


def through_the_fisheye(X):
    """Pixels of points of the camera frame, by OpenCV."""
    (f_u, f_v), (u0, v0) = FISHEYE_FOCAL, FISHEYE_PRINCIPAL
    K = np.array([[f_u, 0, u0], [0, f_v, v0], [0, 0, 1.0]])
    return cv2.fisheye.projectPoints(X[:, None], np.zeros(3), np.zeros(3), K, np.array(ANGULAR))[0][:, 0]


def fisheye_session(seed, n_views=14):
    """Boards all over an image whose corners are 73 degrees off the axis, with the stripe of a flat sheet."""
    rng, board, views = np.random.default_rng(seed), synthetic.BOARD, []
    size, points = np.array(synthetic.IMAGE_SIZE), board.points()
    furthest = points.max(axis=0)[:2]
    while len(views) < n_views:
        R = cv2.Rodrigues(np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.2, 0.2)]))[0]
        depth = rng.uniform(90, 160)
        t = depth * np.array([rng.uniform(-1.3, 1.3), rng.uniform(-0.9, 0.9), 1.0]) - R @ points.mean(axis=0)
        X = points @ R.T + t
        seen = through_the_fisheye(X) if X[:, 2].min() > 25 else np.zeros((1, 2))
        if ((seen < 2) | (seen > size - 3)).any():
            continue
        # The line of the board on the sheet, as far as there is board.
        a = FISHEYE_OMEGA @ R[:, :2]
        line = a * (1 - FISHEYE_OMEGA @ t) / (a @ a) + np.linspace(-300, 300, 6001)[:, None] * [-a[1], a[0]] / np.hypot(
            *a
        )
        line = line[((line > -board.pitch_mm / 2) & (line < furthest + board.pitch_mm / 2)).all(axis=1)]
        stripes = ()
        if len(line) > 50:
            on_line = through_the_fisheye(line @ R[:, :2].T + t)
            columns, order = np.arange(float(size[0])), np.argsort(on_line[:, 0])
            rows = np.interp(columns, *on_line[order].T, left=np.nan, right=np.nan) + 0.1 * rng.normal(
                size=len(columns)
            )
            stripes = (StripePoints(np.stack([columns, rows], axis=1), half_width_px=1e-6),)
        views.append(View(f"view-{len(views)}", seen + 0.05 * rng.normal(size=seen.shape), stripes=stripes))
    return Observations(synthetic.IMAGE_SIZE, board, tuple(views), (), ("",))


def test_a_fisheye_is_found_written_and_triangulated(tmp_path):
    session = fisheye_session(1)
    found = calibrate(session, lens="fisheye")
    # From a start that a pinhole would not give: 192 px.
    with float64():
        assert abs(first_camera(session, "fisheye").focal[0] / FISHEYE_FOCAL[0] - 1) < 0.1
    names = parameter_names(found.rig)
    assert names[4:8] == [f"camera.angular.{i}" for i in range(4)]
    values, sigmas = np.array(jax.tree.leaves(found.rig)), np.array([found.covariance.sigma(name) for name in names])
    assert np.abs((values - FISHEYE_TRUTH) / sigmas).max() < 4
    assert sigmas[0] < 0.2
    assert sigmas[4] < 0.002
    assert found.stripe_rms_px < 0.105
    with pytest.raises(InputError, match=r'lens "fisheye" has .*, camera.angular.3$'):
        calibrate(session, lens="fisheye", hold=["camera.radial.0"])
    write_rig(tmp_path / "rig.json", found.rig_file())
    back = read_rig(tmp_path / "rig.json")
    assert jax.tree.leaves(back.rig) == jax.tree.leaves(found.rig)
    assert back.covariance.names == found.covariance.names
    pixels = np.stack(np.meshgrid(np.linspace(0, 639, 60), np.linspace(0, 479, 50)), axis=-1).reshape(-1, 2)
    points = np.asarray(
        triangulate(
            Kernel.create(back.rig),
            FramePoses.create(back.rig.motion, {}, 1),
            *map(jnp.asarray, pixels.T[:, None]),
        )
    )[0]
    with float64():
        exact = np.asarray(jax.jit(jax.vmap(lambda p: back.rig.triangulate(p, {})))(jnp.asarray(pixels)))
    np.testing.assert_array_equal(np.isfinite(points), np.isfinite(exact))
    seen = np.isfinite(exact).all(axis=1) & (exact[:, 2] < 400)
    assert seen.sum() > 1500
    np.testing.assert_allclose(points[seen], exact[seen], atol=1e-3)
    # What is said of OpenCV's lenses is not said of this one.
    diagnostics = diagnose(found, thorough=False)
    assert (diagnostics.ladder, diagnostics.missing_terms) == (None, None)
    assert climb(found) is None


@pytest.mark.long
def test_the_report_of_a_fisheye():
    """As of any lens, without the comparison with other lenses, which are OpenCV's."""
    pytest.importorskip("matplotlib", reason="the extra plots is not installed")
    found = calibrate(fisheye_session(1), lens="fisheye")
    report, judged = calibration_report(found)
    check(report)
    assert (judged.level, judged.warnings) == ("good", ())
    figures = {figure.name for section in report.sections for figure in section.figures}
    assert figures >= {"working-volume", "scene", "residual-vectors", "radius", "agreement-0", "coverage"}
    assert "ladder" not in figures
    (parameters,) = (table for s in report.sections for table in s.tables if table.columns[0] == "parameter")
    assert [row[0] for row in parameters.rows[4:8]] == [f"camera.angular.{i}" for i in range(4)]


def test_held_terms_of_a_fisheye_are_missed():
    held = calibrate(fisheye_session(1), lens="fisheye", hold=[f"camera.angular.{i}" for i in range(4)])
    assert jax.tree.leaves(held.rig.camera.lens) == [0.0] * 4
    missing = missing_terms(held)
    assert (missing.lens, len(missing.freed)) == ("fisheye", 4)
    assert missing.p < 1e-6


def test_pixels_are_opencvs_and_come_back():
    with float64():
        camera = Camera.create(synthetic.IMAGE_SIZE, FISHEYE_FOCAL, FISHEYE_PRINCIPAL, "fisheye", ANGULAR)
    X = np.random.default_rng(0).uniform([-300, -300, 80], [300, 300, 200], (500, 3))
    X = np.concatenate([X, [[0.0, 0.0, 100.0], [1e-5, 0.0, 100.0], [0.09, 0.05, 100.0]]])
    seen = project_points(camera, X).pixels
    np.testing.assert_allclose(seen, through_the_fisheye(X), rtol=0, atol=1e-9)
    unit = X / np.linalg.norm(X, axis=1, keepdims=True)
    np.testing.assert_allclose(pixel_rays(camera, seen), unit, rtol=1e-10, atol=1e-12)


def test_the_minimum_is_opencvs():
    session = fisheye_session(2)
    flags = cv2.CALIB_FIX_SKEW | cv2.CALIB_RECOMPUTE_EXTRINSIC
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 500, 1e-14)
    points = np.tile(session.board.points()[None], (len(session.views), 1, 1, 1)).astype(np.float64)
    corners = [view.corners[None].astype(np.float64) for view in session.views]
    alone = calibrate(
        Observations(session.image_size, session.board, tuple(View(v.name, v.corners) for v in session.views), (), ()),
        lens="fisheye",
        plain=True,
    )
    _, K, D, _, _ = cv2.fisheye.calibrate(
        list(points), corners, session.image_size, np.eye(3), np.zeros(4), flags=flags, criteria=criteria
    )
    camera = alone.rig.camera
    ours = [float(x) for x in (*camera.focal, *camera.principal)]
    np.testing.assert_allclose(ours, [K[0, 0], K[1, 1], K[0, 2], K[1, 2]], rtol=1e-6)
    np.testing.assert_allclose([float(k) for k in camera.lens.angular], D.ravel(), atol=1e-6)
