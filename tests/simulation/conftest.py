"""Small rigs and helpers for the tests of the simulator."""

import numpy as np
import pytest

from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, LightPlane, Linear, Rig
from jaxscan.simulation.light import Lighting, Sensor

OMEGA = np.array([0.0, -0.00494, 0.00303])


def small_rig(k1: float = 0.0) -> Rig:
    """A quarter of the rig of 2003 in each direction, 160 × 120 pixels."""
    with float64():
        camera = Camera.create((160, 120), np.array([174.4, 172.6]), np.array([77.6, 57.0]), "radial1", np.array([k1]))
        stage = Linear.create(np.array([0.00003, 0.00092, -0.00039]))
        return as_numpy(Rig(camera, (LightPlane.create(OMEGA),), stage))


@pytest.fixture(scope="session")
def rig() -> Rig:
    return small_rig()


@pytest.fixture(scope="session")
def lens_rig() -> Rig:
    return small_rig(-0.3)


@pytest.fixture(scope="session")
def plain_light() -> Lighting:
    """Nothing but ambient light: a white body has 200 grey levels, everywhere."""
    return Lighting(ambient=200.0, directional=0.0)


@pytest.fixture(scope="session")
def exact() -> Sensor:
    """No blur, no noise, and levels to 1/257."""
    return Sensor(blur_px=0.0, noise=0.0, bits=16)
