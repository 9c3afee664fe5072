"""Do the photographs of a turn go with their step counts? Boards are placed by their own corners, their angles sorted.

A turn has no beginning: photographs all around are in order from any of them, and either way round. Of all orders that
fit, the one that moves the fewest photographs is named.
"""

from typing import Final

import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.reorder import NEARER, fewest_to_move
from jaxscan.geometry.rotation import matrix_to_vector
from jaxscan.geometry.turn import rate_of_turn

# Orders that fit no worse than this multiple of the best one are as good.
_AS_GOOD: Final = 1.5


def turned_out_of_order(
    steps: Float[np.ndarray, "images"], rotations: Float[np.ndarray, "images 3 3"], solved: Float[np.ndarray, "3"]
) -> tuple[Int[np.ndarray, "images"], float, float] | None:
    """The order by angle, and how far angles are from their steps before and after (RMS, degrees).

    Args:
        steps: motor steps of each photograph.
        rotations: of the board in each.
        solved: the rotation vector of one step as it was found, radians.

    Returns:
        None where the steps do as well as they are.
    """
    angles, axis = _angles(rotations)
    # By whatever rate they go with the steps as they are.
    rates = {float(axis @ rate) for rate in (solved, rate_of_turn(rotations, steps))}
    by_step = np.argsort(steps, kind="stable")
    orders = []
    for way in (1.0, -1.0):
        order = np.argsort(way * angles, kind="stable")
        for first in range(len(steps)):
            begun = np.roll(order, -first)
            rising = way * angles[begun] + 2 * np.pi * (np.arange(len(begun)) >= len(begun) - first)
            rate, *_ = np.polyfit(steps[by_step], rising, 1)
            orders.append((_from_turn(steps[by_step], way * angles[begun], rate), begun, way * rate))
    least = max(min(error for error, *_ in orders), np.finfo(float).tiny)
    good = [each for each in orders if each[0] <= _AS_GOOD * least]
    after, order, rate = min(good, key=lambda each: len(fewest_to_move(by_step.tolist(), each[1].tolist())))
    before = min(_from_turn(steps, angles, each) for each in (*rates, rate, -rate))
    return (order, float(np.degrees(before)), float(np.degrees(after))) if after < NEARER * before else None


def _angles(
    rotations: Float[np.ndarray, "images 3 3"],
) -> tuple[Float[np.ndarray, "images"], Float[np.ndarray, "3"]]:
    """How far each is turned from the first one, radians in half a turn either way; and about which axis."""
    each = matrix_to_vector((rotations[:, None] @ rotations[None].mT).reshape(-1, 3, 3))
    axis = np.linalg.eigh(each.T @ each)[1][:, -1]
    turned = rotations @ rotations[0].T
    sine = 0.5 * np.stack([turned[:, k - 1, k - 2] - turned[:, k - 2, k - 1] for k in range(3)], axis=1) @ axis
    return np.arctan2(sine, 0.5 * (np.trace(turned, axis1=1, axis2=2) - 1)), axis


def _from_turn(steps: Float[np.ndarray, "images"], angles: Float[np.ndarray, "images"], rate: float) -> float:
    """RMS distance of angles from those that a rate gives, the best beginning of the turn, radians."""
    left = angles - rate * steps
    left = left - np.angle(np.exp(1j * left).sum())
    left = np.angle(np.exp(1j * left))
    return float(np.sqrt((left**2).mean()))
