"""Suggested poses: what a photograph tells against OpenCV's derivatives, the prediction against a solve with it."""

from dataclasses import replace

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from jaxscan.calibration import Calibration, Observations, StripePoints, View, calibrate
from jaxscan.calibration import next_pose as module
from jaxscan.calibration.next_pose import NextPose, predict, suggest
from jaxscan.calibration.placement import outline_of
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.images import Board
from jaxscan.precision import float64
from jaxscan.rig import BoardShape, Rig, System
from jaxscan.rig.rig import parameter_names
from tests.calibration import synthetic

# As many radians of tilt, and mm, as a session has it.
DEPTH_LIMITS, TILT_LIMIT_DEG = 1.1, 45.0
# Hardly any: what there is of it counts where the board bends.
SHAPE = BoardShape.of(np.array([1e-3, 0.0, 0.0, 0.0, 0.0]))


@pytest.fixture(scope="module")
def wanted(calibration: Calibration) -> np.ndarray:
    """Where the sheet is 350 mm away and beside: derivatives by differences of the closed form, along the axis."""
    names = parameter_names(calibration.rig)
    theta = np.array([synthetic.TRUTH[name] for name in names])
    pixels = np.array([[100.0, 200.0], [320.0, 230.0], [540.0, 200.0], [320.0, 150.0]])

    def depth(values: np.ndarray) -> np.ndarray:
        fx, fy, u0, v0, k1, *rest = values
        K = np.array([[fx, 0, u0], [0, fy, v0], [0, 0, 1.0]])
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-15)
        xy = cv2.undistortPoints(pixels[:, None], K, np.array([k1, 0, 0, 0]), criteria=stop)[:, 0]
        return 1 / (np.column_stack([xy, np.ones(len(xy))]) @ np.array(rest[:3]))

    columns = []
    for i, value in enumerate(theta):
        step = 1e-5 * max(abs(value), 1e-3)
        ahead, behind = theta.copy(), theta.copy()
        ahead[i] += step
        behind[i] -= step
        columns.append((depth(ahead) - depth(behind)) / (2 * step))
    return np.stack(columns, axis=1)


@pytest.fixture(scope="module")
def suggested(calibration: Calibration, wanted: np.ndarray) -> tuple[NextPose, ...]:
    return suggest(calibration, wanted, count=2)


def sigma(calibration: Calibration, covariance, wanted: np.ndarray) -> float:
    leaves = covariance.of_leaves(calibration.rig)
    return float(np.sqrt(np.einsum("qi,ij,qj->q", wanted, leaves, wanted).mean()))


def stacked(*poses: NextPose) -> Pose:
    return Pose(np.stack([p.pose.rotation for p in poses]), np.stack([p.pose.translation for p in poses]))


def photographed(pose: NextPose, seed: int) -> View:
    """The view that a detector with the session's noise sees in a pose of the true rig."""
    rng, noise = np.random.default_rng(seed), synthetic.Noise()
    R, t = cv2.Rodrigues(np.asarray(pose.pose.rotation))[0], np.asarray(pose.pose.translation)
    corners = synthetic.project(synthetic.BOARD.points() @ R.T + t)
    stripe = synthetic.stripe_on(R, t, True)
    stripe[:, 1] += noise.stripe * rng.normal(size=len(stripe))
    return View(
        f"next-{seed}",
        corners + noise.corner * rng.normal(size=corners.shape),
        stripes=(StripePoints(stripe, True, half_width_px=1e-6),),
    )


@pytest.mark.long
def test_corners_tell_what_opencv_s_derivatives_say(calibration: Calibration):
    """I = A − B C⁻¹ Bᵀ of the Jacobian that cv2.projectPoints returns, for a rig of a camera alone."""
    rvec, tvec = np.array([0.4, -0.3, 0.2]), np.array([-60.0, -30.0, 360.0])
    with float64():
        scene = module._scene(calibration)
        alone = Rig(scene.rig.camera)
        scene = replace(scene, rig=alone, free=jnp.ones(5, bool), columns=jnp.zeros(0, bool))
        found = np.asarray(scene.information(jnp.asarray(np.concatenate([rvec, tvec]))))
        fx, fy, u0, v0, k1 = (
            float(x) for x in (*alone.camera.focal, *alone.camera.principal, *alone.camera.lens.radial)
        )
        corner = float(scene.noise.corner)
    K = np.array([[fx, 0, u0], [0, fy, v0], [0, 0, 1.0]])
    _, J = cv2.projectPoints(synthetic.BOARD.points(), rvec, tvec, K, np.array([k1, 0, 0, 0]))
    pose, rig = J[:, :6] / corner, J[:, 6:11] / corner
    told = rig.T @ rig - rig.T @ pose @ np.linalg.solve(pose.T @ pose, pose.T @ rig)
    scale = np.sqrt(np.diagonal(rig.T @ rig))
    np.testing.assert_allclose(found / np.outer(scale, scale), told / np.outer(scale, scale), atol=1e-9)


