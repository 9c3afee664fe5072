"""`calibrate` on observations whose truth is known: recovery within the predicted covariance, and what it refuses."""

import re
from dataclasses import replace

import jax
import numpy as np
import optimistix as optx
import pytest

from jaxscan.calibration import calibrate, rounds
from jaxscan.calibration.bundle import MAX_STEPS
from jaxscan.errors import InputError, ObservabilityError, SolveError
from jaxscan.rig.rig import parameter_names
from tests.calibration import synthetic
from tests.calibration.synthetic import FOCAL, TRUTH, Noise


def errors_in_sigma(calibration, truth=TRUTH):
    values = dict(zip(parameter_names(calibration.rig), map(float, jax.tree.leaves(calibration.rig)), strict=True))
    names = calibration.covariance.names
    return np.array([(values[name] - truth[name]) / calibration.covariance.sigma(name) for name in names])


def mahalanobis(calibration):
    values = dict(zip(parameter_names(calibration.rig), map(float, jax.tree.leaves(calibration.rig)), strict=True))
    error = np.array([values[name] - TRUTH[name] for name in calibration.covariance.names])
    return error @ np.linalg.solve(calibration.covariance.matrix, error)


def test_the_truth_lies_within_the_predicted_covariance(calibration):
    # χ² with 11 degrees of freedom: 99.9 % below 31.3. Says nothing of the size of σ; the benchmark does.
    assert mahalanobis(calibration) < 31.3
    assert set(calibration.covariance.names) == set(TRUTH)


def test_sigmas_come_out_of_the_residuals(calibration):
    assert calibration.corner_sigma_px == pytest.approx(0.05, rel=0.08)
    assert calibration.stripe_sigma_px == pytest.approx(0.1, rel=0.08)
    assert calibration.corner_rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.08)


def test_rig_keeps_float64_outside(calibration):
    assert not jax.config.read("jax_enable_x64")
    assert all(np.asarray(leaf).dtype == np.float64 for leaf in jax.tree.leaves(calibration.rig))


def test_it_says_why_it_stopped(calibration):
    assert calibration.settled
    assert 2 <= calibration.solves < 12
    assert calibration.steps < 20


def test_nothing_good_is_thrown_out(calibration):
    assert sum(int((~fit.corner_kept).sum()) for fit in calibration.fits) <= 2
    assert sum(int((~fit.stripe_kept).sum()) for fit in calibration.fits) <= 4


def test_outliers_are_left_out_and_named(session, calibration):
    views = list(session.views)
    corners = views[2].corners.copy()
    corners[[3, 17]] += [[9.0, -7.0], [0.0, 4.0]]
    views[2] = replace(views[2], corners=corners)
    pixels = views[4].stripes[0].pixels.copy()
    seen = np.flatnonzero(np.isfinite(pixels).all(axis=1))[:40]
    pixels[seen, 1] += 6.0
    views[4] = replace(views[4], stripes=(replace(views[4].stripes[0], pixels=pixels),))
    spoilt = calibrate(replace(session, views=tuple(views)))
    assert not spoilt.fits[2].corner_kept[[3, 17]].any()
    assert any("view-2: 2 of 54 corners" in line and "3, 17" in line for line in spoilt.rejected)
    assert any("view-4: 40 of" in line for line in spoilt.rejected)
    assert spoilt.left_out == ()
    # The rig moves by no more than losing those points explains.
    a, b = (np.array([float(x) for x in jax.tree.leaves(c.rig)]) for c in (spoilt, calibration))
    sigma = np.sqrt(np.diagonal(calibration.covariance.matrix))
    assert (np.abs(a - b) < 0.5 * sigma).all()


