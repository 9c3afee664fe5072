"""Nothing is waited for without a limit."""

import signal
import subprocess
import sys
import threading
import time

import pytest

from jaxscan.deadline import PATIENCE, Workers, in_turn, patience_s, result_of
from jaxscan.errors import InputError, StalledError


def test_results_come_in_order_and_errors_are_those_of_the_work():
    with Workers(2) as workers:
        futures = [workers.submit(lambda k: 10 // k, k) for k in (5, 2, 0)]
        assert [result_of(future, "a division") for future in futures[:2]] == [2, 5]
        with pytest.raises(ZeroDivisionError):
            result_of(futures[2], "a division")


def test_items_are_worked_on_together_and_come_in_their_order():
    """Each of three waits for the two others; the fourth is not asked for before the first was taken."""
    together, asked = threading.Barrier(3), []

    def items():
        for k in range(6):
            asked.append(k)
            yield k

    def work(k: int) -> int:
        together.wait(30)
        return 10 * k

    found = in_turn(work, items(), 3, "tens")
    assert next(found) == (0, 0)
    assert asked == [0, 1, 2]
    assert list(found) == [(k, 10 * k) for k in range(1, 6)]


def test_what_was_worked_on_before_an_error_comes_first():
    def items():
        yield 2
        yield 1
        raise InputError("the third is missing")

    found = in_turn(lambda k: 10 // k, items(), 4, "divisions")
    assert [next(found), next(found)] == [(2, 5), (1, 10)]
    with pytest.raises(InputError, match="the third is missing"):
        next(found)
    found = in_turn(lambda k: 10 // k, iter((2, 0, 1)), 4, "divisions")
    assert next(found) == (2, 5)
    with pytest.raises(ZeroDivisionError):
        next(found)


def test_whoever_stops_early_leaves_no_thread():
    found = in_turn(lambda k: k, iter(range(1000)), 3, "numbers")
    assert next(found) == (0, 0)
    found.close()
    assert not [thread for thread in threading.enumerate() if "_work" in thread.name]


def test_ctrl_c_waits_for_nothing_that_goes_on():
    stuck, begin = threading.Event(), time.monotonic()

    def broken_off() -> None:
        with Workers(1) as workers:
            workers.submit(stuck.wait, 30)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken_off()
    assert time.monotonic() - begin < 3
    stuck.set()


def test_a_limit_of_the_work_itself_is_no_stall():
    def work():
        raise TimeoutError("of the work")

    with Workers(1) as workers, pytest.raises(TimeoutError, match="of the work"):
        result_of(workers.submit(work), "it")


def test_what_does_not_end_is_named_and_left_behind(monkeypatch):
    monkeypatch.setenv(PATIENCE, "0.2")
    stuck, begun = threading.Event(), []
    with Workers(1) as workers:
        first = workers.submit(stuck.wait, 30)
        second = workers.submit(begun.append, 2)
        with pytest.raises(StalledError, match=r"photograph 7: it was worked on for 0.2 s .* JAXSCAN_PATIENCE_S"):
            result_of(first, "photograph 7")
        monkeypatch.setattr("jaxscan.deadline._LET_GO_S", 0.1)
        begin = time.monotonic()
    assert time.monotonic() - begin < 20
    assert second.cancelled()
    assert not begun
    stuck.set()


def test_work_that_goes_on_has_ten_times_as_long(monkeypatch):
    """On a loaded machine a step that compiles took more than its time, and the command failed."""
    monkeypatch.setenv(PATIENCE, "0.2")
    ended = threading.Event()

    def works() -> None:
        while not ended.is_set():
            sum(range(1000))

    with Workers(1) as workers:
        begin = time.monotonic()
        with pytest.raises(StalledError):
            result_of(workers.submit(works), "a step")
        assert time.monotonic() - begin > 1.5
        ended.set()


@pytest.mark.parametrize("text", ["soon", "0", "-3", "nan", "inf"])
def test_a_patience_that_is_no_time_is_refused(monkeypatch, text):
    monkeypatch.setenv(PATIENCE, text)
    with pytest.raises(InputError, match=f'JAXSCAN_PATIENCE_S is "{text}"'):
        patience_s()


def run(work: str, patience: str) -> subprocess.CompletedProcess[str]:
    code = f"""
import threading, time
from jaxscan.cli.progress import progress
with progress("solving", unit="step") as advance:
    advance.says("round 1")
    {work}
"""
    env = {PATIENCE: patience, "JAXSCAN_DEBUG": "1"}
    return subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=120)


def test_a_command_that_is_stuck_ends_and_says_where():
    done = run("threading.Event().wait()", "1")
    assert done.returncode == 1
    assert "error: solving: 1 step (round 1), " in done.stderr
    assert "stuck for 1 s" in done.stderr
    assert "most recent call first" in done.stderr


def test_a_command_that_works_is_not_stuck():
    done = run("begin = time.monotonic()\n    while time.monotonic() - begin < 3: pass", "1")
    assert done.returncode == 0
    assert "stuck" not in done.stderr


def test_a_command_that_was_stopped_goes_on():
    """Ctrl-Z for longer than is waited for what is stuck, then fg."""
    code = """
import sys
from jaxscan.cli.progress import progress
from jaxscan.deadline import Workers, result_of
with Workers(1) as workers, progress("solving", unit="step"):
    future = workers.submit(sys.stdin.readline)
    print("begun", flush=True)
    result_of(future, "a line")
"""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, env={PATIENCE: "2"}, text=True, **pipes) as process:
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGSTOP)
        time.sleep(2.5)
        process.send_signal(signal.SIGCONT)
        time.sleep(0.2)
        _, said = process.communicate("a line\n", timeout=60)
    assert process.returncode == 0, said
    assert "stuck" not in said
