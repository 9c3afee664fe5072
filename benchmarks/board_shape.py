"""Boards that are not flat: what a calibration of them is worth beside one of flat boards, and whether they are named.

Sessions of the simulated rig of 2003 with a board of 9 × 6 corners 24 mm apart, 192 mm long, are drawn with normal
noise; each beside the same poses and noise with flat boards, solved as flat. Errors are those of the rig's numbers in
the σ that the flat session gives them, and of points in the working volume, mm; ratios are of root mean squares.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from benchmarks.drawn import Noise, redrawn
from benchmarks.drawn_bent import ON_STAGE, Height, Heights, bent_session, clean_session, flat
from benchmarks.metric import Metric, ratio
from benchmarks.montecarlo import triangulated
from jaxscan.calibration import Adjustment, Calibration, Observations, calibrate
from jaxscan.calibration.block_arrow import NormalEquations, linearise
from jaxscan.calibration.bundle import as_arrow
from jaxscan.images import Board
from jaxscan.precision import as_float64, as_jax, float64
from jaxscan.rig import LightPlane, Rig
from jaxscan.rig.rig import parameter_names

_BOARD: Final = Board.checkerboard((9, 6), 24.0)
HALF: Final = (np.array([9, 6]) - 1) * 24.0 / 2
_NOISE: Final = Noise()
_STAGE_VIEWS, _APART = 11, 4
_SEEDS, _SEEDS_QUICK, _ALARMS = 40, 3, 40
_STEPS_TIMED: Final = 25
# Where points are asked for: over the sheet between these depths, and at both ends of the stage's travel.
_DEPTHS: Final = (310.0, 345.0, 380.0)
_TRAVEL: Final = (0.0, 60000.0)


def measure(quick: bool) -> list[Metric]:
    """Everything; in the short form few sessions, and no odd shapes."""
    seeds = range(_SEEDS_QUICK if quick else _SEEDS)
    plain = [solved(seen_by(seed, lambda _: flat), "flat") for seed in seeds]
    metrics = _beside(
        "warp_0.5_bends_0.1", plain, [solved(seen_by(s, warped(s, 0.5, 0.1)), "bend") for s in seeds], 1.15
    )
    for mm in (0.3, 0.05):
        bent = [seen_by(s, warped(s, mm, 0.0)) for s in seeds]
        metrics += _beside(f"bent_{mm:g}", plain, [solved(each, "bend") for each in bent], 1.2)
        metrics += _named(f"bent_{mm:g}", mm, plain, [solved(each, "flat") for each in bent])
    metrics += _beside("flat", plain, [solved(seen_by(s, lambda _: flat), "bend") for s in seeds], 1.03)
    alarms = [bool(each.calibration.flatness and each.calibration.flatness.statements) for each in plain]
    if not quick:
        alarms = [_alarm(seed) for seed in range(_ALARMS)]
    metrics.append(Metric(f"board_shape.false_alarms_of_{len(alarms)}", sum(alarms), "", "lower", 0.0))
    metrics += _times()
    if not quick:
        metrics += _odd(seeds, plain)
    return metrics


@dataclass(frozen=True)
class Solved:
    """A calibration and how far it is off.

    Attributes:
        calibration: it.
        off: of each of the rig's numbers, the error.
        z: the same in its own σ.
        points_mm: errors of points, each coordinate.
        points_z: the same in σ.
    """

    calibration: Calibration
    off: Float[np.ndarray, "numbers"]
    z: Float[np.ndarray, "numbers"]
    points_mm: Float[np.ndarray, "_"]
    points_z: Float[np.ndarray, "_"]


def seen_by(seed: int, heights: Heights, **how: object) -> tuple[Rig, Observations]:
    arguments = {"board": _BOARD, "stage_views": _STAGE_VIEWS, "columns_apart": _APART} | how
    rig, exact = bent_session(seed, heights, **arguments)  # pyright: ignore[reportArgumentType]
    return rig, redrawn(exact, _NOISE, np.random.default_rng([2003, seed]))


def solved(seen: tuple[Rig, Observations], shape: str) -> Solved:
    rig, observations = seen
    calibration = calibrate(observations, board_shape=shape)
    true, found = (np.array([float(leaf) for leaf in jax.tree.leaves(each)]) for each in (rig, calibration.rig))
    sigma = np.sqrt(np.diagonal(calibration.covariance.of_leaves(calibration.rig)))
    pixels, steps = _asked(rig)
    with float64():
        q = {"stage": jnp.asarray(steps)}
        there, here = (
            np.asarray(triangulated(as_float64(each), jnp.asarray(pixels), q)) for each in (rig, calibration.rig)
        )
        J = np.asarray(_by_rig(as_float64(calibration.rig), jnp.asarray(pixels), q))
    spread = np.einsum("pai,ij,paj->pa", J, calibration.covariance.of_leaves(calibration.rig), J)
    wrong = here - there
    return Solved(calibration, found - true, (found - true) / sigma, wrong.ravel(), (wrong / np.sqrt(spread)).ravel())


def _asked(rig: Rig) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, "points"]]:
    """Pixels that see the sheet at some depths, left, in the middle and right, and steps of the stage at each."""
    (light,) = rig.lights
    assert isinstance(light, LightPlane)
    omega = np.array([float(x) for x in light.plane])
    X = [[x, (1 - omega[0] * x - omega[2] * z) / omega[1], z] for z in _DEPTHS for x in (-60.0, 0.0, 60.0)]
    with float64():
        seen = np.asarray(jax.vmap(as_float64(rig.camera).project)(jnp.asarray(X)))
    return np.tile(seen, (len(_TRAVEL), 1)), np.repeat(_TRAVEL, len(seen))


@jax.jit
def _by_rig(rig: Rig, pixels: Float[Array, "m 2"], q: dict[str, Float[Array, "m"]]) -> Float[Array, "m 3 leaves"]:
    leaves, structure = jax.tree.flatten(rig)

    def points(numbers: Float[Array, "leaves"]) -> Float[Array, "m 3"]:
        return triangulated(jax.tree.unflatten(structure, list(numbers)), pixels, q)

    return jax.jacfwd(points)(jnp.stack(leaves))


def warped(seed: int, common: float, each: float) -> Heights:
    """A common bulge of `common` mm, shared between all five terms, and bulges of each board with σ = `each` mm."""
    random = np.random.default_rng([seed, 18])
    shares = random.normal(size=5) * [1.0, 0.5, 0.3, 0.2, 0.2]
    if not each:
        shares = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
    grid = np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21))
    terms = common * shares / np.ptp(_height(shares, *grid))
    own = {i: each * random.normal(size=2) for i in range(ON_STAGE, 40)}

    def of(board: int) -> Height:
        both = terms + np.pad(own[board], (0, 3))
        return lambda x, y: _height(both, x / HALF[0] - 1, y / HALF[1] - 1)

    return of


def _height(terms: np.ndarray, s: np.ndarray, t: np.ndarray) -> np.ndarray:
    a, b, c, d, e = terms
    return a * (1 / 3 - s**2) + b * (1 / 3 - t**2) + c * s * t + d * (1 / 3 - s**2) * t + e * (1 / 3 - t**2) * s


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def _beside(name: str, plain: list[Solved], bent: list[Solved], goal: float) -> list[Metric]:
    """Errors over those of flat boards: of the rig's numbers, of points; and how many lie within 3 σ."""
    names = parameter_names(plain[0].calibration.rig)
    unit = np.sqrt(np.mean([each.off**2 for each in plain], axis=0))
    kinds: dict[str, list[int]] = {}
    for i, each in enumerate(names):
        kinds.setdefault(".".join(each.split(".")[:2]), []).append(i)
    metrics, stem = [], f"board_shape.{name}"
    for kind, at in kinds.items():
        over = _rms(np.array([each.off[at] / unit[at] for each in bent]))
        metrics.append(Metric(f"{stem}.{kind}", over, "", "shown"))
    rig = _rms(np.array([each.off / unit for each in bent]))
    points = _rms(np.array([s.points_mm for s in bent])) / _rms(np.array([s.points_mm for s in plain]))
    within = float(np.mean([np.abs(np.concatenate([s.z, s.points_z])) < 3 for s in bent]))
    return [
        *metrics,
        Metric(f"{stem}.rig", rig, "", "lower", goal, slack=0.05),
        Metric(f"{stem}.points", points, "", "lower", goal, slack=0.05),
        Metric(f"{stem}.within_3_sigma", within, "", "higher", 0.98, slack=0.01),
    ]


