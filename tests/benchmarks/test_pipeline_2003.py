"""The pipeline of 2003: the Octave scripts against the NumPy transcription, and both against a drawn world."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks import octave, transcription
from benchmarks.pipeline_2003 import Job, Outcome, Quirks
from jaxscan.images import write_image

K = np.array([[697.7, 0, 310.3], [0, 690.4, 228.1], [0, 0, 1]])
LENS = np.array([-0.134, 0.0, 0.0, 0.0])
OMEGA = np.array([0.0001, -0.00494, 0.00303])
MOVE = np.array([0.06, 1.84, -0.78])
FLAT = Quirks(**dict.fromkeys(Quirks().as_dict(), False))

needs_octave = pytest.mark.skipif(octave.octave() is None, reason=octave.MISSING)


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    """Six boards and five on the stage, corners noisy and a few missing; stripes painted where the sheet meets them."""
    folder, random = tmp_path_factory.mktemp("drawn"), np.random.default_rng(0)
    board = 16.0 * np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), axis=-1).reshape(-1, 2)
    corners, photos = [], []
    for i in range(6):
        # z points at the camera.
        turn = cv2.Rodrigues(random.uniform(-0.5, 0.5, 3))[0] @ np.diag([1.0, -1.0, -1.0])
        R, t = turn, np.array([0.0, 6.0 * i - 15.0, 340.0]) - turn @ [64, 40, 0]
        corners.append(seen(board, R, t) + 0.03 * random.normal(size=board.shape))
        # Pairs of stripe points are gone through one by one.
        photos.append(paint(folder / f"board-{i}.png", R[:, 2] / (R[:, 2] @ t), random, every=6))
    corners = np.array(corners)
    corners[1, 7] = corners[4, 30:33] = np.nan
    R = np.diag([1.0, -1.0, -1.0])
    stage = [
        seen(board, R, np.array([-64.0, 30.0, 340.0]) + i * MOVE) + 0.03 * random.normal(size=board.shape)
        for i in range(5)
    ]
    scan = []
    for i in range(3):
        floor = np.array([0.0, -0.0005, 1 / 350])
        # The floor and what stands on it move with the stage.
        scan.append(paint(folder / f"scan-{i}.png", floor / (1 + i * floor @ MOVE), random))
    clicks = np.column_stack([np.linspace(-60, 60, 10), np.tile([28.0, 30.0], 5)])
    return Job((640, 480), board, corners, np.array(stage), tuple(photos), tuple(scan), clicks)


def seen(board: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    points = np.column_stack([board, np.zeros(len(board))])
    return cv2.projectPoints(points, cv2.Rodrigues(R)[0], t, K, LENS)[0][:, 0]


def paint(path: Path, plane: np.ndarray, random: np.random.Generator, every: int = 1) -> Path:
    """A photograph of the sheet's line on a plane, whose light falls off over a few pixels; some columns stay dark."""
    u, v = np.meshgrid(np.arange(640.0), np.arange(480.0))
    ray = cv2.undistortPoints(np.stack([u, v], axis=-1).reshape(-1, 1, 2), K, LENS).reshape(480, 640, 2)
    off = ray @ (OMEGA - plane)[:2] + (OMEGA - plane)[2]
    rows = off / np.gradient(off, axis=0)
    image = random.uniform(0, 6, (480, 640, 3))
    image[..., 0] += 240 * np.exp(-0.5 * (rows / 1.8) ** 2)
    image[:, np.arange(640) % every > 0] = image[:, 300:302] = 0
    write_image(path, image.clip(0, 255).astype(np.uint8))
    return path


