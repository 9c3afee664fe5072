"""What every stage at the end of a serial line does alike: one order at a time, checked before and after, and `stop`.

The controller's count is trusted only as far as it has been checked since the reference switch was found. Whatever
contradicts it ends in `PositionUncertainError`, and then only homing helps.
"""

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

from hardware.errors import (
    HardwareError,
    LineLostError,
    NoAnswerError,
    NotHomedError,
    PositionUncertainError,
    SettingsError,
    StoppedError,
)
from hardware.stages.line import Line
from hardware.stages.travel_settings import HERE, Travel

_HOMINGS = 3
# By so much slower is the switch met when it is to be seen whether steps were lost: a motor that lost steps on its way
# up would lose as many on its way down, and the count would be right.
_SLOWER = 4
# How long `stop` waits for the thread that moves to notice.
_NOTICE_S = 5.0
_SLICE_S = 0.1


class SerialStage(ABC):
    """An axis driven over a serial line.

    Args:
        port: a port, or any URL that pyserial opens.
        travel: the axis's way and pace.
        baud: of the line.
        homed: take it that the controller has kept its count since it was last homed.
        beside: another axis of the same controller, whose line it shares: they take their orders one at a time, and
            whatever stops one stops both.

    Raises:
        SettingsError: the port cannot be opened.
    """

    def __init__(
        self,
        port: str,
        travel: Travel | None = None,
        *,
        baud: int,
        homed: bool = False,
        beside: "SerialStage | None" = None,
    ):
        self.travel = travel or Travel()
        self._take_over = homed
        self._believed: int | None = None
        if beside is None:
            self.line = Line(port, baud)
            self._busy, self._stops = threading.RLock(), threading.Lock()
            self._stopping = threading.Event()
            self._axes: list[SerialStage] = []
        else:
            self.line, self._axes = beside.line, beside._axes
            self._busy, self._stops, self._stopping = beside._busy, beside._stops, beside._stopping
        self._axes.append(self)

    @property
    def name(self) -> str:
        """Which it is, in errors: the port."""
        return self.line.name

    def home(self) -> None:
        """Find the reference switch, count from it, and go to step 0 (or `travel.first`).

        An axis without a switch (`travel.reference` is "here") does not move: where it stands is step 0.

        Raises:
            HardwareError: the switch was not found, or the line is too bad; the text says whether the stage stands.
        """
        with self._order():
            self._believed = None
            if self.travel.reference == HERE:
                self._call_zero()
                self._believed = 0
                return
            self._find_and_leave_switch()

    def move_to(self, step_count: int) -> None:
        """Go there, from below, and return when the controller has twice reported that it stands there.

        Raises:
            HardwareError: it did not arrive, or may not be where it says; the text says whether it stands.
        """
        self.travel.check([step_count])
        with self._order():
            self._check_place()
            self._go(step_count)

    def position(self) -> int:
        """The step count that the controller reports, twice.

        Raises:
            HardwareError: it does not answer, or has another count than that to which it was sent.
        """
        with self._order(halting=False):
            return self._check_place()

    def check(self) -> None:
        """See that the controller answers; nothing moves, and no count is lost.

        Raises:
            NoAnswerError: it does not, or the motor turns.
        """
        with self._order(halting=False):
            if not self._standing():
                raise NoAnswerError(
                    f"{self.name}: nothing that says that the motor stands: check that it is on, cable and baud "
                    "rate; `scanner console` shows what it says"
                )

    @property
    def verifiable(self) -> bool:
        """Whether `verify` works here."""
        return False

    def verify(self) -> int:
        """Meet the switch again, slowly, and count from it again; the axis then stands where `home` leaves it.

        Returns:
            By how many steps the count was off: above 0, the load was nearer to the switch than the count had it.

        Raises:
            SettingsError: the axis has no switch, or its controller does not say at which count it met it.
            HardwareError: as `home`.
        """
        if not self.verifiable:
            raise SettingsError(
                f"{self.name}: cannot be verified: it has no switch, or its controller does not say where it met it"
            )
        with self._order():
            self._check_place()
            self._believed = None
            off = self._switch_met_at() - self.travel.switch
            self._find_and_leave_switch()
            return off

    def settle(self, seconds: float) -> None:
        """Let the load come to rest.

        Raises:
            StoppedError: somebody called `stop`.
        """
        with self._busy:
            self._pause(seconds)

    def stop(self) -> None:
        """Stand still, and be homed before the next move, with all axes of the controller; from any thread.

        Raises:
            LineLostError: the line does not carry the order, or the controller does not say that it stands.
        """
        # One at a time: whoever looks whether it stands must not take another's order to stop for its own.
        with self._stops:
            self._stopping.set()
            with suppress(LineLostError):
                self._halt()
            # Whoever moves sees the flag within a slice of time and lets go.
            if not self._busy.acquire(timeout=_NOTICE_S):
                raise LineLostError(f"{self.name}: {_MAY_MOVE}")
            try:
                for axis in self._axes:
                    axis._believed, axis._take_over = None, False
                self._stopping.clear()
                if any(axis._make_stand() == _MAY_MOVE for axis in self._axes):
                    raise LineLostError(f"{self.name}: the order to stop was given, but {_MAY_MOVE}")
            finally:
                self._busy.release()

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        self.line.close()

    def _find_and_leave_switch(self) -> None:
        """Home, again where the line garbles it."""
        for attempt in range(_HOMINGS):
            try:
                self._find_switch()
                self._believed = self.travel.switch
                self._go(max(0, self.travel.first))
                return
            except (LineLostError, StoppedError):
                raise
            except HardwareError:
                self._believed = None
                if attempt == _HOMINGS - 1:
                    raise
                self._halt()
                self._standing()

    def _check_place(self) -> int:
        """The position, if the controller agrees with the one that is trusted."""
        if self._believed is None and self._take_over:
            self._believed = self._settled()
        if self._believed is None:
            raise NotHomedError(f"{self.name}: it has no reference yet: home it (`scanner home`)")
        count = self._settled()
        if count != self._believed:
            raise PositionUncertainError(
                f"{self.name}: the controller says {count} steps, but it was left at {self._believed}: it was "
                "reset, moved by hand or another program, or a byte of the line was garbled: home it"
            )
        return count

    def _go(self, target: int) -> None:
        """The legs to a place; `_believed` is there or None at any time."""
        start = self._believed
        if start is None:
            raise NotHomedError(f"{self.name}: home it")
        for end in self.travel.legs(start, target):
            self._believed = None
            self._leg(start, end)
            self._believed = start = end

    def _pause(self, seconds: float) -> None:
        """Let time pass, in slices.

        Raises:
            StoppedError: somebody called `stop`.
        """
        clock = self.line.clock
        until_s = clock.now_s() + seconds
        while (left_s := until_s - clock.now_s()) > 0:
            self._check_stop()
            clock.sleep(min(left_s, _SLICE_S))
        self._check_stop()

    def _check_stop(self) -> None:
        if self._stopping.is_set():
            raise StoppedError(f"{self.name}: stopped; home it before it moves again")

    @contextmanager
    def _order(self, halting: bool = True) -> Iterator[None]:
        """One order at a time; when it fails the stage is halted, and the error says whether it stands."""
        with self._busy:
            try:
                yield
            except (SettingsError, NotHomedError, StoppedError):
                raise
            except HardwareError as error:
                self._believed, self._take_over = None, False
                if not halting:
                    raise
                raise type(error)(f"{error}; {self._make_stand()}") from error
            except BaseException:
                self._believed, self._take_over = None, False
                self._make_stand()
                raise

    def _make_stand(self) -> str:
        """Halt, and say in words whether it stands."""
        try:
            self._halt()
            standing = self._standing()
        except HardwareError:
            standing = False
        return "the stage stands still" if standing else _MAY_MOVE

    @abstractmethod
    def _call_zero(self) -> None:
        """Count from where it stands: that is step 0."""

    @abstractmethod
    def _find_switch(self) -> None:
        """Leave the stage standing on its switch, with a count of `travel.switch` there."""

    @property
    def _slow(self) -> Travel:
        """Way and pace when the switch is met to see whether steps were lost."""
        return replace(self.travel, rate_steps_s=max(self.travel.rate_steps_s / _SLOWER, 1.0))

    def _switch_met_at(self) -> int:
        """Drive slowly against the switch: the count where homing would leave the axis, by what was counted so far."""
        raise NotImplementedError

    @abstractmethod
    def _leg(self, start: int, end: int) -> None:
        """Go from one place, where it stands, straight to another, at least an approach away."""

    @abstractmethod
    def _settled(self) -> int:
        """The count at rest, read twice."""

    @abstractmethod
    def _halt(self) -> None:
        """Send the order to stand still, no matter who else is sending."""

    @abstractmethod
    def _standing(self) -> bool:
        """Whether the controller shows that the motor stands."""


_MAY_MOVE = "whether the stage stands is not known, it MAY STILL BE MOVING: switch its motor supply off if in doubt"
