"""Stop, in a thread that does nothing else.

It waits for no request, no queue of other work, no database, and no lock but those that are held for a few assignments.
"""

import queue
import threading
from concurrent.futures import Future
from typing import Final

from hardware.lab.badges import Visitor
from hardware.lab.worker import Worker

_MOMENT_S: Final = 0.5


class Emergency:
    """Carries out Stop.

    Args:
        worker: whose job ends.
    """

    def __init__(self, worker: Worker):
        self._worker = worker
        self._done = threading.Event()
        self._done.set()
        self._orders: queue.SimpleQueue[tuple[str, Future[str]] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="stop", daemon=True)
        self._thread.start()

    def order(self, visitor: Visitor) -> Future[str]:
        """Stand still and switch the laser off, at once; the future says in words what could not be.

        Orders that come while one is carried out are carried out together after it.

        Raises:
            Refusal: the visitor neither operates nor is an administrator.
        """
        self._worker.may_stop(visitor)
        future: Future[str] = Future()
        self._done.clear()
        self._orders.put((visitor.name, future))
        return future

    def give_way(self) -> None:
        """Wait, for a moment at most, while a Stop is carried out: for threads that take turns with it."""
        self._done.wait(_MOMENT_S)

    def close(self) -> None:
        """End."""
        self._orders.put(None)
        self._thread.join()

    def _work(self) -> None:
        while (first := self._orders.get()) is not None:
            orders = [first]
            while not self._orders.empty():
                if (more := self._orders.get()) is None:
                    self._orders.put(None)
                    break
                orders.append(more)
            try:
                words = self._worker.stop(first[0])
            except Exception as error:  # noqa: BLE001 (the thread goes on, whatever is broken)
                for _, future in orders:
                    future.set_exception(error)
            else:
                for _, future in orders:
                    future.set_result(words)
            # One that is ordered just now is found next, and gives way to nobody for that moment.
            self._done.set()
