"""Sessions drawn through lenses that no formula has: a formula's camera, and a smooth field of shifts of its pixels.

A pixel is that of the formula's camera, moved by a field of the pixel. A random field is a sum of plane waves of about
one wavelength, a dent a bell of shifts to one side.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from benchmarks.drawn import Noise, project
from jaxscan.calibration import Observations, StripePoints, View
from jaxscan.geometry import Pose, vector_to_matrix
from jaxscan.images import Board
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, LightPlane, Rig
from jaxscan.rig.projection import pixel_rays

IMAGE_SIZE = (640, 480)
BOARD = Board.checkerboard((14, 11), 16.0)
_WAVES = 12
_CORRECTIONS = 20
_BORDER_PX = 2.0
# Where the laser's sheet lies: it meets boards across the middle of the image.
_OMEGA = np.array([0.0, -0.00494, 0.00303])
_COLUMNS_APART = 8
_NOISE = Noise(0.05, 0.1)


@dataclass(frozen=True)
class Field:
    """Shifts of pixels.

    Attributes:
        waves: of plane waves, radians for each pixel.
        phases: of each wave and component, radians.
        heights: of each wave and component, pixels.
        dent: middle (u, v), width, and shift (u, v) of a bell, pixels.
    """

    waves: Float[np.ndarray, "waves 2"]
    phases: Float[np.ndarray, "waves 2"]
    heights: Float[np.ndarray, "waves 2"]
    dent: tuple[float, float, float, float, float] = (0.0, 0.0, 1.0, 0.0, 0.0)

    @staticmethod
    def random(seed: int, rms_px: float, share: float = 1 / 3) -> "Field":
        """Shifts by a seed: of an RMS along each axis, of wavelengths from 0.8 to 1.25 of a share of the image."""
        random = np.random.default_rng([33, seed])
        length = share * IMAGE_SIZE[0] * random.uniform(0.8, 1.25, _WAVES)
        angle = random.uniform(0, 2 * np.pi, _WAVES)
        waves = 2 * np.pi / length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        phases = random.uniform(0, 2 * np.pi, (_WAVES, 2))
        return Field(waves, phases, np.full((_WAVES, 2), rms_px * np.sqrt(2 / _WAVES)))

    @staticmethod
    def of_dent(seed: int, depth_px: float, width_px: float = 50.0) -> "Field":
        """A bell at a place of a seed."""
        random = np.random.default_rng([34, seed])
        u, v, angle = random.uniform(150, 490), random.uniform(120, 360), random.uniform(0, 2 * np.pi)
        none = np.zeros((0, 2))
        dent = (u, v, width_px, depth_px * np.cos(angle), depth_px * np.sin(angle))
        return Field(none, none, none, dent)

    def moved(self, pixels: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2"]:
        """Where the lens images what the formula images at these pixels."""
        waves = np.cos((pixels @ self.waves.T)[:, :, None] + self.phases)
        u, v, width, *shift = self.dent
        bell = np.exp(-0.5 * ((pixels - [u, v]) ** 2).sum(axis=1) / width**2)
        return pixels + (waves * self.heights).sum(axis=1) + bell[:, None] * shift

    def moved_back(self, pixels: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2"]:
        """The inverse, converged."""
        at = pixels
        for _ in range(_CORRECTIONS):
            at = at + pixels - self.moved(at)
        return at


def camera_of(k1: float = -0.13) -> Camera:
    """The formula beneath: a lens of Brown's."""
    with float64():
        numbers = [k1, 0.05, 0.0], [1e-3, -8e-4]
        return as_numpy(Camera.create(IMAGE_SIZE, [697.7, 690.4], [310.3, 238.1], "brown", *numbers))


def rays_of(camera: Camera, field: Field, pixels: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 3"]:
    """The true rays (x, y, 1) of pixels."""
    return pixel_rays(camera, field.moved_back(pixels))


def session_through(
    camera: Camera,
    field: Field,
    seed: int,
    views: int = 16,
    noise: Noise = _NOISE,
    spread: tuple[float, float] = (0.22, 0.16),
    board: Board = BOARD,
    distances: tuple[float, float] = (260.0, 420.0),
    laser: bool = True,
) -> tuple[Rig, Observations]:
    """Boards in front of a camera, with the stripe of a flat sheet on them; corners out of the image are not seen.

    Args:
        camera: the formula.
        field: on top of it.
        seed: of poses and noise.
        views: how many.
        noise: of corners and stripes.
        spread: how far from the axis the middles of boards stand, in x / z and y / z.
        board: the board.
        distances: the nearest and the farthest, mm.
        laser: whether there is a stripe.
    """
    random, points, seen = np.random.default_rng([35, seed]), board.points(), []
    size = np.array(IMAGE_SIZE)
    for i in range(views):
        R = vector_to_matrix(np.array([*random.uniform(-0.5, 0.5, 2), random.uniform(-0.3, 0.3)]))
        depth = random.uniform(*distances)
        t = depth * np.array([*(random.uniform(-1, 1, 2) * spread), 1.0]) - R @ points.mean(axis=0)
        corners = field.moved(project(camera, points @ R.T + t)) + noise.corner * random.normal(size=(len(points), 2))
        inside = np.all((corners > _BORDER_PX) & (corners < size - 1 - _BORDER_PX), axis=1, keepdims=True)
        stripes = ()
        if laser:
            stripe = _stripe(camera, field, R, t, board)
            stripe[:, 1] += noise.stripe * random.normal(size=len(stripe))
            stripes = (StripePoints(stripe, half_width_px=1e-6),)
        seen.append(View(f"view-{i}", np.where(inside, corners, np.nan), stripes=stripes))
    lights = (LightPlane.create(_OMEGA),) if laser else ()
    with float64():
        rig = as_numpy(Rig(camera, lights))
    return rig, Observations(IMAGE_SIZE, board, tuple(seen), (), ("",) if laser else ())


def _stripe(
    camera: Camera, field: Field, R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, "3"], board: Board
) -> Float[np.ndarray, "columns 2"]:
    """Where the sheet is seen on a board, on some columns; NaN where it is not."""
    a = _OMEGA @ R[:, :2]
    along = np.array([-a[1], a[0]]) / np.hypot(*a)
    line = a * (1 - _OMEGA @ t) / (a @ a) + np.linspace(-500, 500, 8001)[:, None] * along
    most = board.points()[:, :2].max(axis=0)
    line = line[((line > -board.pitch_mm / 2) & (line < most + board.pitch_mm / 2)).all(axis=1)]
    columns = np.arange(0.0, IMAGE_SIZE[0], _COLUMNS_APART)
    none = np.full((len(columns), 2), np.nan)
    if len(line) < 50:
        return none
    pixels = field.moved(project(camera, Pose.from_matrix(R, t).apply(np.pad(line, ((0, 0), (0, 1))))))
    order = np.argsort(pixels[:, 0])
    rows = np.interp(columns, *pixels[order].T, left=np.nan, right=np.nan)
    seen = np.isfinite(rows) & (rows > 0) & (rows < IMAGE_SIZE[1] - 1)
    return np.where(seen[:, None], np.stack([columns, rows], axis=1), none)
