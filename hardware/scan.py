"""A scan: move, settle, photograph, write; every frame is on the disk before the next move.

A scan may be paused, aborted, killed or unplugged at any moment: what it has reported as taken is there and whole, and
`take` goes on from it.
"""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from hardware.errors import HardwareError, PositionUncertainError, StoppedError
from hardware.frame import Frame
from hardware.protocols import CameraDriver, LaserDriver, StageDriver
from hardware.safety import safely
from hardware.scan_plan import ScanFolder
from jaxscan.errors import InputError


class Devices(NamedTuple):
    """What a scanner consists of."""

    camera: CameraDriver
    stage: StageDriver
    laser: LaserDriver


class Control:
    """Pauses and ends a scan from another thread."""

    def __init__(self) -> None:
        self._going = threading.Event()
        self._going.set()
        self._aborted = threading.Event()

    def pause(self) -> None:
        """Stand still after the frame that is being taken, with the laser off."""
        self._going.clear()

    def resume(self) -> None:
        """Go on."""
        self._going.set()

    def abort(self) -> None:
        """End after the frame that is being taken; to end a move under way, stop the stage as well."""
        self._aborted.set()
        self._going.set()

    @property
    def paused(self) -> bool:
        """Whether it is to stand."""
        return not self._going.is_set()

    def wait(self) -> None:
        """Return when the scan may go on.

        Raises:
            StoppedError: it is not to.
        """
        self._going.wait()
        if self._aborted.is_set():
            raise StoppedError("the scan was aborted; what it has taken is kept, --resume goes on from there")


def take(
    folder: ScanFolder,
    devices: Devices,
    control: Control | None = None,
    taken: Callable[[Path, Frame], object] = lambda path, frame: None,
) -> None:
    """Take the frames that are left, in order.

    Args:
        folder: of a new scan, or of one to go on with.
        devices: open; the stage is homed first where it has no reference.
        control: for another thread to pause or end it.
        taken: called with each frame's file once it is durable.

    Raises:
        HardwareError: a device failed; the laser is off and the stage stands, or the text says that they may not.
        InputError: the disk, or a laser that cannot be switched though frames with it off were asked for.
    """
    plan, control = folder.plan, control or Control()
    camera, stage, laser = devices
    if plan.dark and not laser.switchable:
        raise InputError("frames with the laser off were asked for, but this laser is always on: leave out --dark")
    if not folder.left:
        return
    with safely(stage, laser):
        if plan.exposure_s is not None:
            camera.configure(plan.exposure_s, plan.gain)
        ensure_homed(stage)
        for step in folder.left:
            if control.paused:
                laser.off()
            control.wait()
            stage.move_to(step)
            stage.settle(plan.settle_s)
            dark = None
            if plan.dark:
                laser.off()
                dark = camera.expose(step)
            laser.on()
            frame = camera.expose(step)
            if (place := stage.position()) != step:
                raise PositionUncertainError(f"the stage was sent to {step} steps and stands at {place}: home it")
            taken(folder.add(frame, dark), frame)


def ensure_homed(stage: StageDriver) -> None:
    """Home a stage that has no reference, or a doubtful one."""
    try:
        stage.position()
    except HardwareError:
        stage.home()
