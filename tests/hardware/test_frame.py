"""Frames hold what a camera can take, and nothing else."""

import numpy as np
import pytest

from hardware import Frame


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_photographs_are_taken(shape, dtype):
    frame = Frame(np.zeros(shape, dtype), positions={"stage": 2000}, time_s=0.0, exposure_s=0.01)
    assert frame.image.shape == shape


@pytest.mark.parametrize(
    ("image", "exposure_s"),
    [
        (np.zeros((4, 5), np.float32), 0.01),
        (np.zeros((4, 5, 4), np.uint8), 0.01),
        (np.zeros((0, 5), np.uint8), 0.01),
        (np.zeros((4, 5), np.uint8), 0.0),
        (np.zeros((4, 5), np.uint8), float("nan")),
    ],
)
def test_what_no_camera_takes_is_refused(image, exposure_s):
    with pytest.raises(ValueError, match="frame"):
        Frame(image, positions={}, time_s=0.0, exposure_s=exposure_s)


def test_positions_are_by_axis():
    with pytest.raises(ValueError, match=r'positions by axis, as \{"stage": 20000\}, not 2000'):
        Frame(np.zeros((4, 5), np.uint8), 2000, 0.0, 0.01)


@pytest.mark.parametrize(
    ("positions", "words"),
    [
        ({"stage": 5}, "step 5"),
        ({"turntable": 5}, "turntable 5"),
        ({"turntable": 8, "stage": 5}, "turntable 8, stage 5"),
        ({}, "an unknown place"),
    ],
)
def test_a_place_in_words(positions, words):
    assert Frame(np.zeros((4, 5), np.uint8), positions, 0.0, 0.01).place == words
