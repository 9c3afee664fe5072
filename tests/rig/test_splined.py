"""The splined lens: its field against SciPy's B-splines, pixels that come back, derivatives, folds, refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline

from jaxscan.cli.format_summary import format_summary
from jaxscan.cli.summary import rig_summary
from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction.lens_inverse import lens_inverse
from jaxscan.rig import Camera, Rig, spline
from jaxscan.rig.projection import pixel_rays, project_points
from jaxscan.rig.rig import parameter_names
from jaxscan.rig.splined import CELLS, KNOTS, grid_over

SIZE, FOCAL, PRINCIPAL = (640, 480), (700.0, 695.0), (315.0, 236.0)


def camera(rms_px, seed=0, tilt=()):
    random = np.random.default_rng(seed)
    with float64():
        shifts = [random.normal(size=KNOTS) * rms_px / FOCAL[0] for _ in range(2)]
        terms = [-0.2, 0.1, 0.0], [1e-3, -1e-3]
        extent = grid_over(SIZE, FOCAL, PRINCIPAL, tilt)
        return as_numpy(Camera.create(SIZE, FOCAL, PRINCIPAL, "splined", *terms, extent, *shifts, tilt=tilt))


def test_the_field_is_scipys():
    own = camera(1.0)
    extent = np.array([float(x) for x in own.lens.extent])
    x = np.random.default_rng(1).uniform(extent[:2], extent[2:], (200, 2))
    coefficients = np.array([own.lens.shift_x, own.lens.shift_y], float)
    t = (x - extent[:2]) / (extent[2:] - extent[:2]) * CELLS
    across, along = (BSpline.design_matrix(t[:, k], np.arange(-3.0, CELLS[k] + 4), 3).toarray() for k in (1, 0))
    expected = np.einsum("pj,cji,pi->pc", across, coefficients.reshape(2, CELLS[1] + 3, CELLS[0] + 3), along)
    np.testing.assert_allclose(spline.basis(extent, CELLS, x) @ coefficients.T, expected, atol=1e-12)
    with jax.enable_x64(True):
        rows = [list(jnp.asarray(row)) for row in coefficients]
        found = jax.vmap(lambda x: spline.shift(rows, list(jnp.asarray(extent)), CELLS, x))(jnp.asarray(x))
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("tilt", [(), (0.1, -0.05)])
def test_pixels_come_back_and_the_kernels_inverse_is_as_near(tilt):
    own = camera(1.0, tilt=tilt)
    pixels = np.random.default_rng(2).uniform([0, 0], [639, 479], (400, 2))
    rays = pixel_rays(own, pixels)
    np.testing.assert_allclose(project_points(own, 300 * rays).pixels, pixels, atol=1e-9)
    inverse = lens_inverse(own)
    xt = (pixels - np.array(PRINCIPAL)) / np.array(FOCAL)
    with float64():
        found = np.stack(jax.vmap(inverse)(*jnp.asarray(xt.T)), axis=1)
    assert np.abs(found - rays[:, :2]).max() * FOCAL[0] < 1e-3


def test_derivatives_of_the_ray_are_those_of_differences():
    with jax.enable_x64(True):
        own = jax.tree.map(jnp.asarray, camera(1.0))
        leaves, structure = jax.tree.flatten(own)
        random = np.random.default_rng(3)
        along = [jnp.asarray(random.normal() * 1e-3) for _ in leaves]
        pixel = jnp.array([420.0, 130.0])

        @jax.jit
        def ray(step):
            moved = [leaf + step * by for leaf, by in zip(leaves, along, strict=True)]
            return jnp.concatenate(jax.tree.unflatten(structure, moved).ray_and_change(pixel, jnp.array([0.0, 1.0])))

        exact = jax.jit(jax.jacfwd(ray))(0.0)
        h = 1e-4
        np.testing.assert_allclose(exact, (ray(h) - ray(-h)) / (2 * h), rtol=1e-5, atol=1e-9)


def test_where_the_field_folds_there_is_no_ray():
    rays = pixel_rays(camera(60.0), np.random.default_rng(4).uniform([0, 0], [639, 479], (300, 2)))
    gone = ~np.isfinite(rays).all(axis=1)
    assert 0 < gone.sum() < len(rays)
    np.testing.assert_array_less(np.abs(rays[~gone]), 10)


def test_a_file_keeps_it_and_a_wrong_number_of_shifts_is_refused(tmp_path):
    path, own = tmp_path / "rig.json", Rig(camera(1.0))
    write_rig(path, RigFile(own))
    assert jax.tree.leaves(read_rig(path).rig) == jax.tree.leaves(own)
    assert parameter_names(own)[9] == "camera.extent.0"
    assert own.given() == {f"camera.extent.{i}" for i in range(4)}
    text = path.read_text()
    path.write_text(text.replace('"shift_x": [', '"shift_x": [0.0, '))
    with pytest.raises(InputError, match=f'"splined" has {KNOTS} shift_x coefficients, here are {KNOTS + 1}'):
        read_rig(path)
    start = text.index('"extent": [') + len('"extent": [')
    path.write_text(text[:start] + "9.0" + text[text.index(",", start) :])
    with pytest.raises(InputError, match=r"camera.extent = .*must be the least x and y"):
        read_rig(path)


def test_a_summary_has_the_range_of_so_many_numbers(tmp_path):
    own = camera(1.0)
    write_rig(tmp_path / "rig.json", RigFile(Rig(own)))
    ends = f"{min(own.lens.shift_y):.3g} to {max(own.lens.shift_y):.3g}"
    words = format_summary(rig_summary(tmp_path / "rig.json"))
    assert f"{KNOTS} numbers, {ends}; all of them with --json" in words
    assert max(map(len, words.splitlines())) < 120


def test_formats_of_opencvs_terms_refuse_it(tmp_path):
    from jaxscan.files.camera_file import CameraFile
    from jaxscan.files.cameras import write_camera_file

    for name, form in (("a.yml", "opencv"), ("a.yaml", "ros"), ("b.cameramodel", "mrcal")):
        with pytest.raises(InputError, match='the lens "splined" has no counterpart'):
            write_camera_file(tmp_path / name, CameraFile(SIZE, camera(1.0)), format=form)
