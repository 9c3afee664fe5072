"""Boards that are not flat: shape, bends and rig are found together, and what is taken as flat and is not is named."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.drawn import Noise, redrawn
from benchmarks.drawn_bent import Heights, bent_session, flat
from jaxscan.calibration import Calibration, Observations, calibrate, refit
from jaxscan.calibration.bends import without_poses
from jaxscan.calibration.diagnostics import climb
from jaxscan.calibration.flatness import BoardFlatness
from jaxscan.calibration.observations import join
from jaxscan.errors import InputError, ObservabilityError, SolveError
from jaxscan.geometry import vector_to_matrix
from jaxscan.precision import float64
from jaxscan.rig import BoardShape, Rig
from jaxscan.rig.board_shape import LEAST_BEND_MM, BentBoard, basis, bent_by, places_on_board, shape_in_words
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003

TERMS = np.array([0.4, -0.3, 0.2, 0.1, -0.1])
EACH = 0.1
POINTS = rig_2003.BOARD.points()
HALF = POINTS[:, :2].max(axis=0) / 2


def surface(terms: np.ndarray) -> Callable:
    """The five terms written again, in the board's millimetres."""

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        s, t = x / HALF[0] - 1, y / HALF[1] - 1
        S, T = 1 / 3 - s**2, 1 / 3 - t**2
        return terms[0] * S + terms[1] * T + terms[2] * s * t + terms[3] * S * t + terms[4] * T * s

    return height


def bends(seed: int, each: float) -> Heights:
    own = each * np.random.default_rng([seed, 5]).normal(size=(40, 2))
    return lambda board: surface(TERMS + np.pad(own[board], (0, 3)))


@cache
def session(seed: int, each: float, shaped: bool = True, stage_views: int = 7) -> tuple[Rig, Observations]:
    heights = bends(seed, each) if shaped else lambda _: flat
    rig, exact = bent_session(seed, heights, stage_views=stage_views, stripes_on_stage=True, columns_apart=6)
    return rig, redrawn(exact, Noise(), np.random.default_rng(seed))


@cache
def solved(seed: int, each: float, shape: str, shaped: bool = True) -> Calibration:
    return calibrate(session(seed, each, shaped)[1], board_shape=shape)


def in_sigma(result: Calibration, rig: Rig) -> dict[str, float]:
    values, true = (
        dict(zip(parameter_names(each), map(float, jax.tree.leaves(each)), strict=True)) for each in (result.rig, rig)
    )
    return {n: (values[n] - true[n]) / (result.covariance.sigma(n) or np.nan) for n in result.covariance.names}


def test_terms_are_orthogonal_to_each_other_and_to_the_pose():
    s, t = np.polynomial.legendre.leggauss(5)[0], np.polynomial.legendre.leggauss(5)[1]
    s, t = np.meshgrid(s, s)
    weight = np.outer(*(np.polynomial.legendre.leggauss(5)[1],) * 2)
    every = np.concatenate([basis(s, t, 5), [np.ones_like(s), s, t]]).reshape(8, -1)
    products = every * weight.ravel() @ every.T
    np.testing.assert_allclose(products - np.diag(np.diagonal(products)), 0, atol=1e-14)


def test_slopes_are_derivatives_of_the_height():
    shape = BoardShape.of(TERMS)
    s, t, step = np.array([-1.2, 0.0, 0.7]), np.array([0.4, -1.0, 1.3]), 1e-6
    z, by_s, by_t = shape.height_and_slopes(s, t)
    np.testing.assert_allclose(by_s, (shape.height(s + step, t) - shape.height(s - step, t)) / (2 * step), atol=1e-8)
    np.testing.assert_allclose(by_t, (shape.height(s, t + step) - shape.height(s, t - step)) / (2 * step), atol=1e-8)
    np.testing.assert_allclose(z, surface(TERMS)((s + 1) * HALF[0], (t + 1) * HALF[1]), atol=1e-14)


