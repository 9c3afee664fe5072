"""Sheets of light that are not flat: points of the rigs that come of them over a flat sheet's, what is named, and cost.

Sessions of the rig of 2003 as a detector would have seen them with errors of 0.03 px for corners and of 0.1 px for
stripes, without photographs; a rig is judged by points of stripes, with the same errors, on boards that it has not
seen. The sheets are drawn by formulas of their own, not by the light that is fitted: circular cones to all orders about
a laser that stands where it may, a cylinder that is as bent at any distance, and shapes that no kind of light follows.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from benchmarks.metric import Metric, ratio
from benchmarks.throughput import kernel_beside_the_plain
from benchmarks.timing import side_by_side
from jaxscan.calibration import Calibration, Observations, StripePoints, View, calibrate
from jaxscan.calibration.block_arrow import NormalEquations, linearise
from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.bundle import as_arrow
from jaxscan.calibration.first_poses import first_poses
from jaxscan.calibration.residuals import Noise
from jaxscan.precision import as_float64, float64
from jaxscan.rig import BowedSheet, Light, LightPlane, Rig, System
from jaxscan.rig.projection import pixel_rays, project_points
from jaxscan.simulation import rig_2003
from jaxscan.simulation.render import plane_of

# Of points in the camera frame, mm: 0 on the sheet.
Level = Callable[[Float[np.ndarray, "points 3"]], Float[np.ndarray, "points"]]

_CORNER_PX, _STRIPE_PX, _VIEWS = 0.03, 0.1, 12
# The sheets are curved by so many mm at ± 100 mm at this depth.
_DEPTH, _HALF = 345.0, 100.0
_SEEDS, _FEW = 16, 3


def measure(quick: bool) -> list[Metric]:
    """All shapes, sixteen seeds of those that have goals and three of the others; or the former and three."""
    seeds = range(_FEW if quick else _SEEDS)
    flat = [_session(seed, _plane) for seed in seeds]
    as_plane = [calibrate(session) for session in flat]
    base = _rms(as_plane, _plane)
    metrics = [
        Metric("sheets.flat.error_mm", base, "mm"),
        Metric("sheets.flat.called_curved", _named(as_plane), "", "lower", 0),
        _over("flat_as_bowed", [calibrate(session, light="bowed") for session in flat], _plane, base, 1.03),
    ]
    for name, level in (("0.3", _cone(0.3)), ("0.05", _cone(0.05)), *(() if quick else _others())):
        goal = 1.1 if name in ("0.3", "0.05") else None
        sessions = [_session(seed, level) for seed in (seeds if goal else range(_FEW))]
        plain = [calibrate(session) for session in sessions]
        bowed = [calibrate(session, light="bowed") for session in sessions]
        base = _rms(as_plane[: len(sessions)], _plane)
        metrics += [
            Metric(f"sheets.{name}.taken_as_flat_over_flat", _rms(plain, level) / base),
            _over(name, bowed, level, base, goal),
            Metric(f"sheets.{name}.named", _named(plain) / len(plain), "", "higher" if goal else "shown", 1.0),
            Metric(f"sheets.{name}.stripe_rms_px", float(np.mean([c.stripe_rms_px or 0.0 for c in bowed])), "px"),
        ]
        print(f"  {name}: {', '.join(f'{m.value:.4g}' for m in metrics[-4:])}", flush=True)
    return metrics + _kernel(quick) + _step()


def _over(name: str, found: list[Calibration], level: Level, base: float, goal: float | None) -> Metric:
    value = _rms(found, level) / base
    return Metric(f"sheets.{name}.over_flat", value, "", "lower" if goal else "shown", goal, slack=0.05)


def _named(found: list[Calibration]) -> int:
    for each in found[:1]:
        print(f"  {each.warnings}", flush=True)
    return sum(bool(each.sheet_curves) for each in found)


def _others() -> tuple[tuple[str, Level], ...]:
    """Shapes beside the one that is fitted: as large, 0.3 mm at ± 100 mm."""

    def bent(shape: Callable[[np.ndarray], np.ndarray]) -> Level:
        return lambda X: _plane(X) + 0.3 * shape(X[:, 0] / _HALF)

    return (
        ("laser_150_mm_behind", _cone(0.3, (0.0, 0.0, -150.0))),
        ("laser_60_mm_aside", _cone(0.3, (60.0, 0.0, 0.0))),
        ("2.0", _cone(2.0)),
        ("cylinder", bent(lambda f: f**2)),
        ("S", bent(lambda f: f**3)),
        ("kink", bent(np.abs)),
    )


def _plane(X: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points"]:
    """Mm beyond the plane of the rig of 2003."""
    omega = plane_of(rig_2003.simulated_rig(0).lights[0])
    return (X @ omega - 1) / np.linalg.norm(omega)


def _cone(sag: float, beside: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Level:
    """About a normal of the plane, its apex where the plane crosses the camera's v axis, or so many mm from there."""
    omega = plane_of(rig_2003.simulated_rig(0).lights[0])
    normal = omega / np.linalg.norm(omega)
    apex = np.array([0.0, 1 / omega[1], 0.0]) + np.asarray(beside)
    apex -= normal * (normal @ apex - 1 / np.linalg.norm(omega))
    away = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    away /= np.linalg.norm(away)
    middle = (_DEPTH - apex[2]) / away[2]
    slope = sag / (np.hypot(middle, _HALF) - middle)

    def level(X: np.ndarray) -> np.ndarray:
        P = X - apex
        high = P @ normal
        return high + slope * (np.linalg.norm(P - high[:, None] * normal, axis=1) - P @ away)

    return level


