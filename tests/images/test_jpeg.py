"""JPEG as webcams write it."""

from pathlib import Path

import numpy as np
import pytest
import simplejpeg

from jaxscan.errors import InputError
from jaxscan.images import read_image
from jaxscan.images.jpeg import write_jpeg


def test_colour_has_half_the_resolution_and_brightness_all_of_it(tmp_path: Path) -> None:
    grey, bright = np.full((64, 64, 3), 120, np.uint8), np.full((64, 64, 3), 120, np.uint8)
    bright[:, ::2] = 160
    # Of about the same brightness, 0.299 R + 0.587 G + 0.114 B.
    coloured = grey.copy()
    coloured[:, ::2] = [180, 89, 120]
    for name, image, kept in (("bright", bright, 1.0), ("coloured", coloured, 0.0)):
        path = tmp_path / f"{name}.jpg"
        write_jpeg(path, image, 95)
        found = read_image(path)[..., 0].astype(float)
        contrast = found[:, ::2].mean() - found[:, 1::2].mean()
        wanted = float(image[0, 0, 0]) - image[0, 1, 0]
        assert contrast / wanted == pytest.approx(kept, abs=0.1)
    assert simplejpeg.decode_jpeg_header((tmp_path / "bright.jpg").read_bytes())[3] == "420"


def test_quality_is_that_of_the_tables(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (32, 32, 3), dtype=np.uint8)
    for quality, first in ((50, 16), (90, 3), (100, 1)):
        write_jpeg(tmp_path / "image.jpg", image, quality)
        data = (tmp_path / "image.jpg").read_bytes()
        # A table of quantisation: marker, length, number, then 64 steps, of which the standard's first is 16.
        assert data[data.index(b"\xff\xdb") + 5] == first
    for quality in (0, 101):
        with pytest.raises(InputError, match="quality"):
            write_jpeg(tmp_path / "image.jpg", image, quality)
