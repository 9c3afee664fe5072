"""Scans on a stage with play: where each frame stands is told by the order of the frames, however they are read."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxscan.files.axes import StepRule
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings, read_image, write_image
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import Scanner, read_range_image, reconstruct, write_points
from jaxscan.reconstruction.turns import with_runs
from jaxscan.rig import Camera, Covariance, LightPlane, Linear, Rig, run_of, runs
from jaxscan.rig.play import LinearWithPlay
from jaxscan.rig.rig import parameter_names

ROWS, COLUMNS = 96, 40
PER_STEP, PLAY, STEP = np.array([0.0, 0.0025, 0.0]), 80.0, 200
GREY = StripeSettings("grey")
STEPS = (*range(0, 4000, STEP), *range(3900, 0, -STEP))


def scanner(play: float | None = PLAY, per_step=PER_STEP):
    with float64():
        camera = Camera.create((COLUMNS, ROWS), np.array([600.0, 600.0]), np.array([20.0, 48.0]))
        stage = Linear.create(per_step)
        part = stage if play is None else LinearWithPlay.from_plain(stage, play)
        rig = as_numpy(Rig(camera, (LightPlane.create(np.array([0.0, -0.005, 1 / 300])),), part))
    names = tuple(parameter_names(rig))
    variances = np.where([".play." in name for name in names], 4.0, 1e-12)
    return RigFile(rig, Covariance(names, np.diag(variances)))


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    """A wall before the camera; each frame shows the stripe at the same rows."""
    folder = tmp_path_factory.mktemp("scan")
    v, random = np.arange(ROWS)[:, None], np.random.default_rng(0)
    levels = 500 + 40000 * np.exp(-0.5 * ((v - 48.3) / 1.3) ** 2) * np.ones(COLUMNS)
    paths = []
    for i in range(len(STEPS)):
        paths.append(folder / f"{i}.png")
        image = levels + 50 * random.standard_normal(levels.shape)
        write_image(paths[-1], np.rint(image).astype(np.uint16))
    return Scan(folder / "scan.toml", GREY, tuple(paths), axes={"stage": STEPS})


@pytest.fixture(scope="module")
def image(scan):
    return reconstruct(scanner(), scan, detector="gravity")


def test_each_frame_stands_where_its_direction_says(image, scan):
    plain = reconstruct(scanner(None), scan, detector="gravity")
    assert plain.positions.keys() == {"stage"}
    assert image.positions[run_of("stage")].tolist() == runs(np.array(STEPS)).tolist()
    moved = np.nanmedian(image.points - plain.points, axis=1)
    # What lags behind its steps was carried less far: brought back to step 0 its points stand farther on.
    expected = np.sign(runs(np.array(STEPS)))[:, None] * PLAY / 2 * PER_STEP
    np.testing.assert_allclose(moved, expected, atol=2e-5)
    np.testing.assert_array_equal(image.pixels, plain.pixels)


def test_its_sigma_has_the_part_of_the_play(scan):
    # σ is that along the ray, so the stage goes that way.
    known = scanner(per_step=PER_STEP[[0, 2, 1]])
    image = reconstruct(known, scan, detector="gravity")
    rest = reconstruct(replace(known, covariance=_without_play(known.covariance)), scan, detector="gravity")
    more = np.sqrt(np.nanmedian(image.sigma**2 - rest.sigma**2, axis=1))
    np.testing.assert_allclose(more, 0.5 * 2.0 * PER_STEP[1], rtol=0.05)


def _without_play(covariance):
    matrix = covariance.matrix.copy()
    matrix[-1, -1] = 0.0
    return replace(covariance, matrix=matrix)


def test_no_play_is_what_there_was_to_the_bit(scan):
    zero, plain = (reconstruct(scanner(play), scan, detector="gravity") for play in (0.0, None))
    np.testing.assert_array_equal(zero.points, plain.points)


def test_a_scan_of_one_pass_is_shifted_by_half_of_it(scan):
    there = replace(scan, frames=scan.frames[:20], axes={"stage": STEPS[:20]})
    back = replace(scan, frames=scan.frames[:20], axes={"stage": STEPS[:20][::-1]})
    one, other = (reconstruct(scanner(), each, detector="gravity") for each in (there, back))
    apart = np.nanmedian(one.points - other.points[::-1], axis=1)
    np.testing.assert_allclose(apart[10], PLAY * PER_STEP, atol=5e-4)


def test_frames_as_they_come_know_it_too(image, scan):
    given = [(read_image(path), {"stage": step}) for path, step in zip(scan.frames, STEPS, strict=True)]
    parts = list(Scanner(scanner(), detector="gravity").frames(given, GREY, batch=4))
    np.testing.assert_array_equal(np.concatenate([part.points for part in parts]), image.points)


def test_exposures_are_merged_with_it(scan):
    n = 6
    paths, steps = scan.frames[: 2 * n], np.repeat(STEPS[:n], 2)
    twice = replace(scan, frames=paths, axes={"stage": tuple(steps.tolist())}, exposures_s=(0.01, 0.01) * n)
    merged = reconstruct(scanner(), twice, detector="gravity")
    assert merged.positions[run_of("stage")].tolist() == runs(np.array(STEPS[:n])).tolist()


@pytest.mark.parametrize("way", [1, -1])
def test_spacetime_stands_by_it_too(tmp_path, way):
    v, steps = np.arange(ROWS)[:, None], tuple(range(0, 8000, 200))[::way]
    paths = []
    for i, step in enumerate(steps):
        # A wall that goes through the sheet, with a border of reflectance upon it.
        at = 48 + (step - 4000) * PER_STEP[1] * 2
        level = np.where(v < at, 0.7, 1.0) * np.exp(-0.5 * ((v - 48) / 3.0) ** 2) * np.ones(COLUMNS)
        paths.append(tmp_path / f"{i}.png")
        write_image(paths[-1], np.rint(500 + 40000 * level).astype(np.uint16))
    told = Scan(tmp_path / "scan.toml", GREY, tuple(paths), axes={"stage": steps})
    with_play, plain = (reconstruct(scanner(play), told, spacetime=True) for play in (PLAY, None))
    moved = np.nanmedian(with_play.points - plain.points, axis=(0, 1))
    np.testing.assert_allclose(moved, way * PLAY / 2 * PER_STEP, atol=1e-4)


def test_a_range_image_is_written_and_read_with_it(image, tmp_path):
    write_points(tmp_path / "scan.npz", image)
    back = read_range_image(tmp_path / "scan.npz")
    assert back.positions.keys() == image.positions.keys()
    assert back.moving == ("stage",) == image.moving
    assert back.leading == "stage"
    np.testing.assert_allclose(back.cameras(), image.cameras(), atol=1e-9)
    part = back[25:, :]
    np.testing.assert_allclose(part.cameras(), image.cameras()[25:], atol=1e-9)
    assert len(image.sweeps()) == 1


def test_a_video_with_a_rule_goes_one_way():
    scan = Scan(Path("scan.toml"), GREY, rules={"stage": StepRule(0, -20)})
    rule = with_runs(scan, scanner().rig.motion).rules[run_of("stage")]
    assert rule.start < 0 > rule.per_frame
    assert with_runs(scan, scanner(None).rig.motion) == scan


def test_a_scanner_keeps_it_from_scan_to_scan(scan):
    ready = Scanner(scanner(), detector="gravity")
    one, two = (np.concatenate([part.points for part in ready.scan(scan)]) for _ in range(2))
    np.testing.assert_array_equal(one, two)
