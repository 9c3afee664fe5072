"""Where the sheet can be: the band holds every true stripe, and what lies outside of it is left out and counted."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings, write_image
from jaxscan.precision import as_float64, float64
from jaxscan.reconstruction import Kernel, Scanner
from jaxscan.reconstruction.sheet_band import depths_of, sheet_band
from tests.reconstruction.small import COLUMNS, ROWS, small_rig, wavy_stripe

GREY = StripeSettings("grey")


@pytest.mark.parametrize("columns", [True, False])
def test_every_pixel_whose_ray_meets_the_sheet_in_the_range_is_in_the_band(columns):
    rig, random = small_rig(), np.random.default_rng(0)
    near, far = 210.0, 300.0
    laser = StripeSettings("grey", columns=columns)
    band = sheet_band(Kernel.create(rig), laser, (COLUMNS, ROWS), (near, far))
    assert band is not None
    low, high = band
    pixels = np.stack([random.integers(0, COLUMNS, 200), random.integers(0, ROWS, 200)], axis=-1)
    with float64():
        points = np.asarray(jax.vmap(lambda p: as_float64(rig).triangulate(p, {}))(jnp.asarray(pixels, jnp.float64)))
    within = 0
    for pixel, depth in zip(pixels, points[:, 2], strict=True):
        line, place = pixel if columns else pixel[::-1]
        inside = low[line] <= place <= high[line]
        within += inside
        assert inside or not near <= depth <= far
        if inside and not near - 20 < depth < far + 40:
            pytest.fail(f"{depth} mm is in the band")
    assert 0 < within < len(pixels)


def test_any_depth_is_no_band():
    assert sheet_band(Kernel.create(small_rig()), GREY, (COLUMNS, ROWS), (0.0, np.inf)) is None


def test_the_calibrations_depths_are_widened():
    assert depths_of(RigFile(small_rig())) is None
    assert depths_of(RigFile(small_rig(), fit={"stripe_depths_mm": [300, 400]})) == (200.0, 600.0)


@pytest.mark.parametrize("depths", [(-1.0, 5.0), (300.0, 200.0), (np.nan, 5.0)])
def test_depths_that_are_none_are_refused(depths):
    with pytest.raises(InputError, match="nearest and the farthest"):
        Scanner(small_rig(), depths_mm=depths)


def test_what_is_left_out_is_counted_and_told(tmp_path):
    paths = tuple(tmp_path / f"{i}.png" for i in range(3))
    for i, path in enumerate(paths):
        write_image(path, np.rint(wavy_stripe(i)).clip(0, 255).astype(np.uint8))
    scan = Scan(tmp_path / "scan.toml", GREY, paths, axes={"stage": (0, 1000, 2000)})

    def points(**how):
        scanner = Scanner(small_rig(), "gravity", **how)
        return sum(int(image.valid.sum()) for image in scanner.scan(scan)), scanner

    everywhere, scanner = points()
    assert not scanner.notes
    assert not any(scanner.left_out.values())
    some, scanner = points(depths_mm=(270.0, 320.0))
    left = scanner.left_out["outside_of_the_depths"]
    assert 0 < some < everywhere
    assert 0.8 * (everywhere - some) <= left <= 1.1 * (everywhere - some)
    assert any(str(left) in note and "--depths" in note for note in scanner.notes)


def test_a_stripe_too_weak_to_be_told_from_noise_is_told(tmp_path):
    random = np.random.default_rng(0)
    paths = tuple(tmp_path / f"{i}.png" for i in range(4))
    for i, path in enumerate(paths):
        # Its peak stands 1.8 times the noise high.
        faint = 20 + 0.06 * (wavy_stripe(i) - 20) + random.normal(0, 6, (ROWS, COLUMNS))
        write_image(path, np.rint(faint).clip(0, 255).astype(np.uint8))
    scanner = Scanner(small_rig())
    scan = Scan(tmp_path / "scan.toml", GREY, paths, axes={"stage": (0, 1000, 2000, 3000)})
    points = sum(int(image.valid.sum()) for image in scanner.scan(scan))
    weak = scanner.left_out["too_weak"]
    assert weak > points > 0
    assert any(f"{weak} lines" in note and "expose longer" in note for note in scanner.notes)
