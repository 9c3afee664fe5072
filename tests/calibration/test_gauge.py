"""A rig whose light plane is wrong, corrected by objects of known shape; what is no gauge is refused."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import trimesh

from benchmarks.drawn import Noise, exact_session, redrawn
from jaxscan import calibrate
from jaxscan.calibration.gauge import refine_by_gauge
from jaxscan.calibration.gauge_points import Gauge, GaugeScan
from jaxscan.calibration.gauge_shapes import Ball, Solid, Steps, parse_shape
from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Covariance, LightPlane
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.shapes import box, sphere, stair

HEIGHTS = (1.48, 3.68, 8.94, 14.0)
NOISE_PX = 0.05
FRAMES, APART = 15, 4500.0
# σ of a calibration from boards, about as they come out, in the order of the parameters' names.
SIGMA = np.array([0.3, 0.3, 0.2, 0.2, 1e-3, 2e-6, 2e-6, 2e-6, 1e-7, 1e-7, 1e-7])


@pytest.fixture(scope="module")
def true_rig():
    return rig_2003.simulated_rig(0)


@pytest.fixture(scope="module")
def turned(true_rig):
    """The rig with its sheet turned by 1°, and with a covariance that knows nothing of that."""
    omega = np.array([float(c) for c in true_rig.lights[0].plane])
    aside = np.cross(omega, [0.3, 1.0, 0.2])
    aside *= np.linalg.norm(omega) / np.linalg.norm(aside)
    wrong = np.cos(np.radians(1)) * omega + np.sin(np.radians(1)) * aside
    with float64():
        rig = replace(true_rig, lights=(as_numpy(LightPlane.create(wrong)),))
    return RigFile(rig, Covariance(tuple(parameter_names(rig)), np.diag(SIGMA**2)))


def scan_of(rig, bodies, seed=0):
    """What an ideal detector sees, with noise."""
    steps = APART * np.arange(FRAMES)
    scene = rig_2003.scan_scene(rig, bodies)
    rows = np.stack([true_profile(rig, scene, {"stage": float(n)}).position for n in steps])
    return GaugeScan(rows + NOISE_PX * np.random.default_rng(seed).normal(size=rows.shape), {"stage": steps})


@pytest.fixture(scope="module")
def block(true_rig):
    return scan_of(true_rig, stair(37.0, HEIGHTS))


@pytest.fixture(scope="module")
def by_block(turned, block):
    return refine_by_gauge(turned, [Gauge(block, Steps((0.0, *HEIGHTS)))])


def test_a_step_block_puts_the_light_plane_right(by_block, true_rig):
    # 0.05 px are about 0.04 mm on a level face; the plane 1° wrong adds several times that.
    (reading,) = by_block.gauges
    assert reading.rms_after_mm < 0.06 < 2 * reading.rms_after_mm < reading.rms_before_mm
    assert reading.stripe_sigma_px == pytest.approx(NOISE_PX, rel=0.05)
    assert reading.points > 3000
    values, truth = (np.array([float(x) for x in jax.tree.leaves(r)]) for r in (by_block.rig, true_rig))
    sigma = np.sqrt(np.diagonal(by_block.covariance.matrix))
    assert by_block.covariance.names == tuple(parameter_names(true_rig))
    assert (np.abs(values - truth) < 4 * sigma).all()


def test_another_block_then_reads_right(by_block, turned, true_rig):
    """Read as a user would: the same scan by both rigs, another block that the refinement has not seen."""
    heights = (11.5, 6.2)
    other = scan_of(true_rig, stair(30.0, heights), seed=1)
    errors = {}
    for name, rig in (("turned", turned.rig), ("refined", by_block.rig)):
        content = RigFile(rig, turned.covariance)
        # Everything is trusted and nothing free but the pose: a fit of the levels to the points as this rig sees them.
        fit = refine_by_gauge(content, [Gauge(other, Steps((0.0, *heights)))], trust=("laser", "stage"))
        errors[name] = fit.gauges[0].rms_before_mm
    assert errors["refined"] < 0.06 < 2 * errors["refined"] < errors["turned"]


def test_with_everything_trusted_the_gauge_only_adds(true_rig, turned, block):
    content = RigFile(true_rig, turned.covariance)
    fit = refine_by_gauge(content, [Gauge(block, Steps((0.0, *HEIGHTS)))], trust=("laser", "stage"))
    sigma = np.sqrt(np.diagonal(fit.covariance.matrix))
    assert (sigma <= SIGMA * (1 + 1e-9)).all()
    assert fit.from_prior_in_sigma < 4.0


@pytest.mark.parametrize("kind", ["ball", pytest.param("mesh", marks=pytest.mark.long)])
def test_balls_and_meshes_are_gauges_too(kind, true_rig, turned):
    if kind == "ball":
        scan, shape = scan_of(true_rig, (sphere(37.0, 25.0),)), Ball(25.0)
    else:
        low, high = trimesh.creation.box((30.0, 25.0, 10.0)), trimesh.creation.box((60.0, 40.0, 4.0))
        low.apply_translation([8.0, 3.0, 5.0])
        high.apply_translation([0.0, 0.0, 2.0])
        mesh = trimesh.util.concatenate([low, high])
        scan = scan_of(true_rig, (box(40.0, (60.0, 40.0, 4.0)), *_upper(43.0)))
        shape = Solid(mesh)
    fit = refine_by_gauge(turned, [Gauge(scan, shape)])
    assert fit.gauges[0].rms_after_mm < 0.06 < fit.gauges[0].rms_before_mm
    values, truth = (np.array([float(x) for x in jax.tree.leaves(r)]) for r in (fit.rig, true_rig))
    assert (np.abs(values - truth) < 4 * np.sqrt(np.diagonal(fit.covariance.matrix))).all()


def _upper(y):
    """A box of 30 × 25 mm, 10 mm high, 8 mm to the right."""
    body = box(y, (30.0, 25.0, 10.0))
    return (body.moved(np.eye(3), np.array([8.0, 0.0, 0.0])),)


def test_a_gauge_of_another_size_is_refused(turned, block):
    with pytest.raises(InputError, match="no ball of radius 3 mm"):
        refine_by_gauge(turned, [Gauge(block, Ball(3.0))])


def test_too_few_points_are_refused(turned, block):
    few = replace(block, pixels=np.where(np.arange(640) < 3, block.pixels, np.nan))
    with pytest.raises(InputError, match="at least 100"):
        refine_by_gauge(turned, [Gauge(few, Steps())])


def test_what_can_be_trusted(turned, block):
    with pytest.raises(InputError, match="camera"):
        refine_by_gauge(turned, [Gauge(block, Steps())], trust=("camera",))


@pytest.mark.parametrize(
    ("text", "shape"),
    [("plate", Steps()), ("steps:14,1.48", Steps((0.0, 1.48, 14.0))), ("ball:22.5", Ball(22.5))],
)
def test_shapes_by_name(text, shape):
    assert parse_shape(text) == shape


@pytest.mark.parametrize("text", ["steps:", "steps:1,,2", "ball:0", "ball:-3", "cube", "ball:nan"])
def test_a_shape_that_is_none_is_refused_with_what_would_do(text):
    with pytest.raises(InputError, match=r"plate, steps:1\.48"):
        parse_shape(text)


def test_a_shape_from_a_file(tmp_path):
    path = tmp_path / "block.stl"
    trimesh.creation.box((10.0, 10.0, 5.0)).export(path)
    assert isinstance(parse_shape(str(path)), Solid)
    solid = parse_shape(str(path), "cm")
    assert isinstance(solid, Solid)
    np.testing.assert_allclose(np.ptp(solid.mesh.bounds, axis=0).ravel(), [100.0, 100.0, 50.0], rtol=1e-6)
    path.write_bytes(b"no mesh")
    with pytest.raises(InputError, match=r"block\.stl"):
        parse_shape(str(path))


@pytest.fixture(scope="module")
def calibration():
    """From the boards of the same rig, drawn with noise."""
    _, exact = exact_session(0)
    return calibrate(redrawn(exact, Noise(), np.random.default_rng(0)))


def values_of(rig):
    return np.array([float(x) for x in jax.tree.leaves(rig)])


@pytest.mark.long
def test_boards_and_gauge_in_one_solve(calibration, block, true_rig):
    """Where both are near the minimum, the boards' photographs tell what their mean and covariance tell."""
    gauge = [Gauge(block, Steps((0.0, *HEIGHTS)))]
    joint = refine_by_gauge(calibration, gauge, trust=("laser", "stage"))
    by_prior = refine_by_gauge(calibration.rig_file(), gauge, trust=("laser", "stage"))
    sigma = np.sqrt(np.diagonal(joint.covariance.matrix))
    assert (sigma < np.sqrt(np.diagonal(calibration.covariance.matrix))).all()
    assert (np.abs(values_of(joint.rig) - values_of(true_rig)) < 4 * sigma).all()
    assert (np.abs(values_of(joint.rig) - values_of(by_prior.rig)) < 0.05 * sigma).all()
    np.testing.assert_allclose(sigma, np.sqrt(np.diagonal(by_prior.covariance.matrix)), rtol=0.02)
    assert joint.from_prior_in_sigma == pytest.approx(by_prior.from_prior_in_sigma, abs=0.05)


