"""The simulated camera, and the world that it photographs."""

import time
from collections.abc import Mapping, Sequence

import numpy as np

from hardware.frame import Frame
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from jaxscan.simulation import Body, Scene, Sensor, render, rig_2003

# The exposure at which a photograph of the simulated rig is neither dark nor burnt out.
_EXPOSURE_S = 0.01
# The views of the object and of the board on the turntable, which both turn with it.
_OBJECT, _ON_TURNTABLE = (0, 0), (3, 0)
_AXES = ("stage", "turntable")
# Makes step counts positive.
_FAR = 1 << 31


class SimulatedWorld:
    """What stands before the scanner: an object, the board in somebody's hand, or the board on stage or turntable.

    The object stands on the turntable, and that on the stage.

    Attributes:
        rig: the true one.
        seed: of the rig, the poses and the noise.
        scene: what is seen, as it stands at step 0 of every axis.
        lighting: what lights it.
        view: numbers that identify this view, for the seed of the noise.
    """

    def __init__(self, seed: int = 0, bodies: Sequence[Body] = ()):
        self.seed = seed
        self.rig = rig_2003.with_turntable(rig_2003.simulated_rig(seed), seed)
        self._bodies = tuple(bodies)
        self._stage_pose = rig_2003.stage_pose(self.rig, seed)
        self.put_object()

    def put_object(self) -> None:
        """Put the object on the turntable."""
        self.scene, self.lighting = rig_2003.scan_scene(self.rig, self._bodies), rig_2003.SCAN_LIGHTING
        self.view = _OBJECT

    def hold_board(self, pose: int, of: int = rig_2003.BOARD_VIEWS) -> None:
        """Hold the board in pose number `pose` of `of`."""
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

    def lean_board(self) -> None:
        """Lean the board against something on the turntable."""
        pose = rig_2003.turntable_pose(self.rig, self.seed)
        self.scene = rig_2003.board_scene(np.asarray(pose.rotation), np.asarray(pose.translation))
        self.lighting = rig_2003.BOARD_LIGHTING
        self.view = _ON_TURNTABLE


class SimulatedCamera:
    """Photographs the world as stage and turntable *truly* stand.

    One and the same view is one and the same photograph, noise and all, whenever it is taken. `world` may be changed
    between photographs. An axis that there is none of stands at step 0.
    """

    def __init__(self, world: SimulatedWorld, axes: Mapping[str, SimulatedStage], laser: SimulatedLaser):
        self.world, self._axes, self._laser = world, axes, laser
        self._exposure_s, self._gain = _EXPOSURE_S, 1.0

    def open(self) -> None:
        """It is."""

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Set exposure and gain; light counts in proportion to both."""
        self._exposure_s, self._gain = exposure_s, gain

    def expose(self, positions: Mapping[str, int]) -> Frame:
        """Render one photograph."""
        world = self.world
        place, turn = (self._axes[name].true_position() if name in self._axes else 0.0 for name in _AXES)
        sensor = rig_2003.SENSOR
        brightness = self._gain * self._exposure_s / _EXPOSURE_S
        image = render(
            world.rig,
            world.scene,
            q={"stage": place, "turntable": turn if world.view in (_OBJECT, _ON_TURNTABLE) else 0.0},
            laser=0 if self._laser.lit else None,
            lighting=world.lighting,
            sensor=Sensor(blur_px=sensor.blur_px, noise=sensor.noise, gain=brightness),
            # A table that stands at 0 leaves the noise as it is on a scanner without one.
            seed=(
                2003,
                world.seed,
                *world.view,
                round(place) + _FAR,
                int(self._laser.lit),
                *([round(turn) + _FAR] if turn else []),
            ),
        )
        return Frame(image, positions, time.time(), self._exposure_s)

    def close(self) -> None:
        """Nothing to do."""
