"""What is said of the light of a scan: drawn frames with one fault each, and without any."""

from collections.abc import Callable

import numpy as np
import pytest

from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.reconstruction.light_watch import LightWatch

ROWS, COLUMNS, FRAMES = 240, 320, 8
V, U = np.mgrid[:ROWS, :COLUMNS].astype(float)

Fault = Callable[[int, np.ndarray, np.ndarray], np.ndarray]


def surroundings(i: int) -> np.ndarray:
    """A ball that passes before a bright wall."""
    ball = np.clip(1 - ((V - 120) ** 2 + (U - 80 - 20 * i) ** 2) / 60**2, 0, None)
    return np.where(ball > 0, 20 + 60 * np.sqrt(ball), 30 + 20 * V / ROWS)


def notes(fault: Fault, known: bool = False, background: bool = False, color: str = "red") -> list[str]:
    random, frames = np.random.default_rng(0), []
    for i in range(FRAMES):
        laser = 90 * np.exp(-0.5 * ((V - 130 - 8 * np.sin(U / 60) - i) / 1.5) ** 2)
        ambient = surroundings(i)
        levels = fault(i, ambient[..., None], laser[..., None] * np.array([1, 0.02, 0.02]))
        frames.append(np.rint(levels + 2 * random.standard_normal((ROWS, COLUMNS, 3))).clip(0, 255).astype(np.uint8))
    images = np.stack(frames) if color == "red" else np.stack(frames)[..., 0]
    watch = LightWatch()
    for some in (slice(3), slice(3, FRAMES)):
        watch.see(detect_stripe(images[some], StripeSettings(color)))
    return watch.notes(known, background, color == "grey")


def banded(depth: float) -> Fault:
    return lambda i, ambient, laser: ambient * (1 + depth * np.sin(V / 20 + 2.3 * i))[..., None] + laser


@pytest.mark.parametrize("color", ["red", "grey"])
def test_nothing_is_said_of_good_light(color: str) -> None:
    room = 1.0 if color == "red" else 0.3
    assert notes(lambda i, ambient, laser: room * ambient + laser, color=color) == []


def test_grey_photographs_of_a_lit_room() -> None:
    (said,) = notes(lambda i, ambient, laser: 1.5 * ambient + laser, color="grey")
    assert said.startswith("the light of the room differs by ")
    assert "--dark" in said
    assert notes(lambda i, ambient, laser: 1.5 * ambient + laser, color="grey", background=True) == []


def test_a_room_that_is_nearly_as_bright_as_the_stripe() -> None:
    """On dark paint 10 % of the columns were lost, and bars of paint were stripes, without a word."""

    def lit(i: int, ambient: np.ndarray, laser: np.ndarray) -> np.ndarray:
        return 2.5 * ambient * (V > ROWS / 3)[..., None] + laser

    (said,) = notes(lit)
    assert said.startswith("the light of the room differs by ")
    assert "on dark paint points are lost" in said
    assert "--dark" in said
    assert notes(lit, background=True) == []


def test_a_laser_whose_power_changes_needs_no_words() -> None:
    assert notes(lambda i, ambient, laser: ambient + laser * (1 + 0.1 * (-1) ** i)) == []
    assert notes(lambda i, ambient, laser: ambient + laser * (1 + 0.1 * np.sin(U / 30 + i))[..., None]) == []


def test_a_lamp_that_flickers() -> None:
    (said,) = notes(banded(0.2))
    assert "flickers" in said
    assert "1/100" in said
    assert "background" not in said
    (said,) = notes(banded(0.2), background=True)
    assert "subtracting the background does not take it away" in said
    assert notes(banded(0.005)) == []


def test_an_edge_that_moves_over_all_columns_is_no_lamp() -> None:
    """A bright plate that goes by in large steps: some rows change over all columns, and most do not."""

    def plate(i: int, ambient: np.ndarray, laser: np.ndarray) -> np.ndarray:
        over = np.abs(V - 55 - 12 * i) < 35
        return np.where(over, 120.0, 40.0)[..., None] + laser

    assert [said for said in notes(plate) if "flickers" in said] == []


def test_a_lamp_that_is_switched() -> None:
    (said,) = notes(lambda i, ambient, laser: ambient * (2 if i > 4 else 1) + laser)
    assert "beside the stripe changes between neighbouring frames 1 time, by up to a factor of 2.0" in said
    assert "(frames 4 and 5)" in said
    assert "lamp" in said


def test_exposures_that_are_not_listed() -> None:
    def bracketed(i: int, ambient: np.ndarray, laser: np.ndarray) -> np.ndarray:
        return (0.4, 1.0)[i % 2] * (ambient + laser)

    (said,) = notes(bracketed)
    assert "the exposure changes between neighbouring frames 7 times, by up to a factor of 2.4" in said
    assert "exposures_s" in said
    assert notes(bracketed, known=True) == []
    # In the dark the stripe tells.
    (said,) = notes(lambda i, ambient, laser: bracketed(i, 0 * ambient, laser))
    assert "the exposure changes between neighbouring frames 7 times" in said


def test_an_exposure_that_drifts_needs_no_words() -> None:
    assert notes(lambda i, ambient, laser: 2 ** (i / FRAMES) * (ambient + laser)) == []


def test_frames_that_are_overexposed() -> None:
    (said,) = notes(lambda i, ambient, laser: ambient * (9 if i in (2, 3) else 1) + laser, known=True)
    assert said.startswith("2 of 8 frames are overexposed")
    assert "frame 3: " in said or "frame 2: " in said


def test_noise_that_was_smoothed() -> None:
    import cv2

    random, frames = np.random.default_rng(1), []
    for i in range(3):
        levels = 40 + 120 * np.exp(-0.5 * ((V - 130 - i) / 1.5) ** 2) + 5 * random.standard_normal(V.shape)
        frames.append(cv2.GaussianBlur(np.rint(levels).clip(0, 255).astype(np.uint8), (0, 0), 0.8))
    watch = LightWatch()
    watch.see(detect_stripe(np.stack(frames), StripeSettings("grey")))
    (said,) = watch.notes(False, False, True)
    assert said.startswith("the noise of neighbouring pixels is alike (correlation 0.6")
    assert "3 of 3 frames" in said
