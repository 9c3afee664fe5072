"""The server's side of the door: the process that takes connections, and what it hands on.

Where connections cannot be handed from process to process (no Linux), or where TLS is spoken, which hides the request
until the server has read it, there is no door, and the server takes them itself.
"""

import errno
import json
import logging
import os
import select
import socket
import subprocess
import threading
from typing import Any, Final

from hardware.lab.gate import Gate, Listening
from hardware.lab.processes import begin

_LOG: Final = logging.getLogger(__name__)
_AGAIN_S, _ENDED_S = 0.5, 5.0


def can_be() -> bool:
    """Whether this system can have a door."""
    return hasattr(select, "epoll") and hasattr(socket, "send_fds")


class HandedOn(Listening):
    """Connections that the door hands on, as if they came here.

    Args:
        end: this side of the pair of sockets through which they come.
        gate: of this side.
    """

    def __init__(self, end: socket.socket, gate: Gate):
        super().__init__(end, gate, tls=False)

    def listen(self, backlog: int = 0) -> None:
        """The door does."""

    def take(self) -> tuple[socket.socket, Any]:
        """The next one."""
        said, numbers, _, _ = socket.recv_fds(self, 1, 1)
        if not said:
            raise BlockingIOError
        if not numbers:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        line = socket.socket(fileno=numbers[0])
        try:
            return line, line.getpeername()
        except OSError as error:
            # It has gone on its way here.
            line.close()
            raise ConnectionAbortedError from error

    def turn_away(self) -> None:
        """The system has: what there was no descriptor for is closed."""


class Doorway:
    """The door's process, begun again if it ends, until it is closed.

    Args:
        listening: where everybody comes.
        crowd, urgent: the gates of the two loops.
        head_s: within which a header has to be whole.
        proxies, connections: as in `hardware.lab.server.Server`.

    Attributes:
        crowd, urgent: what is handed on to each of the two.
    """

    def __init__(
        self,
        listening: socket.socket,
        crowd: Gate,
        urgent: Gate,
        head_s: float,
        proxies: tuple[str, ...],
        connections: int | None,
        backlog: int,
    ):
        listening.listen(backlog)
        here, its = zip(*(socket.socketpair() for _ in range(2)), strict=True)
        self.crowd, self.urgent = HandedOn(here[0], crowd), HandedOn(here[1], urgent)
        self._sockets = (listening, *its)
        numbers = [one.fileno() for one in self._sockets]
        how = {"sockets": numbers, "head_s": head_s, "proxies": proxies, "connections": connections}
        self._how, self._numbers = json.dumps(how), numbers
        self._closed = threading.Event()
        self.child = self._begin()
        self._thread = threading.Thread(target=self._watch, name="door", daemon=True)
        self._thread.start()

    def shut(self) -> None:
        """Let nobody come any more."""
        self._closed.set()
        self.child.terminate()

    def close(self) -> None:
        """End it, and what is left of it here."""
        self.shut()
        self._thread.join(_ENDED_S)
        for one in (*self._sockets, self.crowd, self.urgent):
            one.close()

    def _begin(self) -> "subprocess.Popen[bytes]":
        return begin("hardware.lab.door", self._how, pass_fds=self._numbers, stdin=subprocess.DEVNULL)

    def _watch(self) -> None:
        while True:
            status = self.child.wait()
            if self._closed.wait(_AGAIN_S):
                return
            _LOG.warning("the process that takes connections ended (%d) and is begun again", status)
            self.child = self._begin()
            if self._closed.is_set():
                self.child.terminate()