@pytest.mark.parametrize("tilt", [0.0, 0.6, 1.05])
def test_rays_meet_the_bent_board(tilt: float):
    """Rays to points of the board, at up to 60° to its normal, meet it within what the docstring says."""
    terms = TERMS / np.ptp(TERMS @ basis(*places_on_board(POINTS), 5)) * 0.5
    R, t = vector_to_matrix(np.array([0.3 * tilt, tilt, 0.1])), np.array([-60.0, -40.0, 350.0])
    X = np.stack([*POINTS[:, :2].T, surface(terms)(*POINTS[:, :2].T)], axis=-1) @ R.T + t
    board = BentBoard.create(BoardShape.of(terms), R, t, HALF, HALF)
    depth = 1 / board.inverse_depth(X / X[:, 2:])
    np.testing.assert_allclose(depth, X[:, 2], atol=2e-4)
    straight = 1 / (X / X[:, 2:] @ board.plane)
    assert np.abs(straight - X[:, 2]).max() > 0.1


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_rig_shape_and_bends_lie_within_their_sigma(seed: int):
    """Stripes on the bent boards in the hand and on the stage, too."""
    result = solved(seed, EACH, "bend")
    off = in_sigma(result, session(seed, EACH)[0])
    assert max(map(abs, off.values())) < 4.0, off
    assert result.corner_sigma_px == pytest.approx(0.02, rel=0.1)
    assert result.stripe_sigma_px == pytest.approx(0.06, rel=0.1)
    assert result.stripe_correlation is not None
    assert result.stripe_correlation < 1.5
    assert result.bend_sigma_mm == pytest.approx(EACH, rel=0.5)
    assert result.shape_covariance is not None
    found = np.array([float(x) for x in jax.tree.leaves(result.system.shape)])
    sigma = np.sqrt(np.diagonal(result.shape_covariance.matrix))
    assert (np.abs(found - TERMS) < 4 * sigma).all()
    assert result.board_covariances[0].names[-6:] == tuple(
        f"board.{part}.{i}" for part in ("rotation", "translation") for i in range(3)
    )


@pytest.mark.parametrize(("shape", "count"), [("bulge", 2), pytest.param("warp", 5, marks=pytest.mark.long)])
def test_bulges_alone_and_five_terms_follow_boards_that_have_no_more(shape: str, count: int):
    truth, exact = bent_session(3, lambda _: surface(np.array([0.5, 0.2, 0, 0, 0])), stage_views=7, columns_apart=6)
    seen = redrawn(exact, Noise(), np.random.default_rng(3))
    result = calibrate(seen, board_shape=shape)
    assert max(map(abs, in_sigma(result, truth).values())) < 4.0
    assert result.shape_covariance is not None
    assert len(result.shape_covariance.names) == count
    assert result.bend_sigma_mm is None
    assert result.board_bent_by()[0] == pytest.approx(0.7, abs=0.03)


def test_flat_boards_lose_nothing():
    bend, plain = solved(2, 0.0, "bend", False), solved(2, 0.0, "flat", False)
    assert bend.bend_sigma_mm is not None
    assert bend.bend_sigma_mm < 0.01
    for name in plain.covariance.names:
        one, other = bend.covariance.sigma(name), plain.covariance.sigma(name)
        assert one is not None
        assert other is not None
        assert one < 1.15 * other


def test_a_bent_board_taken_as_flat_is_named_with_its_millimetres():
    result = solved(0, EACH, "flat")
    found = result.flatness
    assert found is not None
    assert found.bent
    assert found.bent_mm == pytest.approx(bent_by(TERMS)[0], rel=0.15)
    assert found.bends_mm == pytest.approx(EACH, rel=0.5)
    (what, fix), *_ = found.statements
    assert f"{what}. {fix}".removesuffix(".") in result.warnings
    assert "The board is not flat: it is bent by 0." in what
    assert "--board-shape bend" in fix


def found_bent(**but: object) -> BoardFlatness:
    found = BoardFlatness("flat", 0.35, 0.06, 0.17, 1e-9, 1e-9, "camera.focal.0", 4.0, 12)
    return replace(found, **but)


def test_what_is_advised_can_be_done_with_the_views_that_there_are():
    for views, words in ((6, "Calibrate with"), (5, "Take 1 more view of the"), (3, "Take 3 more views of the")):
        ((_, fix),) = found_bent(views=views).statements
        assert fix.startswith(words)
        assert "--board-shape bend" in fix


def test_the_mean_of_two_boards_is_not_named_beside_them():
    """A flat board and one bent by 0.8 mm would be called "the board is bent by 0.35 mm"."""
    ((what, fix),) = found_bent(session="tuesday", differs_mm=0.81).statements
    assert "session tuesday has another shape" in what
    assert "apart" in fix


def test_bulges_that_are_alike_are_said_to_be():
    """Their σ is not 0 but the least that is tried."""
    ((what, _),) = found_bent(bends_mm=LEAST_BEND_MM).statements
    assert "highest point, and alike in all photographs. Taken so" in what
    fit = {"board_shape": "bend", "board_bent_mm": 0.3, "board_bent_sigma_mm": 0.01}
    alike = shape_in_words(fit | {"board_bends_sigma_mm": LEAST_BEND_MM})
    assert alike == "bent by 0.3 ± 0.01 mm from its lowest to its highest point, and alike in all photographs"
    differ = shape_in_words(fit | {"board_bends_sigma_mm": 0.1234})
    assert differ is not None
    assert differ.endswith("its bulges differ by 0.12 mm (σ)")


@pytest.mark.parametrize("shape", ["flat", "bend"])
def test_flat_boards_and_followed_ones_are_not_named(shape: str):
    result = solved(2, 0.0, "flat", False) if shape == "flat" else solved(0, EACH, "bend")
    assert result.flatness is not None
    assert not result.flatness.statements


