"""The pipeline of 2003: the Octave scripts against the NumPy transcription, and both against a drawn world."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import octave, transcription
from benchmarks.drawn_2003 import FLOOR, MOVE, OMEGA, Drawing
from benchmarks.pipeline_2003 import Job, Quirks

FLAT = Quirks(**dict.fromkeys(Quirks().as_dict(), False))

needs_octave = pytest.mark.skipif(octave.octave() is None, reason=octave.MISSING)


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    """Six boards, five on the stage, three photographs of the floor; some corners were not found."""
    # Pairs of stripe points on a board are gone through one by one.
    job = Drawing(tmp_path_factory.mktemp("drawn"), every=6).job(6, 5, 3)
    job.corners[1, 7] = job.corners[4, 30:33] = np.nan
    clicks = np.column_stack([np.linspace(-60, 60, 10), np.tile([28.0, 30.0], 5)])
    return replace(job, clicks=clicks)


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


def test_put_right_it_finds_what_was_drawn(job: Job) -> None:
    outcome = transcription.run(job, FLAT)
    np.testing.assert_allclose(outcome.focal, np.diag(Drawing(Path()).K)[:2], rtol=5e-4)
    np.testing.assert_allclose(outcome.laser_plane, OMEGA, rtol=0, atol=3e-6)
    np.testing.assert_allclose(outcome.stage_move, MOVE, rtol=0, atol=0.005)
    first = outcome.points[outcome.frame == 0]
    # A mean of whole rows above a threshold scatters by some tenths of a pixel, and of a millimetre.
    assert np.sqrt((((first @ FLOOR - 1) / np.linalg.norm(FLOOR)) ** 2).mean()) < 0.25


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
