"""Small photographs for the tests of sessions and scans: only their headers matter there."""

from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest


def _photographs(folder: Path, names: Iterable[str], size: tuple[int, int] = (32, 24)) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / name for name in names]
    for path in paths:
        assert cv2.imwrite(str(path), np.zeros(size[::-1], np.uint8))
    return paths


@pytest.fixture
def photographs() -> Callable[..., list[Path]]:
    """Writes grey photographs of `size` (columns, rows) into a folder: `photographs(folder, names, size)`."""
    return _photographs