def test_poses_can_be_reached(calibration: Calibration, suggested: tuple[NextPose, ...]):
    poses = calibration.system.boards
    middle = outline_of(synthetic.BOARD).mean(axis=0)
    depths = [
        (cv2.Rodrigues(np.array(r))[0] @ middle + t)[2] for r, t in zip(poses.rotation, poses.translation, strict=True)
    ]
    for each in suggested:
        R = cv2.Rodrigues(np.asarray(each.pose.rotation))[0]
        X = outline_of(synthetic.BOARD) @ R.T + each.pose.translation
        outline = synthetic.project(X)
        assert (outline > 0).all()
        assert (outline < np.array(synthetic.IMAGE_SIZE) - 1).all()
        np.testing.assert_allclose(each.outline_px, outline, atol=3)
        centre = X.mean(axis=0)
        assert min(depths) / DEPTH_LIMITS - 1e-6 <= centre[2] <= max(depths) * DEPTH_LIMITS + 1e-6
        assert each.distance_mm == pytest.approx(np.linalg.norm(centre))
        angle = np.degrees(np.arccos(R[:, 2] @ centre / np.linalg.norm(centre)))
        assert angle <= TILT_LIMIT_DEG + 1e-6
        assert np.linalg.norm(each.tilt_deg) == pytest.approx(angle)
        # The side that is said to be nearer is.
        side = (outline - outline.mean(axis=0)) @ each.tilt_deg
        assert X[np.argmax(side), 2] < X[np.argmin(side), 2]


def test_the_stripe_is_where_the_sheet_meets_the_board(suggested: tuple[NextPose, ...]):
    for each in suggested:
        R, t = cv2.Rodrigues(np.asarray(each.pose.rotation))[0], np.asarray(each.pose.translation)
        seen = synthetic.stripe_on(R, t, True)
        crossed = np.isfinite(seen).all(axis=1).sum() > 20
        assert np.isfinite(each.stripes_px).all() == crossed
        if crossed:
            u, v = each.stripes_px[0].T
            at = np.interp(u, np.arange(len(seen)), seen[:, 1])
            np.testing.assert_allclose(v, at, atol=1)


def test_sigma_falls_as_predicted(
    calibration: Calibration, session: Observations, wanted: np.ndarray, suggested: tuple[NextPose, ...]
):
    """The first is photographed and everything is solved again, the σ of corners and stripes too, so they may move."""
    found = calibrate(replace(session, views=(*session.views, photographed(suggested[0], 0)))).covariance
    predicted = suggested[0].covariance
    np.testing.assert_allclose(np.sqrt(np.diagonal(predicted.matrix) / np.diagonal(found.matrix)), 1, atol=0.05)
    assert sigma(calibration, predicted, wanted) == pytest.approx(sigma(calibration, found, wanted), rel=0.03)
    assert sigma(calibration, found, wanted) < 0.8 * sigma(calibration, calibration.covariance, wanted)


