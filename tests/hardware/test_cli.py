"""`scanner`, as a user types it, on emulated controllers and recorded photographs."""

import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from hardware import Frame
from hardware.cameras.folder import FolderCamera
from hardware.cli.main import COMMANDS, main
from hardware.devices import folder_camera, read_scanner
from jaxscan.errors import InputError
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session
from jaxscan.images import read_image

SCANNER = """
[camera]
kind = "folder"
source = "recorded"
exposure_s = 0.01
[stage]
kind = "bistep"
port = "emulator://bistep?length=21000"
last = 20000
[laser]
kind = "rts"
color = "green"
"""


@pytest.fixture
def scanner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scanner, as the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recorded").mkdir()
    for i in range(4):
        cv2.imwrite(f"recorded/{i}.png", np.full((6, 8, 3), 20 * i, np.uint8))
    (tmp_path / "scanner.toml").write_text(SCANNER)
    return tmp_path


def test_a_simulated_scanner_is_said_to_be_one(scanner: Path, capsys: pytest.CaptureFixture[str]):
    """A command in the wrong folder would else take photographs of nothing without a word."""
    assert main(["move", "1000"]) == 0
    assert "simulated" not in capsys.readouterr().err
    (scanner / "scanner.toml").unlink()
    for words in (["move", "1000"], ["shoot", "one.png"]):
        assert main(words) == 0
        assert "there is no scanner.toml in this folder: the scanner is simulated" in capsys.readouterr().err


def test_home_move_shoot_scan(scanner: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["home"]) == 0
    assert "is at step 0" in capsys.readouterr().out
    assert main(["move", "1234", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"positions": {"stage": 1234}}
    assert main(["shoot", "one.png", "--step", "700"]) == 0
    assert "8 × 6 pixels" in capsys.readouterr().out
    assert main(["scan", "cup", "--frames", "3", "--apart", "2000", "--dark", "--name", "cup"]) == 1
    captured = capsys.readouterr()
    assert "has no photograph for step 4000, and 4 in all" in captured.err
    assert captured.err.count("taken ") == 2
    assert main(["scan", "cup", "--resume"]) == 0
    assert "next: jaxscan reconstruct cup" in capsys.readouterr().out
    scan = read_scan("cup")
    assert (scan.axes["stage"], scan.name, scan.laser.color) == ((0, 2000, 4000), "cup", "green")
    assert len(scan.backgrounds) == 3


def test_a_folder_of_photographs_in_its_order_and_a_scan_by_its_steps(scanner: Path):
    camera = folder_camera(scanner / "recorded")
    assert [int(camera.expose({}).image[0, 0, 0]) for _ in range(4)] == [0, 20, 40, 60]
    steps = "steps = [30, 20, 10, 0]"
    (scanner / "recorded" / "scan.toml").write_text(f'[scan]\nframes = "*.png"\n{steps}\n')
    camera = folder_camera(scanner / "recorded")
    assert [int(camera.expose({"stage": step}).image[0, 0, 0]) for step in (20, 0, 20)] == [20, 60, 20]
    with pytest.raises(InputError, match="no such folder"):
        folder_camera(scanner / "nowhere")


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["move", "90000"], "the stage goes from 0 to 20000"),
        (["scan", "new", "--frames", "12", "--apart", "2000"], "the stage goes from 0 to 20000"),
        (["scan", "new", "--frames", "12"], "--frames and --apart"),
        (["scan", "new", "--frames", "2", "--apart", "0"], "places of their own"),
        (["scan", "recorded", "--frames", "2", "--apart", "5"], "is not empty"),
        (["scan", "recorded", "--resume"], "without --resume"),
        (["scan", "recorded", "--resume", "--frames", "9"], "the plan that is in recorded: leave out --frames"),
        (["shoot", "stripe.gif"], "stripe.gif: end its name with one of .png"),
        (["shoot", "no/one.png"], "create it first"),
        (["calibrate", "session", "--board", "nine"], "as 9x6"),
        (["calibrate", "session", "--board", "9x²"], "as 9x6"),
        (["calibrate", "session", "--square", "nan"], "positive number of millimetres"),
        (["calibrate", "session", "--views", "2"], "needs 3 or more"),
        (["calibrate", "session", "--stage-frames", "1"], "give 2 or more"),
        (["calibrate", "session", "--stage-frames", "-1"], "or 0 for a rig without a stage"),
        (["calibrate", "session", "--stage-apart", "0"], "at places of their own"),
        (["calibrate", "session", "--stage-frames", "12"], "the stage goes from 0 to 20000"),
        (["calibrate", "session", "--stage-frames", "0", "--show", "no/live.png"], "create it first"),
        (["home", "--scanner", "other.toml"], "no such file"),
    ],
)
def test_what_cannot_be_is_refused(scanner: Path, capsys: pytest.CaptureFixture[str], argv: list[str], says: str):
    before = sorted(scanner.rglob("*"))
    assert main(argv) in (1, 2)
    assert says in capsys.readouterr().err
    assert sorted(scanner.rglob("*")) == before


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"folder"', '"pinhole"', "one of opencv, folder"),
        ("last = 20000", "last = 0", "first = 0, last = 0"),
        ("last = 20000", "lasst = 20000", 'did you mean "last"'),
        ("last = 20000", "last = 20000.5", "whole number"),
        ('kind = "rts"', 'kind = "controller"', "use rts, or fixed"),
        ('"green"', '"infrared"', "one of red"),
        ("exposure_s = 0.01", "exposure_s = 0", "exposure_s = 0: must be positive"),
        ("exposure_s = 0.01", "gain = -1", "must be positive"),
        ("last = 20000", "rate_steps_s = 1e-9", "give 1 or more"),
    ],
)
def test_a_description_that_is_wrong_is_named(scanner: Path, old: str, new: str, says: str):
    (scanner / "scanner.toml").write_text(SCANNER.replace(old, new))
    with pytest.raises(InputError, match=says):
        read_scanner(None)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("length=21000", "length=21000&speed=-1", "speed = -1: give 0 or more"),
        ("length=21000", "start=nan", "start = nan: give 0 or more"),
        ("last = 20000", "baud = -9", "must be positive"),
        ('"emulator://bistep?length=21000"', '""', "a text in quotes that is not empty"),
    ],
)
def test_a_port_that_cannot_be_is_refused_at_once(
    scanner: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, says: str
):
    (scanner / "scanner.toml").write_text(SCANNER.replace(old, new))
    assert main(["home"]) in (1, 2)
    assert says in capsys.readouterr().err
    assert main(["home", "--seed", "-1"]) == 2


