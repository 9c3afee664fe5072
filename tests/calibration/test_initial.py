"""The closed-form start on data without noise, where it must be exact, and on outliers."""

import cv2
import numpy as np
import pytest

from jaxscan.calibration import initial
from jaxscan.geometry import Pose
from jaxscan.rig import Linear
from jaxscan.rig.light_plane import robust_plane
from tests.calibration import synthetic
from tests.calibration.synthetic import BOARD, IMAGE_SIZE

POINTS = BOARD.points()[:, :2]


def pinhole_views(n=8, focal=(700.0, 690.0), seed=0):
    rng = np.random.default_rng(seed)
    poses = [synthetic.board_pose(rng) for _ in range(n)]
    X = np.stack([BOARD.points() @ R.T + t for R, t in poses])
    centre = (np.array(IMAGE_SIZE) - 1) / 2
    return poses, np.asarray(focal) * X[..., :2] / X[..., 2:] + centre


def test_homographies_map_the_points_and_do_not_read_what_is_masked():
    _, seen = pinhole_views()
    used = np.ones(seen.shape[:2], bool)
    used[0, :10] = False
    seen[0, :10] = np.nan
    H = initial.homographies(POINTS, seen, used)
    mapped = np.einsum("vij,nj->vni", H, np.c_[POINTS, np.ones(len(POINTS))])
    error = (mapped[..., :2] / mapped[..., 2:] - seen)[used]
    assert np.abs(error).max() < 1e-9


@pytest.mark.parametrize("focal", [(700.0, 690.0), (300.0, 310.0), (3000.0, 3000.0)])
def test_focal_length_and_poses_of_a_pinhole(focal):
    poses, seen = pinhole_views(focal=focal)
    used = np.ones(seen.shape[:2], bool)
    found = initial.focal_length(POINTS, seen, used, IMAGE_SIZE)
    np.testing.assert_allclose(found, focal, rtol=1e-6)
    x = (seen - (np.array(IMAGE_SIZE) - 1) / 2) / found
    R, t = initial.board_poses(POINTS, np.concatenate([x, np.ones_like(x[..., :1])], axis=-1), used)
    np.testing.assert_allclose(R, [p[0] for p in poses], atol=1e-6)
    np.testing.assert_allclose(t, [p[1] for p in poses], atol=1e-4)


def test_parallel_boards_still_give_a_number():
    X = BOARD.points() + np.array([-60, -40, 350.0])
    seen = np.stack([700 * (X[:, :2] + d) / X[:, 2:] + 319.5 for d in (0, 5, 10)])
    focal = initial.focal_length(POINTS, seen, np.ones(seen.shape[:2], bool), IMAGE_SIZE)
    assert (focal > 0).all()


def test_robust_plane_through_two_fifths_of_strays():
    rng = np.random.default_rng(0)
    omega = np.array([0.0, -0.00494, 0.00303])
    view = np.repeat(np.arange(6), 50)
    points = np.c_[rng.uniform(-50, 50, (300, 2)), np.zeros(300)]
    points[:, 2] = (1 - points[:, :2] @ omega[:2]) / omega[2] + 0.01 * rng.normal(size=300)
    points[rng.random(300) < 0.4, 2] += rng.uniform(20, 100)
    np.testing.assert_allclose(robust_plane(points, view), omega, atol=2e-6)


def test_stripes_that_make_no_plane_give_no_number():
    line = np.c_[np.linspace(-50, 50, 40), np.zeros(40), np.full(40, 300.0)]
    assert np.isnan(robust_plane(np.concatenate([line, line]), np.repeat([0, 1], 40))).all()
    through_the_camera = np.c_[line[:, :2], np.random.default_rng(0).uniform(200, 400, 40)]
    assert not np.isfinite(robust_plane(through_the_camera, np.repeat([0, 1], 20))).all()


def test_stage_line_with_one_photograph_off():
    steps = np.arange(-100000, -80000, 2000.0)
    translations = np.array([1.0, 2.0, 300.0]) + (steps - steps.mean())[:, None] * [1e-5, 9e-4, -4e-4]
    translations[3] += 50
    poses = Pose(np.zeros((len(steps), 3)), translations)
    found = Linear.fitted("stage", steps, poses, np.zeros(3))
    per_step = [float(x) for x in found.per_step]
    np.testing.assert_allclose(per_step, [1e-5, 9e-4, -4e-4], rtol=1e-6)


def test_a_board_turned_in_one_photograph_has_no_say_in_how_it_stood():
    vectors = np.random.default_rng(0).normal([0.3, -0.2, 0.1], 1e-4, (7, 3))
    vectors[3] = [0.1, 0.2, 3.0]
    np.testing.assert_allclose(initial.usual_rotation(vectors), [0.3, -0.2, 0.1], atol=1e-3)
    # The other way round to the same rotation.
    vectors *= 1 - 2 * np.pi / np.linalg.norm(vectors, axis=1, keepdims=True)
    found, true = (cv2.Rodrigues(w)[0] for w in (initial.usual_rotation(vectors), np.array([0.3, -0.2, 0.1])))
    np.testing.assert_allclose(found, true, atol=1e-3)
