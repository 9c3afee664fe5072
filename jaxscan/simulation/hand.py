"""The motion of a hand that holds a board: each photograph is blurred along a way of its own.

While a photograph is exposed the middle of the board goes straight in a random direction, and the board turns about it
by a random angle that moves its rim about as far. At the time t of the exposure, from −½ to ½, it has gone the part
t + c (t² − 1/12) of the way, where c, −1 to 1, says how much faster or slower it becomes. The mean over the exposure is
0: the pose of the board is the mean one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.geometry import Pose, vector_to_matrix

# No hand that means to hold a board still moves it further.
_MOST_MM = 20.0
# Moments of an exposure are so far apart at most: less than the lens's blur.
_APART_PX = 0.3


@dataclass(frozen=True)
class Hand:
    """How still boards are held by hand.

    Attributes:
        shake_mm: how far the middle of the board moves at most while one photograph is exposed, mm; how far it does is
            even from 0 to that. Photographs of one pose are exposed right after one another, and the motion goes on.
    """

    shake_mm: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no shake.

        Raises:
            InputError: a length that cannot be.
        """
        if not 0 <= self.shake_mm <= _MOST_MM:
            raise InputError(
                f"shake_mm = {self.shake_mm}: give 0 to {_MOST_MM:g} mm, how far a board moves in one exposure; at "
                "10 mm/s that is 0.3 in 1/30 s"
            )

    def held(
        self, pose: Pose, points: Float[np.ndarray, "points 3"], seed: Sequence[int], exposures: int, px_per_mm: float
    ) -> list[list[Pose]]:
        """The poses T_cam_board of a board at even times of each of several exposures that follow each other.

        Args:
            pose: the mean one of the first exposure.
            points: of the board, board frame, mm; it turns about their middle.
            seed: of the motion.
            exposures: how many.
            px_per_mm: of the photograph at the board.
        """
        if not self.shake_mm:
            return [[pose]] * exposures
        random = np.random.default_rng(list(seed))
        middle = points.mean(axis=0)
        rim = np.linalg.norm(points - middle, axis=1).max()
        R, translation = pose.matrix(), np.asarray(pose.translation)
        start, poses = None, []
        for _ in range(exposures):
            # Along three axes the middle moves, about three the board turns, radians.
            directions = random.standard_normal((2, 3))
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
            way = directions * random.uniform(0, self.shake_mm, (2, 1)) * [[1.0], [1 / rim]]
            c = random.uniform(-1, 1)
            farthest = np.linalg.norm(way[0]) + rim * np.linalg.norm(way[1])
            # The fastest part goes at twice the mean speed.
            count = 1 + int(np.ceil(2 * px_per_mm * farthest / _APART_PX))
            t = (np.arange(count) + 0.5) / count - 0.5
            parts, (first, last) = _gone(t, c), _gone(np.array([-0.5, 0.5]), c)
            mean = np.zeros((2, 3)) if start is None else start - first * way
            poses.append([_moved(R, translation, middle, mean + part * way) for part in parts - parts.mean()])
            start = mean + last * way
        return poses


# As on a stand.
STILL: Final = Hand()


def _gone(t: Float[np.ndarray, "times"], c: float) -> Float[np.ndarray, "times"]:
    return t + c * (t**2 - 1 / 12)


def _moved(
    R: Float[np.ndarray, "3 3"],
    translation: Float[np.ndarray, "3"],
    middle: Float[np.ndarray, "3"],
    by: Float[np.ndarray, "2 3"],
) -> Pose:
    turned = vector_to_matrix(by[1]) @ R
    return Pose.from_matrix(turned, translation + by[0] + (R - turned) @ middle)