@needs_octave
@pytest.mark.parametrize("quirks", [Quirks(), Quirks(loops=False), FLAT], ids=["faithful", "not by loops", "put right"])
def test_octave_and_numpy_agree(job: Job, quirks: Quirks, tmp_path: Path) -> None:
    a = octave.run(replace(job, ply=tmp_path / "mesh.ply"), quirks)
    b = transcription.run(replace(job, ply=tmp_path / "none.ply"), quirks)
    for name in ("frame", "column", "kept"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    for name in ("focal", "principal", "k1", "rotations", "translations", "planes", "laser_plane", "stage_move"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-9, atol=1e-9, err_msg=name)
    # A singular vector's sign is free.
    signs = np.sign((a.lines * b.lines).sum(axis=1, keepdims=True)) if not quirks.mean_line else 1.0
    np.testing.assert_allclose(signs * a.lines, b.lines, rtol=0, atol=1e-9)
    np.testing.assert_allclose(a.board_stripes, b.board_stripes, rtol=0, atol=1e-9)
    np.testing.assert_allclose(a.points, b.points, rtol=0, atol=1e-9)
    # Four corners of one circle have two triangulations, and the other side may choose the other.
    assert abs(len(a.faces) - len(b.faces)) <= 0.01 * len(b.faces)
    assert a.points.shape[0] > 1800
    assert set(a.seconds) >= {"camera", "lines", "stage", "detect", "triangulate", "mesh"}


@needs_octave
def test_the_mesh_is_an_ascii_ply_which_its_reader_reads(job: Job, tmp_path: Path) -> None:
    path = tmp_path / "mesh.ply"
    outcome = octave.run(replace(job, clicks=np.zeros((0, 2)), scan_photos=job.scan_photos[:2], ply=path), FLAT)
    said = octave.evaluate(f"[p, f] = read_ply('{path}'); printf('%d %d %.4f', rows(p), rows(f), p(1, 3))").split()
    assert [int(said[0]), int(said[1])] == [len(outcome.points), len(outcome.faces)]
    assert abs(float(said[2]) - outcome.points[0, 2]) < 1e-4
    path.write_bytes(b"ply\nformat binary_little_endian 1.0\nend_header\n")
    with pytest.raises(RuntimeError, match="only ASCII is read"):
        octave.evaluate(f"read_ply('{path}');")


def off_floor(outcome: Outcome, index: int = 0) -> np.ndarray:
    """Distances of the points of the first frame from the drawn floor, moved back by so many moves, mm."""
    plane = np.array([0.0, -0.0005, 1 / 350])
    points = outcome.points[outcome.frame == 0] + index * outcome.stage_move
    return (points @ plane - 1) / np.linalg.norm(plane)


def test_put_right_it_finds_what_was_drawn(job: Job) -> None:
    outcome = transcription.run(job, FLAT)
    np.testing.assert_allclose(outcome.focal, K[[0, 1], [0, 1]], rtol=0.003)
    np.testing.assert_allclose(outcome.laser_plane, OMEGA, rtol=0, atol=3e-5)
    np.testing.assert_allclose(outcome.stage_move, MOVE, rtol=0, atol=0.02)
    assert np.sqrt((off_floor(outcome) ** 2).mean()) < 0.3


def test_each_quirk_does_what_it_says(job: Job) -> None:
    was = transcription.run(job)
    changed = {
        name: transcription.run(job, replace(Quirks(), **{name: False}))
        for name in ("pixels_from_one", "index_from_one", "whole_rows", "mean_line", "mean_of_pairs", "first_and_last")
    }
    # A move more, and the column and row of each pixel one less.
    np.testing.assert_allclose(changed["index_from_one"].points, was.points + was.stage_move, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(changed["pixels_from_one"].board_stripes[:, 1:], was.board_stripes[:, 1:] - 1)
    np.testing.assert_array_equal(changed["pixels_from_one"].column, was.column)
    rows = changed["whole_rows"].board_stripes[:, 2]
    np.testing.assert_array_equal(was.board_stripes[:, 2], np.floor(rows + 0.5))
    assert np.ptp(rows % 1) > 0.4
    for name in ("mean_line", "mean_of_pairs"):
        assert np.abs(changed[name].laser_plane - was.laser_plane).max() > 1e-9, name
    assert np.abs(changed["first_and_last"].stage_move - was.stage_move).max() > 1e-6
    # The floor's clicks: what is left is more than 5 mm off a plane through the first.
    assert not was.kept.all()


def test_a_board_whose_z_points_away_puts_every_point_behind_the_camera(job: Job) -> None:
    flipped = job.board * [1.0, -1.0] + [0.0, job.board[:, 1].max()]
    away = replace(job, board=flipped)
    for quirks, behind in ((Quirks(), True), (replace(Quirks(), board_sign=False), False)):
        outcome = transcription.run(away, quirks)
        assert (outcome.points[outcome.frame == 0, 2] < 0).all() == behind
