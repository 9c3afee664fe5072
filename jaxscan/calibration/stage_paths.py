"""The path of a stage beside a line: bow, turn along the travel, wave of its screw, play; by linear least squares.

What is fitted are the own places of its photographs (`own_places`). A wave a cos w + b sin w, w = 2π n / period, is
linear but for its period, which is searched: the one with the largest fall of the squares, among all that photographs
can resolve (N. R. Lomb 1976). Photographs at equal distances do not distinguish a period from its aliases; of those
that fit as well the longest is taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import stats

from jaxscan.calibration.own_places import OwnPlaces, axes_along, own_places, sigmas_along
from jaxscan.calibration.result import Calibration
from jaxscan.rig.line import Line
from jaxscan.rig.play import FAR

# No screw is finer, mm of travel for a turn.
FINEST_MM = 0.25
# Photographs must cover this number of turns of a screw: less looks like a bow.
FEWEST_TURNS = 1.5
# Frequencies for each turn over the travel, and how the best is closed in on.
_FINE, _CLOSER, _ZOOMS = 8, 21, 3
# Of a wave that is known at all: cosine and sine differ from a line, and from each other, by this share of their
# squares.
LEAST_TOLD = 0.02
# A period fits as well as the best where χ² is larger by less than this, and looks the same where by less than that;
# so does another direction of the first photograph.
_AS_WELL, _ALIKE = 1.0, 9.0
# Least number of photographs by rising steps, and by falling ones, that determine play.
FEWEST_EACH_WAY = 2
# A wave that chance shows less often has a period.
_WAVE = 0.01


@dataclass(frozen=True)
class Course:
    """What the photographs of one axis say of its path.

    Attributes:
        axis: its name.
        direction: of its travel, unit.
        mm_per_step: the travel for one motor step.
        steps: of each photograph.
        sequence: which of the axis's sequences each belongs to, from 0.
        way: whether each was approached by rising steps, 1, by falling ones, −1, or neither.
        first: whether nothing was photographed before it that says how it was approached.
        moved: own places beside the fitted path: along the travel and in two directions across it, mm.
        sigma: of these, as the corners leave it.
        turned: own turns, radians, in the same directions.
        turned_sigma: of these.
        distance: of the boards from the camera, mm.
        reach: from the middle of the board to its farthest corner, mm.
    """

    axis: str
    direction: Float[np.ndarray, "3"]
    mm_per_step: float
    steps: Float[np.ndarray, "images"]
    sequence: Int[np.ndarray, "images"]
    way: Float[np.ndarray, "images"]
    first: Bool[np.ndarray, "images"]
    moved: Float[np.ndarray, "images 3"]
    sigma: Float[np.ndarray, "images 3"]
    turned: Float[np.ndarray, "images 3"]
    turned_sigma: Float[np.ndarray, "images 3"]
    distance: float
    reach: float

    @property
    def middle(self) -> float:
        """The middle of the photographs' steps."""
        return float(self.steps.min() + self.steps.max()) / 2

    @property
    def half(self) -> float:
        """Half of the steps that they cover."""
        return float(np.ptp(self.steps)) / 2

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Along the travel and two directions across it."""
        return axes_along(self.direction)

    def line(self) -> Float[np.ndarray, "images columns"]:
        """What places may differ by without a word: an offset and a slope of each sequence."""
        own = self.sequence[:, None] == np.arange(self.sequence.max() + 1)
        return np.concatenate([own, own * self.along[:, None]], axis=1).astype(float)

    @property
    def along(self) -> Float[np.ndarray, "images"]:
        """Where they stand, −1 to 1."""
        return (self.steps - self.middle) / self.half

    def bow(self) -> Float[np.ndarray, "images 1"]:
        """A parabola, 1 at the ends and 0 in the middle."""
        return (self.along**2)[:, None]

    def play(self) -> Float[np.ndarray, "images 1"]:
        """How far a load with a play of 1 is ahead of its steps."""
        return -self.way[:, None] / 2

    @property
    def there_and_back(self) -> bool:
        """Whether a sequence determines play: two photographs and more by rising steps, and as many by falling ones."""
        each = [self.way[self.sequence == i] for i in range(self.sequence.max() + 1)]
        return any(min(int((way > 0).sum()), int((way < 0).sum())) >= FEWEST_EACH_WAY for way in each)

    def in_time(self) -> Float[np.ndarray, "images sequences"]:
        """A drift of each sequence from its first photograph to its last, −1 to 1."""
        columns = np.zeros((len(self.steps), int(self.sequence.max()) + 1))
        for i in range(columns.shape[1]):
            own = self.sequence == i
            columns[own, i] = np.linspace(-1, 1, own.sum())
        return columns

    def wave(self, period: float) -> Float[np.ndarray, "images 2"]:
        """Cosine and sine of the screw's turn."""
        w = 2 * np.pi * self.steps / period
        return np.stack([np.cos(w), np.sin(w)], axis=1)


