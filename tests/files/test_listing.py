"""Lists of photographs: what is wrong with their sizes."""

from pathlib import Path

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.listing import common_size
from jaxscan.images.decode import write_image


def test_a_photograph_turned_by_a_quarter_is_called_that(tmp_path: Path):
    files = [tmp_path / name for name in ("a.png", "b.png", "c.png")]
    for path, size in zip(files, [(8, 12), (12, 8), (8, 8)], strict=True):
        write_image(path, np.zeros(size, np.uint8))
    with pytest.raises(
        InputError, match=r"b\.png: is 8 × 12 pixels, but .*a\.png is 12 × 8: it is turned by a quarter"
    ):
        common_size(files[:2])
    with pytest.raises(InputError, match=r"c\.png: is 8 × 8 pixels, but .*: all photographs must be of one camera"):
        common_size([files[0], files[2]])
