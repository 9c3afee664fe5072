"""A stripe that moves in a video: error of its place over that of the plain centre of gravity, and σ over the error.

Twenty-four drawn frames of a red stripe on textured ground, which bends, steps and moves by 2.3 px a frame. They are
kept as MPEG-4 part 2 by OpenCV, and as H.264 of two rates where the package `av` is installed (`pip install av`), all
with colours at half resolution. Errors beyond half a pixel are counted apart. σ over the error is as in `cup_jpeg`.
"""

import importlib.util
import tempfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt
from scipy.special import ndtr

from benchmarks.cup_jpeg import Against
from benchmarks.metric import Metric
from jaxscan.images.decode import read_video

_FRAMES, _ROWS, _COLUMNS = 24, 240, 320
# Standard deviation of the stripe, px; its height, grey levels: the last one is burnt out.
_WIDTHS, _HEIGHTS = (0.75, 1.2, 2.0, 3.5), (60.0, 170.0, 600.0)
_SPECKLES: Final = (0.2, 0.0)
COLOURS: Final = np.array([1.0, 0.06, 0.03])
_GROUND, _TEXTURE, _NOISE, _MOVES_PX = 50.0, 8.0, 1.5, 2.3
# The stripe steps each time after this number of columns; so near to a step none is asked.
_FACE, _BESIDE_STEP = 80, 6
_QUALITIES: Final = ("18", "26")
_GOAL: Final = 1.1

Frames = UInt[np.ndarray, "frames rows columns 3"]


def measure(quick: bool) -> list[Metric]:
    """Every width and height with speckle and without; in the short form two of them with speckle."""
    kinds = ["mpeg4"]
    if importlib.util.find_spec("av") is None:
        print("  H.264 is left out: pip install av")
    elif not quick:
        kinds += [f"h264_{quality}" for quality in _QUALITIES]
    cases = [(0.2, 0.75, 170.0), (0.2, 1.2, 600.0)] if quick else product(_SPECKLES, _WIDTHS, _HEIGHTS)
    metrics = []
    print("  speckle, σ px, height: of each kind RMS px, of gravity, quotient; σ over the error; further off, %")
    with tempfile.TemporaryDirectory() as folder:
        for speckle, width, height in cases:
            frames, truth, asked = moving_stripe(width, height, speckle)
            for kind in kinds:
                kept = in_a_video(frames, Path(folder) / "stripe.mp4", kind)
                found = Against.create(kept, truth, asked)
                print(
                    f"    {speckle:g} {width:g} {height:g} {kind}   {found.rms:.4f} {found.other:.4f} "
                    f"{found.rms / found.other:.2f}   {found.sigma:.2f}   {found.far:.1f} ({found.far_other:.1f})",
                    flush=True,
                )
                metrics += found.metrics(f"video.{kind}.speckle_{speckle:g}.width_{width:g}.height_{height:g}", _GOAL)
    return metrics


def moving_stripe(
    width: float, height: float, speckle: float, seed: int = 1, count: int = _FRAMES
) -> tuple[Frames, Float[np.ndarray, "frames columns"], Bool[np.ndarray, "frames columns"]]:
    """Frames, where the stripe is in each, px, and which columns are no step.

    Args:
        width: standard deviation of the stripe, px.
        height: of its peak in red, grey levels.
        speckle: contrast of the laser's light in a pixel.
        seed: of the noise.
        count: how many frames.
    """
    random = np.random.default_rng(seed)
    frames, centres = [], []
    for light, centre in moving_light(width, height, speckle, random, count):
        levels = texture(_GROUND, _TEXTURE)[..., None] + light[..., None] * COLOURS
        levels += _NOISE * random.standard_normal(levels.shape)
        frames.append(np.rint(levels.clip(0, 255)).astype(np.uint8))
        centres.append(centre)
    return np.stack(frames), np.stack(centres), beside_no_step(count)


def moving_light(
    width: float, height: float, speckle: float, random: np.random.Generator, count: int
) -> Iterator[tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "columns"]]]:
    """The laser's light on each frame's pixels, and where its stripe is, px; as `moving_stripe` has them."""
    u = np.arange(_COLUMNS)
    for i in range(count):
        centre = 70 + _MOVES_PX * i + 12 * np.sin(u / 40 + 0.1 * i) + 25 * (u // _FACE % 2)
        edges = (np.arange(_ROWS + 1)[:, None] - 0.5 - centre) / width
        light = height * width * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)
        if speckle:
            light *= random.gamma(speckle**-2, speckle**2, light.shape)
        yield light, centre


def texture(ground: float, by: float) -> Float[np.ndarray, "rows columns"]:
    """Levels of a scene that varies by so much."""
    u, rows = np.arange(_COLUMNS), np.arange(_ROWS)
    return ground + by * np.sin(u / 17) * np.cos(rows / 13)[:, None]


def beside_no_step(count: int) -> Bool[np.ndarray, "frames columns"]:
    """Which columns are not beside a step."""
    u = np.arange(_COLUMNS)
    plain = np.abs(u % _FACE - (_FACE - 1) / 2) < _FACE / 2 - _BESIDE_STEP
    return np.broadcast_to(plain, (count, _COLUMNS))


def in_a_video(frames: Frames, path: Path, kind: str) -> Frames:
    """The frames as they are read from a video.

    Args:
        frames: red, green and blue.
        path: where the video is written.
        kind: mpeg4, or h264_ and a rate factor.
    """
    rows, columns = frames.shape[1:3]
    if kind == "mpeg4":
        file = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30, (columns, rows))
        for frame in frames:
            file.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        file.release()
    else:
        import av  # pyright: ignore[reportMissingImports]

        with av.open(str(path), "w") as file:
            stream = file.add_stream("libx264", rate=30)
            stream.height, stream.width, stream.pix_fmt = rows, columns, "yuv420p"
            stream.options = {"crf": kind.removeprefix("h264_")}
            for frame in frames:
                file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
            file.mux(stream.encode())
    return np.stack(list(read_video(path)))
