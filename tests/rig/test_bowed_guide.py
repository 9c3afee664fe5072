"""Stages that are no lines: identity at step 0, values, derivatives, and what is said of them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxscan.geometry import Pose
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, Covariance, Guide, Linear, Rig, Screw, ScrewOnGuide
from jaxscan.rig.rig import parameter_names
from jaxscan.rig.summary import axis_summary, format_path

PER_STEP = np.array([3e-5, 9e-4, -4e-4])
BOW = np.array([1e-11, -5e-11, -1e-10])
TURN = np.array([-2e-7, 1e-8, 3e-8])
CENTRE = np.array([3.0, -20.0, 350.0])
WAVE, PERIOD = np.array([0.04, -0.03]), 2900.0


def kinds():
    with float64():
        return as_numpy(
            (
                Guide.create(PER_STEP, BOW, TURN, CENTRE),
                Screw.create(PER_STEP, WAVE, PERIOD),
                ScrewOnGuide.create(PER_STEP, BOW, TURN, CENTRE, WAVE, PERIOD),
            )
        )


def plainly(part, n, X):
    """Where a point stands after n steps, written out by SciPy."""
    turn, bow, centre = (np.array(getattr(part, name, np.zeros(3)), float) for name in ("turn", "bow", "centre"))
    shift = n * PER_STEP + n**2 * bow
    if "wave" in part.numbers:
        w = 2 * np.pi * n / PERIOD
        shift = shift + (WAVE[0] * (np.cos(w) - 1) + WAVE[1] * np.sin(w)) * PER_STEP / np.linalg.norm(PER_STEP)
    return Rotation.from_rotvec(n * turn).apply(X - centre) + centre + shift


@pytest.mark.parametrize("part", kinds(), ids=lambda part: part.kind)
def test_it_stands_where_it_is_written(part):
    steps, X = np.array([-4000.0, 0.0, 1.0, 700.0, 60000.0]), np.array([12.0, -30.0, 330.0])
    moved = part.pose({"stage": steps}).apply(X[None])[:, 0]
    np.testing.assert_allclose(moved, [plainly(part, n, X) for n in steps], atol=1e-10)
    still = part.pose({"stage": 0.0})
    assert not np.any(still.matrix() - np.eye(3))
    np.testing.assert_allclose(still.translation, 0, atol=1e-13)
    assert part.pose({"turntable": 5.0}).translation.shape == (3,)


@pytest.mark.parametrize("part", kinds(), ids=lambda part: part.kind)
def test_derivatives_agree_with_differences(part):
    leaves, structure = jax.tree.flatten(part)
    numbers = np.array([float(leaf) for leaf in leaves])

    @jax.jit
    def vector(numbers):
        return jax.tree.unflatten(structure, list(numbers)).pose({"stage": jnp.asarray(7300.0)}).as_vector()

    with float64():
        J = np.asarray(jax.jit(jax.jacfwd(vector))(jnp.asarray(numbers)))
        by_reverse = np.asarray(jax.jit(jax.jacrev(vector))(jnp.asarray(numbers)))
        h = 1e-4 * np.abs(numbers)
        apart = [
            (vector(jnp.asarray(numbers + h * e)) - vector(jnp.asarray(numbers - h * e))) / (2 * h @ e)
            for e in np.eye(len(numbers))
        ]
    scale = np.abs(J).max(axis=0)
    np.testing.assert_allclose(by_reverse / scale, J / scale, atol=1e-9)
    np.testing.assert_allclose(np.stack(apart, axis=1) / scale, J / scale, atol=1e-4)


@pytest.mark.parametrize("kind", [Guide, Screw, ScrewOnGuide])
def test_at_rest_it_does_not_move_and_has_derivatives(kind):
    with float64():
        part = kind.at_rest("stage")
        leaves, structure = jax.tree.flatten(part)

        def shift(numbers):
            return jax.tree.unflatten(structure, list(numbers)).pose({"stage": jnp.asarray(900.0)}).as_vector()

        assert not np.any(np.asarray(shift(jnp.stack(leaves))))
        assert np.isfinite(np.asarray(jax.jacfwd(shift)(jnp.stack(leaves)))).all()


@pytest.mark.parametrize("kind", [Guide, Screw, ScrewOnGuide])
def test_a_start_is_the_line_of_the_middle_of_the_board(kind):
    steps, middle = np.linspace(5000.0, 9000.0, 9), np.array([64.0, 40.0, 0.0])
    at = Pose(np.array([0.1, -0.2, 0.05]), np.array([-60.0, -30.0, 340.0]))
    poses = Pose(np.tile(at.rotation, (9, 1)), at.translation + steps[:, None] * PER_STEP)
    poses.translation[4] += 5.0
    part = as_numpy(kind.fitted("stage", steps, poses, middle))
    np.testing.assert_allclose(np.array(part.per_step), PER_STEP, rtol=1e-4)
    assert not any(float(leaf) for name in part.shape() if name != "period" for leaf in getattr(part, name))
    if "centre" in part.numbers:
        np.testing.assert_allclose(np.array(part.centre), at.apply(middle), atol=1e-3)


def test_it_goes_along_its_line_as_any_stage():
    line = as_numpy(Linear.create(PER_STEP))
    for part in kinds():
        assert part.way() == line.way()
        assert part.amount(1000.0) == pytest.approx(line.amount(1000.0))
        np.testing.assert_allclose(part.direction(), line.direction())


def rig_of(part):
    with float64():
        camera = Camera.create((640, 480), np.array([700.0, 700.0]), np.array([320.0, 240.0]), "none", np.zeros(0))
        return as_numpy(Rig(camera, (), part))


def test_its_centre_is_given_and_nothing_else():
    guide, screw, both = map(rig_of, kinds())
    centre = {f"motion.stage.centre.{i}" for i in range(3)}
    assert guide.given() == centre == both.given()
    assert not screw.given()
    assert not guide.surplus()


def test_bow_and_wave_are_said_with_their_sigma():
    rig = rig_of(kinds()[2])
    names = [name for name in parameter_names(rig) if name.startswith("motion.")]
    variances = np.array([1e-24 if ".bow." in n else 1e-18 if ".turn." in n else 1e-6 for n in names])
    (summary,) = axis_summary(rig, Covariance(tuple(names), np.diag(variances)))
    over = 100 / np.linalg.norm(PER_STEP)
    assert summary["bowed_mm"] == pytest.approx(np.linalg.norm(BOW) * over**2 / 4)
    assert summary["bowed_mm_sigma"] == pytest.approx(1e-12 * over**2 / 4)
    assert summary["turn_mrad"] == pytest.approx(1e3 * np.linalg.norm(TURN) * over)
    assert (summary["wave_mm"], summary["wave_mm_sigma"]) == pytest.approx((0.05, 1e-3))
    assert (summary["period_steps"], summary["period_steps_sigma"]) == pytest.approx((2900, 1e-3))
    said = list(format_path(summary))
    assert said[0].startswith("bowed by 0.28")
    assert said[1] == "ahead of its steps and behind by 0.05 ± 0.001 mm, with a period of 2900 ± 0.001 steps"
    held = Covariance(tuple(names[:-1]), np.diag(variances[:-1]))
    (summary,) = axis_summary(rig, held)
    assert summary["period_steps_sigma"] is None
    (summary,) = axis_summary(rig_of(as_numpy(Linear.create(PER_STEP))), None)
    assert not list(format_path(summary))


def test_screws_of_other_turns_differ():
    screw = kinds()[1]
    other = replace(screw, period=(np.asarray(PERIOD / 2),))
    q = {"stage": np.arange(0.0, PERIOD, 100.0)}
    assert np.abs(screw.pose(q).translation - other.pose(q).translation).max() > 0.02
