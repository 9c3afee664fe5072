"""Where balls of known diameters lie in a scan: by votes for their centres.

A point x of a ball of radius R with the outward normal n votes for the centre x − R n. Votes of one ball meet in one
place; those of anything else are spread (the Hough transform: D. H. Ballard, 1981). Normals are those of planes through
the points around, n towards the camera.
"""

from itertools import permutations
from typing import Final

import numpy as np
from jaxtyping import Bool
from scipy.spatial import KDTree

from jaxscan.errors import InputError
from jaxscan.files.artefact_file import Artefact
from jaxscan.files.region import Region
from jaxscan.measurement.fit import few, finish, settle
from jaxscan.measurement.scanned import Scanned
from jaxscan.measurement.shapes import Ball, Points, Vector

_VOTERS: Final = 20_000
# Points around one by which its normal is found: within the first number of radii, at most the second number of points.
_AROUND, _NEIGHBOURS, _FEWEST = 0.35, 100, 8
# Votes for one centre lie within the first number of radii; fewer than the second are chance.
_NEAR, _LEAST_VOTES = 0.15, 15
# Of a ball's points, in radii from its centre; and how far a fitted radius may be off the known one.
BEYOND, _OFF = 1.1, 0.15
# Diameters that differ by less do not tell balls apart.
_ALIKE: Final = 0.05
_TRIES: Final = 20


def known_balls(scanned: Scanned, artefact: Artefact) -> dict[str, Region]:
    """The region of each ball of an artefact.

    Balls of about one diameter are told apart by their diameters and the certified distances, and where these do not,
    from left to right.

    Raises:
        InputError: one is not there.
    """
    places: dict[str, Ball] = {}
    left = list(artefact.balls)
    while left:
        alike = [ball for ball in left if abs(ball.diameter / left[0].diameter - 1) < _ALIKE]
        found = _balls(scanned, left[0].diameter / 2, len(alike))
        if len(found) < len(alike):
            raise InputError(
                f"{len(found)} of {len(alike)} balls of {left[0].diameter:g} mm were found: see that the scan shows "
                "them whole and nothing else of that size, that they are dull and white, and that `diameter` is in mm, "
                "or in the unit that units says"
            )
        found.sort(key=lambda ball: ball.point[0])
        places |= {ball.name: there for ball, there in zip(alike, found, strict=True)}
        left = [ball for ball in left if ball not in alike]
    return _told_apart(places, artefact)


def _balls(scanned: Scanned, radius: float, count: int) -> list[Ball]:
    """This number of balls of about a radius, those with the most votes."""
    some = few(len(scanned.points), _VOTERS)
    x = scanned.points[some]
    toward = -x if scanned.camera is None else scanned.camera[some] - x
    normal, sound = _normals(x, _AROUND * radius)
    normal *= np.sign((normal * toward).sum(axis=1))[:, None]
    x, votes = x[sound], (x - radius * normal)[sound]
    found: list[Ball] = []
    for _ in range(_TRIES):
        if len(found) == count or len(votes) < _LEAST_VOTES:
            break
        tree = KDTree(votes)
        near = tree.query_ball_point(votes, _NEAR * radius, return_length=True)
        best = int(np.argmax(near))
        if near[best] < _LEAST_VOTES:
            break
        centre = votes[tree.query_ball_point(votes[best], _NEAR * radius)].mean(axis=0)
        ball = _fitted(scanned, centre, radius)
        if ball is not None:
            found.append(ball)
            centre = ball.point
        free = np.linalg.norm(x - centre, axis=1) > BEYOND * radius
        # A place that is no ball takes the votes for it away too, so that the search goes on.
        free &= np.linalg.norm(votes - centre, axis=1) > _NEAR * radius
        x, votes = x[free], votes[free]
    return found


def _fitted(scanned: Scanned, centre: Vector, radius: float) -> Ball | None:
    region = _region(centre, radius)
    try:
        shape = finish(scanned, settle(scanned, "ball", scanned.within(region), region=region)).shape
    except InputError:
        return None
    assert isinstance(shape, Ball)
    return shape if abs(shape.radius / radius - 1) < _OFF else None


def _region(centre: Vector, radius: float) -> Region:
    x, y, z = (float(each) for each in centre)
    return Region((x, y, z), None, BEYOND * radius)


def _normals(x: Points, around: float) -> tuple[Points, Bool[np.ndarray, "points"]]:
    """The normal at each point, and where there are enough points around for one."""
    away, index = KDTree(x).query(x, min(_NEIGHBOURS, len(x)), distance_upper_bound=around)
    near = np.isfinite(away)
    off = np.where(near[..., None], x[np.where(near, index, 0)], 0.0)
    count = near.sum(axis=1)
    off = np.where(near[..., None], off - (off.sum(axis=1) / np.maximum(count, 1)[:, None])[:, None], 0.0)
    return np.linalg.eigh(off.swapaxes(1, 2) @ off)[1][:, :, 0], count >= _FEWEST


def _told_apart(places: dict[str, Ball], artefact: Artefact) -> dict[str, Region]:
    """Each place under the name by which the certified diameters and distances are met best."""
    names = list(places)
    radii = {ball.name: ball.diameter / 2 for ball in artefact.balls}
    best, least = names, np.inf
    for order in permutations(names):
        if any(abs(radii[a] / radii[b] - 1) >= _ALIKE for a, b in zip(names, order, strict=True)):
            continue
        at = dict(zip(order, (places[name] for name in names), strict=True))
        off = _mismatch(at, artefact)
        # Not for a difference that errors make.
        if off < least * (1 - 1e-2) - 1e-9:
            best, least = list(order), off
    return {name: _region(places[own].point, radii[name]) for name, own in zip(best, names, strict=True)}


def _mismatch(at: dict[str, Ball], artefact: Artefact) -> float:
    """What diameters and distances are off by in all, mm."""
    sizes = sum(abs(2 * at[ball.name].radius - ball.diameter) for ball in artefact.balls)
    apart = (float(np.linalg.norm(at[d.of[0]].point - at[d.of[1]].point)) - d.length for d in artefact.distances)
    return float(sizes + sum(abs(each) for each in apart))