def test_a_far_first_step_does_not_matter(session, calibration):
    far = replace(
        session, sequences=(replace(session.sequences[0], positions={"stage": session.sequences[0].steps - 100000}),)
    )
    moved = calibrate(far)
    for a, b in zip(jax.tree.leaves(moved.rig), jax.tree.leaves(calibration.rig), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-15)
    first = len(session.views)
    places = (each.photograph_poses().translation[first] for each in (moved, calibration))
    np.testing.assert_allclose(next(places), next(places), atol=1e-4)
    # … nor to how well the pose there is known, although at step 0, far outside the sequence, it is known much worse.
    there, here = moved.moved_covariances[0], calibration.moved_covariances[0]
    J = np.eye(len(there.names))
    for i in range(3):
        J[there.names.index(f"board.translation.{i}"), there.names.index(f"motion.stage.per_step.{i}")] = -100000.0
    scale = np.sqrt(np.diagonal(here.matrix))
    np.testing.assert_allclose(
        J @ there.matrix @ J.T / np.outer(scale, scale), here.matrix / np.outer(scale, scale), atol=1e-6
    )
    assert there.sigma("board.translation.2") > 2 * here.sigma("board.translation.2")


def test_the_pose_of_each_board_has_a_covariance_with_the_rig(session, calibration):
    n = len(calibration.covariance.names)
    assert len(calibration.board_covariances) == len(session.views)
    for covariance in (*calibration.board_covariances, *calibration.moved_covariances):
        assert covariance.names[:n] == calibration.covariance.names
        np.testing.assert_array_equal(covariance.matrix[:n, :n], calibration.covariance.matrix)
        assert (
            np.linalg.eigvalsh(covariance.matrix / np.outer(*2 * [np.sqrt(np.diagonal(covariance.matrix))])) > 0
        ).all()


def test_stripe_found_row_by_row_and_no_stage():
    # The sheet stands so that its stripe runs along the rows' direction of detection as well as it can.
    turned = synthetic.observations(seed=2, n_stage=0, columns=True)
    result = calibrate(turned)
    assert result.rig.axes() == {}
    assert np.abs(errors_in_sigma(result)).max() < 4.5


def test_corners_alone_give_a_camera(session):
    corners = replace(session, views=tuple(replace(v, stripes=()) for v in session.views), sequences=(), lasers=())
    result = calibrate(corners)
    assert result.rig.lights == ()
    assert result.rig.axes() == {}
    assert result.stripe_rms_px is None
    assert np.abs(errors_in_sigma(result)).max() < 4.5


def test_least_squares_over_corners_is_opencvs_minimum(session):
    import cv2

    # OpenCV takes corners in float32.
    views = [replace(v, corners=v.corners.astype(np.float32).astype(float), stripes=()) for v in session.views]
    ours = calibrate(replace(session, views=tuple(views), sequences=(), lasers=()), plain=True)
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    rms, K, _, _, _ = cv2.calibrateCamera(
        [session.board.points().astype(np.float32)] * len(views),
        [v.corners.astype(np.float32)[:, None] for v in views],
        session.image_size,
        None,
        None,
        flags=flags,
        criteria=(3, 200, 1e-15),
    )
    assert ours.corner_rms_px == pytest.approx(rms, rel=1e-6)
    np.testing.assert_allclose([float(f) for f in ours.rig.camera.focal], [K[0, 0], K[1, 1]], rtol=1e-6)


def test_principal_point_can_be_held(session):
    corners = replace(session, views=tuple(replace(v, stripes=()) for v in session.views), sequences=(), lasers=())
    held = calibrate(corners, principal_point="centre")
    assert [float(x) for x in held.rig.camera.principal] == [319.5, 239.5]
    assert "camera.principal.0" not in held.covariance.names


def test_stripe_beyond_the_board_does_not_spoil_the_plane(session, calibration):
    """Half of each stripe runs on over a table 60 mm behind the board."""
    views = []
    for view in session.views:
        stripe = view.stripes[0]
        pixels = stripe.pixels.copy()
        missing = np.flatnonzero(~np.isfinite(pixels).all(axis=1))
        pixels[missing] = np.stack([missing, np.full(len(missing), np.nanmedian(pixels[:, 1]) - 60.0)], axis=-1)
        views.append(replace(view, stripes=(replace(stripe, pixels=pixels),)))
    result = calibrate(replace(session, views=tuple(views)))
    a, b = (np.array([float(x) for x in jax.tree.leaves(c.rig.lights)]) for c in (result, calibration))
    np.testing.assert_allclose(a, b, atol=3 * calibration.covariance.sigma("lights.0.plane.2"))
    assert any("beyond the board" in line for line in result.rejected)


