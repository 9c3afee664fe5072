"""Laser-off photographs of the place before or behind are pointed out, and those of the same place are not."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings
from jaxscan.reconstruction.background_watch import BackgroundWatch
from jaxscan.reconstruction.frames import Frames

COUNT, ROWS, COLUMNS = 30, 120, 160


def scene(
    moves_px: float = 2.0, seed: int = 0, contrast: float = 15.0, drift: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Photographs of a surface that moves, with a stripe and the laser's stray light, and those without the laser."""
    random = np.random.default_rng(seed)
    texture = 60 + contrast * gaussian_filter(random.normal(0, 3, (ROWS, COLUMNS + 200)), 3) / 0.28
    stripe = 150 * np.exp(-0.5 * ((np.arange(ROWS) - 60) / 2) ** 2)[:, None]
    lit, off = [], []
    for i in range(COUNT):
        left = int(moves_px * i)
        place = texture[:, left : left + COLUMNS] * (1 + drift * i)
        lit.append(place * (1 + drift / 2) + stripe + 2)
        off.append(place)
    noisy = [np.stack(each) + random.normal(0, 2, (COUNT, ROWS, COLUMNS)) for each in (lit, off)]
    return noisy[0].clip(0, 255).round().astype(np.uint8), noisy[1].clip(0, 255).round().astype(np.uint8)


def notes(lit: np.ndarray, off: np.ndarray, batch: int = 8) -> list[str]:
    files = tuple(Path(f"{i:03d}.png") for i in range(len(lit)))
    watch = BackgroundWatch(Scan(Path("scan.toml"), StripeSettings(), files, backgrounds=files))
    for first in range(0, len(lit), batch):
        here = lit[first : first + batch]
        buffer, dark = (np.zeros((batch, *lit.shape[1:]), np.uint8) for _ in range(2))
        buffer[: len(here)], dark[: len(here)] = here, off[first : first + batch]
        watch.see(Frames(buffer, dark, np.zeros((len(here), 1), int)))
    return watch.notes()


@pytest.mark.parametrize("moves_px", [0.0, 0.1, 0.5, 2.0, 6.0])
@pytest.mark.parametrize(("contrast", "drift"), [(15.0, 0.0), (15.0, 0.01), (15.0, -0.01), (0.0, 0.0)])
def test_photographs_of_the_same_place_go_together(moves_px, contrast, drift):
    assert notes(*scene(moves_px, 1, contrast, drift)) == []


@pytest.mark.parametrize("by", [-1, 1])
@pytest.mark.parametrize("moves_px", [1.0, 2.0, 6.0])
def test_a_shift_by_one_is_pointed_out(by, moves_px):
    lit, off = scene(moves_px)
    (note,) = notes(lit, np.roll(off, by, axis=0))
    other, which = ("014", "before") if by < 0 else ("016", "behind")
    assert f"015.png goes better with {other}.png than with its own, 015.png" in note
    assert f"and so do 100% of the photographs with the one {which} their own" in note
    # From the middle on, where one is missing.
    (note,) = notes(lit, np.concatenate([off[:15], np.roll(off, by, axis=0)[15:]]))
    assert "shifted by one" in note


def test_where_nothing_moves_nothing_is_said():
    lit, off = scene(0.0)
    assert notes(lit, np.roll(off, 1, axis=0)) == []
    # One photograph serves for all; no light at all.
    assert notes(lit, np.repeat(off[:1], COUNT, axis=0)) == []
    assert notes(0 * lit, 0 * off) == []
    assert notes(lit[:2], off[:2]) == []
    # One frame in another's place is no shift.
    lit, off = scene(2.0)
    off[[10, 11]] = off[[11, 10]]
    assert notes(lit, off) == []
