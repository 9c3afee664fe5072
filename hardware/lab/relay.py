"""One connection of TLS: its handshake, and the bytes between the browser and the server.

Each side waits for the other: nothing is read for a side that has not taken what was read before.
"""

import contextlib
import select
import socket
import ssl
from typing import Final

# Bytes that are read at once, and so kept for a side that does not take them.
_AT_ONCE: Final = 64 * 1024


class Relay:
    """What is between a browser and the server.

    Args:
        browser: its connection, not blocking, watched by `poll`.
        context: what TLS needs to know.
        poll: that says what can go on.

    Attributes:
        server: the other side, not blocking; None until the handshake is done and somebody sets it.
        done: whether the server has ended and the browser has all of it.
    """

    def __init__(self, browser: socket.socket, context: ssl.SSLContext, poll: "select.epoll"):
        self.browser = browser
        self.server: socket.socket | None = None
        self.done = False
        self._come, self._go = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._come, self._go, server_side=True)
        self._poll = poll
        # What the poll is asked of each side.
        self._asked: dict[socket.socket, int] = {browser: 0}
        self._to_browser, self._to_server = b"", b""
        self._browser_ended = self._server_ended = False

    @property
    def sides(self) -> list[socket.socket]:
        """Both, or the browser's alone."""
        return [self.browser] if self.server is None else [self.browser, self.server]

    def shake_hands(self) -> bool:
        """Continue the handshake.

        Returns:
            Whether it is done.

        Raises:
            OSError: the browser has gone, or (`ssl.SSLError`) said what is no TLS.
        """
        self._hear()
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            return False
        finally:
            # Of a handshake that failed, too: why.
            self._send()
        return True

    def pass_on(self) -> None:
        """Pass on what can go, in both directions.

        Raises:
            OSError: the browser has gone, or (`ssl.SSLError`) said what is no TLS.
        """
        self._from_browser()
        self._from_server()

    def watch(self) -> None:
        """Ask the poll for what this waits for.

        And for nothing else: while the browser takes the last words, the poll would say all the time that the server
        has ended.
        """
        self._ask(self.browser, bool(self._to_server) or self._browser_ended, bool(self._to_browser))
        if self.server is not None:
            self._ask(self.server, bool(self._to_browser) or self._server_ended, bool(self._to_server))

    def _ask(self, side: socket.socket, full: bool, waits: bool) -> None:
        asked, before = (0 if full else select.EPOLLIN) | (select.EPOLLOUT if waits else 0), self._asked.get(side, 0)
        if asked != before:
            if side is self.browser or (asked and before):
                self._poll.modify(side, asked)
            elif asked:
                self._poll.register(side, asked)
            else:
                self._poll.unregister(side)
            self._asked[side] = asked

    def close(self) -> None:
        """Ask nothing more, and end the server's side."""
        self._poll.unregister(self.browser)
        if self.server is not None:
            self.server.close()

    def _hear(self) -> bool:
        """Whether the browser has said something, its end included."""
        try:
            said = self.browser.recv(_AT_ONCE)
        except BlockingIOError:
            return False
        if said:
            self._come.write(said)
        else:
            self._come.write_eof()
        return True

    def _send(self) -> None:
        """Send the browser what TLS has for it, as far as it takes it."""
        self._to_browser = _sent(self.browser, self._to_browser + self._go.read())

    def _from_browser(self) -> None:
        assert self.server is not None
        heard = False
        while not self._browser_ended:
            try:
                self._to_server = _sent(self.server, self._to_server)
                if self._to_server:
                    return
                # Nothing where TLS has ended.
                self._to_server = self._tls.read(_AT_ONCE)
                self._browser_ended = not self._to_server
            except ssl.SSLWantReadError:
                # Once, then the others.
                if heard or not self._hear():
                    return
                heard = True
            except ssl.SSLEOFError:
                self._browser_ended = True
            except (BrokenPipeError, ConnectionResetError):
                # The server hears no more; it may have answered.
                self._browser_ended, self._to_server = True, b""
            if self._browser_ended:
                with contextlib.suppress(OSError):
                    self.server.shutdown(socket.SHUT_WR)

    def _from_server(self) -> None:
        assert self.server is not None
        self._send()
        if not self._to_browser and not self._server_ended:
            try:
                said = self.server.recv(_AT_ONCE)
            except BlockingIOError:
                return
            except ConnectionResetError:
                # It ended with words of the browser unheard.
                said = b""
            if said:
                self._tls.write(said)
            else:
                self._server_ended = True
                with contextlib.suppress(ssl.SSLError):
                    self._tls.unwrap()
            self._send()
        self.done = self._server_ended and not self._to_browser


def _sent(side: socket.socket, words: bytes) -> bytes:
    """What is left after a side took what it could."""
    with contextlib.suppress(BlockingIOError):
        while words:
            words = words[side.send(words) :]
    return words
