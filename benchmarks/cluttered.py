"""Drawn photographs of a stripe and of what else is bright in them: highlights, ghosts, reflections, lamps, a window.

Light is added up in grey levels, the stripe's and its reflections' times speckle, and cut off at 255. The stripe has
steps of reflectance, steps of depth and gaps.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.special import expit

ROWS, COLUMNS = 480, 640
# Speckle's contrast, read noise in grey levels, and how bright a stripe's and a neutral surface's light is.
_SPECKLE, _NOISE, _PEAK, _GROUND = 0.2, 2.0, 170.0, 40.0
# What a red laser leaves in green and blue.
_RED: Final = np.array([1.0, 0.06, 0.04])
_WHITE: Final = np.ones(3)
# Of the stripe's own light within three of its σ: from this part of it on what is drawn over it hides it.
_HIDES, _WITHIN = 0.3, 3.0
# A ghost is seen across gaps up to this number of columns from the stripe.
_GOES_ON: Final = 30

Light = Float[np.ndarray, "rows columns rgb"]
Row = Float[np.ndarray, "columns"]


@dataclass(frozen=True)
class Drawn:
    """A photograph and what is true of it.

    Attributes:
        image: RGB.
        centre: the stripe's row in each column; NaN where it has none.
        hidden: where something as bright lies on the stripe: no detector can be asked for it.
    """

    image: UInt8[np.ndarray, "rows columns rgb"]
    centre: Row
    hidden: Bool[np.ndarray, "columns"]


def course(random: np.random.Generator) -> tuple[Row, Row]:
    """A stripe's row and reflectance in each column: curved, with steps of depth and of reflectance, and gaps."""
    u = np.arange(COLUMNS)
    centre = ROWS / 2 + random.uniform(-60, 60) + random.uniform(10, 50) * np.sin(u / random.uniform(60, 160))
    for _ in range(2):
        first, length = random.integers(40, 420), random.integers(40, 180)
        centre[first : first + length] += random.choice([-1, 1]) * random.uniform(15, 60)
    for _ in range(2):
        first, length = random.integers(20, 560), random.integers(15, 50)
        centre[first : first + length] = np.nan
    return centre, reflectances(random)


def reflectances(random: np.random.Generator) -> Row:
    """Steps of reflectance from 1 down to 0.3."""
    at = np.sort(random.integers(20, COLUMNS - 20, 6))
    return np.repeat(random.uniform(0.3, 1.0, 7), np.diff(np.concatenate([[0], at, [COLUMNS]])))


def photograph(
    centre: Row,
    height: Row,
    s: float,
    kinds: Sequence[str],
    random: np.random.Generator,
    rgb: Float[np.ndarray, "3"] = _RED,
    still: np.random.Generator | None = None,
) -> Drawn:
    """One photograph.

    Args:
        centre: the stripe's row in each column; NaN for none.
        height: its peak in each column, in parts of the usual.
        s: its standard deviation, px.
        kinds: what else is in it, of `KINDS`.
        random: of noise and speckle, and of what else is in it.
        rgb: the laser's colour.
        still: of what else is in it, where that is to stand still from one photograph to the next.
    """
    stripe = _PEAK * _line(centre, height, s)
    clutter = np.zeros((ROWS, COLUMNS, 3))
    for kind in kinds:
        clutter += KINDS[kind](still or random, centre, s, rgb)
    v, u = np.mgrid[:ROWS, :COLUMNS]
    ground = _GROUND + 12 * np.sin(u / 70) + 12 * np.cos(v / 50)
    speckle = random.gamma(_SPECKLE**-2, _SPECKLE**2, stripe.shape)
    light = ground[..., None] + (stripe * speckle)[..., None] * rgb + clutter
    image = np.rint(light + _NOISE * random.standard_normal(light.shape)).clip(0, 255).astype(np.uint8)
    own = int(np.argmax(rgb))
    near = np.abs(v - centre) < _WITHIN * s
    over = np.where(near, clutter[..., own], 0.0).max(axis=0)
    return Drawn(image, centre, over > _HIDES * _PEAK * height)


def _line(centre: Row, height: Row, s: float) -> Float[np.ndarray, "rows columns"]:
    z = (np.arange(ROWS)[:, None] - np.where(np.isfinite(centre), centre, -1e3)) / s
    return height * np.exp(-0.5 * z * z)


def _blob(
    at: tuple[float, float], long: float, short: float, angle: float, peak: float
) -> Float[np.ndarray, "rows columns"]:
    v, u = np.mgrid[:ROWS, :COLUMNS]
    x, y = u - at[0], v - at[1]
    along, across = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    return peak * np.exp(-0.5 * ((along / long) ** 2 + (across / short) ** 2))


def _anywhere(random: np.random.Generator) -> tuple[float, float]:
    return random.uniform(30, COLUMNS - 30), random.uniform(30, ROWS - 30)


def _highlight(random: np.random.Generator, centre: Row, s: float, rgb: Row) -> Light:
    """A lamp's image in a bulge: round, white, burnt out."""
    s = random.uniform(3, 9)
    return _blob(_anywhere(random), s, s, 0.0, random.uniform(400, 2500))[..., None] * _WHITE


