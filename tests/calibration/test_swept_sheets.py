"""A light that an axis turns is found from stripes at several of its positions on each board."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxscan.calibration import Observations, StripePoints, View, calibrate
from jaxscan.calibration.observations import join
from jaxscan.errors import InputError, ObservabilityError
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import SweptSheet
from jaxscan.rig.rig import parameter_names
from tests.calibration.synthetic import BOARD, IMAGE_SIZE, OMEGA, TRUTH, board_pose, project, stripe_on

PER_STEP = np.radians(0.01) * np.array([1.0, 0.02, -0.03])
POINT = np.array([3.0, -207.0, 9.0])
MIDDLE = 2000.0


def light() -> SweptSheet:
    with float64():
        return as_numpy(SweptSheet.about(OMEGA, PER_STEP, POINT, MIDDLE))


def observed(seed: int, views: int = 8, positions: int = 5, sweep: float = 1000.0, noise: float = 0.1) -> Observations:
    """Boards, each with a stripe at each position; corners with half of the stripes' noise."""
    rng, points, seen = np.random.default_rng(seed), BOARD.points(), []
    for i in range(views):
        R, t = board_pose(rng)
        corners = project(points @ R.T + t) + 0.5 * noise * rng.normal(size=(len(points), 2))
        stripes = []
        for n in MIDDLE + np.linspace(-sweep / 2, sweep / 2, positions):
            pixels = stripe_on(R, t, True, np.array(light().at(n).plane))
            pixels[:, 1] += noise * rng.normal(size=len(pixels))
            stripes.append(StripePoints(pixels, half_width_px=1e-6, position=float(n)))
        seen.append(View(f"view-{i}", corners, stripes=tuple(stripes)))
    return Observations(IMAGE_SIZE, BOARD, tuple(seen), lasers=("",), light_axes={"": "sweep"})


def of_light() -> dict[str, float]:
    true = light()
    return {
        f"lights.0.{part}.{i}": float(x)
        for part in ("plane", "per_step", "centre")
        for i, x in enumerate(getattr(true, part))
    }


def test_it_is_found_and_its_sigma_is_that_of_its_errors():
    """The squares of all errors in σ over five sessions have the mean that thirteen numbers have."""
    truth, squares = {k: v for k, v in TRUTH.items() if k.startswith("camera")} | of_light(), []
    for seed in range(5):
        found = calibrate(observed(seed), light="swept")
        assert set(found.covariance.names) == set(truth)
        values = dict(zip(parameter_names(found.rig), map(float, jax.tree.leaves(found.rig)), strict=True))
        off = np.array([values[name] - truth[name] for name in found.covariance.names])
        sigma = np.sqrt(np.diagonal(found.covariance.matrix))
        correlation = found.covariance.matrix / np.outer(sigma, sigma)
        squares.append(off / sigma @ np.linalg.solve(correlation, off / sigma))
        assert found.rig_file().fit["light_positions"] == {"sweep": [1500.0, 2500.0]}
    # χ² of 5 × 13 degrees of freedom: 65 ± 11.
    assert 35 < np.sum(squares) < 105


def test_positions_need_not_be_the_same_on_all_boards():
    seen = observed(30, positions=7)
    views = [replace(view, stripes=view.stripes[i % 2 :: 2]) for i, view in enumerate(seen.views)]
    found = calibrate(replace(seen, views=tuple(views)), light="swept")
    for n in (1500.0, 2500.0):
        a, b = (np.array([float(leaf) for leaf in each.at(n).plane]) for each in (found.rig.lights[0], light()))
        np.testing.assert_allclose(a, b, rtol=5e-3, atol=5e-6)


def test_too_few_positions_are_refused():
    with pytest.raises(ObservabilityError, match="of 2 positions of the sweep"):
        calibrate(observed(0, positions=2), light="swept")


def test_a_light_that_stands_still_is_refused_as_one_that_turns():
    seen = observed(0)
    still = [
        replace(view, stripes=tuple(replace(view.stripes[2], position=n) for n in (0.0, 1.0, 2.0)))
        for view in seen.views
    ]
    with pytest.raises(ObservabilityError, match="make no sheet of light that turns"):
        calibrate(replace(seen, views=tuple(still)), light="swept")


@pytest.mark.parametrize(("kind", "axes"), [("plane", {"": "sweep"}), ("swept", {})])
def test_a_kind_that_does_not_fit_the_observations_is_refused(kind, axes):
    with pytest.raises(InputError, match="name there what moves it if its light moves, and only then"):
        calibrate(replace(observed(0), light_axes=axes), light=kind)


def test_sessions_whose_lights_are_moved_by_different_axes_do_not_join():
    one = observed(0)
    with pytest.raises(InputError, match="moved by \\['mirror'\\]"):
        join(["a", "b"], [one, replace(one, light_axes={"": "mirror"})])


def test_wrong_steps_show():
    """The positions of two photographs of each board are exchanged."""
    mixed = []
    for view in observed(5).views:
        a, b, *rest = view.stripes
        mixed.append(replace(view, stripes=(replace(a, position=b.position), replace(b, position=a.position), *rest)))
    found = calibrate(replace(observed(5), views=tuple(mixed)), light="swept")
    assert any("does not fit the stripes" in warning for warning in found.warnings)
