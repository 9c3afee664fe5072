"""Heights of steps from photographs kept as JPEG: chroma for each pixel (4:4:4) or at half resolution (4:2:0, 4:2:2).

A stripe of the simulated rig of 2003 lies level on faces of known heights over a floor, so that on each its place
among the pixels is one and the same, and an error that depends on that place does not average out. Each face is read
as the mean of its columns less that of the floor. A figure is the root mean square of the errors of faces on all
surfaces, in several photographs each, of the worst width of stripe.

And predicted σ over the actual error, of bent and sloping stripes of several widths, open and burnt out, with speckle
and without, in photographs of three qualities. Of stripes that are burnt out in every second stretch, σ over the error
and the error over that of the centre of gravity are told apart for burnt-out lines and others; of stripes that are dim
in every second stretch σ over the error is, for dim lines and others.
"""

import itertools
import tempfile
from pathlib import Path
from typing import Final, Literal

import jax
import jax.numpy as jnp
import numpy as np
import simplejpeg
from jaxtyping import Bool, Float, UInt
from scipy.special import ndtr

from benchmarks.metric import Metric
from jaxscan.detectors import DEFAULT, Detector
from jaxscan.images import StripeSettings, detect_stripe, read_image, write_image
from jaxscan.images.stripe_settings import CHANNELS
from jaxscan.precision import float64
from jaxscan.simulation import rig_2003
from jaxscan.simulation.render import plane_of

_ROWS, _FACES, _COLUMNS, _EDGE = 112, 8, 80, 8
_HIGHEST_MM, _NOISE, _QUALITY = 14.0, 1.5, 90
Color = Literal["red", "green", "blue"]
_KINDS: Final = ("png", "444", "422", "420")
_COLORS: Final[tuple[Color, ...]] = ("red", "green", "blue")
_DETECTORS: Final[tuple[Detector, ...]] = ("likelihood", "gravity")
# Of the laser in its own channel and in the other two.
_LASER: Final = (1.0, 0.06, 0.03)
# Ambient light and what a surface returns of the laser's: white, a dark room, coloured.
_SURFACES: Final = {"white": ((60, 60, 60), 1.0), "dark": ((6, 6, 6), 1.0), "coloured": ((90, 50, 35), 0.6)}
# Its peak in parts of a full pixel.
_PEAKS: Final = {"open": 0.7, "burnt": 3.0}
_WIDTHS: Final = {"open": (0.7, 1.0, 1.5, 2.0, 3.0), "burnt": (0.7, 1.0, 1.5, 2.0)}
_QUICK: Final = {"open": (0.7, 1.5), "burnt": (1.0,)}
_GOAL_MM: Final = 0.02
# Where σ is asked for: qualities, peaks in grey levels, contrasts of speckle, σ of stripes in px.
_QUALITIES, _LEVELS, _SPECKLES = (95, 90, 75), (180.0, 600.0), (0.0, 0.2)
_SIGMA_WIDTHS: Final = (0.74, 1.0, 1.5, 2.0, 3.0)
_SIGMA_ROWS, _SIGMA_COLUMNS, _LOW, _HIGH = 176, 640, 0.85, 1.18
# Stretches of a stripe that are burnt out in turn, lines, and their peaks; points further off than this are not read.
_STRETCH, _IN_TURN, _FAR_PX = 107, (150.0, 600.0), 0.5
# Peaks of dim stretches and of those between, and the ambient light.
_DIM, _BRIGHT, _DARK_ROOM = (25.0, 40.0, 70.0), 150.0, (8, 8, 8)

Table = tuple[Float[np.ndarray, "heights"], Float[np.ndarray, "heights"]]
Photograph = UInt[np.ndarray, "rows columns 3"]