def _named(name: str, mm: float, plain: list[Solved], taken_flat: list[Solved]) -> list[Metric]:
    """Sessions that were solved as flat: what that costs, how many are named, and how well their mm are said."""
    found = [each.calibration.flatness for each in taken_flat]
    said = [each.bent_mm for each in found if each is not None and each.bent]
    points = _rms(np.array([s.points_mm for s in taken_flat])) / _rms(np.array([s.points_mm for s in plain]))
    off = _rms(np.array(said) / mm - 1) if said else np.nan
    return [
        Metric(f"board_shape.{name}.taken_as_flat.points", points),
        Metric(f"board_shape.{name}.taken_as_flat.named", len(said) / len(found), "", "higher", 1.0),
        Metric(f"board_shape.{name}.taken_as_flat.said_off", off, "", "lower", 0.2, slack=0.2),
    ]


def _alarm(seed: int) -> bool:
    """Whether flat boards are said to be bent."""
    calibration = calibrate(clean_session(seed))
    return bool(calibration.flatness and calibration.flatness.statements)


def _times() -> list[Metric]:
    """A step of the solve of 40 views with each shape over one of flat boards, taken in turn."""
    seen = seen_by(0, warped(0, 0.5, 0.1), views=40)[1]
    with float64():
        own = {
            shape: as_jax(calibrate(seen, board_shape=shape).adjustment) for shape in ("flat", "bulge", "warp", "bend")
        }
        took: dict[str, list[float]] = {shape: [] for shape in own}
        for i in range(_STEPS_TIMED + 1):
            for shape, adjustment in own.items():
                begin = time.perf_counter()
                jax.block_until_ready(_step(adjustment))
                # The first compiles.
                took[shape] += [time.perf_counter() - begin] if i else []
    return [
        ratio(f"board_shape.step_{shape}_over_flat", min(took[shape]) / min(took["flat"]), 1.8)
        for shape in ("bulge", "warp", "bend")
    ]


