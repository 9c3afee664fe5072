"""Places and their poses against OpenCV, and the limits of where a board can be held."""

from dataclasses import replace

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

from jaxscan.calibration.placement import Reach, outline_of
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Camera
from tests.calibration import synthetic
from tests.other_lenses import Division, registered

MARGIN = 5.0


def reach_of(k1: float = synthetic.K1) -> Reach:
    with float64():
        camera = as_float64(Camera.create(synthetic.IMAGE_SIZE, synthetic.FOCAL, synthetic.PRINCIPAL, "radial1", [k1]))
        return Reach(
            camera=camera,
            outline=jnp.asarray(outline_of(synthetic.BOARD)),
            log_depths=jnp.log(jnp.asarray([300.0, 450.0])),
            tilt=jnp.asarray(np.radians(45)),
            margin_px=jnp.asarray(MARGIN),
        )


@eqx.filter_jit
def _excess(reach: Reach, places: Float[Array, "places 6"]) -> tuple[Float[Array, "places"], Float[Array, "places 6"]]:
    return jax.vmap(reach.excess)(places), jax.vmap(reach.pose)(places)


def placed(places: np.ndarray, reach: Reach | None = None) -> tuple[np.ndarray, np.ndarray]:
    """How far each place is beyond the limits, and its pose; all calls have the largest count of places."""
    with float64():
        excess, poses = _excess(reach or reach_of(), jnp.asarray(np.resize(places, (81, 6))))
    return np.asarray(excess)[: len(places)], np.asarray(poses)[: len(places)]


def excess(place: list[float], reach: Reach | None = None) -> float:
    return float(placed(np.array([place]), reach)[0][0])


def test_a_place_is_what_it_says():
    place = [430.0, 200.0, np.log(400.0), 0.5, -0.3, 0.9]
    pose, facing = placed(np.array([place, [*place[:3], 0.0, 0.0, 0.0]]))[1]
    R, middle = cv2.Rodrigues(pose[:3])[0], outline_of(synthetic.BOARD).mean(axis=0)
    X = R @ middle + pose[3:]
    assert X[2] == pytest.approx(400)
    np.testing.assert_allclose(synthetic.project(X[None])[0], place[:2], atol=1e-6)
    sight = X / np.linalg.norm(X)
    assert np.arccos(R[:, 2] @ sight) == pytest.approx(np.hypot(0.5, 0.3))
    np.testing.assert_allclose(cv2.Rodrigues(facing[:3])[0][:, 2], sight, atol=1e-12)


def test_the_outline_has_one_square_around_the_points():
    np.testing.assert_array_equal(outline_of(synthetic.BOARD)[:, :2], [[-16, -16], [144, -16], [144, 96], [-16, 96]])


@pytest.mark.parametrize(
    "place",
    [
        [320.0, 240.0, np.log(400), 0.0, 0.0, 0.0],
        [320.0, 240.0, np.log(400), 0.5, 0.5, 0.0],
        [200.0, 150.0, np.log(450), 0.0, 0.0, 0.0],
    ],
)
def test_within(place):
    assert excess(place) == 0


@pytest.mark.parametrize(
    "place",
    [
        pytest.param([60.0, 240.0, np.log(400), 0.0, 0.0, 0.0], id="beyond the left edge"),
        pytest.param([320.0, 440.0, np.log(400), 0.0, 0.0, 0.0], id="beyond the lower edge"),
        pytest.param([320.0, 240.0, np.log(400), 0.6, 0.6, 0.0], id="edge on"),
        pytest.param([320.0, 240.0, np.log(90), 0.7, 0.0, 0.0], id="too near"),
        pytest.param([320.0, 240.0, np.log(50), 1.4, 0.0, 0.0], id="partly behind the camera"),
    ],
)
def test_beyond(place):
    assert not excess(place) <= 0


def test_beyond_the_fold_of_a_lens_of_another_kind():
    class Narrow(Division):
        """Folds 0.3 from the axis: within the image at 697 px."""

        kind = "narrow"

        def invertible_radius(self, dtype):
            return jnp.asarray(0.3, dtype)

    with registered(Division, Narrow), float64():
        division, narrow = (
            replace(
                reach_of(), camera=as_float64(Camera.create(synthetic.IMAGE_SIZE, [700.0, 700.0], [319.5, 239.5], kind))
            )
            for kind in ("division", "narrow")
        )
    near, middle = [200.0, 150.0, np.log(450), 0.0, 0.0, 0.0], [320.0, 240.0, np.log(450), 0.0, 0.0, 0.0]
    assert [excess(place, division) for place in (near, middle)] == [0, 0]
    assert excess(near, narrow) > 0
    assert excess(middle, narrow) == 0


def test_the_limit_is_the_margin():
    """The excess begins where OpenCV has a corner of the outline less than the margin within the image."""
    places = np.array([[u, 240.0, np.log(400), 0.3, 0.2, 0.1] for u in np.linspace(100, 180, 81)])
    beyond, poses = placed(places)
    inside = []
    for pose in poses:
        X = outline_of(synthetic.BOARD) @ cv2.Rodrigues(pose[:3])[0].T + pose[3:]
        inside.append((synthetic.project(X) >= MARGIN - 0.5).all())
    assert 10 < np.sum(inside) < 70
    np.testing.assert_array_equal(beyond == 0, inside)


def test_beyond_the_fold_of_a_lens_nothing_is_within():
    # With k1 = -1 the lens folds at the undistorted radius 1 / √3, the distorted one 0.385 = 269 px.
    folded = reach_of(-1.0)
    assert excess([320.0, 240.0, np.log(450), 0.0, 0.0, 0.0], folded) == 0
    assert excess([320.0, 240.0, np.log(160), 0.0, 0.0, 0.0], folded) > 0
    assert np.isnan(excess([630.0, 240.0, np.log(450), 0.0, 0.0, 0.0], folded))
