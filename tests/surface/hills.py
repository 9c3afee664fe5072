"""A hilly disc seen from above in any orientation, with what is true of it."""

import numpy as np
from scipy.spatial.transform import Rotation

from jaxscan.geometry import Pose
from jaxscan.reconstruction import RangeImage
from jaxscan.surface.side import Side, side_of_image
from tests.surface.scenes import grid, seen

NOISE = 0.02
RADIUS = 9.0
_HILLS = np.array([[-4, 2, 2.5, 3], [3, 4, 1.8, 2], [2, -4, 3.0, 2.5], [-3, -4, 1.5, 1.5], [6, -1, 2.2, 1.5]])
# Platform coordinates (x, y, up) to the object frame of `scenes.seen`.
_A, _C = np.diag([1.0, -1.0, -1.0]), np.array([0.0, -12.0, 300.0])


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The height of the disc and its hills over the floor, mm; 0 beside it."""
    hills = sum(h * np.exp(-((x - a) ** 2 + (y - b) ** 2) / r**2) for a, b, h, r in _HILLS)
    return np.where(x**2 + y**2 < RADIUS**2, 3.0 + hills, 0.0)


def scanned(degrees: float, seed: int = 0, shift: tuple[float, float] = (0.0, 0.0)) -> RangeImage:
    """A scan with the disc turned anticlockwise as seen from above, then shifted (mm)."""
    x, y = grid()
    a = np.radians(degrees)
    x, y = x - shift[0], y - shift[1]
    return seen(height(np.cos(a) * x + np.sin(a) * y, np.cos(a) * y - np.sin(a) * x), NOISE, seed=seed)


def pose(degrees: float, shift: tuple[float, float] = (0.0, 0.0)) -> Pose:
    """T_first_side of a scan, where the first one is neither turned nor shifted."""
    R = _A @ Rotation.from_euler("z", -degrees, degrees=True).as_matrix() @ _A
    return Pose.from_matrix(R, _C - R @ (_C + _A @ [*shift, 0.0]))


def side(name: str, image: RangeImage) -> Side:
    """What stands on the floor."""
    return side_of_image(name, image, cleaned=False)
