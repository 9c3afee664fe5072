"""Range images of known surfaces, drawn and not rendered."""

import numpy as np

from jaxscan.precision import as_numpy
from jaxscan.reconstruction import RangeImage
from jaxscan.rig import Linear

STAGE = as_numpy(Linear.create([0.0, 0.001, 0.0]))


def seen(
    height: np.ndarray, noise: float = 0.0, spacing: tuple[float, float] = (0.4, 0.2), seed: int = 0
) -> RangeImage:
    """A height field over a floor 300 mm below the camera, NaN for none; frames along y, columns along x.

    The camera is above the frame that it sees.
    """
    frames, columns = height.shape
    y, x = np.meshgrid(spacing[0] * np.arange(frames), spacing[1] * (np.arange(columns) - columns / 2), indexing="ij")
    rng = np.random.default_rng(seed)
    points = np.stack([x, -y, 300.0 - height + noise * rng.normal(size=height.shape)], axis=-1).astype(np.float32)
    valid = np.isfinite(height)
    points[~valid] = np.nan
    return RangeImage(
        points=points,
        pixels=np.where(valid, 100.0, np.nan).astype(np.float32),
        strength=np.where(valid, 250.0, np.nan).astype(np.float32),
        sigma=np.where(valid, 0.05, np.nan).astype(np.float32),
        sigma_pixel=np.where(valid, noise, np.nan).astype(np.float32),
        valid=valid,
        positions={"stage": (1000 * spacing[0] * np.arange(frames)).astype(np.int64)},
        motion=STAGE,
    )


def grid(frames: int = 60, columns: int = 120, spacing: tuple[float, float] = (0.4, 0.2)) -> tuple[np.ndarray, ...]:
    """Coordinates across and along, mm, zero in the middle."""
    y, x = np.meshgrid(
        spacing[0] * (np.arange(frames) - frames / 2), spacing[1] * (np.arange(columns) - columns / 2), indexing="ij"
    )
    return x, y


def block(high: float = 5.0, noise: float = 0.02) -> RangeImage:
    """A block of 12 × 12 mm on a floor of 24 × 24 mm; its walls cast no shadow and have no points."""
    x, y = grid()
    return seen(np.where((np.abs(x) < 6) & (np.abs(y) < 6), high, 0.0), noise)


def ball(radius: float = 8.0, noise: float = 0.0) -> RangeImage:
    """The upper part of a ball on a floor."""
    x, y = grid()
    r2 = x**2 + y**2
    return seen(np.where(r2 < 0.8 * radius**2, np.sqrt(np.maximum(radius**2 - r2, 0)), 0.0), noise)
