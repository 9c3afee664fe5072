"""Connections that one process of the server hands to another, each with the address of its other side.

The descriptor travels beside a message (SCM_RIGHTS), and the message says who is there: behind TLS the descriptor is
one end of a pair of sockets, which has no address of its own.
"""

import errno
import json
import os
import select
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from hardware.lab.gate import Gate, Listening

# Bytes of a message, filled up with blanks: one that carries a descriptor is read by itself, however many wait.
_MESSAGE: Final = 128


def can_be() -> bool:
    """Whether processes of this system can hand connections to each other as `hardware.lab.door` needs it."""
    return hasattr(select, "epoll") and hasattr(socket, "send_fds")


def hand(end: socket.socket, line: socket.socket, peer: Any) -> None:
    """Hand a connection on; the caller still has it, and closes it.

    Args:
        end: of the pair, to whoever takes it.
        line: the connection.
        peer: the address of its other side.

    Raises:
        OSError: the way is full (BlockingIOError), or nobody is there any more.
    """
    socket.send_fds(end, [json.dumps(peer).encode().ljust(_MESSAGE)], [line.fileno()])


class Way:
    """To another process: connections for which there is no room wait.

    Args:
        end: of the pair, to whoever takes them.
        poll: that watches it. Whoever asks the poll calls `go` when it can be written to; it is told, too, when nobody
            is there any more.
        handed: called with each connection and its address once it is on its way.
    """

    def __init__(self, end: socket.socket, poll: "select.epoll", handed: Callable[[socket.socket, Any], None]):
        self._end, self._poll, self._handed = end, poll, handed
        self._waiting: deque[tuple[socket.socket, Any]] = deque()
        end.setblocking(False)
        poll.register(end, 0)

    def fileno(self) -> int:
        """The descriptor that the poll names."""
        return self._end.fileno()

    def add(self, line: socket.socket, peer: Any) -> None:
        """Hand this one on, after those that wait."""
        self._waiting.append((line, peer))
        self.go()

    def go(self) -> None:
        """Hand on, as far as the other side keeps up."""
        while self._waiting:
            line, peer = self._waiting[0]
            try:
                hand(self._end, line, peer)
            except OSError as error:
                if error.errno == errno.ETOOMANYREFS:
                    time.sleep(0.001)
                self._poll.modify(self._end, select.EPOLLOUT)
                return
            self._waiting.popleft()
            self._handed(line, peer)
        self._poll.modify(self._end, 0)


class HandedOn(Listening):
    """Connections that another process hands on, as if they came here.

    Args:
        end: this side of the pair of sockets through which they come.
        gate: of this side.
    """

    def __init__(self, end: socket.socket, gate: Gate):
        super().__init__(end, gate, tls=False)

    def listen(self, backlog: int = 0) -> None:
        """The first process does."""

    def take(self) -> tuple[socket.socket, Any]:
        """The next one."""
        said, numbers, _, _ = socket.recv_fds(self, _MESSAGE, 1)
        if not said:
            raise BlockingIOError
        if not numbers:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return socket.socket(fileno=numbers[0]), tuple(json.loads(said))

    def turn_away(self) -> None:
        """The system has: what there was no descriptor for is closed."""
