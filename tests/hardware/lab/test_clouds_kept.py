"""A cloud that is kept is one of this rig, these photographs and how their stripe is looked for."""

import os
from pathlib import Path

import numpy as np
import pytest

import jaxscan
from hardware.lab.projects import Projects
from hardware.lab.reconstructor import Reconstructor
from hardware.lab.refusal import Refusal
from jaxscan.images import write_image


def rig_of(distance: float) -> jaxscan.RigFile:
    camera = jaxscan.Camera.create((80, 64), (60.0, 60.0), (39.5, 31.5))
    plane = jaxscan.LightPlane.create((0.0, -1 / distance, 0.003))
    return jaxscan.RigFile(jaxscan.Rig(camera, (plane,), jaxscan.Linear.create((0.0, 0.0009, -0.0004))))


def test_what_a_cloud_is_made_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    made: list[object] = []

    def count(made_by: Reconstructor, rig: str, scan: Path, to: Path) -> None:
        made.append((rig, scan))
        to.write_text(str(len(made)))

    monkeypatch.setattr(Reconstructor, "make", count)
    folder = tmp_path / "projects" / "cup"
    (folder / "frames").mkdir(parents=True)
    listing = '[scan]\nframes = ["frames/0.png"]\nsteps = [0]\n'
    (folder / "scan.toml").write_text(listing)
    write_image(folder / "frames" / "0.png", np.zeros((64, 80, 3), np.uint8))
    first, second = Projects(tmp_path, rig_of(250.0)), Projects(tmp_path, rig_of(260.0))
    assert [first.cloud("cup").read_text() for _ in range(2)] == ["1", "1"]
    # Another rig, as after a new calibration and a restart.
    assert second.cloud("cup").read_text() == "2"
    # How the stripe is looked for.
    (folder / "scan.toml").write_text('[laser]\ncolor = "green"\n' + listing)
    assert second.cloud("cup").read_text() == "3"
    # A photograph was replaced by another: the project was removed, and begun again.
    write_image(folder / "frames" / "0.png", np.full((64, 80, 3), 9, np.uint8))
    os.utime(folder / "frames" / "0.png", ns=(1, 1))
    assert second.cloud("cup").read_text() == "4"
    assert len(list((tmp_path / "clouds").iterdir())) == 1


def test_points_are_made_by_a_process_of_their_own(tmp_path: Path):
    """It is begun again when it was killed, and says what is wrong with a scan."""
    folder = tmp_path / "projects" / "cup"
    (folder / "frames").mkdir(parents=True)
    (folder / "scan.toml").write_text('[scan]\nframes = ["frames/0.png"]\nsteps = [0]\n')
    image = np.full((64, 80, 3), 20, np.uint8)
    rows = np.arange(64)[:, None]
    image[..., 0] += (200 * np.exp(-((rows - 40 - 3 * np.sin(np.arange(80) / 12)) ** 2) / 8)).astype(np.uint8)
    write_image(folder / "frames" / "0.png", image)
    projects = Projects(tmp_path, rig_of(250.0))
    try:
        cloud = projects.cloud("cup")
        assert cloud.read_bytes().startswith(b"ply")
        child = projects._reconstructor._child
        assert child is not None
        child.kill()
        child.wait()
        write_image(folder / "frames" / "0.png", image[:32])
        with pytest.raises(Refusal, match="32"):
            projects.cloud("cup")
    finally:
        projects.close()
