"""Connections before they cost anything: a process of its own takes them and reads their first header.

What asks for Stop, or says that the operator is there, is handed to one event loop of the server, everything else to
the other; what never says a whole header is ended here. So a crowd at the door holds up neither the interpreter that
stops the scanner nor its turn at it. A connection is handed on unread: what it said was looked at, and left in the
system's buffer.

`python -m hardware.lab.door`, started by `hardware.lab.doorway`; it ends when the server is gone.
"""

import contextlib
import json
import re
import select
import signal
import socket
import sys
import time
from typing import Any, Final, NamedTuple

from hardware.lab.gate import TIMED_OUT, Gate, Listening
from hardware.lab.handing import HandedOn, Way, hand
from hardware.lab.limits import STRANGER, Limits
from hardware.lab.refusal import Refusal
from hardware.lab.throttle import network_of

# A longer header is no Stop's: whoever reads it says what is wrong with it.
_HEAD: Final = 8192
_WHOLE: Final = re.compile(rb"\r?\n\r?\n")
_FIRST: Final = re.compile(rb"[A-Z]{1,16}(?: [^\r\n]*)?(?:\r?\n|\r?$)")
_URGENT: Final = re.compile(rb"(?:POST /api/stop|PUT /api/lock)(?:\?[^ \r\n]*)? HTTP/1\.[01]\r?\n")
_FORWARDED: Final = re.compile(rb"(?i)\r?\nX-Forwarded-For:([^\r\n]*)")
_LATEST_S: Final = 1.0


class _Caller(NamedTuple):
    line: socket.socket
    peer: Any
    until_s: float


class Door:
    """Takes, reads and hands on.

    Args:
        listening: where everybody comes; its gate says how many there may be.
        crowd, urgent: to the server's two loops.
        head_s: within which a header has to be whole.
        proxies: addresses of proxies, which say whose requests they bring.
    """

    def __init__(
        self, listening: Listening, crowd: socket.socket, urgent: socket.socket, head_s: float, proxies: tuple[str, ...]
    ):
        self._listening, self._gate = listening, listening.gate
        self._urgent = urgent
        self._head_s = head_s
        self._proxies = {network_of(proxy) for proxy in proxies}
        self._limits = Limits()
        # The longest here first.
        self._callers: dict[int, _Caller] = {}
        self._poll = select.epoll()
        for one in (listening, urgent):
            one.setblocking(False)
        self._poll.register(listening, select.EPOLLIN)
        self._crowd = Way(crowd, self._poll, self._end)
        # Of this one only that the server is gone.
        self._poll.register(urgent, 0)

    def serve(self) -> None:
        """Serve until the server is gone."""
        ends = {self._crowd.fileno(), self._urgent.fileno()}
        while True:
            wait_s = _LATEST_S
            if self._callers:
                wait_s = min(wait_s, max(0.0, next(iter(self._callers.values())).until_s - time.monotonic()))
            for number, event in self._poll.poll(wait_s):
                if number == self._listening.fileno():
                    self._take()
                elif number in ends:
                    if event & (select.EPOLLHUP | select.EPOLLERR):
                        return
                    self._crowd.go()
                elif number in self._callers:
                    self._look(number, event)
            self._end_late()

    def _take(self) -> None:
        for line, peer in self._gate.arrivals(self._listening):
            number = line.fileno()
            self._callers[number] = _Caller(line, peer, time.monotonic() + self._head_s)
            # Once for everything that comes: what is left unread would be said again and again.
            self._poll.register(number, select.EPOLLIN | select.EPOLLRDHUP | select.EPOLLET)

    def _look(self, number: int, event: int) -> None:
        """See what a connection has said so far."""
        caller, said = self._callers[number], b""
        with contextlib.suppress(OSError):
            said = caller.line.recv(_HEAD, socket.MSG_PEEK)
        if event & (select.EPOLLHUP | select.EPOLLERR):
            # Ended by its other side, or by the gate for another's sake; what it said is there still.
            self._forget(caller)
            self._end(caller.line, caller.peer)
        elif said and (_WHOLE.search(said) or len(said) == _HEAD or not _FIRST.match(said)):
            self._forget(caller)
            if _URGENT.match(said) and _WHOLE.search(said) and self._urgently(caller, said):
                return
            self._gate.note(caller.peer, "answer")
            self._crowd.add(caller.line, caller.peer)
        elif event & select.EPOLLRDHUP:
            # Nothing more will come.
            self._forget(caller)
            self._end(caller.line, caller.peer)

    def _urgently(self, caller: _Caller, said: bytes) -> bool:
        """Hand on what asks for Stop; False where its address has asked for too much of that, or the way is full."""
        try:
            with self._limits.request(self._whose(caller, said), STRANGER, stays=True):
                pass
            hand(self._urgent, caller.line, caller.peer)
        except (Refusal, OSError):
            return False
        self._end(caller.line, caller.peer)
        return True

    def _whose(self, caller: _Caller, said: bytes) -> str:
        """The address that a request comes from: the last that a proxy names which is none."""
        network = network_of(str(caller.peer[0]))
        if network not in self._proxies:
            return network
        named = b",".join(_FORWARDED.findall(said)).decode("latin-1").split(",")
        others = [other for name in named if (other := network_of(name.strip())) not in self._proxies]
        return others[-1] if others else network

    def _end_late(self) -> None:
        now_s = time.monotonic()
        while self._callers and (caller := next(iter(self._callers.values()))).until_s <= now_s:
            self._forget(caller)
            with contextlib.suppress(OSError):
                caller.line.send(TIMED_OUT)
            with contextlib.suppress(OSError):
                caller.line.shutdown(socket.SHUT_RDWR)
            self._end(caller.line, caller.peer)

    def _forget(self, caller: _Caller) -> None:
        del self._callers[caller.line.fileno()]
        self._poll.unregister(caller.line)

    def _end(self, line: socket.socket, peer: Any) -> None:
        """Close it here; whoever has been given it keeps it."""
        self._gate.left(peer)
        line.close()


def main() -> None:
    """Serve, with the sockets whose numbers were given."""
    # The server says when it ends; Ctrl-C in its terminal is its own affair.
    for one in (signal.SIGINT, signal.SIGHUP):
        signal.signal(one, signal.SIG_IGN)
    how = json.loads(sys.argv[1])
    listening, crowd, urgent = (socket.socket(fileno=number) for number in how["sockets"])
    proxies = tuple(how["proxies"])
    gate = Gate(proxies, how["connections"])
    come = HandedOn(listening, gate) if how["handed_on"] else Listening(listening, gate, tls=False)
    Door(come, crowd, urgent, how["head_s"], proxies).serve()


if __name__ == "__main__":
    main()
