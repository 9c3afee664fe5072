"""What one process holds another does not get, and a killed one holds nothing."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from jaxscan.errors import InputError
from jaxscan.exclusive import InUseError, exclusive

HOLDER = """
import sys, time
from pathlib import Path
from jaxscan.exclusive import exclusive
with exclusive(Path(sys.argv[1]), "scans"):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path: Path):
    process = subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path / ".lock")], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"held\n"
    yield process
    process.kill()
    process.wait()
    process.stdout.close()


def test_who_holds_it_is_named_and_a_killed_process_holds_nothing(holder, tmp_path: Path):
    said = rf"^scans: is in use by process {holder.pid} on .*, since 20"
    with pytest.raises(InUseError, match=said), exclusive(tmp_path / ".lock", "scans"):
        pass
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    with exclusive(tmp_path / ".lock", "scans"):
        assert str(os.getpid()) in (tmp_path / ".lock").read_text()
    assert not (tmp_path / ".lock").exists()


def test_the_same_process_does_not_get_it_twice(tmp_path: Path):
    with exclusive(tmp_path / ".lock", "scans"):
        with pytest.raises(InUseError, match=f"process {os.getpid()}"), exclusive(tmp_path / ".lock", "scans"):
            pass
        assert (tmp_path / ".lock").exists()
    with exclusive(tmp_path / ".lock", "scans"):
        pass


def test_a_place_that_takes_no_file(tmp_path: Path):
    with pytest.raises(InputError, match=r"lock .* cannot be made"), exclusive(tmp_path / "none" / ".lock", "scans"):
        pass


def test_many_at_once_hold_it_one_after_the_other(tmp_path: Path):
    """Each adds to a number that it has read before; none is lost."""
    count = tmp_path / "count"
    count.write_text("0")
    adds = """
import sys, time
from pathlib import Path
from jaxscan.exclusive import InUseError, exclusive
done = 0
while done < 20:
    try:
        with exclusive(Path(sys.argv[1]) / ".lock", "scans"):
            file = Path(sys.argv[1]) / "count"
            n = int(file.read_text())
            time.sleep(0.001)
            file.write_text(str(n + 1))
            done += 1
    except InUseError:
        time.sleep(0.001)
"""
    processes = [subprocess.Popen([sys.executable, "-c", adds, str(tmp_path)]) for _ in range(4)]
    assert [process.wait(timeout=120) for process in processes] == [0] * 4
    assert count.read_text() == "80"