def measure(quick: bool) -> list[Metric]:
    """All colours, widths and kinds; in the short form the red laser and fewer widths."""
    colors, widths = (_COLORS[:1], _QUICK) if quick else (_COLORS, _WIDTHS)
    table = _heights_and_rows()
    print("  RMS error of a step's height, mm: " + ", ".join(f"{kind} ({', '.join(_DETECTORS)})" for kind in _KINDS))
    worst: dict[tuple[Color, str, str, Detector], float] = {}
    for color, (peak, bright) in itertools.product(colors, _PEAKS.items()):
        # A process may have 65530 areas of memory, and each compiled function takes some hundreds.
        jax.clear_caches()
        for s in widths[peak]:
            cells = ""
            for kind in _KINDS:
                found: dict[Detector, float] = {
                    name: _rms(color, bright, s, kind, name, table, 2 if quick else 4) for name in _DETECTORS
                }
                cells += "  " + " ".join(f"{rms:.4f}" for rms in found.values())
                for name, rms in found.items():
                    worst[color, peak, kind, name] = max(worst.get((color, peak, kind, name), 0.0), rms)
            print(f"    {color:6}{peak:6}{s:4} {cells}", flush=True)
    jax.clear_caches()
    return (
        [_metric(*which, rms) for which, rms in worst.items()] + _sigma(quick) + _in_turn(quick) + _dim_in_turn(quick)
    )


def _sigma(quick: bool) -> list[Metric]:
    """σ over the RMS error in each cell; in the short form at the middle quality."""
    print(
        "  σ over the error: quality, peak, speckle, colours; of a stripe of σ = " + ", ".join(map(str, _SIGMA_WIDTHS))
    )
    found: dict[bool, list[float]] = {False: [], True: []}
    cases = itertools.product(_QUALITIES[1:2] if quick else _QUALITIES, _LEVELS, _SPECKLES, ("444", "420"))
    for case in cases:
        row = [_sigma_over_error(s, *case) for s in _SIGMA_WIDTHS]
        level = _sigma_over_error(_SIGMA_WIDTHS[0], *case, level=True)
        print("    {} {:g} {:g} {}  ".format(*case) + " ".join(f"{each:.2f}" for each in row), end="")
        print(f"; level, {_SIGMA_WIDTHS[0]} px: {level:.2f}", flush=True)
        found[False] += row
        found[True].append(level)
    inside = float(np.mean([_LOW < each < _HIGH for each in found[False]]))
    return [
        Metric("jpeg.sigma_least", min(found[False]), "", "higher", _LOW, 0.1),
        Metric("jpeg.sigma_most", max(found[False]), "", "lower", _HIGH, 0.1),
        Metric("jpeg.sigma_within", inside, "", "higher", 1.0, floor=0.05),
        Metric("jpeg.sigma_level_least", min(found[True]), ""),
        Metric("jpeg.sigma_level_most", max(found[True]), ""),
    ]


def _in_turn(quick: bool) -> list[Metric]:
    """Burnt-out lines and others of the same photographs; in the short form at the middle quality."""
    print(
        "  burnt out in turn: quality, speckle, colours; error over gravity's and σ over the error of burnt-out lines, "
        "and of the others; of a stripe of σ = " + ", ".join(map(str, _SIGMA_WIDTHS))
    )
    found: list[tuple[float, float, float, float]] = []
    for case in itertools.product(_QUALITIES[1:2] if quick else _QUALITIES, _SPECKLES, ("444", "422", "420")):
        row = [_of_both_kinds(s, *case) for s in _SIGMA_WIDTHS]
        cells = " | ".join("{:.2f} {:.2f}, {:.2f} {:.2f}".format(*each) for each in row)
        print("    {} {:g} {}  ".format(*case) + cells, flush=True)
        found += row
    over, burnt, over_open, others = np.array(found).T
    return [
        Metric("jpeg.in_turn.burnt_over_gravity", over.max(), "", "lower", 1.0, 0.1),
        Metric("jpeg.in_turn.others_over_gravity", over_open.max(), "", "lower", None, 0.1),
        Metric("jpeg.in_turn.burnt_sigma_least", burnt.min(), "", "higher", _LOW, 0.1),
        Metric("jpeg.in_turn.burnt_sigma_most", burnt.max(), "", "lower", _HIGH, 0.1),
        Metric("jpeg.in_turn.others_sigma_least", others.min(), "", "higher", _LOW, 0.1),
        Metric("jpeg.in_turn.others_sigma_most", others.max(), "", "lower", _HIGH, 0.1),
    ]


def _of_both_kinds(s: float, quality: int, speckle: float, kind: str) -> tuple[float, float, float, float]:
    """Error over gravity's and σ over the error of burnt-out lines, and the same of the others."""
    frames, centres, _ = _drawn_in_turn(s, quality, speckle, kind, _IN_TURN, (40, 40, 40))
    own, other = (detect_stripe(frames, StripeSettings("red"), detector=name) for name in _DETECTORS)
    off, by_gravity = (np.where(each.valid, each.position - centres, np.inf) for each in (own, other))
    both = (np.abs(off) < _FAR_PX) & (np.abs(by_gravity) < _FAR_PX)
    found = []
    for which in (both & own.burnt, both & ~own.burnt):
        rms, rms_of_gravity, in_sigma = (
            float(np.sqrt(np.mean(x[which] ** 2))) for x in (off, by_gravity, off / own.sigma)
        )
        found += [rms / rms_of_gravity, 1 / in_sigma]
    return found[0], found[1], found[2], found[3]


