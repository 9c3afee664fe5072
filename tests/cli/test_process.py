"""A program as a process: Ctrl-C where Python loses it, and how a process ends."""

import os
import subprocess
import sys
import textwrap

import pytest

LIMIT_S = 120


def ends(body: str) -> subprocess.CompletedProcess[str]:
    """How a process ends whose program has this body."""
    words = "import atexit, gc, os, signal, threading, time\nfrom jaxscan.cli.process import run_as_process\n"
    # A shell starts what runs in the background with Ctrl-C ignored.
    words += "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    words += "def program():\n" + textwrap.indent(textwrap.dedent(body), "    ") + "\nrun_as_process(program)\n"
    return subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, timeout=LIMIT_S)


@pytest.mark.parametrize("status", [0, 1, 2, 130])
def test_the_status_is_the_programs(status: int) -> None:
    done = ends(f"print('done')\nreturn {status}")
    assert (done.returncode, done.stdout, done.stderr) == (status, "done\n", "")


def test_ctrl_c_in_a_callback_of_the_garbage_collector_is_not_lost() -> None:
    done = ends(
        """
        def callback(phase, info):
            if phase == "start":
                gc.callbacks.remove(callback)
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.5)
        gc.callbacks.append(callback)
        try:
            gc.collect()
            time.sleep(60)
        except KeyboardInterrupt:
            return 130
        return 0
        """
    )
    assert (done.returncode, done.stderr) == (130, "")


@pytest.mark.parametrize("status", [0, 1, 130])
def test_a_process_ends_after_what_waits_for_its_end(status: int) -> None:
    """Python's own end would call what `__del__` of a module's objects does; the process has ended before."""
    done = ends(
        f"""
        class Late:
            def __del__(self):
                print("too late", flush=True)
        global late
        late = Late()
        atexit.register(print, "put away")
        threading.Thread(target=lambda: (time.sleep(0.5), print("and waited for"))).start()
        return {status}
        """
    )
    assert (done.returncode, done.stdout) == (status, "and waited for\nput away\n")


def test_what_fails_while_it_ends_is_said() -> None:
    """Of words that a full disk does not take Python speaks, with a status of its own."""
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full here")
    words = "from jaxscan.cli.process import run_as_process\nrun_as_process(lambda: print('lost') or 0)"
    # What is not kept back to be written together fails earlier.
    env = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-c", words], stdout=full, stderr=subprocess.PIPE, text=True, timeout=LIMIT_S, env=env
        )
    assert done.returncode == 120
    assert "No space left" in done.stderr


def test_an_exception_of_the_program_is_shown() -> None:
    done = ends("raise ValueError('shown')")
    assert done.returncode == 1
    assert "ValueError: shown" in done.stderr
