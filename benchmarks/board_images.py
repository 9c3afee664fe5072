"""Photographs of checkerboards with known corners, by a renderer that shares no line and no lens with the library.

The scene is evaluated on cells of 1/8 px; cells that an edge crosses are averaged over 4 × 4 samples, so that there are
32 × 32 samples to a pixel wherever it matters. The point spread is applied to the cells, where a sampled Gaussian of 4
cells or more is exact, then each pixel is the mean of its 8 × 8 cells. The lens maps a distorted to an undistorted ray,
x_u = x_d (1 + a r_d²): that direction is closed, and the few corners go the other way by Newton's method.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

CELLS = 8
_SAMPLES = 4
IMAGE_SIZE = (640, 480)
COUNTS = (9, 6)
_PRINCIPAL = np.array([315.3, 236.8])
_DARK, _LIGHT = 0.15, 0.85


@dataclass(frozen=True)
class Line:
    """A laser's line along a row of corners: a Gaussian, straight on the board.

    Attributes:
        row: the row of corners that it runs along.
        beside_px: how far beside the row, in pixels of a board that faces the camera.
        core_px: how wide it is burnt out on the light squares, in the same pixels.
        power: its light in its middle, grey levels on a white surface.
        slant: its angle with the row, about the row's middle, radians.
    """

    row: int
    beside_px: float
    core_px: float
    power: float
    slant: float = 0.0


@dataclass(frozen=True)
class Shot:
    """How one photograph is taken.

    Attributes:
        square_px: side of a square that faces the camera.
        tilt: largest angle between the board and the image, radians.
        blur_px: standard deviation of the Gaussian point spread.
        disc_px: radius of a uniform disc that the point spread is convolved with: defocus.
        noise: standard deviation of the noise, grey levels.
        exposure: grey level of a white surface.
        trouble: what else stands in the picture: "", "stripe", "highlight", "border" or "occluder".
        line: a laser's line along a row.
        gamma: levels are 255 (light / 255) ** gamma.
        jpeg: quality of JPEG compression, 0 for none.
        bayer: whether each pixel has one colour, the others interpolated.
        turn: largest roll of the camera, radians.
        focal_px: focal length.
        undistort: a of the lens; 0.13 is a barrel of about k1 = −0.13.
    """

    square_px: float = 27.0
    tilt: float = np.radians(35.0)
    blur_px: float = 0.6
    disc_px: float = 0.0
    noise: float = 2.0
    exposure: float = 150.0
    trouble: str = ""
    line: Line | None = None
    gamma: float = 1.0
    jpeg: int = 0
    bayer: bool = False
    turn: float = 0.3
    focal_px: float = 700.0
    undistort: float = 0.13


@dataclass(frozen=True)
class Photograph:
    """A photograph and what is in it.

    Attributes:
        image: grey levels, or red, green and blue.
        corners: true pixels (u, v), row by row.
        clean: the same photograph's levels before noise and rounding.
        shot: how it was taken.
    """

    image: UInt8[np.ndarray, "rows columns *rgb"]
    corners: Float[np.ndarray, "corners 2"]
    clean: Float[np.ndarray, "rows columns"]
    shot: Shot


def photograph(shot: Shot, seed: int) -> Photograph:
    """A board in a random pose, lit from the side."""
    random = np.random.default_rng([seed, 77])
    columns, rows = COUNTS
    distance = shot.focal_px / shot.square_px
    axis = random.uniform(0, 2 * np.pi)
    tilt = shot.tilt * np.sqrt(random.uniform())
    R = cv2.Rodrigues(tilt * np.array([np.cos(axis), np.sin(axis), 0.0]))[0]
    R = R @ cv2.Rodrigues(np.array([0, 0, random.uniform(-shot.turn, shot.turn)]))[0]
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2).astype(float)
    room = (np.array(IMAGE_SIZE) - shot.square_px * (np.array(COUNTS) + 1.5)).clip(8) / 2
    aside = random.uniform(-0.6, 0.6, 2) * room
    if shot.trouble == "border":
        aside = np.array([1, 0.6]) * (np.array(IMAGE_SIZE) - shot.square_px * (np.array(COUNTS) - 1)) / 2
    middle = np.array([*(aside / shot.focal_px * distance), distance])
    t = middle - R @ np.array([(columns - 1) / 2, (rows - 1) / 2, 0.0])
    H = np.column_stack([R[:, 0], R[:, 1], t])
    corners = _pixels(np.column_stack([grid, np.ones(len(grid))]) @ H.T, shot)
    clean = _light(H, corners, shot, random)
    if shot.trouble:
        clean = _troubled(clean, corners, shot, random)
    levels = 255 * (clean.clip(0) / 255) ** shot.gamma
    return Photograph(_sensor(levels, shot, random), corners, levels, shot)


def _pixels(X: Float[np.ndarray, "points 3"], shot: Shot) -> Float[np.ndarray, "points 2"]:
    """Pinhole, and the lens backwards."""
    x = X[:, :2] / X[:, 2:]
    r_u = np.hypot(x[:, 0], x[:, 1])
    r = r_u.copy()
    for _ in range(20):
        r -= (r + shot.undistort * r**3 - r_u) / (1 + 3 * shot.undistort * r**2)
    return shot.focal_px * x * (r / np.where(r_u > 0, r_u, 1))[:, None] + _PRINCIPAL


def _board_points(H: np.ndarray, shot: Shot, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the rays of pixels meet the board, in squares from the first corner."""
    x, y = (u - _PRINCIPAL[0]) / shot.focal_px, (v - _PRINCIPAL[1]) / shot.focal_px
    s = 1 + shot.undistort * (x * x + y * y)
    x, y = x * s, y * s
    h = np.linalg.inv(H)
    w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
    return (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w, (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w


def _albedo(i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Dark or light; paper around the squares."""
    m, n = np.floor(i).astype(np.int32), np.floor(j).astype(np.int32)
    on_board = (m >= -1) & (m < COUNTS[0]) & (n >= -1) & (n < COUNTS[1])
    return np.where(on_board & ((m + n) % 2 == 0), _DARK, _LIGHT).astype(np.float32)


def _light(H: np.ndarray, corners: np.ndarray, shot: Shot, random: np.random.Generator) -> Float[np.ndarray, "_ _"]:
    """Light on the pixels: the board about its corners, and bare paper beyond."""
    reach = 2.2 * shot.square_px + 10
    size = np.array(IMAGE_SIZE)
    low = np.floor(corners.min(axis=0) - reach).clip(0).astype(int)
    high = np.minimum(np.ceil(corners.max(axis=0) + reach), size).astype(int)
    # Cells beyond the part, so that its own border does not blur into it.
    margin = int(np.ceil(5 * shot.blur_px + shot.disc_px)) + 1
    u, v = (
        (np.arange(CELLS * (b - a + 2 * margin)) + 0.5) / CELLS - 0.5 + a - margin
        for a, b in zip(low, high, strict=True)
    )
    slope, curve = random.uniform(-0.4, 0.4, 2), random.uniform(-0.3, 0)
    far_u, far_v = (u[None, :] / size[0] - 0.5).astype(np.float32), (v[:, None] / size[1] - 0.5).astype(np.float32)
    light = shot.exposure * (1 + slope[0] * far_u + slope[1] * far_v + curve * (far_u**2 + far_v**2))
    if shot.line:
        light += _on_the_line(shot.line, H, shot, u[None, :], v[:, None])
    # A line changes nothing of the paper: photographs that differ by it alone share the work.
    paper = _paper(tuple(H.flat), replace(shot, line=None), (u[0], len(u)), (v[0], len(v)))
    cells = (paper * light).astype(np.float32)
    if shot.disc_px:
        n = int(np.ceil(shot.disc_px * CELLS))
        y, x = np.mgrid[-n : n + 1, -n : n + 1]
        disc = (np.hypot(x, y) <= shot.disc_px * CELLS).astype(np.float32)
        cells = cv2.filter2D(cells, -1, disc / disc.sum())
    sigma = shot.blur_px * CELLS
    width = 2 * int(np.ceil(5 * sigma)) + 1
    cells = cv2.GaussianBlur(cells, (width, width), sigma)
    part = cells.reshape(len(v) // CELLS, CELLS, len(u) // CELLS, CELLS).mean(axis=(1, 3))
    image = np.full(size[::-1], _LIGHT * shot.exposure)
    image[low[1] : high[1], low[0] : high[0]] = part[margin:-margin, margin:-margin]
    return image


@lru_cache(maxsize=2)
def _paper(
    H: tuple[float, ...], shot: Shot, across: tuple[float, int], down: tuple[float, int]
) -> Float32[np.ndarray, "_ _"]:
    """The reflectance of the cells of a board at H; `across` and `down` give the first cell (px) and the number."""
    pose = np.array(H).reshape(3, 3)
    u, v = (first + np.arange(count) / CELLS for first, count in (across, down))
    cells = _albedo(*_board_points(pose, shot, u[None, :], v[:, None]))
    edge = np.zeros(cells.shape, np.uint8)
    edge[:, 1:] |= cells[:, 1:] != cells[:, :-1]
    edge[1:] |= cells[1:] != cells[:-1]
    at_v, at_u = np.nonzero(cv2.dilate(edge, np.ones((3, 3), np.uint8)))
    offsets = ((np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5) / CELLS
    fine = np.zeros(len(at_u), np.float32)
    for du in offsets:
        for dv in offsets:
            fine += _albedo(*_board_points(pose, shot, u[at_u] + du, v[at_v] + dv))
    cells[at_v, at_u] = fine / _SAMPLES**2
    return cells


def _on_the_line(line: Line, H: np.ndarray, shot: Shot, u: np.ndarray, v: np.ndarray) -> Float32[np.ndarray, "_ _"]:
    """A laser's light on the board, grey levels on a white surface."""
    i, j = (x.astype(np.float32) for x in _board_points(H, shot, u, v))
    across = np.cos(line.slant) * (j - line.row) - np.sin(line.slant) * (i - (COUNTS[0] - 1) / 2)
    limit = (255 / _LIGHT - shot.exposure) / line.power
    width = line.core_px / 2 / np.sqrt(-2 * np.log(limit))
    return line.power * np.exp(-0.5 * ((across * shot.square_px - line.beside_px) / width) ** 2)


def _troubled(
    light: Float[np.ndarray, "_ _"], corners: np.ndarray, shot: Shot, random: np.random.Generator
) -> Float[np.ndarray, "_ _"]:
    """A laser's stripe, a highlight or a finger over the board. A border needs nothing."""
    v, u = np.mgrid[: light.shape[0], : light.shape[1]].astype(float)
    at = corners[random.integers(len(corners))] + random.uniform(-0.5, 0.5, 2) * shot.square_px
    angle = random.uniform(0, np.pi)
    across = np.cos(angle) * (v - at[1]) - np.sin(angle) * (u - at[0])
    if shot.trouble == "stripe":
        return light + 1500 * np.exp(-0.5 * (across / 1.0) ** 2) + 25 * np.exp(-np.abs(across) / 6)
    if shot.trouble == "highlight":
        radius = random.uniform(0.3, 1.0) * shot.square_px
        return light + 400 * np.exp(-0.5 * (np.hypot(u - at[0], v - at[1]) / radius) ** 2)
    if shot.trouble == "occluder":
        along = np.cos(angle) * (u - at[0]) + np.sin(angle) * (v - at[1])
        covered = np.clip(0.6 * shot.square_px - np.abs(across), -0.5, 0.5) + 0.5
        covered *= np.clip(along, -0.5, 0.5) + 0.5
        return light + covered * (0.5 * shot.exposure - light)
    return light


def _sensor(levels: np.ndarray, shot: Shot, random: np.random.Generator) -> UInt8[np.ndarray, "..."]:
    """Noise, rounding, and what a camera does to colours and to files."""
    raw = levels + shot.noise * random.standard_normal(levels.shape)
    image = np.rint(raw).clip(0, 255).astype(np.uint8)
    if shot.bayer:
        image = cv2.cvtColor(image, cv2.COLOR_BayerRG2RGB)
    if shot.jpeg:
        image = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, shot.jpeg])[1], -1)
    return np.asarray(image)
