"""Where the lab listens: on this machine alone, unless told otherwise, and elsewhere over TLS."""

import asyncio
import contextlib
import ipaddress
import logging
import socket
import ssl
import sys
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

import uvicorn

from hardware.lab.app import make_app
from hardware.lab.doorway import Doorway
from hardware.lab.front import own_names
from hardware.lab.gate import Gate, Listening, room
from hardware.lab.handing import can_be
from hardware.lab.lab import Lab
from hardware.lab.long_lived import set_aside
from hardware.lab.protocol import HEAD_S, Seldom, protocol_of
from hardware.lab.tls import context_of
from jaxscan.errors import InputError

_GRACE_S: Final = 3
# Connections that the system keeps until they are accepted.
_BACKLOG: Final = 2048
_TURN_S: Final = 0.001
_SELDOM: Final = Seldom()


def bind(host: str, port: int, tls: bool, insecure: bool) -> socket.socket:
    """A socket that listens.

    Raises:
        InputError: the host is not this machine alone and there is no TLS, or it cannot be bound.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except (OSError, UnicodeError) as error:
        raise InputError(f"--host {host}: is no address of this machine: give 127.0.0.1, or one that it has") from error
    if not (tls or insecure or ipaddress.ip_address(str(address[0]).split("%")[0]).is_loopback):
        raise InputError(
            f"--host {host}: others could read passwords on the way: give --cert and --key, or stay on 127.0.0.1 "
            "behind a proxy that has TLS, or say --insecure for a network where nobody else listens"
        )
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
    except OSError as error:
        listening.close()
        raise InputError(f"--host {host} --port {port}: cannot be bound ({error.strerror}): take another port") from (
            error
        )
    return listening


def check_tls(cert: Path | None, key: Path | None) -> bool:
    """Whether there is TLS.

    Raises:
        InputError: one of certificate and key is missing, or they do not go together.
    """
    if cert is None and key is None:
        return False
    if cert is None or key is None:
        raise InputError("--cert and --key: TLS needs both, a certificate and its private key, in PEM files")
    try:
        context_of(cert, key)
    except (OSError, ssl.SSLError) as error:
        raise InputError(
            f"{cert}, {key}: are no certificate with its private key ({error}); a key may have no password"
        ) from error
    return True


class Server(uvicorn.Server):
    """Uvicorn, which ends the watchers' streams when it ends.

    Behind a door, what asks for Stop and what says that the operator is there have a loop and a thread of their own,
    and every answer ends its connection: so whatever is asked next comes by the door again.

    Args:
        lab: what is served.
        listening: where.
        cert, key: for TLS.
        ready: called once with the URL when requests are answered.
        proxies: addresses of proxies, which say whose requests they bring, and that those came over TLS.
        names: by which browsers know this server, beside those of this machine and all addresses.
        connections: at a time; as many as the descriptors allow, up to 1000.
        deadlines: of a connection's phases, as `hardware.lab.protocol` has them.
    """

    def __init__(
        self,
        lab: Lab,
        listening: socket.socket,
        cert: Path | None = None,
        key: Path | None = None,
        ready: Callable[[str], object] = lambda url: None,
        proxies: tuple[str, ...] = (),
        names: tuple[str, ...] = (),
        connections: int | None = None,
        **deadlines: float,
    ):
        doorway = can_be()
        tls = None if cert is None or key is None else (cert, key)
        hidden = doorway and tls is not None
        connections = connections or room(hidden)
        how: dict[str, Any] = {
            "app": make_app(lab, own_names(names)),
            "ws": "none",
            "log_level": "warning",
            "access_log": False,
            "server_header": False,
            "proxy_headers": bool(proxies),
            "forwarded_allow_ips": list(proxies),
            "backlog": _BACKLOG,
            "timeout_graceful_shutdown": _GRACE_S,
            "ssl_certfile": None if doorway else cert,
            "ssl_keyfile": None if doorway else key,
            "headers": [("Connection", "close")] if doorway else [],
        }
        gate, first = Gate(proxies, connections), Gate(proxies, connections)
        give_way = lab.emergency.give_way if doorway else None
        spoken = "https" if hidden else None
        super().__init__(uvicorn.Config(http=protocol_of(gate, give_way, spoken, **deadlines), **how))
        self._lab, self._listening, self._ready, self._gates = lab, listening, ready, (gate, first)
        self._how_listened = gate, first, deadlines.get("head_s", HEAD_S), proxies, connections, _BACKLOG, tls
        self._doorway: Doorway | None = None
        self._first = None
        if doorway:
            self._first = uvicorn.Server(
                uvicorn.Config(http=protocol_of(first, None, spoken, **deadlines), **{**how, "lifespan": "off"})
            )
        logging.getLogger("uvicorn.error").addFilter(_SELDOM)
        host, port = listening.getsockname()[:2]
        self.url = f"http{'s' if cert else ''}://{f'[{host}]' if ':' in host else host}:{port}/"

    def serve_here(self) -> None:
        """Serve until told to end."""
        # Threads that compile hold the interpreter in turns: short ones, or Stop waits for several.
        sys.setswitchinterval(_TURN_S)
        set_aside(first=True)
        if self._first is None:
            asyncio.run(self.serve([Listening(self._listening, self._gates[0], self.config.is_ssl)]))
            return
        with contextlib.closing(Doorway(self._listening, *self._how_listened)) as doorway:
            self._doorway = doorway
            thread = threading.Thread(
                target=asyncio.run, args=(self._first.serve([doorway.urgent]),), name="first", daemon=True
            )
            thread.start()
            try:
                asyncio.run(self.serve([doorway.crowd]))
            finally:
                self._first.should_exit = True
                thread.join()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen, and say so."""
        if self.config.is_ssl:
            loop = asyncio.get_running_loop()
            # The one phase that uvicorn leaves at a minute.
            listen = partial(loop.create_server, ssl_handshake_timeout=HEAD_S)
            loop.create_server = listen  # pyright: ignore[reportAttributeAccessIssue]
        await super().startup(sockets)
        self._ready(self.url)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams first: they would not end by themselves."""
        if self._doorway is not None:
            self._doorway.shut()
        self._lab.hub.close()
        await super().shutdown(sockets)
        for gate in self._gates:
            gate.close()
