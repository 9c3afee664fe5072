import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.cli.format_summary import format_summary
from jaxscan.cli.summary import rig_summary
from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import Kernel
from jaxscan.reconstruction.triangulate import FramePoses, triangulate, triangulate_into
from jaxscan.rig import BowedSheet, Camera, LightPlane, Linear, Rig
from jaxscan.rig.light import distance, meet, section, sheet_axes

OMEGA = np.array([0.0004, -0.00494, 0.00303])


def sheet(sag=0.3):
    with float64():
        return as_numpy(BowedSheet.curved(OMEGA, sag, 100.0, 345.0))


def rig(light):
    with float64():
        camera = Camera.create((640, 480), (697.7, 690.4), (310.3, 228.1), "radial1", [-0.134])
        return as_numpy(Rig(camera, (light,), Linear.create([0.0, 9e-4, -4e-4])))


def test_it_leaves_its_plane_by_the_sag_and_grows_with_the_depth():
    light = sheet()
    assert light.sag(100.0, 345.0) == pytest.approx(0.3)
    assert light.sag(200.0, 345.0) == pytest.approx(1.2)
    # At a given angle of the fan, twice as far away, by twice as much.
    assert light.sag(200.0, 690.0) == pytest.approx(0.6)
    points = section(light, np.array([345.0]), np.array([-100.0, 0.0, 100.0]))[0]
    np.testing.assert_allclose(distance(light, points), 0, atol=1e-9)
    off = distance(LightPlane(light.plane), points)
    np.testing.assert_allclose(off, [-0.3, 0, -0.3], atol=1e-3)


def test_level_gradient_and_inverse_depth_agree():
    light, rng = sheet(2.0), np.random.default_rng(0)
    rays = np.column_stack([rng.uniform(-0.4, 0.4, 50), rng.uniform(-0.3, 0.1, 50), np.ones(50)])
    w = light.inverse_depth(rays)
    assert isinstance(w, np.ndarray)
    np.testing.assert_allclose(light.level(rays, w), 0, atol=1e-15)
    points = rays / w[:, None] + rng.normal(size=(50, 3))
    steps = 1e-4 * np.eye(3)
    by_steps = np.stack([(light.level(points + h) - light.level(points - h)) / 2e-4 for h in steps], axis=-1)
    np.testing.assert_allclose(light.gradient(points), by_steps, atol=1e-9)
    np.testing.assert_array_equal(light.gradient(np.zeros(3)), OMEGA)
    assert light.level(np.zeros(3)) == -1
    np.testing.assert_allclose(sheet_axes(light), sheet_axes(LightPlane(light.plane)))
    with float64():
        along = jax.vmap(lambda ray: meet(light, ray))(jnp.asarray(rays))
    np.testing.assert_allclose(along, rays / w[:, None])


def test_turned_about_the_cameras_axis_it_is_the_same_sheet():
    c, s = np.cos(1.1), np.sin(1.1)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    light = sheet(2.0)
    with float64():
        turned = as_numpy(BowedSheet.create(R @ OMEGA, light.bow[0]))
    rays = np.random.default_rng(0).uniform(-0.4, 0.4, (50, 3))
    rays[:, 2] = 1
    np.testing.assert_allclose(turned.inverse_depth(rays @ R.T), light.inverse_depth(rays), rtol=1e-12)
    assert turned.sag(100.0, 345.0) == pytest.approx(light.sag(100.0, 345.0))


@pytest.mark.parametrize("sag", [0.3, -2.0, 2.0])
def test_the_kernel_is_one_loop_and_exact_to_a_thousandth_of_a_millimetre(sag):
    whole = rig(sheet(sag))
    u, v = np.meshgrid(np.arange(5.0, 640, 15), np.arange(5.0, 300, 10))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    kernel, frames = Kernel.create(whole), FramePoses.create(whole.motion, {}, 1)
    inputs = [jnp.asarray(x, jnp.float32)[None] for x in pixels.T]
    points = np.asarray(triangulate(kernel, frames, *inputs))[0]
    with float64():
        exact = np.asarray(jax.vmap(lambda p: whole.triangulate(p, {}))(jnp.asarray(pixels)))
    seen = exact[:, 2] < 450
    assert seen.sum() > 500
    np.testing.assert_allclose(points[seen], exact[seen], atol=1e-3)
    text = triangulate_into.lower(jnp.zeros((1, len(pixels), 3)), kernel, frames, *inputs).compile().as_text()
    assert sum(" fusion(" in line for line in text[text.index("ENTRY") :].splitlines()) == 1


def test_its_numbers_go_into_the_rig_file(tmp_path):
    write_rig(tmp_path / "rig.json", RigFile(rig(sheet())))
    text = (tmp_path / "rig.json").read_text()
    assert '"kind": "bowed"' in text
    assert '"bow": [' in text
    assert "curved by 0.3" in format_summary(rig_summary(tmp_path / "rig.json"))
    back = read_rig(tmp_path / "rig.json").rig
    assert jax.tree.leaves(back) == jax.tree.leaves(rig(sheet()))


def test_a_bow_that_no_laser_has_is_refused(tmp_path):
    write_rig(tmp_path / "rig.json", RigFile(rig(sheet())))
    text = (tmp_path / "rig.json").read_text()
    bow = float(sheet().bow[0])
    (tmp_path / "rig.json").write_text(text.replace(str(bow), "40.0"))
    with pytest.raises(InputError, match=r"lights\.0\.bow .*cone of slope 0.4, which no line laser makes"):
        read_rig(tmp_path / "rig.json")
    (tmp_path / "rig.json").write_text(text.replace(f"[\n          {bow}\n        ]", "[]").replace(f"[{bow}]", "[]"))
    with pytest.raises(InputError, match="bow"):
        read_rig(tmp_path / "rig.json")
