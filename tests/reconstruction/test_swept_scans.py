"""Scans in which the light moves and the object stands."""

import re
from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxscan.calibration import calibrate
from jaxscan.calibration.observe import observe
from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session
from jaxscan.images import StripeSettings, read_image
from jaxscan.images.stripes.detect import detect_stripe
from jaxscan.measurement.scanned import scanned_image
from jaxscan.reconstruction import Scanner, reconstruct
from jaxscan.reconstruction.point_sigma import point_sigma
from jaxscan.reconstruction.scan_notes import REASONS, gap_notes, left_out_notes
from jaxscan.reconstruction.sheet_band import sheet_band, swept_band
from jaxscan.reconstruction.triangulate import Kernel
from jaxscan.rig import Covariance, Rig
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_scan
from jaxscan.simulation.shapes import stair
from jaxscan.simulation.swept import in_the_middle, simulate_swept_session, sweep_of, with_sweep

FRAMES = 6


@pytest.fixture(scope="module")
def swept(tmp_path_factory) -> tuple:
    """A rig with a covariance, a scan of a stair by it, and the scan's truth."""
    base = rig_2003.simulated_rig(3)
    rig, folder = with_sweep(base, 3), tmp_path_factory.mktemp("swept") / "scan"
    scene = in_the_middle(base, rig_2003.scan_scene(base, stair(rig_2003.OBJECT_Y)))
    lighting = replace(rig_2003.SCAN_LIGHTING, speckle=0.0)
    truth = simulate_scan(folder, rig, scene, 3, axes={"sweep": sweep_of(FRAMES).tolist()}, lighting=lighting)
    names = [name for name in parameter_names(rig) if name not in rig.given()]
    random = np.random.default_rng(0)
    sigma = 1e-4 * np.abs(
        [float(x) for name, x in zip(parameter_names(rig), jax.tree.leaves(rig), strict=True) if name in names]
    )
    root = random.normal(size=(len(names), len(names))) / len(names) + np.eye(len(names))
    matrix = sigma[:, None] * (root @ root.T) * sigma
    content = RigFile(rig, Covariance(tuple(names), matrix), {"light_positions": {"sweep": [400.0, 1600.0]}})
    return content, read_scan(folder), truth


def test_points_are_where_the_light_met_the_object(swept):
    content, scan, truth = swept
    image = reconstruct(content, scan)
    both = image.valid & np.isfinite(truth.position)
    assert both.sum() > 0.95 * np.isfinite(truth.position).sum()
    off = np.linalg.norm(image.points - truth.points, axis=-1)[both]
    assert np.median(off) < 0.02
    assert np.quantile(off, 0.95) < 0.15
    # The first stair without a position of the light is a plane at rest, and far off.
    wrong = Rig(content.rig.camera, content.rig.with_lights_at({"sweep": 1000.0}).lights)
    still = replace(scan, axes={"stage": (0,) * FRAMES})
    far = reconstruct(wrong, still, depths_mm=(0.0, np.inf))
    assert np.nanmedian(np.linalg.norm(far.points - truth.points, axis=-1)[0]) > 5.0


def test_from_photographs_of_boards_to_points(swept, tmp_path):
    _, scan, truth = swept
    rig = with_sweep(rig_2003.simulated_rig(3), 3)
    simulate_swept_session(tmp_path, 3, rig, views=5, stripes=3)
    found = calibrate(observe(read_session(tmp_path)), light="swept")
    assert found.stripe_rms_px < 0.15
    image = reconstruct(found.rig_file(), scan)
    off = np.linalg.norm(image.points - truth.points, axis=-1)[image.valid & np.isfinite(truth.position)]
    assert np.median(off) < 0.1


def test_sigma_is_that_of_the_exact_derivatives(swept):
    content, scan, _ = swept
    image = reconstruct(content, scan)
    frame, line = np.nonzero(image.valid)
    some = np.linspace(0, len(frame) - 1, 300).astype(int)
    frame, line = frame[some], line[some]
    pixels = np.stack([line.astype(float), image.pixels[frame, line].astype(float)], axis=-1)
    q = {"sweep": np.asarray(image.positions["sweep"], float)[frame]}
    total, pixel = point_sigma(content.rig, "", content.covariance, 1.0, pixels, q, columns=True)
    scale = image.sigma_pixel[frame, line] / pixel
    expected = np.sqrt(np.maximum(total**2 - pixel**2, 0) + (scale * pixel) ** 2)
    np.testing.assert_allclose(image.sigma[frame, line], expected, rtol=2e-3)


def test_photographs_in_memory_give_the_same_points(swept):
    content, scan, _ = swept
    pairs = [(read_image(path), {"sweep": n}) for path, n in zip(scan.frames, scan.axes["sweep"], strict=True)]
    one, other = reconstruct(content, pairs), reconstruct(content, scan)
    np.testing.assert_array_equal(one.valid, other.valid)
    np.testing.assert_allclose(one.points[one.valid], other.points[other.valid], atol=2e-4)
    with pytest.raises(InputError, match="moved by an axis sweep"):
        reconstruct(content, [(pairs[0][0], {"stage": 0}), (pairs[1][0], {"stage": 9})])


