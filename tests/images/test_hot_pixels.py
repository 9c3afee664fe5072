"""Hot pixels: found where they stand out alone in all photographs, and corrected; nothing else is taken for one."""

import numpy as np
import pytest

from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan, write_scan
from jaxscan.images import StripeSettings, write_image
from jaxscan.images.hot_pixels import HotPixels, hot_pixels
from jaxscan.reconstruction import RangeImage, Scanner
from tests.reconstruction.small import COLUMNS, ROWS, small_rig, wavy_stripe

PLACES = tuple(np.random.default_rng(1).integers(0, (ROWS, COLUMNS), (12, 2)).T)


def photographs(added: np.ndarray | float, frames: int = 12, lower: float = 0.5) -> np.ndarray:
    """With noise and something that is the same in all of them, the stripe lower in each."""
    random = np.random.default_rng(0)
    levels = np.stack([wavy_stripe(lower * i) + added for i in range(frames)])
    return np.rint(levels + 2.0 * random.standard_normal(levels.shape)).clip(0, 255).astype(np.uint8)


def hot(level: float) -> np.ndarray:
    added = np.zeros((ROWS, COLUMNS))
    added[PLACES] = level
    return added


def test_bright_ones_are_found() -> None:
    expected = hot(1.0) > 0
    np.testing.assert_array_equal(hot_pixels(photographs(hot(150.0)), True), expected)
    assert not hot_pixels(photographs(hot(20.0)), True).any()
    assert not hot_pixels(photographs(hot(150.0), frames=5), True).any()


@pytest.mark.parametrize("columns", [True, False])
def test_they_have_the_mean_of_their_neighbours_along_the_stripe(columns: bool) -> None:
    corners = np.zeros((ROWS, COLUMNS))
    corners[[0, -1, 40], [0, -1, 40]] = 200.0
    clean, images = photographs(0.0), photographs(corners)
    if not columns:
        clean, images = (np.ascontiguousarray(each.swapaxes(1, 2)) for each in (clean, images))
    watch = HotPixels(columns)
    watch.correct(images)
    changed = np.argwhere((images != clean).any(axis=0))
    assert all(tuple(at) in {(0, 0), (clean.shape[1] - 1, clean.shape[2] - 1), (40, 40)} for at in changed)
    beside = clean[:, 40, [39, 41]] if columns else clean[:, [39, 41], 40]
    np.testing.assert_allclose(images[:, 40, 40], beside.mean(axis=1), atol=0.5)
    np.testing.assert_array_equal(images[:, 0, 0], clean[:, 0, 1] if columns else clean[:, 1, 0])


@pytest.mark.parametrize("lower", [0.0, 0.1, 1.0])
def test_stripes_and_what_a_lens_has_drawn_are_none(lower: float) -> None:
    """A stripe that stands still, a lamp, a pattern of the room."""
    v, u = np.mgrid[:ROWS, :COLUMNS]
    lamp = 200.0 * np.exp(-0.5 * ((u - 30) ** 2 + (v - 20) ** 2) / 0.6**2)
    for added in (0.0, lamp, 60.0 * (np.sin(u / 1.5) * np.sin(v / 1.5) > 0.5)):
        assert not hot_pixels(photographs(added, lower=lower), True).any()


def test_a_scan_is_as_without_them(tmp_path) -> None:
    """They lay up to a millimetre off, within a small σ."""
    scans = {}
    for name, added in (("clean", 0.0), ("hot", hot(150.0))):
        (tmp_path / name).mkdir()
        paths = tuple(tmp_path / name / f"{i:02d}.png" for i in range(12))
        for path, image in zip(paths, photographs(added), strict=True):
            write_image(path, image)
        scan = Scan(
            tmp_path / name / "scan.toml", StripeSettings("grey"), paths, axes={"stage": tuple(range(0, 12000, 1000))}
        )
        write_scan(scan)
        scanner = Scanner(RigFile(small_rig()), "gravity")
        scans[name] = RangeImage.joined(list(scanner.scan(scan))), scanner.notes
    (clean, none), (corrected, notes) = scans["clean"], scans["hot"]
    assert not any("hot pixels" in note for note in none)
    assert sum("12 pixels (977 in a million) are bright in every photograph" in note for note in notes) == 1
    both = clean.valid & corrected.valid
    assert both.sum() > 0.99 * clean.valid.sum()
    assert np.linalg.norm(clean.points - corrected.points, axis=-1)[both].max() < 0.5
