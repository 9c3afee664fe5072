"""How much of a shape was seen: a small piece of a ball or a cylinder leaves its radius and its place undecided."""

from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.geometry.robust_plane import random_planes
from jaxscan.measurement.shapes import Ball, Circle, Cone, Cylinder, Plane, Shape

_OUTERMOST: Final = 0.98
# Below these parts of a ball's surface, and of a round's turn, the interval is wide for that reason.
_OF_BALL: Final = 0.2
_OF_TURN: Final = 90.0
# A point of a plane is within this many times its chance of it. Where less than this part of them is, another plane is
# looked for: one that holds this part of them, and this multiple of the fitted one's.
_WITHIN_SPREADS: Final = 4.0
_OWN: Final = 0.3
_OTHER, _TIMES = 0.2, 2.5


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
        f"only {how_much} was seen, so radius and place cannot be separated well: the interval is wide; enlarge the "
        "region, or scan from another side too"
    )


def check_is_one_plane(plane: Plane, points: Float[np.ndarray, "points 3"], spread_mm: float) -> None:
    """Refuse a plane through points most of which lie on another one, as where a region holds several levels.

    A warped face is none such: no other plane has many more of its points.

    Args:
        plane: that was fitted.
        points: of its region, mm.
        spread_mm: how far a point is off by chance.

    Raises:
        InputError: they lie on several planes.
    """
    within = _WITHIN_SPREADS * spread_mm
    off = np.abs(plane.at(points)[0])
    own = float((off < within).mean())
    if own > _OWN:
        return
    best = float(random_planes(points, within)[2].max(initial=0.0))
    if best > max(_OTHER, _TIMES * own):
        rms = float(np.sqrt((off**2).mean()))
        raise InputError(
            f"the points of its region do not lie on one plane: they are {rms:.2g} mm RMS from the one that fits best, "
            f"and {best:.0%} of them lie on another within {within:.2g} mm. Make the region smaller, so that it holds "
            "one face"
        )