def test_a_poor_lens_is_not_taken_for_a_bent_board():
    _, seen = session(2, 0.0, False)
    result = calibrate(seen, lens="none")
    assert result.flatness is not None
    assert not result.flatness.bent


def test_two_boards_in_one_calibration_are_named():
    each = [
        redrawn(bent_session(4, lambda _, z=z: z, stage_views=0, columns_apart=6)[1], Noise(), np.random.default_rng(i))
        for i, z in enumerate((flat, surface(TERMS)))
    ]
    result = calibrate(join(["monday", "tuesday"], each), board_shape="warp")
    assert result.flatness is not None
    assert result.flatness.session == "tuesday"
    assert any("session tuesday has another shape" in warning for warning in result.warnings)


def test_the_rig_file_says_how_far_it_is_bent():
    result = solved(0, EACH, "bend")
    fit = result.rig_file().fit
    assert fit["board_shape"] == "bend"
    assert fit["board_bent_mm"] == pytest.approx(result.board_bent_by()[0])
    assert fit["board_bends_sigma_mm"] == result.bend_sigma_mm
    assert len(fit["board_terms_mm"]) == 5
    assert "board_shape" not in solved(2, 0.0, "flat", False).rig_file().fit


@pytest.mark.long
def test_refit_finds_the_minimum_again_and_is_differentiated():
    result = solved(0, EACH, "bend")
    with float64():
        adjustment = jax.tree.map(jnp.asarray, result.adjustment)
        again = refit(adjustment)
        np.testing.assert_allclose(np.asarray(again.bends(0)), np.asarray(result.system.bends(0)), atol=1e-6)

        def focal(shift: jax.Array) -> jax.Array:
            moved = eqx.tree_at(lambda a: a.groups[0].corners, adjustment, adjustment.groups[0].corners + shift)
            return jnp.asarray(refit(moved).rig.camera.focal[0])

        shift = np.zeros(adjustment.groups[0].corners.shape)
        shift[0, 0, 0, 0] = 1.0
        slope = jax.jvp(lambda x: focal(x * jnp.asarray(shift)), (0.0,), (1.0,))[1]
        step = 1e-3
        expected = (focal(step * jnp.asarray(shift)) - focal(-step * jnp.asarray(shift))) / (2 * step)
    assert float(slope) == pytest.approx(float(expected), rel=1e-4)


@pytest.mark.long
def test_lenses_are_tried_on_the_board_as_it_is():
    """On a flat one the bulge would be the lens's."""
    result = solved(0, EACH, "bend")
    ladder = climb(result)
    assert ladder is not None
    assert ladder.supported == "radial1"


def test_a_shape_needs_views_enough():
    _, seen = session(0, EACH)
    few = replace(seen, views=seen.views[:4])
    with pytest.raises(InputError, match=r'4 usable views .* board_shape = "bend" needs 6, .* board_shape = "bulge"'):
        calibrate(few, board_shape="bend")
    with pytest.raises(InputError, match='board_shape = "curly": there are flat, bulge, warp, bend'):
        calibrate(few, board_shape="curly")


def test_a_shape_that_runs_away_is_refused():
    _, exact = bent_session(5, lambda _: surface(60 * TERMS), stage_views=0, stripes=False)
    with pytest.raises(SolveError, match="the solve for the board's shape diverged: it came out bent by"):
        calibrate(redrawn(exact, Noise(), np.random.default_rng(0)), board_shape="warp")


@pytest.mark.parametrize(
    ("millimetres", "error", "words"),
    [(10.0, ObservabilityError, "corners fit to .* See whether the board is flat"), (20.0, SolveError, "make it flat")],
)
def test_a_board_that_is_bent_too_far_is_to_be_made_flat(millimetres: float, error: type[Exception], words: str):
    """Taken as flat its advice was to tilt the board, as one that bends to take it as flat."""
    _, exact = bent_session(0, lambda _: surface(millimetres / 3 * np.array([2.0, 1.0, 0, 0, 0])), stripes=False)
    with pytest.raises(error, match=words):
        calibrate(exact, board_shape="flat" if error is ObservabilityError else "bend")


def test_a_range_has_the_sigma_of_its_ends():
    sagitta, sigma = bent_by(np.array([0.3, 0.0]), np.diag([0.01, 1.0]) ** 2)
    assert sagitta == pytest.approx(0.3)
    assert sigma == pytest.approx(0.01)


def test_a_pose_that_too_few_points_tell_takes_what_it_can():
    rng = np.random.default_rng(0)
    poses, columns = rng.normal(size=(1, 4, 6)), rng.normal(size=(1, 4, 3))
    assert np.abs(without_poses(poses, columns)).max() < 1e-9
    twice = np.concatenate([poses[..., :3], poses[..., :3]], axis=-1)
    left = columns[0] - twice[0] @ np.linalg.lstsq(twice[0], columns[0])[0]
    np.testing.assert_allclose(without_poses(twice, columns)[0], columns[0].T @ left, atol=1e-9)