def parallel(observations):
    """The same board, never tilted."""
    points = synthetic.BOARD.points() - synthetic.BOARD.points().mean(axis=0)
    rng = np.random.default_rng(0)
    shifts = rng.uniform([-20, -20, 330], [20, 20, 340], (8, 3))
    views = tuple(
        replace(
            observations.views[i],
            corners=synthetic.project(points + shift) + 0.05 * rng.normal(size=(54, 2)),
            stripes=(),
        )
        for i, shift in enumerate(shifts)
    )
    return replace(observations, views=views, sequences=(), lasers=())


def test_parallel_boards_are_refused_in_words(session):
    with pytest.raises(ObservabilityError, match=r"cannot be distinguished.*Tilt"):
        calibrate(parallel(session))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda o: replace(o, views=o.views[:2]), "2 usable views.*at least 3"),
        (lambda o: replace(o, views=tuple(replace(v, stripes=()) for v in o.views)), "0 usable stripes.*at least 2"),
        (
            lambda o: replace(o, sequences=(o.sequences[0].only([0]),)),
            "1 usable stage photographs",
        ),
        (lambda o: replace(o, views=tuple(replace(v, corners=v.corners * np.nan) for v in o.views)), "0 usable views"),
    ],
)
def test_too_little_is_refused(session, change, words):
    with pytest.raises(InputError, match=words):
        calibrate(change(session))


def test_shapes_that_do_not_fit_are_refused(session):
    with pytest.raises(InputError, match="view-0: corners has the shape"):
        replace(session, views=(replace(session.views[0], corners=np.zeros((5, 2))), *session.views[1:]))


def test_stripes_on_a_board_that_moves_are_used():
    """On the stage and on the turntable; without them the light is known less well."""
    still = synthetic.observations(3, n_stage=8)
    moving = synthetic.observations(3, n_stage=8, stripes_on_stage=True)
    turned = synthetic.turned(3, stage_step=5000, stripes=True)
    found = [
        calibrate(replace(each, sequences=(*each.sequences, turn)))
        for each, turn in ((still, synthetic.turned(3, stage_step=5000)), (moving, turned))
    ]
    for result in found:
        assert np.abs(errors_in_sigma(result, synthetic.TRUTH_WITH_TURNTABLE)).max() < 4.5
    sigma = [result.covariance.sigma("lights.0.plane.1") for result in found]
    assert sigma[1] < 0.9 * sigma[0]
    seen = [sum(int(fit.stripe_kept.sum()) for fit in result.moved_fits) for result in found]
    assert seen[0] == 0
    assert seen[1] > 2000


def test_inside_a_float32_trace_it_says_what_to_do(session):
    with pytest.raises(InputError, match="jax_enable_x64"):
        jax.jit(lambda x: calibrate(session).corner_rms_px * x)(1.0)


def test_noise_free_observations_give_the_truth():
    exact = synthetic.observations(seed=5, n_stage=5, noise=Noise(0.0, 0.0))
    result = calibrate(exact)
    values = dict(zip(parameter_names(result.rig), map(float, jax.tree.leaves(result.rig)), strict=True))
    for name, true in TRUTH.items():
        assert values[name] == pytest.approx(true, rel=2e-6, abs=1e-9), name


@pytest.fixture
def counted(monkeypatch):
    """The solves of the rounds as they come, and a result to report instead."""
    outcomes, real = [], rounds.solve

    def solve(*args, **kwargs):
        outcomes.append(replace(real(*args, **kwargs), **counted_as))
        return outcomes[-1]

    counted_as = {}
    monkeypatch.setattr(rounds, "solve", solve)
    return outcomes, counted_as


def test_what_has_no_minimum_is_refused_after_two_solves(session, counted):
    outcomes, counted_as = counted
    counted_as["result"] = optx.RESULTS.nonlinear_max_steps_reached
    with pytest.raises(SolveError, match=r"did not reach a minimum within 200 steps \(2 rounds\)"):
        calibrate(session)
    assert len(outcomes) == 2


