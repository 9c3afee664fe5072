"""Progress: on standard error, and quiet where nobody watches."""

import io
import os
import sys
import threading
import time
from collections.abc import Callable
from types import ModuleType, SimpleNamespace

import jax
import pytest

import hardware.cli.main
from jaxscan.cli import compiled
from jaxscan.cli.main import Program, run_program
from jaxscan.cli.progress import progress, resting, say, step, track, working


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


def test_a_bar_on_a_terminal_that_does_not_say_how_large_it_is(monkeypatch):
    terminal = Terminal()
    terminal.fileno = lambda: 2
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr("os.get_terminal_size", lambda *_: os.terminal_size((0, 0)))
    assert list(track([1, 2], "reading", total=2)) == [1, 2]
    line = on_screen(terminal.getvalue().rstrip("\n"))
    assert "reading: 100%" in line
    assert "2/2" in line
    # The bar stays, and nothing repeats it.
    assert "reading: 2" not in terminal.getvalue()


def test_what_is_compiled_for_is_said(capsys, monkeypatch):
    monkeypatch.setattr("jaxscan.cli.progress._LINE_S", 0.05)
    monkeypatch.setattr("jaxscan.cli.progress._PULSE_S", 0.02)
    monkeypatch.setattr(compiled, "_READ_S", 0.0)
    monkeypatch.setattr(compiled, "_waited_for", [])
    said = ""
    with progress("reading frames", 7, "frame"):
        compiled._begun(compiled._ASKED)
        for _ in range(1000):
            said += capsys.readouterr().err
            if "reading frames: 0 of 7 frames (compiling, this once), " in said:
                break
            time.sleep(0.02)
        assert "(compiling, this once)" in said
        compiled._done(compiled._THERE, 1.0)
        assert not compiled.compiling()
    assert "compiling" not in capsys.readouterr().err


def test_jax_says_when_it_compiles_and_when_it_is_done(monkeypatch):
    begun = []
    monkeypatch.setattr(compiled, "_waited_for", waited := [])
    monkeypatch.setattr(compiled, "_begun", lambda event, **_: begun.append(event))
    monkeypatch.setattr(compiled, "_listening", False)
    compiled._listen()
    jax.jit(lambda x: x * 1.2345 + len(begun))(1.0).block_until_ready()
    assert compiled._ASKED in begun
    assert waited == []


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


def until(done: Callable[[], bool]) -> bool:
    """Whether something is so within a while."""
    for _ in range(1000):
        if done():
            return True
        time.sleep(0.02)
    return False


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr("jaxscan.cli.progress._PULSE_S", 0.02)
    monkeypatch.setattr("jaxscan.cli.progress._QUIET_S", 0.05)
    monkeypatch.setattr("jaxscan.cli.progress._LATER_LINE_S", 0.05)


@pytest.fixture
def terminal(monkeypatch, quick):
    # Not sys.stderr itself, which pytest puts back between a fixture and its test.
    made = Terminal()
    monkeypatch.setattr("jaxscan.cli.progress.sys", SimpleNamespace(stderr=made))
    return made


def on_screen(written: str) -> str:
    """What stands in the last line of a terminal to which this was written."""
    line = ""
    for part in written.split("\n")[-1].split("\r"):
        line = part + line[len(part) :]
    return line.rstrip()


def test_a_command_says_what_it_does_while_it_says_nothing_else(terminal):
    with working("mesh"):
        assert until(lambda: "mesh: starting, " in terminal.getvalue())
        step("finding the floor")
        assert until(lambda: on_screen(terminal.getvalue()).startswith("mesh: finding the floor, "))
        before = terminal.tell()
        assert until(lambda: terminal.tell() > before + 20), "it does not move"
    assert on_screen(terminal.getvalue()) == ""
    assert "\n" not in terminal.getvalue()


def test_a_long_line_fits_the_terminal(terminal):
    with working("mesh"):
        step("reading " + 200 * "x")
        assert until(lambda: "xxx, " in terminal.getvalue())
        assert len(on_screen(terminal.getvalue())) <= 79


def test_what_is_quick_shows_nothing(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr("jaxscan.cli.progress._PULSE_S", 0.01)
    with working("inspect"):
        time.sleep(0.1)
    assert terminal.getvalue() == ""


def test_without_a_terminal_lines_now_and_then(quick, capsys):
    said = ""
    with working("compare"):
        step("fitting 100 points")

        def heard() -> bool:
            nonlocal said
            said += capsys.readouterr().err
            return said.count("compare: fitting 100 points, ") >= 2

        assert until(heard)
    assert "\r" not in said


def test_it_rests_while_a_bar_moves_and_goes_on_after_it(terminal):
    with working("reconstruct"):
        assert until(lambda: "starting" in terminal.getvalue())
        with progress("reading frames", 2, "frame") as advance:
            begin = terminal.tell()
            advance()
            time.sleep(0.3)
            assert "reconstruct:" not in terminal.getvalue()[begin:]
        assert until(lambda: "reconstruct: going on, " in terminal.getvalue()[begin:])


def test_other_lines_stand_clear_of_it(terminal):
    with working("calibrate"):
        assert until(lambda: "starting" in terminal.getvalue())
        say("jaxscan: warning: of something")
        assert "\rjaxscan: warning: of something\n" in terminal.getvalue()
        with resting():
            before = terminal.tell()
            time.sleep(0.2)
            assert terminal.tell() == before


def test_an_error_passes_and_wipes_the_line(terminal):
    def fail() -> None:
        with working("calibrate"):
            assert until(lambda: "starting" in terminal.getvalue())
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert on_screen(terminal.getvalue()) == ""
    # Outside of a command nothing is shown.
    step("anything")
    with resting():
        pass


@pytest.mark.parametrize("shown", [("slow",), ()])
def test_a_program_shows_the_work_of_those_commands_that_wait_for_nobody(shown, terminal, monkeypatch, capsys):
    command = ModuleType("slow_command")

    def run(args: object) -> dict[str, str]:
        step("counting")
        begin = time.monotonic()
        assert until(lambda: "slow: counting, " in terminal.getvalue() or time.monotonic() - begin > 0.3)
        return {"said": "done"}

    vars(command).update(
        HELP="take long", EXAMPLE="", add_arguments=lambda parser: None, run=run, describe=lambda result: result["said"]
    )
    monkeypatch.setitem(sys.modules, "slow_command", command)
    assert run_program(Program("program", "", {"slow": "slow_command"}, shows_work=shown), ["slow"]) == 0
    assert ("slow: counting, " in terminal.getvalue()) is bool(shown)
    assert on_screen(terminal.getvalue()) == ""
    assert capsys.readouterr().out == "done\n"


def test_commands_that_wait_for_somebody_show_nothing_of_their_own():
    waiting = {"console", "serve", "user"}
    assert waiting <= set(hardware.cli.main.COMMANDS)
    assert set(hardware.cli.main.COMMANDS) - waiting == hardware.cli.main.SHOWS_WORK
