"""How far the light of a stripe reaches, in photographs that were drawn."""

from pathlib import Path

import numpy as np
import pytest

from jaxscan.images import write_image
from jaxscan.reconstruction.stripe_reach import GREATEST_PX, stripe_reach

ROWS, COLUMNS, FRAMES = 200, 240, 3


def drawn(
    folder: Path, light, *, columns: bool = True, bits: int = 8, slope: float = 0.1
) -> tuple[list[Path], np.ndarray]:
    """Photographs of a stripe whose light is a function of the distance from it, in a room that becomes brighter."""
    random = np.random.default_rng(2)
    paths, position = [], np.empty((FRAMES, COLUMNS))
    row = np.tile(np.arange(ROWS, dtype=float)[:, None], COLUMNS)
    for i in range(FRAMES):
        position[i] = 80.3 + 12 * i + 10 * np.sin(np.arange(COLUMNS) / 40)
        picture = 40 + slope * row + light(np.abs(row - position[i])) + random.normal(size=row.shape)
        red = np.stack([picture, 40 + slope * row, 40 + slope * row], axis=-1)
        red = red if columns else red.swapaxes(0, 1)
        scale = 257 if bits == 16 else 1
        path = folder / f"{i}.png"
        write_image(path, (np.clip(red, 0, 255) * scale).astype(np.uint16 if bits == 16 else np.uint8))
        paths.append(path)
    return paths, position


@pytest.mark.parametrize("columns", [True, False])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("s", [1.0, 2.5])
def test_it_ends_where_the_stripe_does(tmp_path: Path, columns: bool, bits: int, s: float) -> None:
    photographs, position = drawn(tmp_path, lambda d: 180 * np.exp(-(d**2) / (2 * s**2)), columns=columns, bits=bits)
    reach = stripe_reach(photographs, position, columns=columns)
    # 180 levels have become one after 3.2 σ.
    assert 3 * s < reach < 4 * s + 3


def test_a_halo_belongs_to_it(tmp_path: Path) -> None:
    photographs, position = drawn(tmp_path, lambda d: 180 * np.exp(-(d**2) / 2) + 30 * np.exp(-d / 8))
    reach = stripe_reach(photographs, position, columns=True)
    # It falls by less than 0.02 of the room's 55 levels in 4 px where 30 exp(−d/8) (1 − exp(−1/2)) does.
    assert 15 < reach < 24


def test_light_that_never_ends_and_too_few_lines(tmp_path: Path) -> None:
    photographs, position = drawn(tmp_path, lambda d: 120 - 2 * d)
    assert stripe_reach(photographs, position, columns=True) == GREATEST_PX
    assert stripe_reach(photographs, np.full_like(position, np.nan), columns=True) == GREATEST_PX
