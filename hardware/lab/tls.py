"""TLS, in a process of its own before the door: what comes encrypted goes on in the clear, through a pair of sockets.

The door has to read a request's header before anybody else does, and to hand the connection on with the header unread.
That needs plain bytes in a socket. So this process holds the keys, speaks TLS with the browser, and gives the door one
end of a pair of sockets with the browser's address; between the two it passes bytes on, as fast as the slower side
takes them.

A handshake is most of the work. Where many begin at the same moment, the addresses take turns. Of one address the
newest and the oldest take turns: in a flood most of those that come do not wait for it, and nobody waits for ever.

`python -m hardware.lab.tls`, started by `hardware.lab.doorway`; it ends when the server is gone.
"""

import contextlib
import gc
import json
import select
import signal
import socket
import ssl
import sys
import time
from collections import OrderedDict, deque
from pathlib import Path
from typing import Any, Final

from hardware.lab.gate import Gate, Listening
from hardware.lab.handing import Way
from hardware.lab.relay import Relay
from hardware.lab.throttle import network_of

# A browser that does not answer the end of TLS: its silence, and all of it. To end it while it still speaks is a reset,
# which takes from it what it has not read.
_FAREWELL_S, _FAREWELLS_S = 5.0, 30.0
_LATEST_S: Final = 1.0
# The first byte of every handshake.
_HANDSHAKE: Final = b"\x16"
_GONE: Final = select.EPOLLHUP | select.EPOLLERR


def context_of(cert: Path, key: Path) -> ssl.SSLContext:
    """What TLS needs to know.

    Args:
        cert: the certificate with its chain, PEM.
        key: its private key, PEM, without a password: nobody could type one.

    Raises:
        OSError: a file cannot be read, or (`ssl.SSLError`) the two do not go together.
    """
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(cert, key, password=lambda: "")
    return context


class Turns:
    """Connections that wait for their handshake: each address in turn, and of one the newest and the oldest in turn."""

    def __init__(self) -> None:
        self._waiting: OrderedDict[str, deque[socket.socket]] = OrderedDict()
        self._newest = False

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def add(self, line: socket.socket, network: str) -> None:
        """Let one wait, of this address."""
        self._waiting.setdefault(network, deque()).append(line)

    def take(self) -> socket.socket:
        """The next one; it waits no more.

        Raises:
            KeyError: nobody waits.
        """
        network, lines = self._waiting.popitem(last=False)
        self._newest = not self._newest
        line = lines.pop() if self._newest else lines.popleft()
        if lines:
            self._waiting[network] = lines
        return line


