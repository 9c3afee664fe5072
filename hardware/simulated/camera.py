"""The simulated camera, and the world that it photographs."""

import time
from collections.abc import Sequence

import numpy as np

from hardware.frame import Frame
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from jaxscan.simulation import Body, Scene, Sensor, render, rig_2003

# The exposure at which a photograph of the simulated rig is neither dark nor burnt out.
_EXPOSURE_S = 0.01
# Makes step counts positive.
_FAR = 1 << 31


class SimulatedWorld:
    """What stands before the scanner: an object on the stage, the board in somebody's hand, or the board on the stage.

    Attributes:
        rig: the true one.
        seed: of the rig, the poses and the noise.
        scene: what is seen, as it stands at step 0.
        lighting: what lights it.
        view: numbers that tell this view from the others, for the seed of the noise.
    """

    def __init__(self, seed: int = 0, bodies: Sequence[Body] = ()):
        self.seed = seed
        self.rig = rig_2003.simulated_rig(seed)
        self._bodies = tuple(bodies)
        self._stage_pose = rig_2003.stage_pose(self.rig, seed)
        self.put_object()

    def put_object(self) -> None:
        """Put the object on the stage."""
        self.scene, self.lighting = rig_2003.scan_scene(self.rig, self._bodies), rig_2003.SCAN_LIGHTING
        self.view = (0, 0)

    def hold_board(self, pose: int, of: int = rig_2003.BOARD_VIEWS) -> None:
        """Hold the board in one of so many poses."""
        boards = rig_2003.board_poses(self.rig, self.seed, of)
        still = rig_2003.board_scene(np.asarray(boards.rotation[pose]), np.asarray(boards.translation[pose]))
        bodies = tuple(Body(body.shape, body.albedo, on_stage=False) for body in still.bodies)
        self.scene, self.lighting = Scene(bodies), rig_2003.BOARD_LIGHTING
        self.view = (1, pose)

    def put_board(self) -> None:
        """Fix the board on the stage."""
        pose = self._stage_pose
        self.scene = rig_2003.board_scene(np.asarray(pose.rotation), np.asarray(pose.translation))
        self.lighting = rig_2003.BOARD_LIGHTING
        self.view = (2, 0)


class SimulatedCamera:
    """Photographs the world as the stage *truly* stands.

    One and the same view is one and the same photograph, noise and all, whenever it is taken. `world` may be changed
    between photographs.
    """

    def __init__(self, world: SimulatedWorld, stage: SimulatedStage, laser: SimulatedLaser):
        self.world, self._stage, self._laser = world, stage, laser
        self._exposure_s, self._gain = _EXPOSURE_S, 1.0

    def open(self) -> None:
        """It is."""

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Set exposure and gain; light counts in proportion to both."""
        self._exposure_s, self._gain = exposure_s, gain

    def expose(self, step_count: int) -> Frame:
        """Render one photograph."""
        world, place = self.world, self._stage.true_position()
        sensor = rig_2003.SENSOR
        brightness = self._gain * self._exposure_s / _EXPOSURE_S
        image = render(
            world.rig,
            world.scene,
            steps=place,
            laser=0 if self._laser.lit else None,
            lighting=world.lighting,
            sensor=Sensor(blur_px=sensor.blur_px, noise=sensor.noise, gain=brightness),
            seed=(2003, world.seed, *world.view, round(place) + _FAR, int(self._laser.lit)),
        )
        return Frame(image, step_count, time.time(), self._exposure_s)

    def close(self) -> None:
        """Nothing to do."""
