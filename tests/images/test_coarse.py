"""The coarse peak of each line against one found by looping over blocks."""

import numpy as np
import pytest

from jaxscan.images.stripes.coarse import block_size, choose_peaks, coarse_peaks


def by_loops(level):
    """The row that stands out most in each column, `level` as (rows, columns)."""
    rows, columns = level.shape
    block = block_size(rows)
    starts = [*range(0, rows - block + 1, block)] + ([] if rows % block == 0 else [rows - block])
    found = np.empty(columns, int)
    for u in range(columns):
        peaks = [level[start : start + block, u] for start in starts]
        top = [int(some.max()) for some in peaks]
        n = len(top)
        score = [2 * top[i] - max(top[max(i - 3, 0)], top[min(i + 3, n - 1)]) for i in range(n)]
        best = int(np.argmax(score))
        found[u] = starts[best] + int(np.argmax(peaks[best]))
    return found


@pytest.mark.parametrize("columns", [True, False])
@pytest.mark.parametrize(("dtype", "rows"), [(np.uint8, 96), (np.uint8, 101), (np.uint16, 101)])
def test_the_row_that_stands_out_most(dtype, rows, columns):
    random = np.random.default_rng(rows)
    # Few levels: of equal ones the first is taken.
    images = random.choice(np.linspace(0, np.iinfo(dtype).max, 7).astype(dtype), (2, rows, 40, 3))
    ambient = np.full(2, np.iinfo(dtype).max, np.int32)
    red, green, blue = (images[..., i].astype(np.int64) for i in range(3))
    level = 2 * red - np.minimum(green + blue, ambient[0])
    assert level.min() < 0
    given = images if columns else images.transpose(0, 2, 1, 3)
    peaks = coarse_peaks(given, None, ambient, "red", columns)
    found, stands = (np.asarray(each) for each in choose_peaks(peaks, rows, columns))
    np.testing.assert_array_equal(found, [by_loops(frame) for frame in level])
    assert stands.shape == found.shape
    assert (stands >= 0).all()
