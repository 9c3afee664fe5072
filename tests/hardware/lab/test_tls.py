"""The process that speaks TLS: what it passes on, in what order handshakes are, and what it leaves behind."""

import contextlib
import os
import select
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.lab_tls import certificate, unverified
from hardware.lab.gate import Gate, Listening
from hardware.lab.handing import can_be
from hardware.lab.tls import Before, Turns, context_of

pytestmark = pytest.mark.skipif(not can_be(), reason="connections cannot be handed on here")
LARGE = np.random.default_rng(3).bytes(3_000_001)
LONG_S = 60.0


class Speaker:
    """One that speaks TLS in a thread of its own, and the door's side of it."""

    def __init__(self, folder: Path, head_s: float = LONG_S):
        files = certificate(folder)
        bound = socket.create_server(("127.0.0.1", 0), backlog=100)
        self.address = bound.getsockname()
        self.door, theirs = socket.socketpair()
        self.door.settimeout(LONG_S)
        listening = Listening(bound, Gate(most=100), tls=True)
        self.before = Before(listening, theirs, context_of(*files), head_s)
        self.gate = listening.gate
        self.thread = threading.Thread(target=self.before.serve, daemon=True)
        self._held = [listening, theirs]
        self.thread.start()

    def browser(self) -> ssl.SSLSocket:
        return unverified().wrap_socket(socket.create_connection(self.address, timeout=LONG_S))

    def come(self) -> socket.socket:
        _, numbers, _, _ = socket.recv_fds(self.door, 128, 1)
        line = socket.socket(fileno=numbers[0])
        line.settimeout(LONG_S)
        self._held.append(line)
        return line

    def pair(self) -> tuple[ssl.SSLSocket, socket.socket]:
        return self.browser(), self.come()

    def until(self, number: int) -> None:
        """Wait until this number of connections is left."""
        end_s = time.monotonic() + LONG_S
        while len(self.gate) != number and time.monotonic() < end_s:
            time.sleep(0.01)
        assert len(self.gate) == number

    def close(self) -> None:
        self.door.close()
        self.thread.join(LONG_S)
        assert not self.thread.is_alive()
        for one in self._held:
            one.close()


@pytest.fixture
def speaker(tmp_path: Path) -> Iterator[Speaker]:
    with contextlib.closing(Speaker(tmp_path)) as one:
        yield one


def heard(line: socket.socket, slowly: bool = False) -> bytes:
    """All that is said until the end."""
    parts = []
    while part := line.recv(1 << 16):
        parts.append(part)
        if slowly:
            time.sleep(0.001)
    return b"".join(parts)


def test_addresses_take_turns_and_so_do_the_newest_and_the_oldest():
    turns = Turns()
    lines = [socket.socket() for _ in range(6)]
    for line, network in zip(lines, "aaaabb", strict=True):
        turns.add(line, network)
    order = [lines.index(turns.take()) for _ in lines]
    assert order == [3, 4, 2, 5, 1, 0]
    assert not turns
    for line in lines:
        line.close()


def exchanged(browser: ssl.SSLSocket, words: bytes, pause_s: float, at_once: int = 1 << 16) -> bytes:
    """Say this and hear all that is said at the same time, by one thread: a connection of TLS is not for two."""
    browser.settimeout(0.0)
    parts: list[bytes] = []
    said, end_s = 0, time.monotonic() + LONG_S
    while not (parts and not parts[-1]):
        assert time.monotonic() < end_s
        with contextlib.suppress(ssl.SSLWantWriteError, ssl.SSLWantReadError):
            # What could not be said at once has to be said again as it was.
            said += browser.send(words[said : said + at_once]) if said < len(words) else 0
        with contextlib.suppress(ssl.SSLWantReadError):
            parts.append(browser.recv(at_once))
        time.sleep(pause_s)
    return b"".join(parts)


@pytest.mark.parametrize("slowly", [False, True])
def test_everything_arrives_in_both_directions_at_once(speaker: Speaker, slowly: bool):
    browser, server = speaker.pair()

    def answer() -> None:
        server.sendall(LARGE[::-1])
        server.shutdown(socket.SHUT_WR)

    came: list[bytes] = []
    threads = [threading.Thread(target=answer), threading.Thread(target=lambda: came.append(heard(server, slowly)))]
    for thread in threads:
        thread.start()
    answered = exchanged(browser, LARGE, 0.001 * slowly)
    # All is said to the browser: what it still says is for nobody.
    browser.close()
    for thread in threads:
        thread.join(LONG_S)
    server.close()
    assert answered == LARGE[::-1]
    assert LARGE.startswith(came[0])
    speaker.until(0)


