"""TLS, in a process of its own before the door: what comes encrypted goes on in the clear, through a pair of sockets.

The door has to read a request's header before anybody else does, and to hand the connection on with the header unread.
That needs plain bytes in a socket. So this process holds the keys, speaks TLS with the browser, and gives the door one
end of a pair of sockets with the browser's address; between the two it passes bytes on, as fast as the slower side
takes them.

`python -m hardware.lab.tls`, started by `hardware.lab.doorway`; it ends when the server is gone.
"""

import asyncio
import contextlib
import gc
import json
import logging
import signal
import socket
import ssl
import sys
from pathlib import Path
from typing import Any, Final, cast

from hardware.lab.gate import Gate, Listening
from hardware.lab.handing import hand

# Bytes on their way to a side that does not take them, before the other side is asked to wait.
_ON_THE_WAY: Final = 64 * 1024
# A browser that does not answer the end of TLS.
_FAREWELL_S: Final = 5.0


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


class _Side(asyncio.Protocol):
    """One side of a connection: what it says is written to the other."""

    def __init__(self) -> None:
        self.transport: asyncio.Transport | None = None
        self.other: _Side | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """It begins."""
        self.transport = cast("asyncio.Transport", transport)
        self.transport.set_write_buffer_limits(_ON_THE_WAY)

    def data_received(self, data: bytes) -> None:
        """Pass it on."""
        if self.other is not None and self.other.transport is not None:
            self.other.transport.write(data)

    def pause_writing(self) -> None:
        """The other side waits until this one has taken what there is."""
        if self.other is not None and self.other.transport is not None:
            self.other.transport.pause_reading()

    def resume_writing(self) -> None:
        """It need not wait any more."""
        if self.other is not None and self.other.transport is not None:
            self.other.transport.resume_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        """The other side gets what is on its way, then ends too; at once if this one was broken off."""
        if self.other is None or self.other.transport is None:
            return
        if exc is None:
            self.other.transport.close()
        else:
            self.other.transport.abort()


class _Outside(_Side):
    """The side that speaks TLS; it is made when the handshake is done.

    Args:
        gate: through which it came.
        door: where its other side goes.
    """

    def __init__(self, gate: Gate, door: socket.socket):
        super().__init__()
        self._gate, self._door = gate, door
        self._peer: Any = None
        self._task: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Hand the other side of it to the door."""
        super().connection_made(transport)
        self._peer = transport.get_extra_info("peername")
        # From here on the door and the server say how long it may be silent.
        self._gate.note(self._peer, "answer")
        assert self.transport is not None
        self.transport.pause_reading()
        self._task = asyncio.get_running_loop().create_task(self._begin())

    async def _begin(self) -> None:
        assert self.transport is not None
        try:
            here, its = socket.socketpair()
        except OSError:
            # No descriptors are left.
            self.transport.abort()
            return
        with its:
            here.setblocking(False)
            _, inside = await asyncio.get_running_loop().create_connection(_Side, sock=here)
            assert inside.transport is not None
            try:
                hand(self._door, its, self._peer)
            except OSError:
                # The door is behind with its work.
                self.transport.abort()
            if self.transport.is_closing():
                inside.transport.abort()
                return
        self.other, inside.other = inside, self
        self.transport.resume_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        """It has ended."""
        self._gate.left(self._peer)
        super().connection_lost(exc)


async def _serve(listening: Listening, door: socket.socket, context: ssl.SSLContext, head_s: float) -> None:
    """Serve until the server is gone."""
    loop, gone = asyncio.get_running_loop(), asyncio.Event()
    server = await loop.create_server(
        lambda: _Outside(listening.gate, door),
        sock=listening,
        ssl=context,
        ssl_handshake_timeout=head_s,
        ssl_shutdown_timeout=_FAREWELL_S,
    )
    # Nothing is ever said on it: it becomes readable when the server's end is closed.
    loop.add_reader(door, gone.set)
    async with server:
        await gone.wait()


def main() -> None:
    """Serve, with the sockets whose numbers were given."""
    for one in (signal.SIGINT, signal.SIGHUP):
        signal.signal(one, signal.SIG_IGN)
    how = json.loads(sys.argv[1])
    context = context_of(Path(how["cert"]), Path(how["key"]))
    bound, door = (socket.socket(fileno=number) for number in how["sockets"])
    door.setblocking(False)
    # What strangers say that is no TLS is no fault of this program.
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    gc.freeze()
    listening = Listening(bound, Gate(tuple(how["proxies"]), how["connections"]), tls=True)
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_serve(listening, door, context, how["head_s"]))


if __name__ == "__main__":
    main()
