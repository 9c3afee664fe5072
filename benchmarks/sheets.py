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
from jaxtyping import Array

from benchmarks.drawn_sheets import CORNER_PX, DEPTH, HALF, STRIPE_PX, Level, cone, plane, triangulated, unseen, view
from benchmarks.metric import Metric, ratio
from benchmarks.throughput import kernel_beside_the_plain
from benchmarks.timing import side_by_side
from jaxscan.calibration import Calibration, Observations, calibrate
from jaxscan.calibration.block_arrow import NormalEquations, linearise
from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.bundle import as_arrow
from jaxscan.calibration.first_poses import first_poses
from jaxscan.calibration.residuals import Noise
from jaxscan.precision import as_float64, float64
from jaxscan.rig import BowedSheet, Light, LightPlane, Rig, System
from jaxscan.simulation import rig_2003
from jaxscan.simulation.render import plane_of

_VIEWS = 12
_SEEDS, _FEW = 16, 3
_RIG = rig_2003.simulated_rig(0)
_PLANE = plane(_RIG)


def measure(quick: bool) -> list[Metric]:
    """All shapes, sixteen seeds of those that have goals and three of the others; or the former and three."""
    seeds = range(_FEW if quick else _SEEDS)
    flat = [_session(seed, _PLANE) for seed in seeds]
    as_plane = [calibrate(session) for session in flat]
    base = _rms(as_plane, _PLANE)
    metrics = [
        Metric("sheets.flat.error_mm", base, "mm"),
        Metric("sheets.flat.called_curved", _named(as_plane), "", "lower", 0),
        _over("flat_as_bowed", [calibrate(session, light="bowed") for session in flat], _PLANE, base, 1.03),
    ]
    for name, level in (("0.3", cone(_RIG, 0.3)), ("0.05", cone(_RIG, 0.05)), *(() if quick else _others())):
        goal = 1.1 if name in ("0.3", "0.05") else None
        sessions = [_session(seed, level) for seed in (seeds if goal else range(_FEW))]
        plain = [calibrate(session) for session in sessions]
        bowed = [calibrate(session, light="bowed") for session in sessions]
        base = _rms(as_plane[: len(sessions)], _PLANE)
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
        return lambda X: _PLANE(X) + 0.3 * shape(X[:, 0] / HALF)

    return (
        ("laser_150_mm_behind", cone(_RIG, 0.3, (0.0, 0.0, -150.0))),
        ("laser_60_mm_aside", cone(_RIG, 0.3, (60.0, 0.0, 0.0))),
        ("2.0", cone(_RIG, 2.0)),
        ("cylinder", bent(lambda f: f**2)),
        ("S", bent(lambda f: f**3)),
        ("kink", bent(np.abs)),
    )


def _session(seed: int, level: Level) -> Observations:
    rig, random, views = _RIG, np.random.default_rng([18, seed]), []
    poses = rig_2003.board_poses(rig, seed, _VIEWS)
    for i, (R, t) in enumerate(zip(poses.matrix(), poses.translation, strict=True)):
        views.append(view(f"{i:02d}", rig, R, np.asarray(t), level, random))
    return Observations(rig.camera.image_size, rig_2003.BOARD, tuple(views), (), ("",))


def _rms(found: list[Calibration], level: Level) -> float:
    """Errors of the points that rigs make of the stripe on boards that they have not seen, mm."""
    pixels, truth = unseen(_RIG, 0, 2 * _VIEWS, level)
    squares = [((triangulated(each.rig, pixels) - truth) ** 2).sum(axis=1).mean() for each in found]
    return float(np.sqrt(np.mean(squares)))


def _kernel(quick: bool) -> list[Metric]:
    """The kernel's rate with a bowed sheet over that with a flat one."""
    omega = np.array([0.0, -0.00494, 0.00303])
    with float64():
        bowed = BowedSheet.curved(omega, 0.3, HALF, DEPTH)
    return kernel_beside_the_plain("sheets.kernel", "a plane's", 0.7, quick, light=bowed)


def _step() -> list[Metric]:
    """A step of the solve, residuals, derivatives and elimination, with a bowed sheet over one with a flat one."""
    session = _session(0, _PLANE)
    session = replace(session, views=session.views * 12)
    with float64():
        group, rig = view_blocks(session), as_float64(_RIG)
        poses, noise = first_poses(rig.camera, group), Noise.create(CORNER_PX, STRIPE_PX)
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
