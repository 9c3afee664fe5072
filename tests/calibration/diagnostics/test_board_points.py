"""Points of a board that are not where its shape has them: found, named, and admitted by σ."""

import jax
import numpy as np
import pytest

from benchmarks.board_shape import HALF, seen_by
from benchmarks.left_over import stretched
from jaxscan.calibration import calibrate
from tests.calibration.clean import clean


def like_an_s(seed):
    """A board that is bent like an S by 0.3 mm."""

    def height(x, y):
        s = x / HALF[0] - 1
        return 0.3 / 0.77 * (s**3 - s)

    return seen_by(seed, lambda _: height)


def in_sigma(rig, result, covariance):
    true, own = (np.array([float(leaf) for leaf in jax.tree.leaves(each)]) for each in (rig, result.rig))
    return np.abs(own - true) / np.sqrt(np.diagonal(covariance.of_leaves(result.rig)))


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_points_that_are_where_they_should_be_widen_nothing(seed):
    result = clean(seed)
    assert result.off_grid is None
    np.testing.assert_array_equal(result.covariance.matrix, result.formal_covariance.matrix)
    assert set(result.widened_by().values()) == {1.0}
    assert "sigma_over_noise_alone" not in result.rig_file().fit


@pytest.mark.parametrize("seed", [0, pytest.param(2, marks=pytest.mark.long)])
def test_a_board_like_an_s_is_told_by_its_height(seed):
    rig, session = like_an_s(seed)
    result = calibrate(session, board_shape="bend")
    found = result.off_grid
    # What the five terms leave of it: the RMS of 0.39 (s³ − s) without its line, over the points.
    assert found.height_mm == pytest.approx(0.084, rel=0.1)
    assert found.in_plane_mm == 0
    assert in_sigma(rig, result, result.formal_covariance).max() > 3
    assert in_sigma(rig, result, result.covariance).max() < 3
    ((what, _),) = found.statements
    assert "0.08" in what
    assert "out of it" in what
    assert any("not where they should be" in warning for warning in result.warnings)


def test_a_stretched_pattern_is_told_in_its_plane():
    rig, session = stretched(0)
    result = calibrate(session)
    assert result.off_grid.in_plane_mm > 0.03
    assert result.off_grid.height_mm == 0
    assert in_sigma(rig, result, result.formal_covariance).max() > 10
    assert in_sigma(rig, result, result.covariance).max() < 3


def test_what_is_wider_is_a_covariance_and_the_boards_go_along():
    _, session = like_an_s(1)
    result = calibrate(session, board_shape="bend")
    more = result.covariance.matrix - result.formal_covariance.matrix
    scale = np.sqrt(np.diagonal(result.covariance.matrix))
    assert np.linalg.eigvalsh(more / np.outer(scale, scale)).min() > -1e-9
    n = len(result.covariance.names)
    for board in (*result.board_covariances, *result.moved_covariances):
        np.testing.assert_allclose(board.matrix[:n, :n], result.covariance.matrix, rtol=1e-6)
        spread = board.matrix / np.sqrt(np.outer(*[np.diagonal(board.matrix)] * 2))
        assert np.linalg.eigvalsh(spread).min() > -1e-9


def test_a_bent_board_that_is_named_is_named_once():
    _, session = seen_by(0, lambda _: lambda x, y: 0.3 * (1 - (x / HALF[0] - 1) ** 2))
    result = calibrate(session)
    assert result.flatness.bent
    assert result.off_grid is not None
    assert result.off_grid.statements == ()
    fit = result.rig_file().fit
    assert fit["sigma_over_noise_alone"]["camera.radial.0"] > 1
