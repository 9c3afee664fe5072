"""HTTP on one connection, with a deadline on each of its phases: nobody holds a connection by saying nothing."""

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Any, Final, Literal

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from hardware.lab.gate import TIMED_OUT, Gate

# A request's header from its first byte (or a connection's beginning), its body, and TLS's first words.
HEAD_S: Final = 10.0
BODY_S: Final = 20.0
# An answer of which nothing more can be sent.
SEND_S: Final = 30.0


class Protocol(H11Protocol):
    """A connection.

    Class attributes are set by `protocol_of`.
    """

    gate: Gate
    # What is spoken with the browser, where another process does so.
    spoken: Literal["http", "https"] | None = None
    head_s = HEAD_S
    body_s = BODY_S
    send_s = SEND_S

    @staticmethod
    def give_way() -> None:
        """Let what cannot wait go first."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """It begins."""
        self.give_way()
        super().connection_made(transport)  # pyright: ignore[reportArgumentType]
        self._peer = transport.get_extra_info("peername")
        # A connection that was handed on need have no address of its own.
        self.client = (str(self._peer[0]), int(self._peer[1]))
        self.scheme = self.spoken or self.scheme
        self._phase, self._deadline, self._sending = "", None, None
        self._look()

    def data_received(self, data: bytes) -> None:
        """Something has come."""
        self.give_way()
        super().data_received(data)
        self._look()

    def on_response_complete(self) -> None:
        """An answer has been sent."""
        super().on_response_complete()
        self._look()

    def pause_writing(self) -> None:
        """The other side does not read, for now."""
        super().pause_writing()
        self._sending = self.loop.call_later(self.send_s, self.transport.abort)

    def resume_writing(self) -> None:
        """It has read."""
        super().resume_writing()
        if self._sending is not None:
            self._sending.cancel()

    def connection_lost(self, exc: Exception | None) -> None:
        """It has ended."""
        self.gate.left(self._peer)
        for timer in (self._deadline, self._sending):
            if timer is not None:
                timer.cancel()
        super().connection_lost(exc)

    def _look(self) -> None:
        """See in which phase it is; a phase that goes on keeps its deadline, however slowly bytes come."""
        phase: Literal["head", "body", "rest", "answer"] = "answer"
        if self.conn.their_state is h11.SEND_BODY:
            phase = "body"
        elif self.conn.their_state is h11.IDLE:
            # Between two requests it rests, and uvicorn ends it soon.
            phase = "head" if self.cycle is None or self.conn.trailing_data[0] else "rest"
        if phase == self._phase:
            return
        self._phase = phase
        self.gate.note(self._peer, "head" if phase in ("head", "body") else phase)
        if self._deadline is not None:
            self._deadline.cancel()
        after_s = {"head": self.head_s, "body": self.body_s}.get(phase)
        self._deadline = None if after_s is None else self.loop.call_later(after_s, self._late)

    def _late(self) -> None:
        if self.transport.is_closing():
            return
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            self.transport.write(TIMED_OUT)
        self.transport.close()


def protocol_of(
    gate: Gate,
    give_way: Callable[[], object] | None = None,
    spoken: Literal["http", "https"] | None = None,
    **seconds: float,
) -> type[Protocol]:
    """The protocol of a server's connections.

    Args:
        gate: through which they have come.
        give_way: called before anything is done for one of them; waits as long as something else cannot.
        spoken: with the browser, where another process does so.
        seconds: other deadlines, if need be.
    """
    values: dict[str, Any] = {"gate": gate, "spoken": spoken, **seconds}
    if give_way is not None:
        values["give_way"] = staticmethod(give_way)
    return type("LabProtocol", (Protocol,), values)


class Seldom(logging.Filter):
    """Lets a message through once a minute, however often it is said: a log fills a disk too."""

    def __init__(self, every_s: float = 60.0):
        super().__init__()
        self._every_s = every_s
        self._said_s: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether it is to be said."""
        now_s, kind = time.monotonic(), str(record.msg)[:80]
        if now_s - self._said_s.get(kind, -self._every_s) < self._every_s:
            return False
        if len(self._said_s) > 1000:
            self._said_s.clear()
        self._said_s[kind] = now_s
        return True
