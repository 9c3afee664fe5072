"""The simulated camera; the way from hardware to points is in `test_end_to_end`."""

import numpy as np
import pytest

from hardware import CameraDriver, LaserDriver, StageDriver
from hardware.simulated.camera import SimulatedCamera, SimulatedWorld
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Travel
from jaxscan.cli.compiled import keep_compiled
from jaxscan.simulation import render, rig_2003
from jaxscan.simulation.shapes import cup


@pytest.fixture(scope="module")
def world() -> SimulatedWorld:
    keep_compiled()
    return SimulatedWorld(1, cup(rig_2003.OBJECT_Y))


def scanner(world: SimulatedWorld) -> tuple[SimulatedCamera, SimulatedStage, SimulatedLaser]:
    stage, laser = SimulatedStage(Travel(last=80000, backlash=900), play=900), SimulatedLaser()
    return SimulatedCamera(world, {"stage": stage}, laser), stage, laser


def test_the_camera_sees_where_the_stage_truly_is(world: SimulatedWorld) -> None:
    """With 900 steps of play, at a place that was come to from above."""
    camera, stage, laser = scanner(world)
    assert isinstance(camera, CameraDriver)
    assert isinstance(stage, StageDriver)
    assert isinstance(laser, LaserDriver)
    stage.home()
    stage.move_to(30000)
    assert stage.true_position() == 30000
    stage.line.send(b"29000g")
    stage.line.clock.sleep(5)
    assert stage.true_position() == 29900
    laser.on()
    image = camera.expose({"stage": 29000}).image
    assert np.array_equal(camera.expose({"stage": 29000}).image, image)

    def off(steps: float) -> float:
        clean = render(world.rig, world.scene, steps=steps, laser=0, lighting=world.lighting, sensor=rig_2003.SENSOR)
        return float(np.abs(image.astype(float) - clean).mean())

    assert off(29900) < 0.95 * off(29000)
    laser.off()
    dark = camera.expose({"stage": 29000}).image.astype(int)
    assert (dark[..., 0] - dark[..., 1]).max() < 60
