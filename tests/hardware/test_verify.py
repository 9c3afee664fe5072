"""A board that rides on the stage, in photographs that are drawn: lost steps are marked, and said by reconstruct."""

import json
from pathlib import Path

import pytest

from hardware.cli.main import main
from hardware.scan import Devices, take
from hardware.scan_plan import Plan, ScanFolder, alone_in
from hardware.simulated.camera import SimulatedCamera, SimulatedWorld
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Travel
from jaxscan import RigFile, write_rig
from jaxscan.files.place_checks import doubts
from jaxscan.files.scan import read_scan

STEPS = (0, 6000, 12000, 18000)


def scanned(folder: Path, push: int = 0) -> None:
    """A scan of the board on the stage; before its third photograph a hand pushes the load."""
    stage, laser, world = SimulatedStage(Travel(last=20000)), SimulatedLaser(), SimulatedWorld()
    world.put_board()
    devices = Devices(SimulatedCamera(world, {"stage": stage}, laser), {"stage": stage}, laser)
    scan = ScanFolder.create(folder / "cup", Plan({"stage": STEPS}, settle_s=0))

    def taken(path: Path, frame: object) -> None:
        if push and len(scan.done.frames) == 2:
            stage.line.port.axis.push(push, stage.line.port.clock.now_s())

    take(scan, devices, taken=taken)
    write_rig(folder / "rig.json", RigFile(world.rig))


def verify(folder: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[int, str, str]:
    status = main(["verify", str(folder / "cup"), "--rig", str(folder / "rig.json"), *more])
    said = capsys.readouterr()
    return status, said.out, said.err


@pytest.mark.timeout(300)
@pytest.mark.parametrize("push", [0, -60])
def test_drawn_photographs(tmp_path: Path, capsys: pytest.CaptureFixture[str], push: int):
    scanned(tmp_path, push)
    status, out, _ = verify(tmp_path, capsys, "--json")
    assert status == 0
    result = json.loads(out)
    assert result["seen"] == [0, 1, 2, 3]
    for off, sigma, lost in zip(result["off"]["stage"], result["sigma"]["stage"], [0, 0, push, push], strict=True):
        assert off == pytest.approx(lost, abs=max(4.0, 4 * sigma))
    checks = read_scan(tmp_path / "cup").checks
    assert [(check.first, check.last, bool(check.off)) for check in checks] == (
        [(0, 1, False), (2, 3, True)] if push else [(0, 3, False)]
    )
    said = list(doubts(checks))
    assert len(said) == (1 if push else 0)
    assert all("the board that rides on it is seen elsewhere" in one for one in said)
    # Once more replaces what was found before.
    assert verify(tmp_path, capsys, "--every", "3")[0] == 0
    assert all(check.by_board for check in read_scan(tmp_path / "cup").checks)
    if push:
        assert [(check.first, check.last) for check in read_scan(tmp_path / "cup").checks] == [(0, 0), (1, 3)]


@pytest.mark.timeout(300)
def test_what_cannot_be(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    scanned(tmp_path)
    status, _, err = verify(tmp_path, capsys, "--board", "12x9", "--every", "3")
    assert (status, "the board is in 0 of 4 photographs" in err) == (2, True)
    assert verify(tmp_path, capsys, "--board", "9")[0] == 2
    assert verify(tmp_path, capsys, "--every", "0")[0] == 2
    with alone_in(tmp_path / "cup"):
        status, _, err = verify(tmp_path, capsys)
    assert (status, "in use" in err) == (2, True)
    assert read_scan(tmp_path / "cup").checks == ()
    # Squares of another size are the same board further away, and its way is longer.
    status, out, _ = verify(tmp_path, capsys, "--square", "20")
    assert (status, "--square or the rig may be wrong" in out) == (0, True)