def test_each_frame_has_the_band_of_its_own_light(swept):
    content, _, _ = swept
    rig, size, depths = content.rig, content.rig.camera.image_size, (300.0, 400.0)
    find = swept_band(rig, StripeSettings(), depths)
    low, high = find({"sweep": np.array([400, 1000, 1600])})
    still = sheet_band(Kernel.create(rig), StripeSettings(), size, depths)
    np.testing.assert_allclose([low[1], high[1]], still, atol=4.0)
    assert np.median(np.abs(low[2] - low[0])[np.isfinite(low[0] + low[2])]) > 20.0
    assert swept_band(rig, StripeSettings(), (0.0, np.inf)) is None


def test_a_stripe_outside_its_frames_band_is_none():
    """Two frames, each with the same two stripes; the band of one holds the upper, that of the other the lower."""
    rows, columns = 120, 80
    v = np.arange(rows)[:, None]
    image = 10 + 150 * (np.exp(-((v - 30) ** 2) / 4.5) + np.exp(-((v - 90) ** 2) / 4.5))
    photographs = np.clip(np.random.default_rng(0).normal(image, 2.0, (2, rows, columns)), 0, 255).astype(np.uint8)
    low = np.repeat(np.float32([[10.0], [70.0]]), columns, axis=1)
    found = detect_stripe(photographs, StripeSettings(color="grey"), band=(low, low + 40))
    np.testing.assert_allclose(np.nanmedian(found.position, axis=1), [30.0, 90.0], atol=0.1)


def test_what_goes_beyond_the_calibrations_sweep_is_said(swept):
    content, scan, _ = swept
    narrow = replace(content, fit={"light_positions": {"sweep": [700.0, 1600.0]}})
    for rig, said in ((content, False), (narrow, True)):
        scanner = Scanner(rig)
        list(scanner.scan(scan))
        assert any("the calibration from 700 to 1600" in note for note in scanner.notes) is said


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_steps_far_from_the_calibrations_are_the_reason_that_nothing_is_found(swept):
    content, scan, _ = swept
    far = replace(scan, axes={"sweep": tuple(100000 + 200 * i for i in range(FRAMES))})
    with pytest.raises(InputError, match='axis "sweep" goes from 100000 to 101000 steps, the calibration from 400 to'):
        reconstruct(content, far)


def test_points_outside_the_depths_are_laid_on_the_steps_first():
    left_out = dict.fromkeys(REASONS.values(), 0) | {"outside_of_the_depths": 12}
    for points, swept_by, said in ((100, "mirror", True), (500, "mirror", False), (100, None, False)):
        (note,) = left_out_notes(left_out, points, (200.0, 500.0), swept_by)
        assert note.startswith("12 points were left out")
        assert ('see whether the steps of axis "mirror" are counted from the same place' in note) is said


def test_reversed_steps_are_named_where_points_fall_outside_of_the_depths(swept):
    content, scan, _ = swept
    scanner = Scanner(content, depths_mm=(335.0, 365.0))
    list(scanner.scan(replace(scan, axes={"sweep": scan.axes["sweep"][::-1]})))
    assert any('steps of axis "sweep" are counted from the same place' in note for note in scanner.notes)


def test_where_a_photograph_is_missing_its_axis_is_named(swept, tmp_path):
    _, scan, _ = swept
    frames = tuple(tmp_path / f"{i:02d}.png" for i in (*range(6), *range(7, 11)))
    for axis, under in (("sweep", r"\[scan.axes\] sweep"), ("stage", "steps")):
        (note,) = gap_notes(replace(scan, frames=frames, axes={axis: tuple(range(10))}))
        assert re.search(f"07.png follows 05.png.* for each photograph under {under}$", note)


def test_the_light_position_must_be_given(swept):
    content, scan, _ = swept
    with pytest.raises(InputError, match="moved by an axis sweep, and the scan does not say"):
        reconstruct(content, replace(scan, axes={"stage": tuple(range(FRAMES))}))
    with pytest.raises(InputError, match="leave --spacetime out"):
        reconstruct(content, scan, spacetime=True)


def test_measured_points_know_the_light_of_their_frame(swept):
    content, scan, _ = swept
    image = reconstruct(content, scan)
    known = scanned_image(image, content)
    # The direction of a stripe's error lies in the sheet of its own frame.
    frame = known.place[:, 0]
    for f in (0, FRAMES - 1):
        normal = np.array([float(x) for x in content.rig.lights[0].at(float(image.positions["sweep"][f])).plane])
        across = known.stripe[frame == f] @ normal
        assert np.abs(across).max() < 1e-6 * np.linalg.norm(normal) * np.linalg.norm(known.stripe, axis=1).max() * 10


def test_background_colours_are_those_of_an_object_that_stands(swept):
    content, scan, _ = swept
    scan = replace(scan, backgrounds=(scan.frames[0],))
    image = reconstruct(content, scan)
    assert image.colours is not None