def test_a_lens_that_the_views_do_not_determine_is_refused_soon(counted):
    """The outliers, and with them what is minimised, change from round to round: it took twelve solves."""
    outcomes, _ = counted
    rng, views = np.random.default_rng(2), []
    seen = synthetic.observations(seed=3, n_stage=0, laser=False)
    for view in seen.views:
        astray = rng.normal(size=(54, 2)) * np.where(rng.random((54, 1)) < 0.3, 1.0, 0.0)
        views.append(replace(view, corners=view.corners + astray))
    with pytest.raises((ObservabilityError, SolveError)):
        calibrate(replace(seen, views=tuple(views)), lens="rational")
    assert len(outcomes) <= 4
    assert sum(int(outcome.steps) for outcome in outcomes) <= 4 * MAX_STEPS


COLUMNS = "the stripe runs up and down in most photographs: set columns = false under [laser]"


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (lambda o: replace(o, views=tuple(replace(v, stripes=()) for v in o.views)), InputError),
        (lambda o: parallel(o), ObservabilityError),
        (lambda o: replace(o, views=tuple(beside(v) for v in o.views)), InputError),
    ],
    ids=["too little", "not determined", "stripes beside the boards"],
)
def test_a_refusal_brings_notes_and_what_was_left_out(session, change, error):
    noted = replace(change(session), notes=(COLUMNS,), left_out=("07.png: the board was not found",))
    with pytest.raises(error) as refused:
        calibrate(noted)
    lines = str(refused.value).split("\n")
    assert f"  note: {COLUMNS}" in lines
    assert "  left out: 07.png: the board was not found" in lines
    assert len(lines) == len(set(lines))


def beside(view):
    """A view with its stripe in the upper corner of the image, beside the board."""
    stripe = view.stripes[0]
    pixels = np.stack([np.arange(640.0), np.full(640, 1.0)], axis=-1)
    return replace(view, stripes=(replace(stripe, pixels=pixels),))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda corners: np.where(np.arange(54)[:, None] == 5, 1e300, corners), "a corner at 1e+300 px, where no"),
        (lambda corners: np.full_like(corners, 200.0), "its 54 corners lie in one place of the photograph"),
        (lambda corners: corners * [1.0, 0.0], "its 54 corners lie in one place of the photograph, or on one line"),
    ],
)
def test_a_photograph_of_absurd_corners_is_left_out_by_name(session, spoil, said):
    """Where all have such corners, it is said of each; they were singular matrices."""
    spoilt = tuple(replace(view, corners=spoil(view.corners)) for view in session.views)
    with pytest.raises(InputError, match=f"left out: {re.escape('view-3: ' + said)}"):
        calibrate(replace(session, views=(*session.views[:2], spoilt[2], *spoilt[3:])))


def test_a_photograph_with_few_corners_is_named_where_too_few_are_left(session):
    few = tuple(replace(v, corners=np.where(np.arange(54)[:, None] < 4, v.corners, np.nan)) for v in session.views)
    with pytest.raises(InputError, match="left out: view-3: 4 corners, fewer than 6"):
        calibrate(replace(session, views=few))


@pytest.mark.parametrize(
    "seen", [range(9), range(3, 54, 9), [*range(9), 31]], ids=["row", "column", "row and one more"]
)
def test_corners_on_one_line_give_no_pose(session, seen):
    """A highlight, or a stripe as wide as the squares, may leave no more; their board could be turned about them."""
    first = session.views[0]
    corners = np.full_like(first.corners, np.nan)
    corners[seen] = first.corners[seen]
    result = calibrate(replace(session, views=(replace(first, corners=corners), *session.views[1:])))
    assert len(result.fits) == len(session.views) - 1
    (line,) = result.left_out
    assert line == f"view-0: its {len(seen)} corners lie on one line of the board, or all but one do"
    for i in range(2):
        assert abs(float(result.rig.camera.focal[i]) - FOCAL[i]) < 4 * (
            result.covariance.sigma(f"camera.focal.{i}") or 0
        )


def test_a_stage_that_did_not_move_is_lost_in_the_noise(session):
    (stage,) = session.sequences
    still = replace(stage, views=tuple(stage.views[0] for _ in stage.views))
    with pytest.raises(ObservabilityError, match=r"the motion of the stage is not determined, it is lost in the noise"):
        calibrate(replace(session, sequences=(still,)))
