"""A scan: move, settle, photograph, write; every frame is on the disk before the next move.

A scan may be paused, aborted, killed or unplugged at any moment: what it has reported as taken is there and whole, and
`take` goes on from it.
"""

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from hardware.errors import HardwareError, LineLostError, PositionUncertainError, StoppedError
from hardware.frame import Frame, in_words
from hardware.protocols import CameraDriver, LaserDriver, StageDriver, Verifiable
from hardware.safety import safely
from hardware.scan_plan import ScanFolder
from jaxscan.errors import InputError
from jaxscan.files.place_checks import PlaceCheck

# A switch is met again within this number of steps.
_MEETS_AGAIN = 4


class Devices(NamedTuple):
    """What a scanner consists of; its axes by their names, as {"stage": …, "turntable": …}."""

    camera: CameraDriver
    axes: Mapping[str, StageDriver]
    laser: LaserDriver

    def close(self) -> None:
        """Disconnect the camera and all axes."""
        self.camera.close()
        for axis in self.axes.values():
            axis.close()


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
        """End after the frame that is being taken; to end a move under way, stop the axes as well."""
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
            raise StoppedError("the scan was aborted; what it has taken is kept, --resume continues from there")


def take(
    folder: ScanFolder,
    devices: Devices,
    control: Control | None = None,
    taken: Callable[[Path, Frame], object] = lambda path, frame: None,
    *,
    verify: int | None = None,
) -> list[str]:
    """Take the frames that are left, in order.

    Args:
        folder: of a new scan, or of one to continue.
        devices: open; an axis of the scan that has no reference is homed first.
        control: for another thread to pause or end it.
        taken: called with each frame's file once it is durable.
        verify: after how many frames the axes that can are to meet their switches again, and at the end; 0 for at the
            end alone, None for never. What was found is written into `scan.toml`; frames that were to be verified and
            were not are marked there too.

    Returns:
        Why some frames were not verified, where that was asked for and a bad line forbade it.

    Raises:
        PositionUncertainError: a switch was met at another count than before; the frames since are marked.
        HardwareError: a device failed; the laser is off and all axes stand, or the text says that they may not.
        InUseError: another process takes frames into the folder.
        InputError: the disk, an axis that the scanner does not have, or a laser that cannot be switched though frames
            with it off were asked for.
    """
    plan, control = folder.plan, control or Control()
    camera, axes, laser = devices
    verified = verifiable(axes, plan.axes) if verify is not None else {}
    if lacking := [name for name in plan.axes if name not in axes]:
        raise InputError(
            f"{folder.done.path.parent}: the scan moves the axis {lacking[0]}, and this scanner has "
            f"{', '.join(axes) or 'none'}: use the scanner that has it"
        )
    if plan.dark and not laser.switchable:
        raise InputError("frames with the laser off were asked for, but this laser is always on: leave out --dark")
    unverified: list[str] = []
    if not folder.left:
        return unverified
    with folder.held(), _marking(folder, bool(verified)), safely(axes, laser):
        if plan.exposure_s is not None:
            camera.configure(plan.exposure_s, plan.gain)
        ensure_homed({name: axes[name] for name in plan.axes})
        unchecked = len(folder.done.frames)
        for place in folder.left:
            if control.paused:
                laser.off()
            control.wait()
            for name, step in place.items():
                axes[name].move_to(step)
            # The time in which it comes to rest is the same for all; the last was the last to move.
            axes[list(place)[-1]].settle(plan.settle_s)
            dark = None
            if plan.dark:
                laser.off()
                dark = camera.expose(place)
            laser.on()
            frame = camera.expose(place)
            if (found := {name: axes[name].position() for name in place}) != place:
                raise PositionUncertainError(f"sent to {in_words(place)}, the scanner is at {in_words(found)}: home it")
            taken(folder.add(frame, dark), frame)
            count = len(folder.done.frames)
            if verified and (not folder.left or (verify and count - unchecked >= verify)):
                laser.off()
                unverified += _check_places(folder, verified, unchecked)
                unchecked = count
    return unverified


def verifiable(axes: Mapping[str, StageDriver], names: Iterable[str]) -> dict[str, Verifiable]:
    """Those of some axes that can find out whether they have lost steps."""
    asked = {name: axis for name, axis in axes.items() if name in names}
    return {name: axis for name, axis in asked.items() if isinstance(axis, Verifiable) and axis.verifiable}


@contextmanager
def _marking(folder: ScanFolder, verified: bool) -> Iterator[None]:
    """Where frames are verified, mark those that were taken before, and those that the block leaves, unverified."""
    if not verified:
        yield
        return
    _mark(folder)
    try:
        yield
    finally:
        with suppress(InputError):
            _mark(folder)


def _mark(folder: ScanFolder) -> None:
    """Mark the frames that no check covers."""
    told = max((check.last + 1 for check in folder.done.checks), default=0)
    if told < len(folder.done.frames):
        folder.check(PlaceCheck(told, len(folder.done.frames) - 1, unverified=True))


def _check_places(folder: ScanFolder, axes: Mapping[str, Verifiable], first: int) -> list[str]:
    """Let the axes meet their switches again, and write down what that shows of the frames from one on.

    Where a bad line spoils it, nothing is shown, and the axis counts again from its next homing: why.
    """
    last = len(folder.done.frames) - 1
    lost, spoilt = lost_steps(axes)
    if spoilt:
        folder.check(PlaceCheck(first, last, unverified=True))
        return [f"frames {first} to {last} are not verified: {spoilt}"]
    folder.check(PlaceCheck(first, last, lost))
    if lost:
        words = " and ".join(f"the {name} by {abs(steps)} steps" for name, steps in lost.items())
        raise PositionUncertainError(
            f"steps were lost, {words}: frames {first} to {last} are marked in {folder.done.path}; set a lower "
            "rate_steps_s or ramp_steps_s2, look that nothing is in the way, and take the scan again"
        )
    return []


def lost_steps(axes: Mapping[str, Verifiable]) -> tuple[dict[str, int], str]:
    """Let axes meet their switches again: by how many steps those were off that lost some.

    Where a bad line spoils it, nothing is shown, the axis counts again from its next homing, and it is said why.

    Raises:
        LineLostError: the line is gone.
        StoppedError: somebody called `stop`.
    """
    off = {}
    for name, axis in axes.items():
        try:
            off[name] = axis.verify()
        except (LineLostError, StoppedError):
            raise
        except HardwareError as error:
            axis.home()
            return {}, str(error)
    return {name: steps for name, steps in off.items() if abs(steps) > _MEETS_AGAIN}, ""


def ensure_homed(axes: Mapping[str, StageDriver]) -> None:
    """Home each axis that has no reference, or a doubtful one."""
    for axis in axes.values():
        try:
            axis.position()
        except HardwareError:
            axis.home()