@pytest.mark.long
def test_boards_tell_nothing_of_a_part_that_is_not_trusted(calibration, turned, true_rig):
    """The laser was pushed after the boards were photographed: their stripes lie on a sheet that is no more."""
    pushed = replace(true_rig, lights=turned.rig.lights)
    scan = scan_of(pushed, stair(37.0, HEIGHTS))
    fit = refine_by_gauge(calibration, [Gauge(scan, Steps((0.0, *HEIGHTS)))])
    sigma = np.sqrt(np.diagonal(fit.covariance.matrix))
    assert (np.abs(values_of(fit.rig) - values_of(pushed)) < 4 * sigma).all()
    assert fit.gauges[0].rms_after_mm < 0.06


@pytest.mark.long
def test_a_gauge_in_two_places(turned, block, by_block, true_rig):
    around = scan_of(true_rig, stair(37.0, HEIGHTS[::-1]), seed=3)
    fit = refine_by_gauge(turned, [Gauge(scan, Steps((0.0, *HEIGHTS))) for scan in (block, around)])
    one, two = (np.sqrt(np.diagonal(f.covariance.matrix)) for f in (by_block, fit))
    assert (two < one * (1 + 1e-9)).all()
    assert (two[-6:-3] < 0.8 * one[-6:-3]).any()
    assert (np.abs(values_of(fit.rig) - values_of(true_rig)) < 4 * two).all()
    assert [gauge.points > 3000 for gauge in fit.gauges] == [True, True]


