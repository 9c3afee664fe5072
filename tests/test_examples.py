"""The files in examples/, run as they are, on photographs that are there already."""

import runpy
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from jaxscan import read_ply

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def folder(world: Path, tmp_path: Path) -> Path:
    (tmp_path / "world").symlink_to(world)
    return tmp_path


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    def run(name: str) -> str:
        monkeypatch.syspath_prepend(EXAMPLES)
        monkeypatch.setattr(sys, "argv", [name, str(tmp_path)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def number(said: str, after: str) -> float:
    """The first number that is said after some words."""
    return float(said.split(after)[1].split()[0].strip("[],:;"))


def test_all_are_here():
    tested = dict.fromkeys(name.split("_")[1] for name in globals() if name.startswith("test_0"))
    assert list(tested) == [path.name[:2] for path in sorted(EXAMPLES.glob("[0-9]*.py"))]
    for path in EXAMPLES.glob("*.py"):
        assert 20 <= len(path.read_text(encoding="utf-8").splitlines()) <= 60, path


def test_01_calibrate(run, folder, world):
    said = run("01_calibrate.py")
    assert "6 boards, 5 photographs of the stage" in said
    # As the command does it.
    assert (folder / "rig.json").read_bytes() == (world / "rig.json").read_bytes()


def test_02_reconstruct(run, folder, world):
    (folder / "rig.json").symlink_to(world / "rig.json")
    said = run("02_reconstruct.py")
    assert int(said.split()[0]) == len(read_ply(world / "cup.ply").points)
    cup = read_ply(folder / "cup.ply")
    assert cup.sigma is not None
    assert 0 < cup.sigma.max() < 0.2
    assert (folder / "sigma.png").read_bytes().startswith(b"\x89PNG")


def test_03_gradient_of_a_height(run, folder, world):
    (folder / "rig.json").symlink_to(world / "rig.json")
    said = run("03_gradient_of_a_height.py")
    assert abs(number(said, "height over the floor") - 5) < 0.05
    alone, whole = (number(said, words) for words in ("light plane alone", "whole rig"))
    # Both are in the rig's covariance, which has its own tests; what a height owes to the plane, the camera takes back.
    assert 0 < whole < alone < 0.01


def test_04_next_board_pose(run, folder):
    said = run("04_next_board_pose.py")
    first, second = (float(line.split()[-2]) for line in said.splitlines() if "falls to" in line)
    assert number(said, "point now:") > first > second
    assert (folder / "next.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_05_merge_eight_sides(run, tmp_path):
    said = run("05_merge_eight_sides.py")
    assert number(said, "closes within") < 0.05
    low, high = trimesh.load_mesh(tmp_path / "figure.stl").bounds
    assert np.linalg.norm(high - low) > 50


def test_06_drive_a_simulated_scanner(run):
    said = run("06_drive_a_simulated_scanner.py")
    assert "laser off: True; still to be taken: (24000, 36000, 48000)" in said
    assert said.count("points") == 5


@pytest.mark.long
def test_07_what_narrows_a_dimension(run, folder):
    said = run("07_what_narrows_a_dimension.py")
    assert abs(number(said, "right over left:")) < 0.1
    rig, pixels, again, new = (
        float(said.split(words)[1].split()[0])
        for words in (
            "σ of the rig's part ",
            "σ from all photographs: ",
            "σ of the rig's part falls to ",
            "°: it falls to ",
        )
    )
    # The noise of all pixels, through the solve, is the rig's part; a pose that is looked for beats those there are.
    assert abs(pixels / rig - 1) < 0.1
    assert new < again < rig


def test_08_publish_for_ros(run, folder, world, monkeypatch):
    (folder / "cup.ply").symlink_to(world / "cup.ply")
    monkeypatch.setitem(sys.modules, "rclpy", None)
    said = run("08_publish_for_ros.py")
    assert (
        f"{len(read_ply(world / 'cup.ply').points)} points of 24 bytes: x, y, z, sigma, sigma_pixel, intensity" in said
    )
    assert "rclpy is not there, so nothing is published: set ROS 2 up in this shell" in said


def test_08_hands_ros_what_its_message_has(run, folder, world, monkeypatch):
    """A stand-in of rclpy and sensor_msgs, by the names that they have: what is published is kept."""
    (folder / "cup.ply").symlink_to(world / "cup.ply")
    sent = []
    field, clock = (
        lambda **named: SimpleNamespace(**named),
        SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: 17)),
    )

    class Node:
        def __init__(self, name):
            assert name == "jaxscan"

        def create_publisher(self, kind, topic, depth):
            return SimpleNamespace(publish=lambda message: sent.append((topic, message)))

        def get_clock(self):
            return clock

        def create_timer(self, period, send):
            self.send = send

        def destroy_node(self):
            sent.append("destroyed")

    def spin(node):
        node.send()
        raise KeyboardInterrupt

    rclpy = SimpleNamespace(init=lambda: None, create_node=Node, spin=spin)
    msg = SimpleNamespace(
        PointCloud2=lambda **named: SimpleNamespace(header=SimpleNamespace(), **named), PointField=field
    )
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    monkeypatch.setitem(sys.modules, "sensor_msgs", SimpleNamespace(msg=msg))
    monkeypatch.setitem(sys.modules, "sensor_msgs.msg", msg)
    run("08_publish_for_ros.py")
    (topic, message), ended = sent
    assert (topic, ended) == ("/jaxscan/points", "destroyed")
    assert (message.header.stamp, message.header.frame_id) == (17, "scanner_optical_frame")
    assert len(message.data) == message.row_step == message.width * message.point_step
    assert [(each.name, each.offset) for each in message.fields][:3] == [("x", 0), ("y", 4), ("z", 8)]


def test_09_profiles_of_a_gear(run, tmp_path):
    said = run("09_profiles_of_a_gear.py")
    assert "from 140 profiles of 321" in said
    assert abs(number(said, "the gear is") - 6) < 0.003
    mesh = trimesh.load_mesh(tmp_path / "gear.stl")
    # One piece, of the area that was drawn: a tooth's width in angle follows the rim.
    angle = np.linspace(0, 2 * np.pi, 100_000, endpoint=False)
    rim = 12.0 + 1.5 * np.clip(3.0 * np.sin(14 * angle), -1.0, 1.0)
    drawn = 0.5 * np.mean(rim**2 - 4.0**2) * 2 * np.pi
    assert 0.93 < mesh.area / drawn < 1.0
    assert (tmp_path / "gear" / "profiles.toml").is_file()
