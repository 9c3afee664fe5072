"""The guide of a calibration session, on the page: it asks, shows what the camera sees, and waits for the operator."""

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from pydantic import BaseModel

from hardware.coverage import ON_STAGE, ON_TURNTABLE
from hardware.places import STAGE, TURNTABLE

if TYPE_CHECKING:
    from hardware.guide import Sight
    from hardware.simulated.operator import SimulatedOperator

# Between two live pictures.
_EVERY_S: Final = 0.1


class Guide(BaseModel):
    """What everybody sees of a calibration session under way.

    Attributes:
        wish: what to do with the board now; "" while photographs are taken.
        on_axis: the axis on which the board belongs now, stage or turntable; "" while it is held in a hand.
        board_seen: whether the board was found in the last photograph.
        covered: the cells of the image, row by row, that have held a corner of the board.
        tilted: the edges of the board that have been towards the camera.
        views: poses of the board that have been taken.
    """

    wish: str = ""
    on_axis: str = ""
    board_seen: bool = False
    covered: list[list[bool]] = []
    tilted: dict[str, bool] = {}
    views: int = 0


class PageOperator:
    """Whoever holds the board, and says from a browser when it is held.

    Args:
        permit: raises what ends the session.
        shown: called with every photograph.
        said: called with words, and with how many photographs there are.
        hand: who holds the board before a simulated camera.
    """

    def __init__(
        self,
        permit: Callable[[], object],
        shown: "Callable[[Sight], object]",
        said: Callable[[str, int], object],
        hand: "SimulatedOperator | None" = None,
    ):
        self.guide = Guide()
        self._permit, self._shown, self._said, self._hand = permit, shown, said, hand
        self._mutex = threading.Condition()
        self._waiting, self._answer = False, None
        self._taken = 0

    def answer(self, go: bool) -> bool:
        """Say that the board is held as asked, or (not `go`) held often enough; False where nothing is asked."""
        with self._mutex:
            if not self._waiting:
                return False
            self._waiting, self._answer = False, go
            self._mutex.notify()
            return True

    def ready(self, wish: str, look: Callable[[], object]) -> bool:
        """Ask, and look until there is an answer."""
        if self._hand is not None:
            self._hand.ready(wish)
        with self._mutex:
            self._waiting, self._answer = True, None
        self._tell(wish=wish, on_axis={ON_STAGE: STAGE, ON_TURNTABLE: TURNTABLE}.get(wish, ""))
        try:
            while True:
                self._permit()
                look()
                with self._mutex:
                    if self._mutex.wait_for(lambda: self._answer is not None, _EVERY_S):
                        return bool(self._answer)
        finally:
            self._waiting = False
            self._tell(wish="")

    def show(self, sight: "Sight") -> None:
        """Show a photograph."""
        self._permit()
        session = sight.session
        views = len(session.views.boards)
        self._taken = views + sum(session.counts.values())
        self._tell(
            board_seen=sight.corners is not None, covered=sight.covered.tolist(), tilted=sight.tilted, views=views
        )
        self._shown(sight)

    def say(self, words: str) -> None:
        """Tell what became of it."""
        self._said(words, self._taken)

    def _tell(self, **values: object) -> None:
        self.guide = self.guide.model_copy(update=values)