class Before:
    """Takes connections, speaks TLS with them and hands on what they say.

    Args:
        listening: where everybody comes; its gate says how many there may be.
        door: to the door.
        context: what TLS needs to know.
        head_s: within which a handshake has to be done.
    """

    def __init__(self, listening: Listening, door: socket.socket, context: ssl.SSLContext, head_s: float):
        self._listening, self._gate = listening, listening.gate
        self._context, self._head_s = context, head_s
        self._turns = Turns()
        # Those without a handshake, and those that are said farewell, with the time until they may stay: both in the
        # order in which they have to go. Of the latter, how long they may stay at most.
        self._young: dict[socket.socket, float] = {}
        self._leaving: dict[socket.socket, float] = {}
        self._latest: dict[socket.socket, float] = {}
        self._lines: dict[int, tuple[socket.socket, Any]] = {}
        # By the descriptors of both sides.
        self._relays: dict[int, Relay] = {}
        self._poll = select.epoll()
        listening.setblocking(False)
        self._poll.register(listening, select.EPOLLIN)
        self._way = Way(door, self._poll, self._handed)

    def serve(self) -> None:
        """Serve until the server is gone."""
        while True:
            arrived = False
            for number, event in self._poll.poll(self._wait_s()):
                if number == self._listening.fileno():
                    arrived = True
                elif number == self._way.fileno():
                    if event & _GONE:
                        return
                    self._way.go()
                elif (relay := self._relays.get(number)) is not None:
                    self._pass_on(relay, number, event)
                elif number in self._lines:
                    self._hear(*self._lines[number], event)
            if self._turns:
                self._begin(self._turns.take())
            if arrived:
                # After the others: a descriptor that is free again would be taken for one that this round is about.
                self._take()
            self._end_late()

    def _wait_s(self) -> float:
        if self._turns:
            return 0.0
        ends_s = [next(iter(some.values())) for some in (self._young, self._leaving) if some]
        return min([_LATEST_S, *(max(0.0, end_s - time.monotonic()) for end_s in ends_s)])

    def _take(self) -> None:
        for line, peer in self._gate.arrivals(self._listening):
            self._lines[line.fileno()] = line, peer
            self._young[line] = time.monotonic() + self._head_s
            self._poll.register(line, select.EPOLLIN)

    def _hear(self, line: socket.socket, peer: Any, event: int) -> None:
        """See how one begins that has not said anything, or whether one that leaves has gone."""
        try:
            said = line.recv(1, socket.MSG_PEEK) if line in self._young else line.recv(1 << 16)
        except BlockingIOError:
            if not event & _GONE:
                # What it said was passed on in this same round, before it was said farewell.
                return
            said = b""
        except OSError:
            said = b""
        if event & _GONE or not said or (line in self._young and said != _HANDSHAKE):
            self._end(line)
        elif line in self._young:
            # Ended meanwhile, it still says so.
            self._poll.modify(line, 0)
            self._turns.add(line, network_of(str(peer[0])))
        elif (until_s := time.monotonic() + _FAREWELL_S) <= self._latest[line]:
            # To the end of the order.
            del self._leaving[line]
            self._leaving[line] = until_s

    def _begin(self, line: socket.socket) -> None:
        """Begin the handshake of one whose turn it is."""
        if line in self._young:
            relay = self._relays[line.fileno()] = Relay(line, self._context, self._poll)
            self._pass_on(relay, line.fileno(), select.EPOLLIN)

    def _pass_on(self, relay: Relay, number: int, event: int) -> None:
        """Let one go on as far as it can."""
        line = relay.browser
        if event & _GONE and number == line.fileno():
            self._end(line)
            return
        try:
            if relay.server is None and relay.shake_hands():
                self._open(relay)
            if relay.server is not None:
                relay.pass_on()
            if relay.done:
                self._leave(relay)
            else:
                relay.watch()
        except OSError:
            self._end(line)

    def _open(self, relay: Relay) -> None:
        """Give the door its side."""
        line = relay.browser
        peer = self._lines[line.fileno()][1]
        del self._young[line]
        # From here on the door and the server say how long it may be silent.
        self._gate.note(peer, "answer")
        here, its = socket.socketpair()
        here.setblocking(False)
        relay.server = here
        self._relays[here.fileno()] = relay
        self._way.add(its, peer)

    @staticmethod
    def _handed(its: socket.socket, _: Any) -> None:
        """The door has it."""
        its.close()

    def _leave(self, relay: Relay) -> None:
        """All is said: wait for the browser's farewell; without it, what is on its way to it might be lost."""
        line = relay.browser
        self._forget(relay)
        line.shutdown(socket.SHUT_WR)
        self._gate.note(self._lines[line.fileno()][1], "rest")
        now_s = time.monotonic()
        self._leaving[line], self._latest[line] = now_s + _FAREWELL_S, now_s + _FAREWELLS_S
        self._poll.register(line, select.EPOLLIN)

    def _forget(self, relay: Relay) -> None:
        """Nothing more is passed on; the browser's side stays."""
        for side in relay.sides:
            del self._relays[side.fileno()]
        relay.close()

    def _end(self, line: socket.socket) -> None:
        """End a connection, whatever it was about."""
        number = line.fileno()
        if (relay := self._relays.get(number)) is not None:
            self._forget(relay)
        with contextlib.suppress(FileNotFoundError):
            self._poll.unregister(line)
        self._gate.left(self._lines.pop(number)[1])
        for some in (self._young, self._leaving, self._latest):
            some.pop(line, None)
        line.close()

    def _end_late(self) -> None:
        now_s = time.monotonic()
        for some in (self._young, self._leaving):
            while some and (line := next(iter(some))) and some[line] <= now_s:
                self._end(line)


def main() -> None:
    """Serve, with the sockets whose numbers were given."""
    for one in (signal.SIGINT, signal.SIGHUP):
        signal.signal(one, signal.SIG_IGN)
    how = json.loads(sys.argv[1])
    context = context_of(Path(how["cert"]), Path(how["key"]))
    bound, door = (socket.socket(fileno=number) for number in how["sockets"])
    gc.freeze()
    listening = Listening(bound, Gate(tuple(how["proxies"]), how["connections"]), tls=True)
    Before(listening, door, context, how["head_s"]).serve()


if __name__ == "__main__":
    main()
