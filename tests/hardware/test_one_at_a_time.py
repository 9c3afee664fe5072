"""A port and a scan's folder are one program's at a time."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from hardware.cli.main import main
from hardware.errors import SettingsError
from hardware.scan_plan import Plan, ScanFolder
from hardware.stages.line import Line
from jaxscan.errors import InputError
from jaxscan.exclusive import InUseError
from jaxscan.files.scan import Scan, write_scan
from jaxscan.images import StripeSettings

HOLDER = """
import sys
from hardware.stages.line import Line
line = Line(sys.argv[1], 9600)
print("held", flush=True)
sys.stdin.read()
"""


def test_a_port_that_another_program_has(tmp_path: Path):
    controller, port = pty.openpty()
    name = os.ttyname(port)
    os.close(port)
    argv = [sys.executable, "-c", HOLDER, name]
    with subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdin is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(SettingsError, match=rf"{name}: is in use by process {other.pid} \(.*python"):
            Line(name, 9600)
        other.stdin.close()
        other.wait(timeout=30)
    Line(name, 9600).close()
    os.close(controller)


def test_a_folder_into_which_another_scan_is_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = ScanFolder.create(tmp_path / "cup", Plan({"stage": (0, 10, 20)}))
    part = tmp_path / "cup" / "frames" / ".0001.png.part"
    with folder.held():
        part.write_bytes(b"half a photograph of the other's")
        with pytest.raises(InUseError, match=f"cup: is in use by process {os.getpid()}"):
            ScanFolder.resume(tmp_path / "cup")
        assert main(["scan", str(tmp_path / "cup"), "--resume"]) == 2
        assert "is in use by" in capsys.readouterr().err
        assert part.exists()
    ScanFolder.resume(tmp_path / "cup")
    assert not part.exists()
    assert sorted(path.name for path in (tmp_path / "cup").iterdir()) == ["frames", "plan.json", "scan.toml"]


def test_frames_that_another_process_took_meanwhile_are_not_taken_again(tmp_path: Path):
    assert main(["scan", str(tmp_path / "cup"), "--frames", "2", "--apart", "100"]) == 0
    late = ScanFolder.resume(tmp_path / "cup")
    late.done = type(late.done)(late.done.path, late.done.laser, axes={"stage": ()})
    with late.held():
        assert len(late.done.frames) == 2
        assert not late.left


@pytest.mark.parametrize("left", [(), ("frames",), ("frames", "scan"), ("part",), ("frames", "scan", "part")])
def test_what_a_beginning_that_was_cut_off_leaves_is_no_scan(tmp_path: Path, left: tuple[str, ...]):
    """A folder with a scan of no frames and without a plan took no other scan."""
    cup = tmp_path / "cup"
    cup.mkdir()
    (cup / ".scan.lock").write_text("")
    if "frames" in left:
        (cup / "frames").mkdir()
    if "scan" in left:
        write_scan(Scan(cup / "scan.toml", StripeSettings(), axes={"stage": ()}))
    if "part" in left:
        (cup / ".plan.json.1234.part").write_text("{")
    ScanFolder.create(cup, Plan({"stage": (0, 10)}))
    assert sorted(path.name for path in cup.iterdir()) == ["frames", "plan.json", "scan.toml"]


@pytest.mark.parametrize("name", ["notes.txt", "frames/0000.png", "other/", "scan.toml"])
def test_what_is_no_beginning_is_kept(tmp_path: Path, name: str):
    path = tmp_path / "cup" / name
    path.parent.mkdir(parents=True)
    path.mkdir() if name.endswith("/") else path.write_text("mine")
    with pytest.raises(InputError, match="is not empty: name a folder that is new or empty"):
        ScanFolder.create(tmp_path / "cup", Plan({"stage": (0, 10)}))
    assert path.exists()
