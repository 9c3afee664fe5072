"""Photographs of boards and stripes with known truth. Independent of the library: only closed forms and sampling."""

import cv2
import numpy as np

# The plane's evenest sequence (M. Roberts 2018) and its mirror image: unlike a square grid of samples it has no
# direction in which edges fall on many of them at once, and its mean is exactly the pixel's centre.
_HALF = (0.5 + np.outer(np.arange(40), [0.7548776662466927, 0.5698402909980532])) % 1 - 0.5
_OFFSETS = np.concatenate([_HALF, -_HALF])


def homography(points_mm, corners_px):
    """The homography that takes four points in mm to four pixels."""
    return cv2.getPerspectiveTransform(np.float32(points_mm), np.float32(corners_px)).astype(np.float64)


def project(H, points_mm):
    p = np.c_[points_mm[:, :2], np.ones(len(points_mm))] @ H.T
    return p[:, :2] / p[:, 2:]


class Barrel:
    """A lens in OpenCV's meaning, after the homography: focal length (px), k1, k2 and the principal point (px)."""

    def __init__(self, focal, k1, k2, centre):
        self.focal, self.k1, self.k2, self.centre = focal, k1, k2, np.array(centre)
        self.table = np.linspace(0, 3, 30001)

    def bend(self, pixels):
        x = (pixels - self.centre) / self.focal
        square = (x**2).sum(axis=-1, keepdims=True)
        return self.centre + self.focal * x * (1 + self.k1 * square + self.k2 * square**2)

    def straighten(self, u, v):
        x, y = (u - self.centre[0]) / self.focal, (v - self.centre[1]) / self.focal
        r = np.maximum(np.hypot(x, y), 1e-9)
        factor = np.interp(r, self.table * (1 + self.k1 * self.table**2 + self.k2 * self.table**4), self.table) / r
        return self.centre[0] + self.focal * x * factor, self.centre[1] + self.focal * y * factor


def photograph(pattern, H, shape, *, dark=30.0, light=210.0, noise=0.0, blur=0.0, seed=0, lens=None):
    """A board by area-exact pixels: `pattern(x, y)` in mm is 1 on light, 0 on dark; `H` takes mm to pixels (u, v).

    A `lens` bends what `H` has made.
    """
    rows, columns = shape
    inverse = np.linalg.inv(H)
    total = np.zeros(shape)
    v, u = np.mgrid[:rows, :columns].astype(np.float64)
    for du, dv in _OFFSETS:
        at_u, at_v = (u + du, v + dv) if lens is None else lens.straighten(u + du, v + dv)
        x, y, w = (inverse[i, 0] * at_u + inverse[i, 1] * at_v + inverse[i, 2] for i in range(3))
        total += pattern(x / w, y / w)
    image = dark + (light - dark) * total / len(_OFFSETS)
    if blur:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    return image + noise * np.random.default_rng(seed).standard_normal(shape)


def checkerboard(counts, square_mm, first_dark=True):
    """Light paper with (columns + 1) x (rows + 1) squares; the origin is the first inner corner."""
    columns, rows = counts

    def pattern(x, y):
        i, j = np.floor(x / square_mm), np.floor(y / square_mm)
        on_board = (i >= -1) & (i < columns) & (j >= -1) & (j < rows)
        return ~(on_board & ((i + j) % 2 == (0 if first_dark else 1)))

    return pattern


def circles(counts, pitch_mm, radius_mm):
    def pattern(x, y):
        i, j = (np.clip(np.rint(c / pitch_mm), 0, n - 1) for c, n in zip((x, y), counts, strict=True))
        return (x - i * pitch_mm) ** 2 + (y - j * pitch_mm) ** 2 > radius_mm**2

    return pattern