def _dim_in_turn(quick: bool) -> list[Metric]:
    """Dim lines and others of the same photographs; in the short form without full colour resolution."""
    print(
        f"  dim in turn, quality {_QUALITY}, others {_BRIGHT:g}: colours, speckle, peak; "
        "σ over the error of dim lines and others; of a stripe of σ = " + ", ".join(map(str, _SIGMA_WIDTHS[1:]))
    )
    found: list[tuple[float, float]] = []
    kinds, peaks = (("420",), _DIM[::2]) if quick else (("444", "420"), _DIM)
    for kind, speckle, peak in itertools.product(kinds, _SPECKLES, peaks):
        row = []
        for s in _SIGMA_WIDTHS[1:]:
            frames, centres, dim = _drawn_in_turn(s, _QUALITY, speckle, kind, (_BRIGHT, peak), _DARK_ROOM)
            own = detect_stripe(frames, StripeSettings("red"))
            in_sigma = np.where(own.valid, (own.position - centres) / own.sigma, np.nan)
            row.append((_over_error(in_sigma[dim]), _over_error(in_sigma[~dim])))
        print(
            f"    {kind} {speckle:g} {peak:g}  " + " | ".join("{:.2f} {:.2f}".format(*each) for each in row), flush=True
        )
        found += row
    dim, others = np.array(found).T
    return [
        Metric("jpeg.dim_in_turn.dim_sigma_least", dim.min(), "", "higher", _LOW, 0.1),
        Metric("jpeg.dim_in_turn.dim_sigma_most", dim.max(), "", "lower", _HIGH, 0.1),
        Metric("jpeg.dim_in_turn.others_sigma_least", others.min(), "", "higher", _LOW, 0.1),
        Metric("jpeg.dim_in_turn.others_sigma_most", others.max(), "", "lower", _HIGH, 0.1),
    ]


def _over_error(in_sigma: Float[np.ndarray, "lines"]) -> float:
    return 1 / float(np.sqrt(np.nanmean(in_sigma**2)))


