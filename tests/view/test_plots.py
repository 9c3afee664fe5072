"""The picture of a scan: it is there, whole, and shows the cup, not nothing."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxscan.view.plots import draw_scan

pytest.importorskip("matplotlib", reason="the extra plots is not installed")


def test_a_scan_is_drawn(tmp_path: Path) -> None:
    frames, columns = 12, 60
    y, x = np.mgrid[:frames, :columns].astype(np.float32)
    height = 20 * np.exp(-((x - 30) ** 2 + 4 * (y - 6) ** 2) / 40)
    points = np.stack([x, 3 * y, 300 - height], axis=-1)
    valid = np.ones((frames, columns), bool)
    valid[3, 10:20] = valid[5] = False
    points[~valid] = np.nan
    photograph = np.full((48, 64, 3), 80, np.uint8)
    draw_scan(tmp_path / "scan.png", photograph, points, valid, np.where(valid, 0.01 * x, np.nan), "a hill")
    picture = cv2.imread(str(tmp_path / "scan.png"))
    assert picture is not None
    assert picture.shape == (500, 1700, 3)
    middle, right = picture[:, 480:1000], picture[:, 1050:1560]
    for part in (middle, right):
        coloured = np.ptp(part.astype(int), axis=-1) > 40
        assert coloured.mean() > 0.005
    assert [path.name for path in tmp_path.iterdir()] == ["scan.png"]
