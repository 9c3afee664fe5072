"""What a scan asks of a camera, a stage and a laser. Anything with these methods will do; nothing has to inherit.

Every call returns within a time that follows from what was asked, or raises a `hardware.errors.HardwareError`; one that
ran out of time is a `TimeoutError` too. `StageDriver.stop` may be called from another thread, at any time.
"""

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

if TYPE_CHECKING:
    from hardware.frame import Frame

# Names until 0.1, which are those of other things in jaxscan.
_RENAMED: Final = {"Camera": "CameraDriver", "Stage": "StageDriver", "Laser": "LaserDriver"}


@runtime_checkable
class CameraDriver(Protocol):
    """Takes photographs."""

    def open(self) -> None:
        """Connect; after it `expose` works."""
        ...

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Set exposure time and gain for the photographs to come."""
        ...

    def expose(self, positions: Mapping[str, int]) -> "Frame":
        """Take one photograph, with the axes at these positions: motor steps by the axis's name, as far as known."""
        ...

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        ...


@runtime_checkable
class StageDriver(Protocol):
    """One axis: moves something along a line, or turns it, in motor steps."""

    def home(self) -> None:
        """Drive to the reference switch and call that place 0."""
        ...

    def move_to(self, step_count: int) -> None:
        """Go there and return when it stands still there: arrived, by its own report."""
        ...

    def position(self) -> int:
        """The step count that the controller reports, read again each time."""
        ...

    def check(self) -> None:
        """See that the controller answers; nothing moves, and no count is lost."""
        ...

    def settle(self, seconds: float) -> None:
        """Let the load come to rest, for so long in the stage's own time."""
        ...

    def stop(self) -> None:
        """Stand still as soon as the line carries the order; from any thread."""
        ...

    def close(self) -> None:
        """Disconnect; safe to call twice."""
        ...


@runtime_checkable
class Verifiable(Protocol):
    """An axis that can find out whether its motor has lost steps."""

    @property
    def verifiable(self) -> bool:
        """Whether it can: it has a switch, and its controller says at which count it was met."""
        ...

    def verify(self) -> int:
        """Meet the switch again, slowly, and count from it again: by how many steps the count was off."""
        ...

    def home(self) -> None:
        """Count from the switch again."""
        ...


@runtime_checkable
class LaserDriver(Protocol):
    """A sheet of light that may be switched."""

    @property
    def switchable(self) -> bool:
        """Whether `on` and `off` do anything; a laser that is always on says no."""
        ...

    def on(self) -> None:
        """Switch it on."""
        ...

    def off(self) -> None:
        """Switch it off."""
        ...


def renamed(name: str, module: str) -> Any:
    """What had that name in a module, with a warning.

    Raises:
        AttributeError: nothing had.
    """
    if name not in _RENAMED:
        raise AttributeError(f"module '{module}' has no attribute '{name}'")
    new = _RENAMED[name]
    warnings.warn(
        f"{module}.{name} is now {module}.{new}; the old name goes with the next version",
        DeprecationWarning,
        stacklevel=3,
    )
    return globals()[new]


def __getattr__(name: str) -> Any:
    return renamed(name, __name__)
