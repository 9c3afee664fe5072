"""The kernel against the exact triangulation: lenses, both precisions, and where there is no answer."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import Kernel, triangulate
from jaxscan.reconstruction.lens_inverse import lens_inverse
from jaxscan.reconstruction.triangulate import triangulate_into
from jaxscan.rig import Camera, LightPlane, Rig, Stage

LENSES = {
    "none": ((), ()),
    "radial1": ([-0.134], ()),
    "brown": ([-0.27, 0.05, 0.1], [1e-3, -2e-3]),
    "rational": ([0.47, 0.0267, 4.4e-5, 0.767, 0.0963, 0.0014], [-1e-5, 9e-5]),
}


def rig_with(lens: str, image_size=(640, 480), radial=None) -> Rig:
    k, p = LENSES[lens]
    with float64():
        camera = Camera.create(image_size, [697.7, 690.4], [310.3, 228.1], lens, k if radial is None else radial, p)
        return as_numpy(Rig(camera, (LightPlane.create([0.0, -0.00494, 0.00303]),), Stage.create([0.0, 1e-3, -1e-4])))


@pytest.mark.parametrize("lens", LENSES)
def test_kernel_is_the_definition(lens):
    rig = rig_with(lens)
    random = np.random.default_rng(0)
    u, v, steps = random.uniform([0, 0, 0], [639, 479, 7e4], (2000, 3)).T
    with float64():
        exact = jax.jit(jax.vmap(lambda p, n: rig.triangulate(p, n)))(jnp.stack([u, v], -1), jnp.asarray(steps))
        exact = np.asarray(exact)
        double = np.asarray(triangulate(Kernel.create(rig, dtype="float64"), *map(jnp.asarray, (u, v, steps))))
    single = triangulate(Kernel.create(rig), *(jnp.asarray(x, jnp.float32) for x in (u, v, steps)))
    assert single.dtype == jnp.float32
    near = np.isfinite(exact).all(axis=1) & (exact[:, 2] < 400)
    assert near.sum() > 300
    np.testing.assert_array_equal(np.isfinite(double), np.isfinite(exact))
    np.testing.assert_allclose(double[near], exact[near], atol=1e-5)
    # A micrometre at 400 mm; float32 itself resolves 0.03.
    np.testing.assert_allclose(np.asarray(single)[near], exact[near], atol=1e-3)


@pytest.mark.parametrize(
    ("lens", "radial", "tangential", "focal"),
    [
        ("radial1", [-0.3], (), 500.0),
        ("rational", [0.47, 0.0267, 4.4e-5, 0.767, 0.0963, 0.0014], [-1e-5, 9e-5], 300.0),
        ("brown", [-0.27, 0.05, 0.1], [1e-2, -2e-2], 697.0),
        ("brown", [-0.3, 0.0, 0.0], [5e-3, -5e-3], 480.0),
    ],
)
def test_strong_lenses_in_float32_over_the_whole_image(lens, radial, tangential, focal):
    """Of a lens that folds back inside the image, up to the fold."""
    with float64():
        camera = Camera.create((640, 480), [focal, focal], [327.0, 235.0], lens, radial, tangential)
        # A plane across the axis at the distance 1 sees the rays themselves.
        rig = as_numpy(Rig(camera, (LightPlane.create([0.0, 0.0, 1.0]),)))
        pixels = np.stack(np.meshgrid(np.linspace(-0.5, 639.5, 97), np.linspace(-0.5, 479.5, 73)), -1).reshape(-1, 2)
        exact = np.asarray(jax.jit(jax.vmap(camera.ray))(jnp.asarray(pixels)))
    u, v = jnp.asarray(pixels.T, jnp.float32)
    points = np.asarray(triangulate(Kernel.create(rig), u, v, jnp.zeros_like(u)))
    found = np.isfinite(points).all(axis=1)
    assert np.isfinite(exact[found]).all()
    assert found.sum() > 0.95 * np.isfinite(exact).all(axis=1).sum()
    assert np.linalg.norm(points - exact, axis=1)[found].max() * focal < 2e-3


def test_a_usual_lens_needs_no_correction_and_a_strong_one_does():
    usual = Kernel.create(rig_with("brown")).lens
    assert (usual.corrections, usual.along.shape, usual.across.shape) == (0, (3, 5), (2, 5))
    with float64():
        strong = Camera.create((640, 480), [697.0, 697.0], [320.0, 240.0], "brown", [-0.27, 0.05, 0.1], [1e-2, -2e-2])
    assert lens_inverse(as_numpy(strong)).corrections > 0


def test_a_pixel_that_is_missing_or_sees_no_sheet_gives_nan():
    kernel = Kernel.create(rig_with("radial1"))
    points = triangulate(kernel, jnp.array([300.0, jnp.nan, 300.0]), jnp.array([100.0, 100.0, jnp.nan]), jnp.zeros(3))
    assert np.isfinite(points).all(axis=1).tolist() == [True, False, False]
    rig = rig_with("radial1")
    steep = Kernel.create(replace(rig, lasers=(LightPlane.create([0.0, -0.0145, 0.00303]),)))
    assert np.isnan(triangulate(steep, jnp.array([300.0]), jnp.array([478.0]), jnp.zeros(1))).all()


def test_a_lens_that_folds_back_inside_the_image_has_points_up_to_the_fold():
    # r (1 − 0.134 r²) is highest at r_d = 1.0515, 734 px from the middle: inside an image of 1600 × 1200.
    rig = rig_with("radial1", (1600, 1200))
    kernel = Kernel.create(rig)
    u = jnp.array([310.0 + 600, 310.0 + 900], jnp.float32)
    points = triangulate(kernel, u, jnp.array([100.0, 100.0]), jnp.zeros(2))
    assert np.isfinite(points).all(axis=1).tolist() == [True, False]


def test_another_rig_does_not_compile_again():
    u, v, steps = (jnp.full(7, x) for x in (300.0, 100.0, 0.0))
    triangulate(Kernel.create(rig_with("radial1")), u, v, steps)
    before = triangulate._cache_size()
    triangulate(Kernel.create(rig_with("radial1", radial=[-0.13])), u, v, steps)
    assert triangulate._cache_size() == before


@pytest.mark.parametrize(("dtype", "lens"), [("float32", "radial1"), ("float64", "radial1"), ("float32", "brown")])
def test_the_kernel_is_one_pass_into_memory_that_is_handed_in(dtype, lens):
    with jax.enable_x64(dtype == "float64"):
        kernel = Kernel.create(rig_with(lens), dtype=dtype)
        random = np.random.default_rng(0)
        u, v, steps = (jnp.asarray(x, dtype) for x in random.uniform([0, 0, 0], [639, 479, 7e4], (4096, 3)).T)
        out = jnp.zeros((4096, 3), dtype)
        compiled = triangulate_into.lower(out, kernel, u, v, steps).compile()
        entry = compiled.as_text().split("ENTRY")[1]
        assert entry.count(" fusion(") == 1
        assert entry.count(" call(") == 0
        place = out.unsafe_buffer_pointer()
        points = triangulate_into(out, kernel, u, v, steps)
        assert points.unsafe_buffer_pointer() == place
        assert points.dtype == dtype
        np.testing.assert_allclose(points, triangulate(kernel, u, v, steps), rtol=1e-6)
