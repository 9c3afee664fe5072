"""Folders that the simulator writes, read back by the readers of real ones."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.rig_file import read_rig
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session
from jaxscan.images import find_board, read_image
from jaxscan.precision import as_float64, float64
from jaxscan.simulation import folders, rig_2003
from jaxscan.simulation.shapes import sphere


@pytest.fixture(autouse=True)
def few_photographs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig_2003, "BOARD_VIEWS", 3)
    monkeypatch.setattr(rig_2003, "STAGE_VIEWS", 3)


def test_session_scan_and_truth(tmp_path: Path) -> None:
    counted = []
    session_truth = folders.simulate_session(tmp_path / "session", 4, advance=counted.append)
    assert sum(counted) == 6
    session = read_session(tmp_path / "session")
    assert session.board == rig_2003.BOARD
    assert len(session.views.boards) == 3
    assert session.views.stripes is None
    assert session.stage is not None
    assert session.stage.steps == (0, 2000, 4000)
    rig = session_truth.rig
    scene = rig_2003.scan_scene(rig, (sphere(rig_2003.OBJECT_Y),))
    truth = folders.simulate_scan(tmp_path / "scan", rig, scene, 4, name="ball", frames=2, steps_apart=30000)
    scan = read_scan(tmp_path / "scan")
    assert scan.name == "ball"
    assert scan.axes["stage"] == (0, 30000)
    frame = read_image(scan.frames[1])
    strongest = np.argmax(frame[..., 0].astype(int) - frame[..., 1], axis=0)
    seen = np.isfinite(truth.position[1])
    assert (np.abs(strongest - truth.position[1])[seen] < 3).mean() > 0.98
    folders.write_truth(tmp_path / "truth", session_truth, truth)
    written = read_rig(tmp_path / "truth" / "rig.json").rig
    assert [float(x) for x in written.lights[0].plane] == [float(x) for x in rig.lights[0].plane]
    values = json.loads((tmp_path / "truth" / "session.json").read_text())
    np.testing.assert_array_equal([b["rotation"] for b in values["boards"]], session_truth.boards.rotation)
    np.testing.assert_array_equal(values["stage"]["translation"], session_truth.stage.translation)
    again = folders.read_scan_truth(tmp_path / "truth")
    np.testing.assert_array_equal(again.points, truth.points)
    assert again.points.shape == (2, 640, 3)
    assert not [path for path in tmp_path.rglob("*.part")]


def test_a_board_on_the_turntable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig_2003, "TURNTABLE_VIEWS", 3)
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(1), 1)
    truth = folders.simulate_session(tmp_path / "session", 1, rig=rig)
    session = read_session(tmp_path / "session")
    assert session.turntable is not None
    assert session.turntable.steps == truth.turntable_steps == (0, 1066, 2132)
    assert session.turntable.stage_step == rig_2003.turntable_stage_step(rig)
    folders.write_truth(tmp_path / "truth", truth)
    values = json.loads((tmp_path / "truth" / "session.json").read_text())
    assert truth.turntable is not None
    np.testing.assert_array_equal(values["turntable"]["translation"], truth.turntable.translation)
    # The corners are where the truth has them.
    boards = rig_2003.turned_boards(rig, truth.turntable, np.array(values["turntable_steps"]))
    moved = rig_2003.stage_travel(rig, np.array([values["turntable_stage_step"]]))
    for path, board in zip(session.turntable.images, boards, strict=True):
        found = find_board(rig_2003.BOARD, read_image(path))
        assert found is not None
        X = board.apply(rig_2003.BOARD.points()) + moved
        with float64():
            seen = jax.vmap(as_float64(rig.camera).project)(jnp.asarray(X))
        assert np.abs(np.asarray(seen) - found.corners).max() < 0.1


def test_two_lasers_are_photographed_one_by_one(tmp_path: Path) -> None:
    folders.simulate_session(tmp_path, 0, rig=rig_2003.simulated_rig(0, lasers=2))
    session = read_session(tmp_path)
    assert [laser.name for laser in session.lasers] == ["upper", "lower"]
    assert session.views.stripes is not None
    lit = [
        read_image(path)[..., 0].max()
        for path in (session.views.boards[0], session.views.stripes["upper"][0], session.views.stripes["lower"][0])
    ]
    assert lit[0] < 120
    assert lit[1] == 255


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="choose another folder"):
        folders.simulate_session(tmp_path / "file" / "session")
    with pytest.raises(InputError, match="no such file"):
        folders.read_scan_truth(tmp_path)