@eqx.filter_jit
def _step(adjustment: Adjustment) -> object:
    y, _, residual = as_arrow(adjustment.start, adjustment.free, adjustment.groups, adjustment.noise)
    normal = NormalEquations.create(*linearise(residual, y))
    return normal.determined_step(), normal.damped(jnp.asarray(1e-6), normal.diagonal()).step()


def _odd(seeds: range, plain: list[Solved]) -> list[Metric]:
    """Shapes that the five terms have not, or have only together: solved as bend, and named when taken as flat."""
    shapes: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
        "rolled_about_a_diagonal": lambda s, t: 0.3 * (1 - ((s + t) / 2) ** 2),
        "like_an_s": lambda s, t: 0.3 / 0.77 * (s**3 - s),
        "corner_bent_up": lambda s, t: 0.3 * np.maximum(0, s + t - 1) ** 2,
    }
    metrics = []
    for name, z in shapes.items():
        seen = [seen_by(s, lambda _, z=z: lambda x, y: z(x / HALF[0] - 1, y / HALF[1] - 1)) for s in seeds]
        metrics += [
            replace(m, better="shown") for m in _beside(name, plain, [solved(each, "bend") for each in seen], 1.2)
        ]
        as_flat = [solved(each, "flat") for each in seen]
        metrics += [replace(m, better="shown") for m in _named(name, 0.3, plain, as_flat)]
    circles = Board.circles((9, 6), 24.0, 14.0)
    kinds = {
        "circles_bent_0.3": {"board": circles, "radius_mm": 7.0},
        "charuco_bent_0.3": {"board": Board.charuco((10, 7), 24.0, 17.0, "DICT_5X5_50")},
    }
    for name, how in kinds.items():
        straight = [solved(seen_by(s, lambda _: flat, **how), "flat") for s in seeds]
        bent = [seen_by(s, warped(s, 0.3, 0.0), **how) for s in seeds]
        metrics += _beside(name, straight, [solved(each, "bend") for each in bent], 1.2)
        metrics += _named(name, 0.3, straight, [solved(each, "flat") for each in bent])
    half = [_half_seen(seen_by(s, lambda _: flat), s) for s in seeds]
    bent = [_half_seen(seen_by(s, warped(s, 0.3, 0.0)), s) for s in seeds]
    straight = [solved(each, "flat") for each in half]
    metrics += _beside("partial_views_bent_0.3", straight, [solved(each, "bend") for each in bent], 1.2)
    return metrics


def _half_seen(seen: tuple[Rig, Observations], seed: int) -> tuple[Rig, Observations]:
    """With a third of each view's corners hidden, on one side of the board."""
    random, (rig, observations) = np.random.default_rng([seed, 3]), seen
    place = observations.board.points()[:, :2] - observations.board.points()[:, :2].mean(axis=0)
    views = []
    for view in observations.views:
        angle = random.uniform(0, 2 * np.pi)
        along = place @ [np.cos(angle), np.sin(angle)]
        hidden = along > np.quantile(along, 2 / 3)
        views.append(replace(view, corners=np.where(hidden[:, None], np.nan, view.corners)))
    return rig, replace(observations, views=tuple(views))
