"""Range images drawn and not rendered: where an ideal camera sees the sheet, plus noise, triangulated with the rig."""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxscan.precision import as_float64, float64
from jaxscan.reconstruction import RangeImage
from jaxscan.reconstruction.point_sigma import ray_jacobian
from jaxscan.rig import Rig
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.scene import Scene

_STRENGTH = 250.0


class Drawn(NamedTuple):
    """A range image and what is true of it; NaN where there is nothing.

    Attributes:
        image: with the noise.
        points: the true ones, object frame, mm.
        position: the true rows, px.
    """

    image: RangeImage
    points: Float[np.ndarray, "frames columns 3"]
    position: Float[np.ndarray, "frames columns"]


def drawn_scan(
    rig: Rig, scene: Scene, q: Mapping[str, Int[np.ndarray, "frames"]], noise_px: float, seed: int = 0
) -> Drawn:
    """A scan of a scene without photographs.

    Args:
        rig: the true one.
        scene: as it stands with all axes at 0.
        q: motor steps of each axis at each frame.
        noise_px: σ of the stripe's position, the same everywhere.
        seed: of the noise.
    """
    profiles = [
        true_profile(rig, scene, dict(zip(q, map(float, place), strict=True)))
        for place in zip(*q.values(), strict=True)
    ]
    points, position = (np.stack([profile[k] for profile in profiles]) for k in (1, 0))
    return Drawn(noisy_scan(rig, position, q, noise_px, seed), points, position)


def noisy_scan(
    rig: Rig,
    position: Float[np.ndarray, "frames columns"],
    q: Mapping[str, Int[np.ndarray, "frames"]],
    noise_px: float,
    seed: int = 0,
) -> RangeImage:
    """A scan with the stripe at these rows (NaN for none) and with noise; the arguments are those of `drawn_scan`."""
    rows = position + noise_px * np.random.default_rng(seed).normal(size=position.shape)
    valid = np.isfinite(rows)
    frame, column = np.nonzero(valid)
    pixels = np.stack([column, rows[valid]], axis=1)
    each = {axis: np.asarray(steps)[frame].astype(np.float64) for axis, steps in q.items()}
    with float64():
        see = jax.jit(jax.vmap(as_float64(rig).triangulate))
        seen = np.asarray(see(jnp.asarray(pixels), jax.tree.map(jnp.asarray, each)))

    def grid(values: np.ndarray) -> np.ndarray:
        full = np.full((*valid.shape, *values.shape[1:]), np.nan, np.float32)
        full[valid] = values
        return full

    sigma = grid(noise_px * np.abs(ray_jacobian(rig, "", pixels, each, True)[1]))
    return RangeImage(
        points=grid(seen),
        pixels=rows.astype(np.float32),
        strength=grid(np.full(len(seen), _STRENGTH)),
        sigma=sigma,
        sigma_pixel=sigma,
        valid=valid,
        positions={axis: np.asarray(steps, np.int64) for axis, steps in q.items()},
        motion=rig.motion,
        sheets=(rig.light(),),
    )