def _drawn_in_turn(
    s: float,
    quality: int,
    speckle: float,
    kind: str,
    peaks: tuple[float, float],
    ambient: tuple[int, int, int],
) -> tuple[
    UInt[np.ndarray, "frames rows columns 3"], Float[np.ndarray, "frames lines"], Bool[np.ndarray, "frames lines"]
]:
    """Photographs of a stripe with two peaks in turn, its centres, and which lines have the second peak."""
    x = np.arange(_SIGMA_COLUMNS)
    frames, centres, second = [], [], []
    for seed in range(4):
        random = np.random.default_rng(seed)
        centres.append(_SIGMA_ROWS / 2 + random.uniform(-4, 4) + 0.03 * (x - len(x) / 2) + 4 * np.sin(x / 60 + seed))
        second.append((x // _STRETCH + seed) % 2 == 0)
        drawn = draw(
            "red", np.where(second[-1], *peaks[::-1]), ambient, centres[-1], s, random, _SIGMA_ROWS, speckle=speckle
        )
        frames.append(simplejpeg.decode_jpeg(simplejpeg.encode_jpeg(drawn, quality, "RGB", kind)))
    return np.stack(frames), np.stack(centres), np.stack(second)


def _sigma_over_error(s: float, quality: int, peak: float, speckle: float, kind: str, level: bool = False) -> float:
    x = np.arange(_SIGMA_COLUMNS)
    bend = 0.0 * x if level else 0.03 * (x - len(x) / 2) + 4 * np.sin(x / 60)
    frames, centres = [], []
    # Of a level stripe each photograph shows one place among the pixels.
    for seed in range(16 if level else 4):
        random = np.random.default_rng(seed)
        centres.append(_SIGMA_ROWS / 2 + random.uniform(-4, 4) + bend)
        drawn = draw("red", peak, (40, 40, 40), centres[-1], s, random, _SIGMA_ROWS, speckle=speckle)
        frames.append(simplejpeg.decode_jpeg(simplejpeg.encode_jpeg(drawn, quality, "RGB", kind)))
    stripe = detect_stripe(np.stack(frames), StripeSettings("red"))
    off = np.where(stripe.valid, (stripe.position - np.stack(centres)) / stripe.sigma, np.nan)
    return float(1 / np.sqrt(np.nanmean(off**2)))


def _metric(color: Color, peak: str, kind: str, name: Detector, rms: float) -> Metric:
    label = f"jpeg.{color}.{peak}.{kind}.{name}"
    if name != DEFAULT:
        return Metric(label, rms, "mm")
    goal = _GOAL_MM if peak == "open" and kind in ("png", "420") else None
    return Metric(label, rms, "mm", "lower", goal, 0.1, floor=0.002)


def _rms(
    color: Color,
    bright: float,
    s: float,
    kind: str,
    name: Detector,
    table: Table,
    photographs: int,
) -> float:
    """Over the faces of some photographs of every surface, mm."""
    random, errors = np.random.default_rng(0), []
    settings = StripeSettings(color)
    for ambient, returned in _SURFACES.values():
        heights = np.concatenate(
            [np.zeros((photographs, 1)), random.uniform(0, _HIGHEST_MM, (photographs, _FACES - 1))], axis=1
        )
        # The floor's place among the pixels differs from photograph to photograph too.
        shift = random.uniform(-0.5, 0.5, (photographs, 1))
        rows = np.interp(heights, *table) + shift
        frames = [
            _kept(draw(color, 255 * bright * returned, ambient, np.repeat(each, _COLUMNS), s, random), kind)
            for each in rows
        ]
        found = np.asarray(detect_stripe(np.stack(frames), settings, detector=name).position, np.float64)
        faces = found.reshape(photographs, _FACES, _COLUMNS)[:, :, _EDGE:-_EDGE]
        read = np.nanmean(faces, axis=2)
        by_row = np.argsort(table[1])
        read = np.interp(read - shift, table[1][by_row], table[0][by_row])
        errors.append((read - read[:, :1] - heights)[:, 1:])
    return float(np.sqrt(np.mean(np.square(errors))))


def draw(
    color: Color,
    peak: float | Float[np.ndarray, "columns"],
    ambient: tuple[float, float, float],
    centre: Float[np.ndarray, "columns"],
    s: float,
    random: np.random.Generator,
    rows: int = _ROWS,
    noise: float = _NOISE,
    speckle: float = 0.0,
) -> Photograph:
    """A stripe of σ = s px, each pixel its exact mean, with speckle and noise, before it is full."""
    edges = (np.arange(rows + 1)[:, None] - 0.5 - centre) / s
    light = s * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)
    if speckle:
        light *= random.gamma(speckle**-2, speckle**2, light.shape)
    levels = np.zeros((*light.shape, 3)) + np.asarray(ambient, float)
    for channel, part in zip(CHANNELS[color], _LASER, strict=True):
        levels[..., channel] += peak * part * light
    return np.rint((levels + noise * random.standard_normal(levels.shape)).clip(0, 255)).astype(np.uint8)


def _kept(photograph: Photograph, kind: str) -> Photograph:
    """As it is read from a file of this kind."""
    with tempfile.TemporaryDirectory() as folder:
        if kind == "png":
            path = Path(folder) / "frame.png"
            write_image(path, photograph)
        else:
            path = Path(folder) / "frame.jpg"
            path.write_bytes(simplejpeg.encode_jpeg(photograph, _QUALITY, "RGB", kind))
        return read_image(path)


def _heights_and_rows() -> Table:
    """In which row of the middle column the sheet meets a plane so far over the platform, counted from a middle row."""
    rig = rig_2003.simulated_rig(0)
    R, origin = rig_2003.platform(rig)
    omega = plane_of(rig.lights[0])
    heights = np.linspace(-1.0, _HIGHEST_MM + 1.0, 200)
    # On the sheet, at this height, and in the plane through the middle of the platform.
    planes = np.stack([omega, R[:, 2], R[:, 0]])
    points = [np.linalg.solve(planes, np.array([1.0, R[:, 2] @ origin + h, R[:, 0] @ origin])) for h in heights]
    with float64():
        rows = np.array([float(rig.camera.project(jnp.asarray(point))[1]) for point in points])
    return heights, rows - rows.mean() + _ROWS / 2
