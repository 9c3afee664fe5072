"""The kernel against the exact triangulation: lenses, both precisions, and where there is no answer."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import Kernel, triangulate
from jaxscan.reconstruction.lens_inverse import FittedInverse, lens_inverse
from jaxscan.reconstruction.opencv_inverse import LensInverse
from jaxscan.reconstruction.triangulate import FramePoses, triangulate_into
from jaxscan.rig import Camera, Fixed, LightPlane, Linear, Rig, Rotary
from tests.other_lenses import Division, Faceted, Prism, registered

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
        return as_numpy(Rig(camera, (LightPlane.create([0.0, -0.00494, 0.00303]),), Linear.create([0.0, 1e-3, -1e-4])))


def points_of(kernel: Kernel, rig: Rig, u, v, steps, dtype: str = "float32"):
    """Each pixel a frame of its own."""
    frames = FramePoses.create(rig.motion, {"stage": np.asarray(steps)}, len(u), dtype)
    return triangulate(kernel, frames, *(jnp.asarray(x, dtype)[:, None] for x in (u, v)))[:, 0]


def still(count: int, dtype: str = "float32") -> FramePoses:
    return FramePoses.create(Fixed(), {}, count, dtype)


@pytest.mark.parametrize("lens", LENSES)
def test_kernel_is_the_definition(lens):
    rig = rig_with(lens)
    random = np.random.default_rng(0)
    u, v, steps = random.uniform([0, 0, 0], [639, 479, 7e4], (2000, 3)).T
    with float64():
        exact = jax.jit(jax.vmap(lambda p, n: rig.triangulate(p, {"stage": n})))(
            jnp.stack([u, v], -1), jnp.asarray(steps)
        )
        exact = np.asarray(exact)
        double = np.asarray(points_of(Kernel.create(rig, dtype="float64"), rig, u, v, steps, "float64"))
    single = points_of(Kernel.create(rig), rig, u, v, steps)
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
    """The lens folds back inside the image; pixels up to the fold are tried."""
    with float64():
        camera = Camera.create((640, 480), [focal, focal], [327.0, 235.0], lens, radial, tangential)
        # A plane across the axis at the distance 1 sees the rays themselves.
        rig = as_numpy(Rig(camera, (LightPlane.create([0.0, 0.0, 1.0]),)))
        pixels = np.stack(np.meshgrid(np.linspace(-0.5, 639.5, 97), np.linspace(-0.5, 479.5, 73)), -1).reshape(-1, 2)
        exact = np.asarray(jax.jit(jax.vmap(camera.ray))(jnp.asarray(pixels)))
    u, v = jnp.asarray(pixels.T, jnp.float32)
    points = np.asarray(triangulate(Kernel.create(rig), still(1), u[None], v[None])[0])
    found = np.isfinite(points).all(axis=1)
    assert np.isfinite(exact[found]).all()
    assert found.sum() > 0.95 * np.isfinite(exact).all(axis=1).sum()
    assert np.linalg.norm(points - exact, axis=1)[found].max() * focal < 2e-3


@pytest.mark.parametrize(
    ("kind", "numbers", "inverse"),
    [(Division, ([-0.25],), LensInverse), (Prism, ([0.02], [-0.03]), FittedInverse)],
)
def test_a_lens_that_is_none_of_opencvs(kind, numbers, inverse):
    with registered(kind), float64():
        camera = Camera.create((640, 480), [400.0, 410.0], [327.0, 235.0], kind.kind, *numbers)
        rig = as_numpy(Rig(camera, (LightPlane.create([0.0, 0.0, 1.0]),)))
        pixels = np.stack(np.meshgrid(np.linspace(-0.5, 639.5, 97), np.linspace(-0.5, 479.5, 73)), -1).reshape(-1, 2)
        exact = np.asarray(jax.jit(jax.vmap(camera.ray))(jnp.asarray(pixels)))
    kernel = Kernel.create(rig)
    assert isinstance(kernel.lens, inverse)
    u, v = jnp.asarray(pixels.T, jnp.float32)
    points = np.asarray(triangulate(kernel, still(1), u[None], v[None])[0])
    assert np.linalg.norm(points - exact, axis=1).max() * 400 < 2e-3


def test_a_symmetric_lens_of_another_kind_has_the_kernel_of_a_radial_one():
    with registered(Division), float64():
        camera = as_numpy(Camera.create((640, 480), [697.7, 690.4], [310.3, 228.1], "division", [-0.13]))
    u, v = (jnp.full((1, 7), x) for x in (300.0, 100.0))
    triangulate(Kernel.create(rig_with("radial1")), still(1), u, v)
    before = triangulate.jitted._cache_size()
    triangulate(Kernel.create(replace(rig_with("radial1"), camera=camera)), still(1), u, v)
    assert triangulate.jitted._cache_size() == before


def test_a_lens_that_is_not_smooth_is_refused():
    with registered(Faceted), float64():
        camera = as_numpy(Camera.create((640, 480), [697.7, 690.4], [310.3, 228.1], "faceted", [0.01]))
        with pytest.raises(InputError, match=r"lens faceted with division \[0.01\] is not smooth over the image"):
            lens_inverse(camera)


def test_a_usual_lens_needs_no_correction_and_a_strong_one_does():
    usual = Kernel.create(rig_with("brown")).lens
    assert (usual.corrections, usual.along.shape, usual.across.shape) == (0, (3, 5), (2, 5))
    with float64():
        strong = Camera.create((640, 480), [697.0, 697.0], [320.0, 240.0], "brown", [-0.27, 0.05, 0.1], [1e-2, -2e-2])
    assert lens_inverse(as_numpy(strong)).corrections > 0


def test_a_pixel_that_is_missing_or_sees_no_sheet_gives_nan():
    kernel = Kernel.create(rig_with("radial1"))
    u, v = jnp.array([[300.0, jnp.nan, 300.0]]), jnp.array([[100.0, 100.0, jnp.nan]])
    points = triangulate(kernel, still(1), u, v)[0]
    assert np.isfinite(points).all(axis=1).tolist() == [True, False, False]
    rig = rig_with("radial1")
    steep = Kernel.create(replace(rig, lights=(LightPlane.create([0.0, -0.0145, 0.00303]),)))
    assert np.isnan(triangulate(steep, still(1), jnp.array([[300.0]]), jnp.array([[478.0]]))).all()


def test_a_lens_that_folds_back_inside_the_image_has_points_up_to_the_fold():
    # r (1 − 0.134 r²) is highest at r_d = 1.0515, 734 px from the middle: inside an image of 1600 × 1200.
    rig = rig_with("radial1", (1600, 1200))
    kernel = Kernel.create(rig)
    u = jnp.array([[310.0 + 600, 310.0 + 900]], jnp.float32)
    points = triangulate(kernel, still(1), u, jnp.array([[100.0, 100.0]]))[0]
    assert np.isfinite(points).all(axis=1).tolist() == [True, False]


def test_another_rig_does_not_compile_again():
    u, v = (jnp.full((1, 7), x) for x in (300.0, 100.0))
    triangulate(Kernel.create(rig_with("radial1")), still(1), u, v)
    before = triangulate.jitted._cache_size()
    triangulate(Kernel.create(rig_with("radial1", radial=[-0.13])), still(1), u, v)
    assert triangulate.jitted._cache_size() == before


TURNED = Rotary.create([0.0, 2e-3, 1e-4], [3.0, 4.0, 300.0])


def swept(count: int) -> LightPlane:
    """A plane that a mirror turns: a stack of them, one for each frame."""
    c = np.linspace(0.0025, 0.0035, count)
    return LightPlane((1e-5 * c, np.full(count, -0.00494), c))


@pytest.mark.parametrize("motion", ["stage", "turntable", "both", "light"])
@pytest.mark.parametrize(("dtype", "lens"), [("float32", "radial1"), ("float64", "radial1"), ("float32", "brown")])
def test_the_kernel_is_one_pass_into_memory_that_is_handed_in(dtype, lens, motion):
    with jax.enable_x64(dtype == "float64"):
        rig = rig_with(lens)
        if motion in ("turntable", "both"):
            rig = as_numpy(rig.with_axis(TURNED) if motion == "both" else Rig(rig.camera, rig.lights, TURNED))
        kernel = Kernel.create(rig, dtype=dtype)
        if motion == "light":
            kernel = kernel.with_lights(swept(32))
        random = np.random.default_rng(0)
        q = {"stage": random.uniform(0, 7e4, 32), "turntable": random.uniform(0, 3e3, 32)}
        frames = FramePoses.create(rig.motion, q, 32, dtype)
        u, v = (jnp.asarray(random.uniform(0, high, (32, 128)), dtype) for high in (639, 479))
        out = jnp.zeros((32, 128, 3), dtype)
        compiled = triangulate_into.lower(out, kernel, frames, u, v).compile()
        entry = compiled.as_text().split("ENTRY")[1]
        assert entry.count(" fusion(") == 1
        assert entry.count(" call(") == 0
        place = out.unsafe_buffer_pointer()
        points = triangulate_into(out, kernel, frames, u, v)
        assert points.unsafe_buffer_pointer() == place
        assert points.dtype == dtype
        np.testing.assert_allclose(points, triangulate(kernel, frames, u, v), rtol=1e-6)


def test_points_of_turned_and_shifted_frames_are_those_of_the_definition():
    rig = as_numpy(rig_with("radial1").with_axis(TURNED))
    random = np.random.default_rng(1)
    q = {"stage": random.uniform(0, 7e4, 50), "turntable": random.uniform(0, 3e3, 50)}
    u, v = random.uniform(0, 639, (50, 40)), random.uniform(0, 300, (50, 40))
    found = np.asarray(
        triangulate(Kernel.create(rig), FramePoses.create(rig.motion, q, 50), jnp.asarray(u), jnp.asarray(v))
    )
    with float64():
        exact = rig_points(rig, np.stack([u, v], axis=-1), q)
    near = np.isfinite(exact).all(axis=-1) & (np.abs(exact) < 600).all(axis=-1)
    assert near.mean() > 0.5
    np.testing.assert_allclose(found[near], exact[near], atol=2e-3)


def rig_points(rig: Rig, pixels: np.ndarray, q: dict) -> np.ndarray:
    """The points of frames and lines, as the rig itself computes them."""
    along = jax.vmap(jax.vmap(rig.triangulate, in_axes=(0, None)))
    return np.asarray(jax.jit(along)(jnp.asarray(pixels), {axis: jnp.asarray(steps) for axis, steps in q.items()}))


def test_a_light_that_moves_stands_elsewhere_in_each_frame():
    rig, lights = rig_with("radial1"), swept(20)
    random = np.random.default_rng(2)
    q = {"stage": random.uniform(0, 7e4, 20)}
    u, v = random.uniform(0, 639, (20, 30)), random.uniform(0, 300, (20, 30))
    frames = FramePoses.create(rig.motion, q, 20)
    found = np.asarray(triangulate(Kernel.create(rig).with_lights(lights), frames, jnp.asarray(u), jnp.asarray(v)))
    for i, omega in enumerate(np.stack(lights.plane, axis=-1)):
        one = Kernel.create(replace(rig, lights=(LightPlane.create(omega),)))
        alone = triangulate(
            one,
            FramePoses.create(rig.motion, {"stage": q["stage"][i]}, 1),
            *map(jnp.asarray, (u[i : i + 1], v[i : i + 1])),
        )
        np.testing.assert_allclose(found[i], alone[0], rtol=1e-5, atol=1e-3)