def test_one_that_speaks_while_it_is_said_farewell_loses_nothing(speaker: Speaker, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("hardware.lab.tls._FAREWELL_S", 0.5)
    browser, server = speaker.pair()
    server.sendall(LARGE[:400_000])
    server.close()
    # Two seconds, in which it is never silent for long.
    assert exchanged(browser, LARGE, 0.02, 4000) == LARGE[:400_000]
    browser.close()
    speaker.until(0)


def test_what_was_heard_in_the_round_of_the_farewell_is_no_end(speaker: Speaker):
    """The poll says that the browser speaks, and the server's turn, which comes first, takes the words and ends."""
    browser, server = speaker.pair()
    server.close()
    end_s = time.monotonic() + LONG_S
    while not speaker.before._leaving and time.monotonic() < end_s:
        time.sleep(0.01)
    (line,) = speaker.before._leaving
    speaker.before._hear(line, line.getpeername(), select.EPOLLIN)
    assert line in speaker.before._leaving
    browser.close()
    speaker.until(0)


def test_one_that_speaks_for_ever_is_ended(speaker: Speaker, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("hardware.lab.tls._FAREWELL_S", 0.5)
    monkeypatch.setattr("hardware.lab.tls._FAREWELLS_S", 1.5)
    browser, server = speaker.pair()
    server.close()

    def speak() -> None:
        for _ in range(int(LONG_S / 0.05)):
            browser.send(b"more")
            time.sleep(0.05)

    with pytest.raises(OSError, match=r"(reset|closed|[Bb]roken|EOF)"):
        speak()
    browser.close()
    speaker.until(0)


def test_a_browser_that_has_said_all_gets_its_answer(speaker: Speaker):
    browser, server = speaker.pair()
    browser.sendall(LARGE)
    # The end of TLS, without an end of the connection.
    browser.settimeout(0.0)
    with contextlib.suppress(ssl.SSLWantReadError):
        browser.unwrap()
    assert heard(server) == LARGE
    server.sendall(b"thanks")
    server.close()
    speaker.until(1)
    browser.close()
    speaker.until(0)


def test_an_answer_before_all_was_heard_arrives(speaker: Speaker):
    browser, server = speaker.pair()
    browser.sendall(LARGE[:200_000])
    server.recv(1)
    server.sendall(b"too large")
    server.close()
    assert heard(browser) == b"too large"
    browser.close()
    speaker.until(0)


def test_one_that_breaks_off_is_gone_on_both_sides(speaker: Speaker):
    browser, server = speaker.pair()
    # Ends with a reset.
    browser.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    socket.socket(fileno=browser.detach()).close()
    assert server.recv(1) == b""
    speaker.until(0)


def test_a_browser_that_takes_nothing_costs_no_time(speaker: Speaker):
    browser, server = speaker.pair()
    server.settimeout(1.0)
    with contextlib.suppress(TimeoutError):
        server.sendall(LARGE * 10)
    server.close()
    begin_s = time.process_time()
    time.sleep(1.0)
    assert time.process_time() - begin_s < 0.5
    assert len(heard(browser)) > 100_000
    browser.close()
    speaker.until(0)


@pytest.mark.parametrize("said", [b"GET / HTTP/1.1\r\n\r\n", b"\x16nonsense", b"\x16\x03\x01\x00\x05abcde" * 100])
def test_what_is_no_tls_is_ended(speaker: Speaker, said: bytes):
    line = socket.create_connection(speaker.address, timeout=LONG_S)
    line.sendall(said)
    with contextlib.suppress(ConnectionResetError):
        heard(line)
    speaker.until(0)
    line.close()


@pytest.mark.parametrize("said", [b"", b"\x16\x03\x01\x02\x00\x01"])
def test_one_that_does_not_go_on_with_its_handshake_is_ended_in_time(tmp_path: Path, said: bytes):
    with contextlib.closing(Speaker(tmp_path, head_s=0.5)) as speaker:
        line = socket.create_connection(speaker.address, timeout=LONG_S)
        line.sendall(said)
        heard(line)
        speaker.until(0)
        line.close()


def test_whoever_comes_last_from_elsewhere_does_not_wait_for_a_crowd(speaker: Speaker):
    """A hundred clients say hello at once, and one of another address after them."""
    hello, back = ssl.MemoryBIO(), ssl.MemoryBIO()
    with contextlib.suppress(ssl.SSLWantReadError):
        unverified().wrap_bio(back, hello).do_handshake()
    words = hello.read()
    # The process does nothing until all are there.
    reached, go = threading.Event(), threading.Event()
    order: list[str] = []
    begin = speaker.before._begin

    def slow(line: socket.socket) -> None:
        reached.set()
        go.wait(LONG_S)
        order.append(line.getpeername()[0])
        begin(line)

    speaker.before._begin = slow
    with contextlib.ExitStack() as opened:

        def hail(address: str) -> None:
            line = socket.create_connection(speaker.address, timeout=LONG_S, source_address=(address, 0))
            opened.enter_context(line).sendall(words)

        for _ in range(60):
            hail("127.0.0.1")
        reached.wait(LONG_S)
        hail("127.0.0.2")
        go.set()
        speaker.until(61)
        end_s = time.monotonic() + LONG_S
        while len(order) < 61 and time.monotonic() < end_s:
            time.sleep(0.01)
    assert len(order) == 61
    # One turn was under way, and 16 connections are taken at a time.
    assert order.index("127.0.0.2") < 10
    speaker.until(0)


def test_descriptors_come_back(speaker: Speaker):
    def used() -> int:
        return len(os.listdir("/proc/self/fd"))

    before = used()
    for _ in range(20):
        browser, server = speaker.pair()
        server.sendall(b"hello")
        server.close()
        assert heard(browser) == b"hello"
        browser.close()
    speaker.until(0)
    assert used() <= before
