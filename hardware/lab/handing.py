"""Connections that one process of the server hands to another, each with the address of its other side.

The descriptor travels beside a message (SCM_RIGHTS), and the message says who is there: behind TLS the descriptor is
one end of a pair of sockets, which has no address of its own.
"""

import errno
import json
import os
import select
import socket
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
