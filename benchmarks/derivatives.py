"""Derivatives through a solution of 80 views: the block-arrow elimination against dense matrices, figures and times.

Two things are compared. One damped step of the solve, with least squares over the whole Jacobian. And the gradient of
the focal length with respect to all corners, with an LU of the whole Hessian: by `jax.grad` through the solve for its
digits, by the pull-back through the minimum alone for its time.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from benchmarks.growth import observations
from benchmarks.metric import Metric, ratio
from jaxscan.calibration import Adjustment, calibrate
from jaxscan.calibration.block_arrow import Arrow, NormalEquations, linearise
from jaxscan.calibration.bundle import as_arrow, solve
from jaxscan.calibration.implicit import BlockArrowSolver
from jaxscan.precision import float64
from jaxscan.rig import System

VIEWS = 80
_DAMPING = 1e-4


def measure(quick: bool) -> list[Metric]:
    """Differences from the dense answers, and times."""
    adjustment = calibrate(observations(VIEWS), plain=True).adjustment
    with float64():
        adjustment = jax.tree.map(jnp.asarray, adjustment)
        return [step_difference(adjustment), *gradients(adjustment, 3 if quick else 9)]


def step_difference(adjustment: Adjustment) -> Metric:
    """A step from a focal length 2 % off, in units of each unknown's own σ."""
    start = adjustment.start
    rig, f = start.rig, start.rig.camera.focal
    off = replace(rig, camera=replace(rig.camera, focal=(1.02 * f[0], 1.02 * f[1])))
    y, _, residual = as_arrow(replace(start, rig=off), adjustment.free, adjustment.groups, adjustment.noise)
    value, jacobian = jax.jit(lambda y: linearise(residual, y))(y)
    normal = NormalEquations.create(value, jacobian)
    step, _ = ravel_pytree(normal.damped(jnp.asarray(_DAMPING), normal.diagonal()).step())

    at, back = ravel_pytree(y)
    J = np.asarray(jax.jit(jax.jacfwd(lambda x: ravel_pytree(residual(back(x)))[0]))(at))
    scale = np.linalg.norm(J, axis=0)
    rows = np.concatenate([J / scale, np.sqrt(_DAMPING) * np.eye(len(scale))])
    dense = np.linalg.lstsq(rows, -np.append(ravel_pytree(value)[0], np.zeros(len(scale))), rcond=None)[0]
    difference = np.linalg.norm(scale * np.asarray(step) - dense) / np.linalg.norm(dense)
    return Metric("derivatives.step_from_dense", float(difference), "", "lower", 1e-9, floor=1e-9)


def gradients(adjustment: Adjustment, repeats: int) -> list[Metric]:
    """The gradient of f_u with respect to the corners, both ways."""
    start, free, (views,), noise = adjustment.start, adjustment.free, adjustment.groups, adjustment.noise

    def solved(corners: Float[Array, "views 1 corners 2"]) -> tuple[Float[Array, ""], System]:
        found = solve(start, free, (replace(views, corners=corners),), noise).system
        return jnp.asarray(found.rig.camera.focal[0]), found

    found, minimum = jax.jit(jax.grad(solved, has_aux=True))(views.corners)
    y, _, _ = as_arrow(minimum, free, (views,), noise)
    wanted = jax.tree.map(jnp.zeros_like, y)
    wanted = replace(wanted, shared=wanted.shared.at[0].set(1.0))

    def cost(y: Arrow, corners: Float[Array, "views 1 corners 2"]) -> Float[Array, ""]:
        _, _, residual = as_arrow(minimum, free, (replace(views, corners=corners),), noise)
        return 0.5 * (ravel_pytree(residual(y))[0] ** 2).sum()

    def pull_back(solver: lx.AbstractLinearSolver) -> Callable[..., Float[Array, "views 1 corners 2"]]:
        def gradient(y: Arrow, corners: Float[Array, "views 1 corners 2"]) -> Float[Array, "views 1 corners 2"]:
            hessian = lx.JacobianLinearOperator(lambda y, _: jax.grad(cost)(y, corners), y)
            adjoint = lx.linear_solve(hessian, wanted, solver).value
            return -jax.vjp(lambda corners: jax.grad(cost)(y, corners), corners)[1](adjoint)[0]

        return jax.jit(gradient)

    arrow, dense = pull_back(BlockArrowSolver()), pull_back(lx.LU())
    expected = np.asarray(dense(y, views.corners))
    difference = np.abs(found - expected).max() / np.abs(expected).max()
    arrow(y, views.corners)
    times: dict[str, list[float]] = {"arrow": [], "dense": []}
    for _ in range(repeats):
        for name, function in (("arrow", arrow), ("dense", dense)):
            begin = time.perf_counter()
            jax.block_until_ready(function(y, views.corners))
            times[name].append(time.perf_counter() - begin)
    ours, theirs = (1000 * statistics.median(times[name]) for name in ("arrow", "dense"))
    return [
        Metric("derivatives.gradient_from_dense", float(difference), "", "lower", 1e-9, floor=1e-9),
        Metric(f"derivatives.{VIEWS}_views.block_arrow", ours, "ms"),
        Metric(f"derivatives.{VIEWS}_views.dense", theirs, "ms"),
        ratio("derivatives.dense_over_block_arrow", theirs / ours, 10.0, "higher"),
    ]
