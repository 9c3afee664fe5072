"""How much of a shape was seen: a small piece of a ball or a cylinder leaves its radius and its place undecided."""

from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.measurement.shapes import Ball, Circle, Cone, Cylinder, Shape

_OUTERMOST: Final = 0.98
# Below these parts of a ball's surface, and of a round's turn, the interval is wide for that reason.
_OF_BALL: Final = 0.2
_OF_TURN: Final = 90.0


def seen_part(shape: Shape, x: Float[np.ndarray, "points 3"]) -> tuple[str, ...]:
    """A sentence where only a small piece of a shape was seen."""
    if isinstance(shape, Ball):
        away = shape.gradient(x)
        middle = away.mean(axis=0)
        middle /= max(float(np.linalg.norm(middle)), 1e-300)
        part = (1 - float(np.quantile(away @ middle, 1 - _OUTERMOST))) / 2
        if part < _OF_BALL:
            return (_sentence(f"{100 * part:.0f} % of the ball"),)
    if isinstance(shape, Cylinder | Cone | Circle):
        w = shape.turned_by(x)
        angle = np.sort(np.arctan2(w[:, 1], w[:, 0]))
        turn = 360.0 - float(np.degrees(np.diff(angle, append=angle[0] + 2 * np.pi).max()))
        if turn < _OF_TURN:
            return (_sentence(f"{turn:.0f}° of its turn"),)
    return ()


def _sentence(how_much: str) -> str:
    return (
        f"only {how_much} was seen, so that radius and place are known together rather than each: the interval is "
        "wide; enlarge the region, or scan from another side too"
    )