def courses(calibration: Calibration) -> dict[str, Course]:
    """The course of each axis that moves its load along a line, more or less."""
    by_axis: dict[str, list[OwnPlaces]] = {}
    for places in own_places(calibration):
        if isinstance(calibration.rig.axis(places.sequence.axis), Line):
            by_axis.setdefault(places.sequence.axis, []).append(places)
    return {axis: _course(calibration, axis, each) for axis, each in by_axis.items()}


def _course(calibration: Calibration, axis: str, each: Sequence[OwnPlaces]) -> Course:
    line = calibration.rig.axis(axis)
    axes, points = axes_along(line.direction()), calibration.observations.board.points()
    return Course(
        axis=axis,
        direction=line.direction(),
        mm_per_step=line.amount(1.0)[0],
        steps=np.concatenate([places.sequence.steps for places in each]),
        sequence=np.repeat(np.arange(len(each)), [len(places.names) for places in each]),
        way=np.concatenate([np.sign(places.sequence.runs) for places in each]),
        first=np.concatenate([np.abs(places.sequence.runs) == FAR for places in each]),
        moved=np.concatenate([places.moved @ axes.T for places in each]),
        sigma=np.concatenate([sigmas_along(axes, places.moved_covariance) for places in each]),
        turned=np.concatenate([places.turned @ axes.T for places in each]),
        turned_sigma=np.concatenate([sigmas_along(axes, places.turned_covariance) for places in each]),
        distance=float(np.mean([np.linalg.norm(places.corners.mean(axis=1), axis=1).mean() for places in each])),
        reach=float(np.linalg.norm(points - points.mean(axis=0), axis=1).max()),
    )


@dataclass(frozen=True)
class Fit:
    """Some columns fitted beside others.

    Attributes:
        values: of the columns.
        covariance: of these, by the scatter about the fit.
        scatter: σ about the fit, in units of the σ that were given.
        p: how often chance would show as much (R. A. Fisher's F).
        fall: by how much χ² falls for them, in units of the scatter about the fit.
        left: χ² about the fit.
    """

    values: Float[np.ndarray, "columns"]
    covariance: Float[np.ndarray, "columns columns"]
    scatter: float
    p: float
    fall: float
    left: float


def fitted(
    values: Float[np.ndarray, "n"],
    sigma: Float[np.ndarray, "n"],
    beside: Float[np.ndarray, "n others"],
    columns: Float[np.ndarray, "n columns"],
) -> Fit | None:
    """Columns fitted to values beside others; None where too few are left to estimate the scatter."""
    y, A, B = values / sigma, columns / sigma[:, None], beside / sigma[:, None]
    Q = np.linalg.qr(B)[0]
    y, A = y - Q @ (Q.T @ y), A - Q @ (Q.T @ A)
    degrees = len(y) - np.linalg.matrix_rank(B) - A.shape[1]
    if degrees < 1:
        return None
    inverse = np.linalg.pinv(A.T @ A, hermitian=True)
    found = inverse @ A.T @ y
    left = float(((y - A @ found) ** 2).sum())
    fall = float((y**2).sum()) - left
    variance = max(left / degrees, np.finfo(float).tiny)
    p = float(stats.f.sf(fall / A.shape[1] / variance, A.shape[1], degrees))
    return Fit(found, variance * inverse, variance**0.5, p, fall / variance, left)


