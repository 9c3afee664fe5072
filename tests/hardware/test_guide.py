"""What the guide of a calibration session asks for; the session that comes of it is in `test_end_to_end`."""

from pathlib import Path

import numpy as np
import pytest

from hardware.cli.main import main
from hardware.coverage import ViewsSoFar, draw_coverage
from hardware.errors import PositionUncertainError
from hardware.guide import guided_session
from hardware.scan import Devices
from hardware.simulated.camera import SimulatedCamera, SimulatedWorld
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.operator import SimulatedOperator
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Travel
from jaxscan.errors import InputError
from jaxscan.files.session import read_session
from jaxscan.images import find_board, read_image
from jaxscan.simulation import rig_2003


def test_the_guide_asks_for_what_is_missing() -> None:
    board = rig_2003.BOARD
    views = ViewsSoFar(board)
    assert "fills the middle" in views.wish()
    points = board.points()[:, :2]
    views.add(points + 100, (640, 480))
    assert "tilt" in views.wish()
    assert 0 < views.share < 0.5
    x, y = ((points - points.mean(axis=0)) / 60).T
    for lean_x, lean_y in ((0.4, 0), (-0.4, 0), (0, 0.8), (0, -0.8)):
        depth = 1 + lean_x * x + lean_y * y
        views.add(np.stack([320 + 60 * x / depth, 240 + 60 * y / depth], axis=1), (640, 480))
    assert "now move the board to the upper" in views.wish()
    assert views.tilted == dict.fromkeys(("right", "left", "lower", "upper"), True)


def test_covered_cells_are_drawn_where_they_are() -> None:
    views = ViewsSoFar(rig_2003.BOARD)
    corners = np.full((len(rig_2003.BOARD.points()), 2), np.nan)
    # The last pixel of a cell, the first of the next, and the edges of the image.
    corners[:6] = [(159, 100), (160, 200), (639.4, 479.4), (-0.4, 479), (10, 10), (20, 20)]
    views.add(corners, (640, 480))
    assert np.argwhere(views.covered).tolist() == [[0, 0], [1, 1], [2, 0], [2, 3]]
    shown = draw_coverage(np.zeros((480, 640, 3), np.uint8), views.covered)
    tint = shown[80::160, 80::160]
    assert np.array_equal(tint[..., 1] > 20, views.covered)


def test_the_board_on_the_turntable_of_the_simulated_scanner(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its corners are where the true rig sees the board that leans on the table, turned by the frame's steps."""
    monkeypatch.chdir(tmp_path)
    argv = ["calibrate", "session", "--views", "3", "--stage-frames", "2", "--stage-apart", "30000"]
    assert main([*argv, "--turntable-frames", "3", "--turntable-at", "48000"]) == 0
    captured = capsys.readouterr()
    assert "3 views of the board, 2 along the stage, 3 on the turntable" in captured.out
    assert "lean the board on the turntable" in captured.err
    session = read_session(tmp_path / "session")
    table = session.turntable
    assert table is not None
    assert (table.steps, table.stage_step) == ((0, 1067, 2133), 48000)
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(0), 0)
    leaning = rig_2003.turntable_pose(rig, 0)
    moved = rig_2003.stage_travel(rig, np.array([48000]))
    poses = rig_2003.turned_boards(rig, leaning, np.array(table.steps))
    for path, pose in zip(table.images, poses, strict=True):
        found = find_board(session.board, read_image(path))
        assert found is not None
        points = session.board.points() @ pose.matrix().T + pose.translation + moved
        expected = np.asarray(rig_2003._project(rig.camera, points))
        # A board of an even by an odd number of corners has one order, wherever it is turned.
        assert np.abs(found.corners - expected).max() < 0.5


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["--turntable-frames", "2", "--turntable-at", "0"], "2 turntable photographs: give 3 or more"),
        (["--turntable-frames", "4"], "--turntable-at: say where the stage"),
        (["--turntable-frames", "4", "--turntable-at", "90000"], "the stage goes from 0 to 80000"),
        (["--turntable-frames", "4000", "--turntable-at", "0"], "give 1 to 3200"),
    ],
)
def test_turntables_that_cannot_be(tmp_path: Path, monkeypatch, capsys, argv: list[str], says: str) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", "session", *argv]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "session").exists()


def test_a_sequence_of_an_axis_that_the_scanner_lacks(tmp_path: Path) -> None:
    devices = Devices(None, {}, None)  # pyright: ignore[reportArgumentType]
    for name in ("stage", "turntable"):
        with pytest.raises(InputError, match=f"3 {name} photographs: this scanner has no {name}"):
            guided_session(tmp_path, devices, rig_2003.BOARD, None, **{f"{name}_steps": (0, 1, 2)})


@pytest.mark.parametrize("push", [0, -60])
def test_photographs_along_a_stage_that_lost_steps_are_left_out(tmp_path: Path, push: int) -> None:
    """The switch is met again after the last photograph; one that stands where it says is found to."""
    stage, laser, world = SimulatedStage(Travel(last=60000)), SimulatedLaser(), SimulatedWorld()
    said: list[str] = []

    def say(words: str) -> None:
        said.append(words)
        if push and words.startswith("step 0"):
            stage.line.port.axis.push(push, stage.line.port.clock.now_s())

    devices = Devices(SimulatedCamera(world, {"stage": stage}, laser), {"stage": stage}, laser)
    hand = SimulatedOperator(world, 3, say)
    if push:
        with pytest.raises(PositionUncertainError, match=r"the stage by 60 steps: .*session.toml leaves the stage"):
            guided_session(tmp_path / "session", devices, rig_2003.BOARD, hand, views=3, stage_steps=(0, 30000))
    else:
        guided_session(tmp_path / "session", devices, rig_2003.BOARD, hand, views=3, stage_steps=(0, 30000))
    session = read_session(tmp_path / "session")
    assert (session.stage is None) == bool(push)
    assert len(session.views.boards) == 3