def _session(seed: int, level: Level) -> Observations:
    rig, random, views = rig_2003.simulated_rig(0), np.random.default_rng([18, seed]), []
    poses = rig_2003.board_poses(rig, seed, _VIEWS)
    for i, (R, t) in enumerate(zip(poses.matrix(), poses.translation, strict=True)):
        pixels, _ = _stripe(rig, R, t, level, random)
        corners = project_points(rig.camera, rig_2003.BOARD.points() @ R.T + t).pixels
        corners = corners + _CORNER_PX * random.normal(size=corners.shape)
        views.append(View(f"{i:02d}", corners, stripes=(StripePoints(pixels, half_width_px=1e-6),)))
    return Observations(rig.camera.image_size, rig_2003.BOARD, tuple(views), (), ("",))


def _stripe(
    rig: Rig, R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, "3"], level: Level, random: np.random.Generator
) -> tuple[Float[np.ndarray, "columns 2"], Float[np.ndarray, "columns 3"]]:
    """Where the stripe on a board is seen, with errors, and the true points; NaN where it is not."""
    board, size = rig_2003.BOARD, rig.camera.image_size
    furthest, columns = board.points().max(axis=0)[:2], np.arange(float(size[0]))
    x = np.linspace(-board.pitch_mm, furthest[0] + board.pitch_mm, 2000)
    on, y = (x[:, None] * R[:, 0]) + t, np.zeros_like(x)
    for _ in range(20):
        X = on + y[:, None] * R[:, 1]
        y -= level(X) * 1e-3 / (level(X + 1e-3 * R[:, 1]) - level(X))
    within = (y > -board.pitch_mm) & (y < furthest[1] + board.pitch_mm)
    X = (on + y[:, None] * R[:, 1])[within]
    seen = project_points(rig.camera, X).pixels
    order = np.argsort(seen[:, 0])
    u = seen[order, 0]
    rows, *truth = (np.interp(columns, u, part[order], left=np.nan, right=np.nan) for part in (seen[:, 1], *X.T))
    rows = np.where((rows < 0) | (rows > size[1] - 1), np.nan, rows) + _STRIPE_PX * random.normal(size=size[0])
    return np.stack([columns, rows], axis=1), np.stack(truth, axis=1)


def _rms(found: list[Calibration], level: Level) -> float:
    """Of the points that rigs make of the stripe on boards that they have not seen, from the true ones, mm."""
    rig, random = rig_2003.simulated_rig(0), np.random.default_rng(81)
    poses = rig_2003.board_poses(rig, 1000, 2 * _VIEWS)
    stripes = [_stripe(rig, R, t, level, random) for R, t in zip(poses.matrix(), poses.translation, strict=True)]
    pixels, truth = (np.concatenate(parts) for parts in zip(*stripes, strict=True))
    there, squares = np.isfinite(pixels).all(axis=1), []
    for each in found:
        seen = pixel_rays(each.rig.camera, pixels[there])
        points = seen / each.rig.lights[0].inverse_depth(seen)[:, None]
        squares.append(((points - truth[there]) ** 2).sum(axis=1).mean())
    return float(np.sqrt(np.mean(squares)))


def _kernel(quick: bool) -> list[Metric]:
    """The kernel's rate with a bowed sheet over that with a flat one."""
    omega = np.array([0.0, -0.00494, 0.00303])
    with float64():
        bowed = BowedSheet.curved(omega, 0.3, _HALF, _DEPTH)
    return kernel_beside_the_plain("sheets.kernel", "a plane's", 0.7, quick, light=bowed)


def _step() -> list[Metric]:
    """A step of the solve, residuals, derivatives and elimination, with a bowed sheet over one with a flat one."""
    session = _session(0, _plane)
    session = replace(session, views=session.views * 12)
    with float64():
        group, rig = view_blocks(session), as_float64(rig_2003.simulated_rig(0))
        poses, noise = first_poses(rig.camera, group), Noise.create(_CORNER_PX, _STRIPE_PX)
        omega = plane_of(rig.lights[0])
        flat, bowed = (
            _one_step(rig, light, poses, group, noise)
            for light in (LightPlane.create(omega), BowedSheet.create(omega, 2.0))
        )
        of_flat, took = side_by_side(flat, bowed, 21)
    return [ratio("sheets.step.over_flat", took / of_flat, 1.6)]


def _one_step(rig: Rig, light: Light, poses: Array, group: Any, noise: Noise) -> Callable[[], object]:
    system = System(Rig(rig.camera, (light,)), (poses,))
    free = jnp.ones(len(system.shared_names()), bool)

    @eqx.filter_jit
    def step(system: System) -> Any:
        y, _, residual = as_arrow(system, free, (group,), noise)
        return NormalEquations.create(*linearise(residual, y)).step()

    jax.block_until_ready(step(system))
    return lambda: jax.block_until_ready(step(system))
