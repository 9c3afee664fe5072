"""Progress: on standard error, and quiet where nobody watches."""

import io
import sys
import threading
import time

from jaxscan.cli.progress import progress, track


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_one_line_where_nobody_watches(capsys):
    with progress("reading corners", 3) as advance:
        for _ in range(3):
            advance(1)
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("reading corners: 3 images, 0.")
    assert err.count("\n") == 1


def test_items_pass_unchanged(capsys):
    assert list(track(iter("a"), "reading", unit="frame")) == ["a"]
    assert capsys.readouterr().err.startswith("reading: 1 frame, ")


def test_a_bar_on_a_terminal(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    assert list(track([1, 2], "reading", total=2)) == [1, 2]
    assert "reading: 100%" in terminal.getvalue()
    assert "2/2" in terminal.getvalue()


def test_an_error_passes_and_leaves_no_line(capsys):
    try:
        with progress("reading"):
            raise KeyError
    except KeyError:
        pass
    assert capsys.readouterr().err == ""


def test_long_work_says_now_and_then_what_it_does(capsys, monkeypatch):
    monkeypatch.setattr("jaxscan.cli.progress._LINE_S", 0.05)
    monkeypatch.setattr("jaxscan.cli.progress._PULSE_S", 0.02)
    printed = threading.Event()
    with progress("solving", 7, "round") as advance:
        advance.says("lens")
        for _ in range(1000):
            if "solving: 1 of 7 rounds (lens), " in capsys.readouterr().err:
                printed.set()
                break
            time.sleep(0.02)
    assert printed.is_set()


def test_the_bar_moves_while_nothing_is_done(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr("jaxscan.cli.progress._PULSE_S", 0.02)
    with progress("solving", 3):
        before = terminal.tell()
        for _ in range(1000):
            if terminal.tell() > before:
                break
            time.sleep(0.02)
        assert terminal.tell() > before
