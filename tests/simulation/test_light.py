"""Light as it is, measured in the photographs: speckle, coloured lamps, highlights, ghosts."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.images import Board
from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.rig import LightPlane, Rig
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.render import render
from jaxscan.simulation.scene import Body, Scene
from jaxscan.simulation.shapes import board_plate, grey
from jaxscan.simulation.solids import Sphere
from jaxscan.simulation.speckle import speckle

DARK = (0.0, 0.0, 0.0)
# A sheet that lights all of the plate alike, and nothing else.
FLOOD = Lighting(ambient=0.0, directional=0.0, laser_power=20.0, sheet_sigma_mm=1e5)
# A lens that blurs, and a sensor without noise.
LENS = Sensor(blur_px=0.8, noise=0.0, bits=16)


@pytest.fixture(scope="module")
def plate() -> Scene:
    wall = board_plate(Board.checkerboard((4, 3), 16.0), margin_mm=300, ink=1.0, white=1.0)
    return Scene((wall.moved(np.eye(3), np.array([0.0, 0.0, 300.0])),), DARK)


def upright(rig: Rig) -> Rig:
    """The rig with a sheet whose stripe runs down the columns."""
    with float64():
        return as_numpy(replace(rig, lights=(LightPlane.create(np.array([-0.00494, 0.0, 0.00303])),)))


def grains(rig: Rig, scene: Scene, lighting: Lighting, seed: int) -> np.ndarray:
    """Light of the laser over what it is without speckle, in the pixels of a photograph."""
    images = (
        render(rig, scene, laser=0, lighting=replace(lighting, speckle=c), sensor=LENS, seed=seed)
        for c in (lighting.speckle, 0.0)
    )
    speckled, steady = (image[..., 0].astype(float) for image in images)
    return speckled / steady


@pytest.mark.parametrize("contrast", [0.2, 1.0])
def test_speckle_has_its_contrast_in_the_pixels(rig: Rig, plate: Scene, contrast: float) -> None:
    factor = grains(rig, plate, replace(FLOOD, speckle=contrast), 1)
    assert factor.mean() == pytest.approx(1, abs=0.02)
    assert factor.std() == pytest.approx(contrast, rel=0.05)
    # A gamma variable has twice its contrast for skewness; each pixel is by itself.
    away = factor - factor.mean()
    assert (away**3).mean() / factor.std() ** 3 == pytest.approx(2 * contrast, rel=0.15)
    assert abs((away[:, 1:] * away[:, :-1]).mean()) < 0.03 * factor.var()


@pytest.mark.parametrize("down_columns", [False, True])
def test_speckle_has_its_length_along_and_across_the_stripe(rig: Rig, plate: Scene, down_columns: bool) -> None:
    lighting = replace(FLOOD, speckle=0.2, speckle_length_px=(2.0, 1.0))
    factors = [grains(upright(rig) if down_columns else rig, plate, lighting, seed) - 1 for seed in range(6)]
    assert np.sqrt(np.mean(np.square(factors))) == pytest.approx(0.2, rel=0.05)
    along, across = (length_of(np.array(factors), axis) for axis in ((1, 2) if down_columns else (2, 1)))
    assert along == pytest.approx(2.0, rel=0.05)
    assert across == pytest.approx(1.0, rel=0.05)


def length_of(factors: np.ndarray, axis: int) -> float:
    """Where the correlation has fallen to e^(−1/2), from that of neighbours at one or two pixels."""
    lag = 1 if axis == axis_of_least(factors) else 2
    first, second = (
        np.take(factors, range(*ends), axis) for ends in ((0, factors.shape[axis] - lag), (lag, factors.shape[axis]))
    )
    return lag / np.sqrt(-2 * np.log((first * second).mean() / (factors**2).mean()))


def axis_of_least(factors: np.ndarray) -> int:
    """The axis of a photograph along which neighbours have least in common."""
    return 1 + int(
        np.argmin([(factors[:, 1:] * factors[:, :-1]).mean(), (factors[:, :, 1:] * factors[:, :, :-1]).mean()])
    )


@pytest.mark.parametrize("contrast", [0.05, 0.4, 1.0])
def test_factors_are_right_at_every_contrast(contrast: float) -> None:
    factors = speckle(np.random.default_rng(0), (700, 900), contrast, (1.5, 4.0))[None] - 1
    assert factors.std() == pytest.approx(contrast, rel=0.03)
    for axis, lag, length in ((1, 1, 1.5), (2, 4, 4.0)):
        n = factors.shape[axis]
        product = np.take(factors, range(n - lag), axis) * np.take(factors, range(lag, n), axis)
        assert lag / np.sqrt(-2 * np.log(product.mean() / factors.var())) == pytest.approx(length, rel=0.04)


def test_a_lamp_has_its_colour(rig: Rig, plate: Scene) -> None:
    tungsten = (1.0, 0.75, 0.45)
    image = render(rig, plate, lighting=Lighting(ambient=90.0, ambient_colour=tungsten), sensor=LENS).astype(float)
    np.testing.assert_allclose(image.mean((0, 1)) / image[..., 0].mean(), tungsten, rtol=1e-3)


def test_a_ghost_is_turned_around_the_middle(rig: Rig, plate: Scene) -> None:
    lighting = Lighting(laser_power=400.0, speckle=0.2)
    plain, ghost = (
        render(rig, plate, laser=0, lighting=replace(lighting, ghost=part), sensor=LENS).astype(float)
        for part in (0.0, 0.35)
    )
    off = render(rig, plate, lighting=lighting, sensor=LENS)
    stripe = plain - off
    assert stripe.max() > 50 * 257
    np.testing.assert_allclose(ghost - plain, 0.35 * stripe[::-1, ::-1], atol=1.5)


def test_a_glossy_body_has_a_highlight_of_the_lamp(rig: Rig) -> None:
    """It is where the normal is halfway between lamp and camera, is burnt out, and has the lamp's colour around it."""
    centre, radius = np.array([4.0, -6.0, 300.0]), 45.0
    lighting = Lighting(highlight=1000.0, highlight_deg=6.0, ambient_colour=(1.0, 0.8, 0.5))
    matt, glossy = (
        render(
            rig,
            Scene((Body(Sphere(centre, radius), grey(0.6), glossy=shine),), DARK),
            lighting=lighting,
            sensor=Sensor(noise=0.0),
        ).astype(float)
        for shine in (False, True)
    )
    assert matt.max() < 100
    full = (glossy == 255).all(axis=2)
    assert 10 < full.sum() < 0.05 * (matt[..., 0] > 20).sum()
    to_lamp = np.asarray(lighting.direction) / np.linalg.norm(lighting.direction)
    normal = to_lamp
    for _ in range(30):
        point = centre + radius * normal
        normal = to_lamp - point / np.linalg.norm(point)
        normal /= np.linalg.norm(normal)
    with float64():
        expected = as_float64(rig.camera).project(jnp.asarray(centre + radius * normal))
    rows, columns = np.nonzero(full)
    np.testing.assert_allclose([columns.mean(), rows.mean()], expected, atol=0.5)
    added = (glossy - matt)[(glossy < 250).all(axis=2) & (glossy[..., 0] - matt[..., 0] > 30)]
    np.testing.assert_allclose(added.mean(axis=0) / added[:, 0].mean(), lighting.ambient_colour, rtol=0.03)
