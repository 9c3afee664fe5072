"""Connections: how many there may be, and which has to go when there is no room for another.

Somebody who has not asked for anything yet, or has been answered, makes room for whoever comes: so 2000 sockets that
say nothing keep nobody out, and no connection is refused as long as one such is left.
"""

import contextlib
import errno
import logging
import os
import socket
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal

from hardware.lab.throttle import network_of

try:
    import resource
except ImportError:  # not on Windows, which has no such limit
    resource = None

_LOG: Final = logging.getLogger(__name__)
# Connections in all, and of them from one address: a class behind one router has two streams for each of 300.
_MOST, _SHARE = 1000, 0.8
# Descriptors that connections leave to files, devices and the database.
_SPARE: Final = 256
# Descriptors that a connection takes at most, where another process speaks TLS for it.
_HIDDEN: Final = 5
_SAID_S: Final = 60.0
# Connections that are accepted before any is read.
_IN_A_ROW: Final = 16
_NO_MORE: Final = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
TIMED_OUT: Final = b"HTTP/1.1 408 Request Timeout\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
_FULL: Final = b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 5\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


def raise_limit() -> None:
    """Let this process have as many descriptors as it may."""
    if resource is None:
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _HIDDEN * _MOST + _SPARE
    if hard != resource.RLIM_INFINITY:
        wanted = min(wanted, hard)
    if soft < wanted:
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def room(hidden: bool = False) -> int:
    """Connections for which this process, and each that begins in it, has descriptors; 1000 at most.

    Args:
        hidden: another process speaks TLS for them.
    """
    if resource is None:
        return _MOST
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return max(16, min(_MOST, (soft - _SPARE) // (_HIDDEN if hidden else 1)))


# Whether a connection waits for a request that has begun or never came, rests after an answer, or is being answered.
Phase = Literal["head", "rest", "answer"]


@dataclass
class _Line:
    line: socket.socket
    network: str
    phase: Phase = "head"


class Gate:
    """All connections of a server.

    Args:
        proxies: addresses of proxies, from which everybody may come.
        most: connections; as many as the descriptors allow, up to 1000.
    """

    def __init__(self, proxies: tuple[str, ...] = (), most: int | None = None):
        self.most = most or room()
        self._each = max(8, int(self.most * _SHARE))
        self._proxies = {network_of(proxy) for proxy in proxies}
        # By the other side's address and port, the longest here first.
        self._lines: dict[Any, _Line] = {}
        self._counts: Counter[str] = Counter()
        self._said_s = -_SAID_S
        self._spare = os.open(os.devnull, os.O_RDONLY)

    def __len__(self) -> int:
        return len(self._lines)

    def accept(self, listening: "Listening") -> tuple[socket.socket, Any]:
        """The next connection, with room made for it.

        Raises:
            OSError: there is none, or no room: to be asked again.
        """
        try:
            line, peer = listening.take()
        except OSError as error:
            if error.errno in _NO_MORE:
                self._turn_away(listening, error)
                raise ConnectionAbortedError from error
            raise
        network = network_of(str(peer[0]))
        if not self._room(network):
            with contextlib.suppress(OSError):
                if not listening.tls:
                    line.setblocking(False)
                    line.send(_FULL)
            line.close()
            self._say("%d connections are busy: no more are taken", len(self._lines))
            raise ConnectionAbortedError
        # One that ended unheard may have come from the same port before.
        self.left(peer)
        self._lines[peer] = _Line(line, network)
        self._counts[network] += 1
        return line, peer

    def arrivals(self, listening: "Listening") -> Iterator[tuple[socket.socket, Any]]:
        """Those that have come, not blocking: some of them, before those that are here are looked at."""
        for _ in range(_IN_A_ROW):
            try:
                line, peer = self.accept(listening)
            except ConnectionAbortedError:
                continue
            except OSError:
                return
            line.setblocking(False)
            yield line, peer

    def note(self, peer: Any, phase: Phase) -> None:
        """Note what a connection does now."""
        if (line := self._lines.get(peer)) is not None:
            line.phase = phase

    def left(self, peer: Any) -> None:
        """A connection has ended."""
        if (one := self._lines.pop(peer, None)) is not None:
            self._counts[one.network] -= 1
            if not self._counts[one.network]:
                del self._counts[one.network]

    def close(self) -> None:
        """End."""
        os.close(self._spare)

    def _room(self, network: str) -> bool:
        """Whether there is room for another, made if need be."""
        if network not in self._proxies and self._counts[network] >= self._each:
            return self._drop(network)
        return len(self._lines) < self.most or self._drop(network) or self._drop(None)

    def _drop(self, network: str | None) -> bool:
        """End the oldest connection, of a network or of all, that owes a request; then one that rests."""
        for phase in ("head", "rest"):
            for peer, one in self._lines.items():
                if one.phase == phase and network in (None, one.network):
                    # Some have ended before anything was read on them, as in the middle of TLS's first words.
                    self.left(peer)
                    with contextlib.suppress(OSError):
                        one.line.shutdown(socket.SHUT_RDWR)
                    return True
        return False

    def _turn_away(self, listening: "Listening", error: OSError) -> None:
        """Take a connection by the descriptor that is kept for this, and end it: else it would be offered for ever."""
        self._say("no descriptors are left (%s): connections are turned away", error)
        self._drop(None)
        os.close(self._spare)
        listening.turn_away()
        with contextlib.suppress(OSError):
            self._spare = os.open(os.devnull, os.O_RDONLY)

    def _say(self, words: str, *values: object) -> None:
        if time.monotonic() - self._said_s > _SAID_S:
            self._said_s = time.monotonic()
            _LOG.warning(words, *values)


class Listening(socket.socket):
    """A socket that listens, behind a gate.

    Args:
        bound: the socket, which this one replaces.
        gate: through which everybody comes.
        tls: whether TLS is spoken.
    """

    def __init__(self, bound: socket.socket, gate: Gate, tls: bool):
        super().__init__(bound.family, bound.type, bound.proto, bound.detach())
        self.gate, self.tls = gate, tls
        self._in_a_row = 0

    def take(self) -> tuple[socket.socket, Any]:
        """The next connection that the system has.

        Raises:
            OSError: there is none.
        """
        return super().accept()

    def turn_away(self) -> None:
        """End the next connection unheard."""
        with contextlib.suppress(OSError):
            self.take()[0].close()

    def accept(self) -> tuple[socket.socket, Any]:
        """The next connection.

        Raises:
            BlockingIOError: there is none, or the loop should first read what the last ones say: a crowd that came
                together would else be the end of one among them before a word of it was read.
        """
        self._in_a_row += 1
        if self._in_a_row > _IN_A_ROW:
            self._in_a_row = 0
            raise BlockingIOError
        return self.gate.accept(self)
