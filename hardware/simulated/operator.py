"""Who holds the board of the simulated scanner."""

from collections.abc import Callable

from hardware.coverage import ON_STAGE, ON_TURNTABLE
from hardware.guide import Sight
from hardware.protocols import CameraDriver
from hardware.simulated.camera import SimulatedCamera, SimulatedWorld


class SimulatedOperator:
    """Holds the board in one pose of the simulated session after the other, and fixes it on an axis when asked."""

    def __init__(self, world: SimulatedWorld, views: int, say: Callable[[str], object] = lambda words: None):
        self._world, self._views, self._say = world, views, say
        self._next = 0

    def ready(self, wish: str, look: Callable[[], object] = lambda: None) -> bool:
        """Do it."""
        self._say(wish)
        if wish == ON_STAGE:
            self._world.put_board()
        elif wish == ON_TURNTABLE:
            self._world.lean_board()
        else:
            self._world.hold_board(self._next % self._views, self._views)
            self._next += 1
        return True

    def show(self, sight: Sight) -> None:
        """It need not look."""

    def say(self, words: str) -> None:
        """Pass it on."""
        self._say(words)

    def leave(self) -> None:
        """Take the board away, and put the object back."""
        self._world.put_object()


def simulated_operator(
    camera: CameraDriver, views: int, say: Callable[[str], object] = lambda words: None
) -> SimulatedOperator | None:
    """Who holds the board before the simulated camera; nobody before a real one."""
    return SimulatedOperator(camera.world, views, say) if isinstance(camera, SimulatedCamera) else None
