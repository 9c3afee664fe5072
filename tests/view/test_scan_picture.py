"""The picture of a scan: the photograph on the left, and on the right the surface, in its colours."""

from pathlib import Path

import cv2
import numpy as np

from jaxscan.cli.demo import joined
from jaxscan.reconstruction import RangeImage
from jaxscan.view.scan_picture import draw_scan


def hill() -> RangeImage:
    """A hill of 20 mm, 60 mm across, seen from above by a camera that looks along z."""
    frames, columns = 40, 60
    y, x = np.mgrid[:frames, :columns].astype(np.float32)
    height = 20 * np.exp(-((x - 30) ** 2 + (y - 20) ** 2) / 150)
    points = np.stack([x - 30, y - 20, 300 - height], axis=-1)
    number = np.full((frames, columns), 0.01, np.float32)
    pixels = np.broadcast_to(20.0 + y, (frames, columns)).astype(np.float32)
    valid = np.ones((frames, columns), bool)
    return RangeImage(points, pixels, 100 * number, number, number, valid, {"stage": 100 * np.arange(frames)})


def test_the_surface_stands_beside_its_photograph_in_its_colours(tmp_path: Path) -> None:
    image = hill()
    photograph = np.full((80, 60, 3), (0, 200, 0), np.uint8)
    surface = joined(image)
    colours = np.where(surface.vertices[:, :1] < 0, [220.0, 30.0, 30.0], [30.0, 30.0, 220.0])
    up = np.array([0.0, 0.0, -1.0])
    draw_scan(tmp_path / "scan.png", photograph, image.pixels[20], image, surface, up, colours)
    picture = cv2.imread(str(tmp_path / "scan.png"))
    assert picture is not None
    blue, green, red = (picture[..., k].astype(int) for k in range(3))
    half = picture.shape[1] // 2
    assert (green - red > 60)[:, :half].mean() > 0.9
    # The camera's left is on the left: red there, blue on the right; and no photograph.
    reds, blues = np.argwhere((red - blue > 60)[:, half:]), np.argwhere((blue - red > 60)[:, half:])
    assert min(len(reds), len(blues)) > 5000
    assert reds[:, 1].mean() + 100 < blues[:, 1].mean()
    assert not (green - red > 60)[:, half + 1 :].any()
    # What faces the lamp is brighter than what does not.
    lit = np.maximum(red, blue)[:, half:][((np.abs(red - blue)) > 20)[:, half:]]
    assert np.percentile(lit, 95) > 1.5 * np.percentile(lit, 5)
    assert [path.name for path in tmp_path.iterdir()] == ["scan.png"]
