"""Range images drawn and not rendered: where an ideal camera sees the sheet, plus noise, triangulated with the rig."""

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
from jaxscan.simulation.rig_2003 import stage_travel
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


def drawn_scan(rig: Rig, scene: Scene, steps: Int[np.ndarray, "frames"], noise_px: float, seed: int = 0) -> Drawn:
    """A scan of a scene without photographs.

    Args:
        rig: the true one.
        scene: as it stands at motor step 0.
        steps: motor step count of each frame.
        noise_px: σ of the stripe's position, the same everywhere.
        seed: of the noise.
    """
    profiles = [true_profile(rig, scene, float(n)) for n in steps]
    points, position = (np.stack([profile[k] for profile in profiles]) for k in (1, 0))
    return Drawn(noisy_scan(rig, position, steps, noise_px, seed), points, position)


def noisy_scan(
    rig: Rig,
    position: Float[np.ndarray, "frames columns"],
    steps: Int[np.ndarray, "frames"],
    noise_px: float,
    seed: int = 0,
) -> RangeImage:
    """A scan with the stripe at these rows (NaN for none) and with noise; the arguments are those of `drawn_scan`."""
    rows = position + noise_px * np.random.default_rng(seed).normal(size=position.shape)
    valid = np.isfinite(rows)
    frame, column = np.nonzero(valid)
    pixels, counts = np.stack([column, rows[valid]], axis=1), steps[frame].astype(np.float64)
    with float64():
        see = jax.jit(jax.vmap(as_float64(rig).triangulate))
        seen = np.asarray(see(jnp.asarray(pixels), jnp.asarray(counts)))

    def grid(values: np.ndarray) -> np.ndarray:
        full = np.full((*valid.shape, *values.shape[1:]), np.nan, np.float32)
        full[valid] = values
        return full

    sigma = grid(noise_px * np.abs(ray_jacobian(rig, "", pixels, counts, True)[1]))
    return RangeImage(
        points=grid(seen),
        pixels=rows.astype(np.float32),
        strength=grid(np.full(len(seen), _STRENGTH)),
        sigma=sigma,
        sigma_pixel=sigma,
        valid=valid,
        steps=np.asarray(steps, np.int64),
        per_step=stage_travel(rig, np.ones(1))[0],
    )
