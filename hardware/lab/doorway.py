"""The server's side of the door: the processes that take connections, and what they hand on.

Without TLS there is one, the door. With TLS of the server's own there is another before it, which holds the keys.
Where connections cannot be handed from process to process (no Linux) there is no door: the server takes them itself.
"""

import json
import logging
import socket
import subprocess
import threading
from pathlib import Path
from typing import Any, Final

from hardware.lab.gate import Gate
from hardware.lab.handing import HandedOn
from hardware.lab.processes import begin

_LOG: Final = logging.getLogger(__name__)
_AGAIN_S, _ENDED_S = 0.5, 5.0
# What speaks TLS has a connection for each one at the door and each one that the server answers, and some that come;
# and two descriptors for each.
_BEFORE: Final = 2.5


class _Child:
    """A process, begun again if it ends, until it is told to.

    Args:
        module: what it runs.
        sockets: that it has, by the name `sockets` in what it is told.
        how: what else it is told.
    """

    def __init__(self, module: str, sockets: tuple[socket.socket, ...], how: dict[str, Any]):
        self._module, self._numbers = module, [one.fileno() for one in sockets]
        self._how = json.dumps({"sockets": self._numbers, **how})
        self._closed = threading.Event()
        self.process = self._begin()
        self._thread = threading.Thread(target=self._watch, name=module, daemon=True)
        self._thread.start()

    def shut(self) -> None:
        """End it."""
        self._closed.set()
        self.process.terminate()

    def join(self) -> None:
        """Wait until it has ended."""
        self._thread.join(_ENDED_S)

    def _begin(self) -> "subprocess.Popen[bytes]":
        return begin(self._module, self._how, pass_fds=self._numbers, stdin=subprocess.DEVNULL)

    def _watch(self) -> None:
        while True:
            status = self.process.wait()
            if self._closed.wait(_AGAIN_S):
                return
            _LOG.warning("the process %s, which takes connections, ended (%d) and is begun again", self._module, status)
            self.process = self._begin()
            if self._closed.is_set():
                self.process.terminate()


class Doorway:
    """The processes that take connections, until it is closed.

    Args:
        listening: where everybody comes.
        crowd, urgent: the gates of the two loops.
        head_s: within which a header, and before it TLS's first words, have to be whole.
        proxies, connections: as in `hardware.lab.server.Server`.
        backlog: connections that the system keeps until they are taken.
        tls: certificate and key, where TLS is spoken.

    Attributes:
        crowd, urgent: what is handed on to each of the two.
        children: the processes, the one that browsers reach last.
    """

    def __init__(
        self,
        listening: socket.socket,
        crowd: Gate,
        urgent: Gate,
        head_s: float,
        proxies: tuple[str, ...],
        connections: int,
        backlog: int,
        tls: tuple[Path, Path] | None = None,
    ):
        listening.listen(backlog)
        here, its = zip(*(socket.socketpair() for _ in range(2)), strict=True)
        self.crowd, self.urgent = HandedOn(here[0], crowd), HandedOn(here[1], urgent)
        self._sockets = [listening, *its]
        how = {"head_s": head_s, "proxies": proxies}
        at_door = {**how, "connections": connections, "handed_on": tls is not None}
        if tls is None:
            self.children = [_Child("hardware.lab.door", (listening, *its), at_door)]
        else:
            come, before = socket.socketpair()
            self._sockets += [come, before]
            files = {name: str(path.resolve()) for name, path in zip(("cert", "key"), tls, strict=True)}
            at_tls = {**how, **files, "connections": int(_BEFORE * connections)}
            self.children = [
                _Child("hardware.lab.door", (come, *its), at_door),
                _Child("hardware.lab.tls", (listening, before), at_tls),
            ]

    def shut(self) -> None:
        """Let nobody come any more."""
        for child in reversed(self.children):
            child.shut()

    def close(self) -> None:
        """End it, and what is left of it here."""
        self.shut()
        for child in self.children:
            child.join()
        for one in (*self._sockets, self.crowd, self.urgent):
            one.close()
