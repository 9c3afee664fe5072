"""How a measured height moves with the light plane: the derivative, by `jax.grad` through the scanner's own geometry.

The height of a place of the object over the floor is a function of the rig: four pixels are triangulated, three of
them on the floor, and the fourth's distance from their plane is taken. `Rig.triangulate` goes through the lens (its
converged inverse, differentiated implicitly), the light plane and the stage, and JAX goes through all of it.

With the gradient g and the covariance Σ of the light plane, g Σ gᵀ is the height's variance as far as the plane is to
blame. `Covariance.of` does it for all parameters at once, correlations included. These are not independent: a light
plane and a camera that were fitted together share their errors, and part of them cancels in a height.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import photographs

import jaxscan

content = photographs.rig()
image = jaxscan.reconstruct(content, jaxscan.read_scan(photographs.world() / "scan"))

# The frame across the object's middle, and the first. In each column the stripe's row is known.
across, first = int(np.argmin(np.abs(image.steps - 36_000))), 0
chosen = [(across, 200), (across, 430), (first, 310), (across, 310)]  # frame, column
seen = [((column, float(image.pixels[frame, column])), float(image.steps[frame])) for frame, column in chosen]


@jax.jit
def height(rig: jaxscan.Rig) -> jax.Array:
    """Distance of the fourth point from the plane through the other three, mm."""
    a, b, c, top = (rig.triangulate(jnp.asarray(pixel), {"stage": step}) for pixel, step in seen)
    normal = jnp.cross(b - a, c - a)
    return jnp.abs((top - a) @ normal) / jnp.linalg.norm(normal)


with jax.enable_x64(True):
    rig = content.rig
    gradient = np.array(jax.grad(height)(rig).lights[0].plane)
    # The same by moving the plane there and back.
    plane, by_differences, h = np.array(jax.tree.leaves(rig.light())), np.zeros(3), 1e-8
    for i in range(3):
        there, back = (jaxscan.LightPlane.create(plane + s * h * np.eye(3)[i]) for s in (1, -1))
        ends = [float(height(replace(rig, lights=(laser,)))) for laser in (there, back)]
        by_differences[i] = (ends[0] - ends[1]) / (2 * h)
    measured = float(height(rig))

print(f"height over the floor        {measured:.3f} mm")
print(f"∂ height / ∂ω, mm · mm       {gradient}")
print(f"  … by finite differences    {by_differences}")
assert np.allclose(gradient, by_differences, rtol=1e-5, atol=1e-3)

covariance = content.covariance
assert covariance is not None  # a rig that was written by hand has none
at = [covariance.names.index(f"lights.0.plane.{i}") for i in range(3)]
from_plane = np.sqrt(gradient @ covariance.matrix[np.ix_(at, at)] @ gradient)
from_rig = np.sqrt(covariance.of(rig, height)[0, 0])
print(f"σ from the light plane alone {from_plane:.4f} mm")
print(f"σ from the whole rig         {from_rig:.4f} mm")
