"""`jaxscan compare` with the truth that a simulation has written."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.reconstruction import read_range_image
from jaxscan.simulation.accuracy import near_its_true_point
from jaxscan.simulation.folders import read_scan_truth


def compared(capsys: pytest.CaptureFixture[str], *words: object) -> dict:
    capsys.readouterr()
    assert main(["compare", *map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_points_against_those_of_the_same_frame_and_column(world: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = compared(capsys, world / "cup.npz", world / "truth")
    image, truth = read_range_image(world / "cup.npz"), read_scan_truth(world / "truth").points
    points = np.where(image.valid[..., None], image.points, np.nan)
    near = near_its_true_point(points, truth)
    rms = np.sqrt(np.mean(np.sum((points - truth)[near] ** 2, axis=1)))
    assert found["truth"]["to_true_point"] == pytest.approx(rms, rel=1e-5)
    assert found["truth"]["to_true_point_after_fit"] <= rms
    seen = np.isfinite(truth).all(axis=-1)
    assert found["truth"]["completeness"] == pytest.approx((image.valid & seen).sum() / seen.sum())
    assert found["figures"]["median_mm"] < rms < 1
    # The file by itself is the same; of a cloud the order of its points is not known.
    assert compared(capsys, world / "cup.npz", world / "truth" / "scan.npz")["truth"] == found["truth"]
    assert compared(capsys, world / "cup.ply", world / "truth")["truth"] is None
    assert main(["compare", str(world / "cup.npz"), str(world / "truth")]) == 0
    assert "from that of the same frame and column" in capsys.readouterr().out


def test_what_is_moved_is_further_off_and_fits_again(world: Path, tmp_path: Path, capsys) -> None:
    from dataclasses import replace

    from jaxscan.reconstruction import write_points

    image = read_range_image(world / "cup.npz")
    moved = replace(image, points=image.points + np.array([1.0, 0.0, 0.5], np.float32))
    write_points(tmp_path / "moved.npz", moved)
    before, after = (
        compared(capsys, path, world / "truth")["truth"] for path in (world / "cup.npz", tmp_path / "moved.npz")
    )
    assert after["to_true_point"] == pytest.approx(1.25**0.5, abs=0.2)
    assert after["to_true_point_after_fit"] == pytest.approx(before["to_true_point_after_fit"], abs=0.05)


def test_parts_of_a_scan_are_compared_by_distance_alone(world: Path, tmp_path: Path, capsys) -> None:
    from jaxscan.reconstruction import write_points

    write_points(tmp_path / "part.npz", read_range_image(world / "cup.npz")[:, ::2])
    found = compared(capsys, tmp_path / "part.npz", world / "truth")
    assert found["truth"] is None
    assert found["figures"]["points"] > 100


def test_what_is_no_truth_or_several_is_refused(world: Path, tmp_path: Path, capsys) -> None:
    cup = str(world / "cup.npz")
    assert main(["compare", cup, str(world / "session")]) == 2
    assert "session: is a folder, and not the folder truth of a simulation" in capsys.readouterr().err
    shutil.copytree(world / "truth", tmp_path / "truth")
    shutil.copy(tmp_path / "truth" / "scan.npz", tmp_path / "truth" / "scan-090.npz")
    assert main(["compare", cup, str(tmp_path / "truth")]) == 2
    assert "has the truth of 2 scans: name one of its files: scan-090.npz, scan.npz" in capsys.readouterr().err
    np.savez(tmp_path / "other.npz", position=np.zeros((2, 3)), points=np.zeros((3, 3)))
    assert main(["compare", cup, str(tmp_path / "other.npz")]) == 2
    assert 'other.npz: "position" and "points" have the shapes' in capsys.readouterr().err
    (tmp_path / "broken.npz").write_bytes(b"PK")
    assert main(["compare", cup, str(tmp_path / "broken.npz")]) == 2
    assert "broken.npz: " in capsys.readouterr().err
