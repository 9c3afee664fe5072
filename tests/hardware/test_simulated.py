"""The simulated camera; the way from hardware to points is in `test_end_to_end`."""

from pathlib import Path

import numpy as np
import pytest

from hardware import CameraDriver, LaserDriver, StageDriver
from hardware.lab.gallery import Gallery
from hardware.lab.hub import Hub
from hardware.simulated.camera import SimulatedCamera, SimulatedWorld
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Travel
from jaxscan import RigFile
from jaxscan.cli.compiled import keep_compiled
from jaxscan.images import StripeSettings
from jaxscan.simulation import Scene, distance, render, rig_2003
from jaxscan.simulation.shapes import cup

# Where the sheet passes under the turntable's axis.
TURNED_AT = 37000


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
        clean = render(
            world.rig, world.scene, q={"stage": steps}, laser=0, lighting=world.lighting, sensor=rig_2003.SENSOR
        )
        return float(np.abs(image.astype(float) - clean).mean())

    assert off(29900) < 0.95 * off(29000)
    laser.off()
    dark = camera.expose({"stage": 29000}).image.astype(int)
    assert (dark[..., 0] - dark[..., 1]).max() < 60


def test_the_object_turns_with_the_table_and_comes_back_in_the_cloud(world: SimulatedWorld) -> None:
    """The stripe's points, turned back from where the table has turned them, lie on the object as it stands at 0."""
    axes = {"stage": SimulatedStage(Travel(last=80000)), "turntable": SimulatedStage(Travel(last=3200))}
    laser = SimulatedLaser()
    camera = SimulatedCamera(world, axes, laser)
    laser.on()
    for axis in axes.values():
        axis.home()
    axes["stage"].move_to(TURNED_AT)
    gallery = Gallery(Hub(), StripeSettings(), RigFile(world.rig))
    R, origin = rig_2003.platform(world.rig)
    images, clouds = [], []
    for turn in (0, 800):
        axes["turntable"].move_to(turn)
        frame = camera.expose({"stage": TURNED_AT, "turntable": turn})
        images.append(frame.image.astype(float))
        gallery._clear("cup")
        gallery._measure(frame.image, Path("0000.png"), dict(frame.positions), 0)
        points = np.frombuffer(gallery.cloud(), "<f4").reshape(-1, 3).astype(float)
        # The platform does not turn; only the object counts, some way above it.
        clouds.append(points[((points - origin) @ R)[:, 2] > 5])
    gallery.close()
    assert np.abs(images[0] - images[1]).mean() > 0.5
    bodies = tuple(body for body in world.scene.bodies[:-1])
    for cloud in clouds:
        assert len(cloud) > 50
        assert np.sqrt((distance(Scene(bodies), cloud) ** 2).mean()) < 0.3
    # A quarter of a turn: the two profiles stand at right angles about the axis.
    flat = [((cloud - origin) @ R)[:, :2] - (0.0, rig_2003.OBJECT_Y) for cloud in clouds]
    spread = [np.linalg.svd(at - at.mean(axis=0))[2][0] for at in flat]
    assert abs(spread[0] @ spread[1]) < 0.3


def test_the_same_view_has_the_same_noise_with_a_turntable_at_0_as_without(world: SimulatedWorld) -> None:
    stage, table, laser = SimulatedStage(Travel(last=80000)), SimulatedStage(Travel(last=3200)), SimulatedLaser()
    for axis in (stage, table):
        axis.home()
    with_table = SimulatedCamera(world, {"stage": stage, "turntable": table}, laser).expose({})
    assert np.array_equal(with_table.image, SimulatedCamera(world, {"stage": stage}, laser).expose({}).image)
