"""How far a scatter over some drawings of the noise is off by chance alone.

The estimate of one Gauss-Newton step from the truth is linear in the noise, so its covariance is known without any
drawing. Its scatter over the drawings that a Monte Carlo has solved is off by as much as these drawings are unusual,
and so is the scatter of the solutions, which are nearly linear too.
"""

from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from benchmarks.drawn import Noise
from jaxscan.calibration import Observations
from jaxscan.calibration.blocks import sequence_blocks, view_blocks
from jaxscan.calibration.residuals import Blocks, far_away
from jaxscan.calibration.residuals import Noise as Sigmas
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Rig, System
from jaxscan.rig.rig import parameter_names


def by_chance(
    rig: Rig,
    poses: tuple[Float[np.ndarray, "_ 6"], Float[np.ndarray, "_ 6"]],
    exact: Observations,
    drawn: Iterable[Observations],
    noise: Noise,
) -> dict[str, Float[np.ndarray, "_"]]:
    """Exact σ over the scatter of the linear estimate: of the rig's free `parameters`, of the first `board_pose`.

    Args:
        rig: the true one.
        poses: T_cam_board of the views, and of the board of each sequence where its axes are at their reference.
        exact: what is seen without noise.
        drawn: with it, drawing by drawing.
        noise: how large it is.
    """
    names = parameter_names(rig)
    numbers = np.array([name not in rig.surplus() for name in names])
    with float64():
        leaves, structure = jax.tree.flatten(as_float64(rig))
        truth = jnp.concatenate([jnp.stack(leaves), *(jnp.asarray(each).ravel() for each in poses)])
        sizes = np.cumsum([len(names), poses[0].size])
        sigma = Sigmas.create(noise.corner, noise.stripe)

        def residuals(off: Float[Array, "unknowns"], groups: tuple[Blocks, ...]) -> Float[Array, "_"]:
            own, *placed = jnp.split(truth + off, sizes)
            padded = [
                far_away(len(group.points)).at[: len(each) // 6].set(each.reshape(-1, 6))
                for group, each in zip(groups, placed, strict=True)
            ]
            system = System(jax.tree.unflatten(structure, list(own)), tuple(padded))
            found = (g.residuals(system, each, sigma).ravel() for g, each in zip(groups, padded, strict=True))
            return jnp.concatenate(list(found))

        def seen(observations: Observations) -> tuple[Blocks, ...]:
            return view_blocks(observations), sequence_blocks(observations)

        none = jnp.zeros(len(truth))
        J = np.asarray(jax.jit(jax.jacfwd(residuals))(none, seen(exact)))
        free = np.append(numbers, np.ones(len(truth) - len(names), bool))
        covariance = np.linalg.inv(J[:, free].T @ J[:, free])
        gradient = jax.jit(jax.grad(lambda off, groups: 0.5 * (residuals(off, groups) ** 2).sum()))
        steps = [covariance @ np.asarray(gradient(none, seen(each)))[free] for each in drawn]
    ratio = np.sqrt(np.diagonal(covariance)) / np.std(steps, axis=0, ddof=1)
    count = int(numbers.sum())
    return {"parameters": ratio[:count], "board_pose": ratio[count : count + 6]}