@dataclass(frozen=True)
class Periods:
    """What a search for a screw's period found.

    Attributes:
        period: of the wave that is taken, steps.
        others: those that fit nearly as well, the longest first.
        fit: of cosine and sine of that period.
        p: how often chance would show as much at any period.
    """

    period: float
    others: tuple[float, ...]
    fit: Fit
    p: float


def find_period(course: Course, beside: Float[np.ndarray, "images others"]) -> Periods | None:
    """The period of what is left along the travel; None where the photographs show none.

    Args:
        course: of the axis.
        beside: what is fitted together with them.
    """
    travel = 2 * course.half
    apart = np.unique(course.steps - course.steps.min())[1:]
    every = float(np.gcd.reduce(np.round(apart).astype(int))) if len(apart) else 0.0
    least, most = FEWEST_TURNS / travel, course.mm_per_step / FINEST_MM
    if most <= least or every <= 0:
        return None
    frequencies = np.arange(least, most, 1 / (_FINE * travel))
    gains = _gains(course, beside, frequencies)
    if not gains.any():
        return None
    peaks = np.flatnonzero((gains >= np.r_[-np.inf, gains[:-1]]) & (gains >= np.r_[gains[1:], -np.inf]) & (gains > 0))
    # Between grid points the best may be larger than at them.
    peaks = peaks[gains[peaks] > 0.6 * gains.max()]
    closed = [_closed_in(course, beside, f, 1 / (_FINE * travel)) for f in frequencies[peaks]]
    best = max(gain for _, gain in closed)
    fit = _wave_fit(course, beside, 1 / max(closed, key=lambda each: each[1])[0])
    if fit is None:
        return None
    variance = fit.scatter**2
    alike = sorted(f for f, gain in closed if best - gain < _ALIKE * variance)
    taken = min(f for f, gain in closed if best - gain < _AS_WELL * variance)
    fit = _wave_fit(course, beside, 1 / taken)
    if fit is None:
        return None
    # Number of independent periods that were tried (R. V. Baluev 2008). Beyond half of the common divisor of all steps
    # they repeat.
    asked = max((min(most, 0.5 / every) - least) * travel, 1.0) * len(course.steps) ** 0.5
    others = tuple(1 / f for f in alike if abs(f - taken) > 0.5 / travel)
    return Periods(1 / taken, others, fit, min(1.0, fit.p * asked))


def _wave_fit(course: Course, beside: Float[np.ndarray, "images others"], period: float) -> Fit | None:
    return fitted(course.moved[:, 0], course.sigma[:, 0], beside, course.wave(period))


def told_of_wave(course: Course, beside: Float[np.ndarray, "images others"], period: float) -> float:
    """How far cosine and sine of a period differ from what is beside them, and from each other: 0 to 1."""
    return float(_told(course, beside, np.array([1 / period]))[0])


def _projected(
    course: Course, beside: Float[np.ndarray, "images others"], frequencies: Float[np.ndarray, "f"]
) -> tuple[Float[np.ndarray, "f 2 2"], Float[np.ndarray, "f 2"]]:
    """Normal equations of cosine and sine at each frequency, without what is beside them."""
    sigma = course.sigma[:, 0]
    Q = np.linalg.qr(beside / sigma[:, None])[0]
    y = course.moved[:, 0] / sigma
    y = y - Q @ (Q.T @ y)
    w = 2 * np.pi * frequencies[:, None] * course.steps
    A = np.stack([np.cos(w), np.sin(w)], axis=-1) / sigma[:, None]
    A = A - np.einsum("nq,fqc->fnc", Q, np.einsum("nq,fnc->fqc", Q, A))
    return np.einsum("fni,fnj->fij", A, A), np.einsum("fni,n->fi", A, y)


def _told(
    course: Course, beside: Float[np.ndarray, "images others"], frequencies: Float[np.ndarray, "f"]
) -> Float[np.ndarray, "f"]:
    N, _ = _projected(course, beside, frequencies)
    return np.linalg.eigvalsh(N)[:, 0] / (0.5 / course.sigma[:, 0] ** 2).sum()