def _long_highlight(random: np.random.Generator, centre: Row, s: float, rgb: Row) -> Light:
    """… in an edge that is rounded off."""
    long, short, angle = random.uniform(15, 45), random.uniform(1.2, 4), random.uniform(-1.2, 1.2)
    return _blob(_anywhere(random), long, short, angle, random.uniform(400, 1500))[..., None] * _WHITE


def _rim(random: np.random.Generator, centre: Row, s: float, rgb: Row) -> Light:
    """An arc of a burnt-out rim."""
    v, u = np.mgrid[:ROWS, :COLUMNS]
    at, radius, middle = _anywhere(random), random.uniform(40, 140), random.uniform(-np.pi, np.pi)
    off = np.hypot(u - at[0], v - at[1]) - radius
    turn = np.angle(np.exp(1j * (np.arctan2(v - at[1], u - at[0]) - middle)))
    fade = np.exp(-0.5 * (turn / random.uniform(0.3, 0.7)) ** 2)
    return (random.uniform(500, 900) * fade * np.exp(-0.5 * (off / random.uniform(0.8, 1.6)) ** 2))[..., None] * _WHITE


def _ghost(random: np.random.Generator, centre: Row, s: float, rgb: Row) -> Light:
    """The stripe once more, 35 % as bright, above or below; it goes on across gaps."""
    known, rows = _known(centre)
    u = np.arange(COLUMNS)
    beside = np.abs(u[:, None] - known).min(axis=1, initial=COLUMNS) <= _GOES_ON
    whole = np.where(beside, np.interp(u, known, rows, np.nan, np.nan), np.nan)
    return _laser(whole + random.choice([-1, 1]) * random.uniform(35, 130), 0.35 * reflectances(random), s, random, rgb)


def _crossing_ghost(random: np.random.Generator, centre: Row, s: float, rgb: Row) -> Light:
    """… at a slant."""
    u = np.arange(COLUMNS)
    through = np.interp(u, *_known(centre)).mean()
    slope = random.choice([-1, 1]) * random.uniform(0.15, 0.6)
    return _laser(through + slope * (u - random.uniform(150, 490)), 0.35 * reflectances(random), s, random, rgb)


def _mirror(random: np.random.Generator, centre: Row, s: float, rgb: Row) -> Light:
    """A part of the stripe upside down, as a polished floor shows it."""
    first, length = random.integers(20, 400), random.integers(80, 200)
    part = np.full(COLUMNS, np.nan)
    part[first : first + length] = centre[first : first + length]
    middle = np.nanmean(part) if np.isfinite(part).any() else ROWS / 2
    axis = middle + random.choice([-1, 1]) * random.uniform(25, 70)
    return _laser(2 * axis - part, random.uniform(0.2, 0.6) * reflectances(random), s, random, rgb)


def _glints(random: np.random.Generator, centre: Row, s: float, rgb: Row) -> Light:
    """Small bright spots, half of them of the laser's colour."""
    light = np.zeros((ROWS, COLUMNS, 3))
    for i in range(16):
        s = random.uniform(0.7, 2.5)
        light += _blob(_anywhere(random), s, s, 0.0, random.uniform(150, 900))[..., None] * (rgb if i % 2 else _WHITE)
    return light


def _lamp(random: np.random.Generator, centre: Row, s: float, rgb: Row) -> Light:
    """A lamp of the laser's colour in view, with its halo."""
    v, u = np.mgrid[:ROWS, :COLUMNS]
    at, radius = _anywhere(random), random.uniform(12, 35)
    off = np.hypot(u - at[0], v - at[1])
    disc = random.uniform(250, 600) * expit((radius - off) / 0.7)
    halo = random.uniform(30, 110) * np.exp(-0.5 * (off / (random.uniform(1.5, 2.5) * radius)) ** 2)
    return (disc + halo)[..., None] * (0.8 * rgb + 0.2 * rgb.max() * _WHITE)


def _window(random: np.random.Generator, centre: Row, s: float, rgb: Row) -> Light:
    """A window at the photograph's border, white, with a straight edge at a slant and a bar."""
    v, u = np.mgrid[:ROWS, :COLUMNS]
    top, slope = random.uniform(30, 110), random.uniform(-0.1, 0.1)
    edge = v - (top + slope * u)
    inside = expit(-edge / 0.6) * (np.abs(u - random.uniform(150, 490)) < random.uniform(60, 200))
    bar = np.exp(-0.5 * ((edge + 20) / random.uniform(1, 2)) ** 2)
    level = random.uniform(120, 350) * inside * (1 - bar)
    return (level[::-1] if random.random() < 0.3 else level)[..., None] * _WHITE


def _laser(centre: Row, height: Row, s: float, random: np.random.Generator, rgb: Row) -> Light:
    line = _PEAK * _line(centre, height, s)
    return (line * random.gamma(_SPECKLE**-2, _SPECKLE**2, line.shape))[..., None] * rgb


def _known(centre: Row) -> tuple[Row, Row]:
    known = np.flatnonzero(np.isfinite(centre))
    return known.astype(float), centre[known]


KINDS: Final[dict[str, Callable[[np.random.Generator, Row, float, Row], Light]]] = {
    "highlight": _highlight,
    "long_highlight": _long_highlight,
    "rim": _rim,
    "ghost": _ghost,
    "crossing_ghost": _crossing_ghost,
    "mirror": _mirror,
    "glints": _glints,
    "lamp": _lamp,
    "window": _window,
}
