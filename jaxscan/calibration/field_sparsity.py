"""Which coefficients of a splined lens's field each residual depends on: those about the place that it was seen at.

A place of the image depends on four coefficients along each axis. Five are allowed for, the nearest and two on either
side: so whatever moves places by less than half a cell, a step of the solve or the size of a circle, changes nothing.
Of coefficients five apart no residual depends on two, so 25 products of each component serve all.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.block_arrow import Sparsity
from jaxscan.calibration.residuals import Blocks, corner_errors, photograph_poses
from jaxscan.rig import Camera, System
from jaxscan.rig.spline import MORE_THAN_CELLS
from jaxscan.rig.splined import CELLS, FIELD_NUMBERS, Splined
from jaxscan.rig.tilted_sensor import off_sensor

_REACH, _WINDOW = 2, 5


def field_sparsity(system: System, groups: tuple[object, ...]) -> Sparsity | None:
    """The sparsity of the residuals of groups, by where they lie for this system; None where they may depend on any.

    Args:
        system: whose lens has a field.
        groups: of others than `Blocks` nothing is known.
    """
    blocks = [group for group in groups if isinstance(group, Blocks)]
    if len(blocks) < len(groups):
        return None
    names, across = system.shared_names(), CELLS[0] + MORE_THAN_CELLS
    classes, own = [], [name for name in names if not name.startswith(FIELD_NUMBERS)]
    grid = np.full((len(names), 2), -1)
    for at, name in enumerate(names):
        if not name.startswith(FIELD_NUMBERS):
            classes.append(own.index(name))
            continue
        stem, i = name.rsplit(".", 1)
        grid[at] = int(i) % across, int(i) // across
        one_of = (grid[at] % _WINDOW) @ [1, _WINDOW]
        classes.append(len(own) + FIELD_NUMBERS.index(f"{stem}.") * _WINDOW**2 + int(one_of))
    depends = tuple(_depends(system, poses, group, grid) for poses, group in zip(system.poses, blocks, strict=True))
    return Sparsity(depends, tuple(classes))


def _depends(
    system: System, poses: Float[Array, "blocks size"], group: Blocks, grid: np.ndarray
) -> Bool[Array, "blocks residuals shared"]:
    camera = system.rig.camera
    stands = jax.vmap(partial(photograph_poses, system))(poses[:, :6], group)
    corners = jax.vmap(partial(corner_errors, system))(poses, stands, group) + group.corners
    n = len(corners)
    # Of a corner (u, v in turn), of a stripe point, and of what is known of a board's bends.
    pixels = jnp.concatenate([jnp.repeat(corners.reshape(n, -1, 2), 2, axis=1), group.stripe.reshape(n, -1, 2)], axis=1)
    nearest = jnp.round(jax.vmap(jax.vmap(partial(_place, camera)))(pixels)) + 1
    bends = poses.shape[1] - 6
    nearest = jnp.pad(nearest, ((0, 0), (0, bends), (0, 0)), constant_values=-10 * _WINDOW)
    near = (jnp.abs(nearest[:, :, None] - jnp.asarray(grid)[None, None]) <= _REACH).all(-1)
    return near | jnp.asarray((grid < 0).all(axis=1))[None, None]


def _place(camera: Camera, pixel: Float[Array, "2"]) -> Float[Array, "2"]:
    """Where a pixel stands on the lens's grid, in cells."""
    lens = camera.lens
    assert isinstance(lens, Splined)
    xd = off_sensor(camera.tilt, (pixel - jnp.stack(camera.principal)) / jnp.stack(camera.focal))
    low, high = jnp.stack(lens.extent[:2]), jnp.stack(lens.extent[2:])
    return jnp.clip((lens.unshifted(xd) - low) / (high - low), 0, 1) * jnp.asarray(CELLS, xd.dtype)
