"""Photographs that several tests share, and what the commands make of them."""

from pathlib import Path

import pytest

from jaxscan.cli.main import main
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_scan, simulate_session, write_truth
from jaxscan.simulation.shapes import cup

CALIBRATE = "jaxscan calibrate session -o rig.json --report report"


def make(folder: Path) -> None:
    """A session of six boards and five stage photographs, a scan of five frames, calibrated and reconstructed."""
    folder.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_2003, "BOARD_VIEWS", 6)
        patch.setattr(rig_2003, "STAGE_VIEWS", 5)
        session = simulate_session(folder / "session", 1)
    scene = rig_2003.scan_scene(session.rig, cup(rig_2003.OBJECT_Y))
    scan = simulate_scan(folder / "scan", session.rig, scene, 1, frames=5, steps_apart=12000)
    write_truth(folder / "truth", session, scan)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(CALIBRATE.split()[1:]) == 0
    points = ["-o", str(folder / "cup.ply"), "-o", str(folder / "cup.npz")]
    assert main(["reconstruct", str(folder / "scan"), "--rig", str(folder / "rig.json"), *points]) == 0