def test_a_wrong_certificate_contradicts_the_boards(true_rig, block):
    content = RigFile(true_rig, Covariance(tuple(parameter_names(true_rig)), np.diag(SIGMA**2)))
    right = refine_by_gauge(content, [Gauge(block, Steps((0.0, *HEIGHTS)))])
    assert right.contradictions == ()
    assert "warnings" not in right.rig_file().fit
    read = [level.read_mm for level in right.gauges[0].levels]
    np.testing.assert_allclose(read, HEIGHTS, atol=0.02)
    unseen = refine_by_gauge(content, [Gauge(block, Steps((0.0, 1.48, 3.68, 8.94, 16.0)))])
    assert any("No point lies on the gauge's level of 16 mm" in words for words in unseen.contradictions)
    wrong = refine_by_gauge(content, [Gauge(block, Steps((0.0, 1.48, 3.68, 8.94, 14.5)))])
    assert any("Levels of the gauge do not fit together: " in words for words in wrong.contradictions)
    assert wrong.rig_file({"warnings": ["before"]}, ["after"]).warnings == ("before", *wrong.contradictions, "after")


@pytest.mark.parametrize("text", ["steps:0.01,0.02", "ball:0.007"])
def test_metres_are_recognised(text):
    with pytest.raises(InputError, match=r"give millimetres \(0\.0\d+ m are (20|7)\)"):
        parse_shape(text)