def test_a_line_that_is_dead(scanner: Path, capsys: pytest.CaptureFixture[str]):
    (scanner / "scanner.toml").write_text(SCANNER.replace("21000", "21000&drop=1"))
    assert main(["home"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("scanner: error: ")
    assert "MAY STILL BE MOVING" in err
    assert main(["devices"]) == 0
    assert "check that it is on, cable and baud rate" in capsys.readouterr().out


def test_devices_that_answer(scanner: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["devices", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["axes"], found["camera"], found["described"]) == ({"stage": "answers"}, "opens", "scanner.toml")
    for kind in ("grbl", "marlin"):
        text = SCANNER.replace("bistep", kind).replace("last =", "steps_per_mm = 250\nlast =")
        (scanner / "scanner.toml").write_text(text)
        assert main(["devices", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["axes"] == {"stage": "answers"}
        # A controller that is off has no reference either, and does not answer.
        (scanner / "scanner.toml").write_text(text.replace("21000", "21000&drop=1"))
        assert main(["devices", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert "check that it is on, cable and baud rate" in found["axes"]["stage"]
        assert "not tried" in found["camera"]


def test_console(scanner: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO("-1?\n70=\n-1?\n"))
    assert main(["console"]) == 0
    assert capsys.readouterr().out.splitlines() == ["X,-1,0", "*", "*", "X,-1,70", "*"]
    monkeypatch.setattr(sys, "stdin", io.StringIO("?\n"))
    assert main(["console", "--port", "emulator://grbl", "--baud", "115200"]) == 0
    assert "<Alarm|MPos:0.000" in capsys.readouterr().out


def test_calibrate_shows_what_it_sees(
    scanner: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    """A person at the terminal, and the live picture in a file; the board lies still before a camera that repeats."""
    squares = np.kron(np.indices((7, 10)).sum(axis=0) % 2, np.ones((30, 30)))
    photograph = np.pad((230 - 200 * squares).astype(np.uint8), 40, constant_values=230)
    for path in (scanner / "recorded").iterdir():
        cv2.imwrite(str(path), cv2.GaussianBlur(photograph, (0, 0), 0.7))
    monkeypatch.setattr(FolderCamera, "expose", lambda self, at: Frame(read_image("recorded/0.png"), at, 0.0, 0.01))
    live, asked = scanner / "live.png", []

    def answer(prompt: str) -> str:
        asked.append(prompt)
        live.unlink(missing_ok=True)
        deadline_s = time.monotonic() + 60
        while not live.exists():
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
        return ""

    monkeypatch.setattr("builtins.input", answer)
    argv = ["calibrate", "session", "--views", "3", "--stage-frames", "2", "--stage-apart", "500", "--show", "live.png"]
    assert main(argv) == 0
    captured = capsys.readouterr()
    assert "3 views of the board, 2 along the stage" in captured.out
    assert "fix the board on the stage" in captured.err
    assert len(asked) == 4
    # The corners are drawn in colour over a photograph without any.
    picture = cv2.imread(str(live)).astype(int)
    assert picture.shape == (*photograph.shape, 3)
    assert np.ptp(picture[70 : 70 + 30, 70 : 70 + 30], axis=2).max() > 100
    session = read_session("session")
    assert session.stage is not None
    assert session.stage.steps == (0, 500)
    monkeypatch.setattr("builtins.input", lambda prompt: "q")
    assert main(["calibrate", "other", "--stage-frames", "0"]) == 2
    assert "ended after 0 poses" in capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_quick_and_imports_nothing_slow(command: str):
    code = "import sys; from hardware.cli.main import main; main(sys.argv[1:]); print(*sys.modules)"
    argv = [sys.executable, "-c", code, command, "--help"]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=60, check=True)
    assert "example:" in done.stdout
    assert not {"jax", "numpy", "cv2", "serial"} & set(done.stdout.splitlines()[-1].split())


def test_a_scan_by_command_needs_no_jax(scanner: Path):
    code = "import sys; from hardware.cli.main import main; main(sys.argv[1:]); print('jax' in sys.modules)"
    argv = [sys.executable, "-c", code, "scan", "cup", "--frames", "1", "--apart", "1"]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.splitlines()[-1] == "False"


@pytest.mark.skipif(not hasattr(signal, "SIGTSTP"), reason="no job control")
def test_ctrl_z_pauses_and_fg_goes_on(scanner: Path):
    """It stands after a whole frame, however long, and goes on to the end."""
    # Ten times as fast the line's answers would come late on a machine that has other work to do.
    (scanner / "scanner.toml").write_text(SCANNER.replace("21000", "21000&speed=4"))
    scan = ["scan", "cup", "--frames", "4", "--apart", "1000", "--settle=1", "--no-verify"]
    argv = [sys.executable, "-m", "hardware", *scan]
    child = subprocess.Popen(
        argv, stderr=subprocess.PIPE, text=True, env={"PYTHONPATH": str(Path(__file__).parents[2])}
    )
    assert child.stderr is not None
    assert "taken 0000.png" in child.stderr.readline()
    child.send_signal(signal.SIGTSTP)
    assert os.WIFSTOPPED(os.waitpid(child.pid, os.WUNTRACED)[1])
    taken = len(read_scan(scanner / "cup").frames)
    time.sleep(0.3)
    assert len(read_scan(scanner / "cup").frames) == taken < 4
    child.send_signal(signal.SIGCONT)
    _, err = child.communicate(timeout=60)
    assert child.returncode == 0
    assert "paused, the laser is off" in err
    assert len(read_scan(scanner / "cup").frames) == 4


def test_a_signal_switches_the_laser_off(scanner: Path):
    """SIGTERM in mid-move ends as Ctrl-C does: the block that guards the laser is left."""
    (scanner / "scanner.toml").write_text(SCANNER.replace("21000", "21000&speed=1"))
    argv = [sys.executable, "-m", "hardware", "home"]
    root = Path(__file__).parents[2]
    child = subprocess.Popen(argv, stderr=subprocess.PIPE, text=True, env={"PYTHONPATH": str(root)})
    try:
        child.wait(1.0)
    except subprocess.TimeoutExpired:
        child.terminate()
    _, err = child.communicate(timeout=20)
    assert child.returncode == 130
    assert err == "scanner: interrupted\n"
