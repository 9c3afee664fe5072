"""Corners as the library finds them in photographs of `benchmarks.board_images`, and their errors."""

import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from benchmarks.board_images import COUNTS, Photograph, Shot, photograph
from jaxscan.images.refine import refine_corners

_FAR_PX = 0.3


@dataclass(frozen=True)
class Errors:
    """Errors of the corners of some photographs.

    Attributes:
        pixels: found minus true, px; NaN for a corner that was left out.
        sigma: predicted, px.
    """

    pixels: Float[np.ndarray, "corners 2"]
    sigma: Float[np.ndarray, "corners"]

    def rms(self) -> Float[np.ndarray, "2"]:
        """Along each axis, px."""
        return np.sqrt(np.nanmean(self.pixels**2, axis=0))

    def in_sigma(self) -> float:
        """RMS of the errors in units of their predicted σ."""
        return float(np.sqrt(np.nanmean((self.pixels / self.sigma[:, None]) ** 2)))

    def far(self) -> int:
        """How many are wrong by more than 0.3 px and not left out."""
        return int((np.linalg.norm(self.pixels, axis=1) > _FAR_PX).sum())


def photographs(shots: list[Shot], seeds: Iterable[int]) -> list[Photograph]:
    """A photograph of each of these poses with each seed, side by side."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(lambda each: photograph(*each), [(shot, s) for shot in shots for s in seeds]))


def refined(p: Photograph) -> tuple[np.ndarray, np.ndarray]:
    """Corners and σ, from the truth moved by as much as a finder errs."""
    columns, rows = COUNTS
    spacing = np.linalg.norm(np.diff(p.corners.reshape(rows, columns, 2), axis=1), axis=-1).min()
    moved = p.corners + np.random.default_rng(1).uniform(-1, 1, p.corners.shape) * min(1.0, 0.06 * spacing)
    corners, sigma = refine_corners(p.image, moved.reshape(rows, columns, 2))
    return corners.reshape(-1, 2), sigma.ravel()


def of_ours(taken: list[Photograph]) -> Errors:
    """Errors of the library's corners."""
    found = [refined(p) for p in taken]
    return Errors(
        np.concatenate([corners - p.corners for (corners, _), p in zip(found, taken, strict=True)]),
        np.concatenate([sigma for _, sigma in found]),
    )


def rms(values: np.ndarray) -> float:
    """The RMS of those that are numbers."""
    return float(np.sqrt(np.nanmean(np.asarray(values) ** 2)))
