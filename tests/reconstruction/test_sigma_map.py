"""The maps of σ against the exact derivatives at pixels all over the image."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction.point_sigma import point_sigma
from jaxscan.reconstruction.sigma_map import MovedFrames, SigmaMap, point_sigmas
from jaxscan.rig import BowedSheet, Camera, Covariance, LightPlane, Linear, Rig, Rotary
from jaxscan.rig.rig import parameter_names

LENSES = {
    "radial1": ([-0.134], []),
    "rational": ([-0.1, 0.05, 0.0, 0.05, 0.02, 0.0], [1e-3, 1e-3]),
    "fisheye": ([0.012, -0.006, 0.0012, -0.00008],),
}


@pytest.mark.parametrize(
    ("lens", "columns", "turned", "bow"),
    [
        ("radial1", True, False, None),
        ("radial1", True, True, None),
        ("radial1", True, False, 16.0),
        ("fisheye", True, True, None),
        pytest.param("rational", False, False, None, marks=pytest.mark.long),
        pytest.param("rational", False, True, None, marks=pytest.mark.long),
    ],
)
def test_sigma_is_that_of_the_exact_derivatives(lens, columns, turned, bow):
    plane = [0.0, -0.00494, 0.00303] if columns else [-0.004, 0.0005, 0.0024]
    # A fisheye sees 115° to its sides, and the sheet behind it.
    focal, plane = ([151.0, 149.0], [0.001, -0.0067, 0.001]) if lens == "fisheye" else ([697.7, 690.4], plane)
    with float64():
        camera = Camera.create((640, 480), focal, [310.3, 228.1], lens, *LENSES[lens])
        light = LightPlane.create(plane) if bow is None else BowedSheet.create(plane, bow)
        rig = as_numpy(Rig(camera, (light,), Linear.create([0.0, 1e-3, -4e-4])))
        if turned:
            rig = as_numpy(rig.with_axis(Rotary.create([1e-4, 1.5e-3, 2e-4], [3.0, 4.0, 340.0])))
    names = tuple(parameter_names(rig))
    random = np.random.default_rng(0)
    scale = np.array([1e-3 if n.split(".")[1] in ("radial", "tangential") else 0.3 for n in names])
    if lens == "fisheye":
        scale[4:8] = [3e-4, 2e-4, 5e-5, 6e-6]
    motion = next(i for i, n in enumerate(names) if n.startswith("motion"))
    plane_at = names.index("lights.0.plane.0")
    scale[plane_at : plane_at + 3], scale[motion : motion + 3] = [1e-6, 2e-6, 2e-6], 4e-6
    if bow is not None:
        scale[names.index("lights.0.bow.0")] = 0.1
    if turned:
        scale[-6:] = [2e-6, 2e-6, 2e-6, 0.02, 0.02, 0.02]
    root = scale[:, None] * (np.eye(len(names)) + 0.3 * random.normal(size=(len(names), len(names))))
    covariance = Covariance(names, root @ root.T)

    q = {"stage": np.array([-72000.0, 0.0, 40000.0]), "turntable": np.array([300.0, 0.0, -900.0])}
    lines, length = (640, 480) if columns else (480, 640)
    position = random.uniform(0, length - 1, (3, lines)).astype(np.float32)
    index = np.broadcast_to(np.arange(lines, dtype=np.float32), position.shape)
    pixels = np.stack([index, position] if columns else [position, index], axis=-1).reshape(-1, 2).astype(np.float64)
    each = {axis: np.repeat(steps, lines) for axis, steps in q.items()}
    stripe = random.uniform(0.02, 0.3, position.size)
    with float64():
        points = np.asarray(jax.vmap(rig.triangulate)(jnp.asarray(pixels), jax.tree.map(jnp.asarray, each)))
    pose = rig.pose(each)
    seen = pose.apply(points[:, None])[:, 0]
    far = camera.chart.range_of(seen)
    inside = np.isfinite(points).all(axis=1) & (far > 0) & (far < 2000)
    assert inside.mean() > 0.4
    assert lens != "fisheye" or (seen[inside, 2] < 0).mean() > 0.2
    exact = point_sigma(rig, "", covariance, stripe, pixels, each, columns)
    mapped = point_sigmas(
        SigmaMap.create(rig, "", covariance, columns),
        MovedFrames.create(rig, q, 3),
        jnp.asarray(position),
        jnp.asarray(points.reshape(3, lines, 3), jnp.float32),
        jnp.asarray(stripe.reshape(position.shape), jnp.float32),
    )
    for own, known in zip(mapped, exact, strict=True):
        assert own.dtype == jnp.float32
        np.testing.assert_allclose(np.asarray(own).ravel()[inside], known[inside], rtol=5e-3)