def test_a_board_that_bends_tells_less(calibration: Calibration, suggested: tuple[NextPose, ...]):
    """Its bulges were taken as known; two columns more that cost information, by a dense elimination."""
    with float64():
        scene = module._scene(calibration)
        system = eqx.tree_at(lambda s: s.shape, calibration.system, SHAPE, is_leaf=lambda leaf: leaf is None)
        bent = replace(calibration, bend_sigma_mm=0.3, system=system)
        bending = module._scene(bent)
        rigid = replace(bending, noise=replace(bending.noise, bend=jnp.asarray(1e-6)))
        pose = jnp.asarray(suggested[0].pose.as_vector())
        flat, none, some = (module._told(each, np.asarray(pose)[None])[0] for each in (scene, rigid, bending))
        block = jax.tree.map(lambda leaf: leaf[None], eqx.filter_jit(type(bending).seen)(bending, pose))

        def residuals(both):
            rig, own = both
            return block.residuals(System(rig, (own[None],), bending.shape), own[None], bending.noise)[0]

        rig, own = bending.rig, jnp.pad(pose, (0, 2))
        flattened, back = ravel_pytree((rig, own))
        J = np.asarray(jax.jit(jax.jacfwd(lambda y: residuals(back(y))))(flattened))
    n = len(parameter_names(calibration.rig))
    # The motion is not in a view: its columns are 0.
    seen = np.flatnonzero(np.abs(J[:, :n]).sum(axis=0) > 0)
    U, W, V = (J.T @ J)[np.ix_(seen, seen)], (J.T @ J)[seen, n:], (J.T @ J)[n:, n:]
    np.testing.assert_allclose(
        some[np.ix_(seen, seen)], U - W @ np.linalg.solve(V, W.T), rtol=1e-6, atol=1e-6 * U.max()
    )
    scale = np.sqrt(np.diagonal(none)[seen])
    lost = ((none - some)[np.ix_(seen, seen)]) / np.outer(scale, scale)
    assert np.linalg.eigvalsh(lost)[0] > -1e-9
    assert np.linalg.eigvalsh(lost)[-1] > 0.01
    np.testing.assert_allclose(np.diagonal(none)[seen], np.diagonal(flat)[seen], rtol=0.05)


def test_no_pose_of_a_thousand_is_better(calibration: Calibration, wanted: np.ndarray, suggested: tuple[NextPose, ...]):
    rng, best = np.random.default_rng(0), np.inf
    with float64():
        reach, scene, root = module.reachable(calibration), module._scene(calibration), module._root(calibration)
        low, high = np.transpose(reach.bounds())
        places = rng.uniform(low, high, size=(120 * 40, 6))
        excess, poses = zip(*(module._placed(reach, jnp.asarray(part)) for part in np.split(places, 40)), strict=True)
        within = np.concatenate(poses)[np.concatenate(excess) == 0]
        assert len(within) > 100
        for told in module._told(scene, within):
            new = wanted @ module._updated(root, told)
            best = min(best, float(np.sqrt((new**2).sum() / len(wanted))))
    assert sigma(calibration, suggested[0].covariance, wanted) < best


def test_a_longer_search_finds_hardly_more(
    calibration: Calibration, wanted: np.ndarray, suggested: tuple[NextPose, ...], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(module, "_GENERATIONS", 400)
    longer = suggest(calibration, wanted, count=1, seed=1)[0]
    found = [sigma(calibration, pose.covariance, wanted) for pose in (suggested[0], longer)]
    assert found[0] < 1.02 * found[1]


def test_predicted_and_suggested_agree(calibration: Calibration, suggested: tuple[NextPose, ...]):
    for i in range(len(suggested)):
        found = predict(calibration, stacked(*suggested[: i + 1]))
        assert found.names == calibration.covariance.names
        scale = np.sqrt(np.diagonal(found.matrix))
        difference = (found.matrix - suggested[i].covariance.matrix) / np.outer(scale, scale)
        np.testing.assert_allclose(difference, 0, atol=1e-9)


def test_the_same_seed_finds_the_same_pose(
    calibration: Calibration, wanted: np.ndarray, suggested: tuple[NextPose, ...]
):
    again = suggest(calibration, wanted, count=1)
    np.testing.assert_array_equal(again[0].pose.translation, suggested[0].pose.translation)


def test_a_board_that_does_not_fit_has_no_place(calibration: Calibration, wanted: np.ndarray):
    large = replace(calibration, observations=replace(calibration.observations, board=Board.checkerboard([9, 6], 60.0)))
    assert suggest(large, wanted) == ()


def test_nothing_is_suggested_where_nothing_is_gained(calibration: Calibration, wanted: np.ndarray):
    assert suggest(calibration, np.zeros_like(wanted)) == ()


def test_bad_input(calibration: Calibration, wanted: np.ndarray):
    with pytest.raises(InputError, match="a row of 11 finite derivatives"):
        suggest(calibration, wanted[:, :-1])
    with pytest.raises(InputError, match="a row of 11 finite derivatives"):
        suggest(calibration, wanted[:0])
    with pytest.raises(InputError, match="a row of 11 finite derivatives"):
        suggest(calibration, np.where(wanted == wanted[0, 0], np.nan, wanted))
    with pytest.raises(InputError, match="count = 0"):
        suggest(calibration, wanted, count=0)
