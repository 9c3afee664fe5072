"""The live picture: a photograph now and then while nobody has ordered anything else."""

import logging
import threading
from collections.abc import Callable
from typing import Final

from hardware.errors import HardwareError
from hardware.lab.bench import Bench
from hardware.lab.gallery import Gallery
from hardware.lab.lock import OperatorLock
from hardware.safety import safely
from jaxscan.errors import JaxscanError

_LOG: Final = logging.getLogger(__name__)


class Preview:
    """Photographs at rest, for as long as its operator is there.

    Attributes:
        on: whether it is switched on.
        laser: whether the laser shines in it.

    Args:
        bench: the devices.
        lock: without a holder it goes off.
        gallery: where it is shown.
        busy: whether a job is under way, which has photographs of its own.
        every_s: time between two.
    """

    def __init__(
        self, bench: Bench, lock: OperatorLock, gallery: Gallery, busy: Callable[[], bool], every_s: float
    ) -> None:
        self._bench, self._lock, self._gallery, self._busy, self._every_s = bench, lock, gallery, busy, every_s
        self.on = self.laser = False
        self._changed, self._closed = threading.Event(), False
        self._thread = threading.Thread(target=self._work, name="live picture", daemon=True)
        self._thread.start()

    def switch(self, on: bool, laser: bool) -> None:
        """Switch it on or off, with or without the laser."""
        self.on, self.laser = on, on and laser
        self._changed.set()

    def close(self) -> None:
        """End."""
        self._closed = True
        self.switch(False, False)
        self._thread.join()

    def _work(self) -> None:
        while not self._closed:
            # A switch that is thrown is seen to at once, and otherwise the next picture waits its time.
            self._changed.wait(self._every_s if self.on else None)
            self._changed.clear()
            if not self.on or self._busy() or self._lock.holder is None:
                continue
            try:
                with self._bench.devices() as devices, safely({}, devices.laser):
                    if self.laser:
                        devices.laser.on()
                    self._gallery.show(devices.camera.expose(dict(self._bench.places)))
            except (HardwareError, JaxscanError) as error:
                _LOG.warning("the live picture ends: %s", error)
                self.switch(False, False)
            except Exception:  # noqa: BLE001 (said in the log; the thread goes on)
                _LOG.exception("the live picture ends")
                self.switch(False, False)