def _gains(
    course: Course, beside: Float[np.ndarray, "images others"], frequencies: Float[np.ndarray, "f"]
) -> Float[np.ndarray, "f"]:
    """How much χ² falls for a wave of each frequency; 0 where it cannot be determined."""
    N, g = _projected(course, beside, frequencies)
    told = np.linalg.eigvalsh(N)[:, 0] > LEAST_TOLD * (0.5 / course.sigma[:, 0] ** 2).sum()
    N[~told] = np.eye(2)
    return np.where(told, np.einsum("fi,fi->f", g, np.linalg.solve(N, g[..., None])[..., 0]), 0.0)


def _closed_in(
    course: Course, beside: Float[np.ndarray, "images others"], frequency: float, width: float
) -> tuple[float, float]:
    """The peak near a frequency, and its gain."""
    gain = 0.0
    for _ in range(_ZOOMS):
        near = frequency + width * np.linspace(-1, 1, _CLOSER)
        gains = _gains(course, beside, near[near > 0])
        frequency, gain = float(near[near > 0][np.argmax(gains)]), float(gains.max())
        width *= 4 / _CLOSER
    return frequency, gain


def first_came_otherwise(course: Course, sequence: int) -> bool:
    """Whether a sequence's first photograph stands as one approached from the other side than the second."""
    first = course.first & (course.sequence == sequence)
    if not course.there_and_back or not first.any():
        return False
    beside = np.concatenate([course.line(), course.bow()], axis=1)
    other = replace(course, way=np.where(first, -course.way, course.way))
    fits = [fitted(course.moved[:, 0], course.sigma[:, 0], beside, each.play()) for each in (course, other)]
    if fits[0] is None or fits[1] is None:
        return False
    # Of the same numbers what is left; so the fall of χ² is that of a choice, in units of the scatter then.
    return bool(fits[0].left - fits[1].left > _ALIKE * fits[1].scatter ** 2)


def started(part: Line, course: Course, period: float | None) -> tuple[Line, Periods | None]:
    """A line with those numbers of its shape that the own places give it, from which a solve goes on.

    Args:
        part: the motion, as the solve found it with its shape held.
        course: what its photographs say.
        period: of its screw, where it is known.

    Returns:
        The motion, and what was found of the period of its screw; None where it has none, or shows no wave, whose
        period could be any.
    """
    told = None
    shape = part.shape()
    line, bow = course.line(), course.bow()
    beside = np.concatenate([line, bow], axis=1) if "bow" in shape else line
    columns = [course.along[:, None]]
    if "bow" in shape:
        columns.append(bow)
    across = len(columns)
    if "play" in shape:
        beside = np.concatenate([beside, course.play()], axis=1)
        columns.append(course.play())
    if "wave" in shape:
        if period is None:
            found = find_period(course, beside)
            period = found.period if found else 2 * course.half / FEWEST_TURNS
            told = found if found is not None and found.p < _WAVE else None
        columns.append(course.wave(period))
    offsets = line[:, : course.sequence.max() + 1]
    A = np.concatenate(columns, axis=1)
    # Along the travel all, across it neither play nor wave.
    values = np.zeros((3, A.shape[1]))
    for k in range(3):
        own = A if k == 0 else A[:, :across]
        B = np.concatenate([offsets, own], axis=1) / course.sigma[:, k, None]
        values[k, : own.shape[1]] = np.linalg.lstsq(B, course.moved[:, k] / course.sigma[:, k])[0][offsets.shape[1] :]
    in_camera = values.T @ course.axes
    m, h = course.middle, course.half
    slope = in_camera[0] / h
    changed: dict[str, np.ndarray] = {}
    if "bow" in shape:
        # ((n − m) / h)² in powers of n.
        changed["bow"] = in_camera[1] / h**2
        slope = slope - 2 * m * changed["bow"]
        A = np.concatenate([offsets, course.along[:, None]], axis=1)
        turn = [
            np.linalg.lstsq(A / s[:, None], y / s)[0][-1] / h
            for y, s in zip(course.turned.T, course.turned_sigma.T, strict=True)
        ]
        changed["turn"] = np.asarray(turn) @ course.axes
    if "play" in shape:
        changed["play"] = values[:1, across] / course.mm_per_step
    if "wave" in shape:
        changed["wave"], changed["period"] = values[0, -2:], np.array([period])
    return part.bent(slope, changed), told
