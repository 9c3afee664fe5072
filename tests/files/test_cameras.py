"""Cameras of other programs: exact round trips, projection by OpenCV, and what other readers make of our files."""

import ast
from pathlib import Path
from typing import Any

import cv2
import foreign_samples as samples
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.io
import yaml

from jaxscan import read_camera, write_camera
from jaxscan.errors import InputError
from jaxscan.files.cameras import lost, read_camera_file, write_camera_file
from jaxscan.files.formats import FORMATS
from jaxscan.files.table import PassedOverWarning
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera
from jaxscan.rig.opencv_lens import LADDER
from tests.other_lenses import Division, registered

# How many of OpenCV's terms each format has.
TERMS = {"rig": 8, "bouguet": 5, "opencv": 8, "ros": 8, "kalibr": 4, "mrcal": 8}
NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def camera(lens: str, seed: int = 0) -> Camera:
    """A camera of which no number fits a float32."""
    rng = np.random.default_rng(seed)
    n_radial, n_tangential = LADDER[lens].numbers.values()
    with jax.enable_x64(True):
        made = Camera.create(
            (int(rng.integers(1, 5000)), int(rng.integers(1, 5000))),
            rng.uniform(300, 3000, 2),
            rng.uniform(-10, 2000, 2),
            lens,
            rng.normal(size=n_radial) * 10.0 ** rng.integers(-7, 0, n_radial),
            rng.normal(size=n_tangential) * 1e-5,
        )
    return jax.tree.map(np.asarray, made)


def numbers(camera: Camera) -> list[float]:
    return [float(leaf) for leaf in jax.tree.leaves(camera)]


def opencv_terms(camera: Camera) -> list[float]:
    k = [*map(float, camera.lens.radial), *[0.0] * 6][:6]
    p = [*map(float, camera.lens.tangential), 0.0, 0.0][:2]
    return [k[0], k[1], *p, *k[2:]]


def test_a_lens_of_another_kind_is_written_to_rig_json_alone(tmp_path):
    with registered(Division):
        with float64():
            camera = as_numpy(Camera.create(samples.SIZE, [700.0, 699.0], [320.5, 239.25], "division", [-0.21]))
        write_camera(tmp_path / "rig.json", camera)
        back = read_camera(tmp_path / "rig.json")
        assert (back.lens.kind, numbers(back)) == ("division", numbers(camera))
        for name in ("camera.mat", "camera.xml", "camera.cameramodel"):
            with pytest.raises(InputError, match=rf'{name}: the lens "division" has no counterpart in .* rig.json, or'):
                write_camera(tmp_path / name, camera)
            assert not (tmp_path / name).exists()
    with pytest.raises(InputError, match=r'camera.lens = "division": must be one of none, radial1'):
        read_camera(tmp_path / "rig.json")


@pytest.mark.parametrize("x64", [False, True])
@pytest.mark.parametrize("lens", LADDER)
@pytest.mark.parametrize("form", FORMATS)
def test_every_bit_survives_where_the_format_has_the_term(tmp_path, form, lens, x64):
    for seed in range(5):
        original = camera(lens, seed)
        for ending in FORMATS[form].endings:
            path = tmp_path / f"camera{ending}"
            beyond = [name for name, value in zip(NAMES, opencv_terms(original), strict=True) if value][::-1]
            beyond = [name for name in beyond if NAMES.index(name) >= TERMS[form]][::-1]
            with jax.enable_x64(x64):
                if beyond:
                    with pytest.raises(InputError, match=rf"camera.* the lens term {beyond[0]} = .* no counterpart"):
                        write_camera(path, original, format=form)
                    assert not path.exists()
                    continue
                write_camera(path, original, format=form)
                back = read_camera(path)
            assert jax.tree.structure(back) == jax.tree.structure(original)
            assert numbers(back) == numbers(original)
            assert all(leaf.dtype == np.float64 for leaf in jax.tree.leaves(back))


@pytest.mark.parametrize("lens", LADDER)
@pytest.mark.parametrize("form", ["bouguet", "opencv", "ros", "mrcal"])
def test_what_is_written_projects_as_opencv_does(x64, tmp_path, form, lens):
    """K and the coefficients are taken from the file by another reader, and the points projected by another program."""
    if form == "bouguet" and lens == "rational":
        return
    n_radial, n_tangential = LADDER[lens].numbers.values()
    ours = Camera.create(
        (640, 480),
        (697.7, 690.4),
        (310.3, 228.1),
        lens,
        [-0.27, 0.05, 0.02, 0.07, 0.01, 0.001][:n_radial],
        [1e-3, -2e-3][:n_tangential],
    )
    path = tmp_path / f"camera{FORMATS[form].endings[0]}"
    write_camera(path, ours, format=form)
    K, D = OTHER_READERS[form](path)
    points = np.random.default_rng(1).uniform([-120, -90, 300], [120, 90, 400], (40, 3))
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, D)[0].reshape(-1, 2)
    back = jax.tree.map(jnp.asarray, read_camera(path))
    np.testing.assert_allclose(jax.jit(jax.vmap(back.project))(jnp.asarray(points)), expected, atol=1e-9)


def _by_opencv(path: Path) -> tuple[np.ndarray, np.ndarray]:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.getNode("image_width").real() == 640
    return storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()


def _by_yaml(path: Path) -> tuple[np.ndarray, np.ndarray]:
    values = yaml.safe_load(path.read_text())
    P = np.reshape(values["projection_matrix"]["data"], (3, 4))
    np.testing.assert_array_equal(P[:, :3], np.reshape(values["camera_matrix"]["data"], (3, 3)))
    assert (
        values["distortion_model"]
        == {5: "plumb_bob", 8: "rational_polynomial"}[len(values["distortion_coefficients"]["data"])]
    )
    return P[:, :3].copy(), np.array(values["distortion_coefficients"]["data"])


def _by_scipy(path: Path) -> tuple[np.ndarray, np.ndarray]:
    values = scipy.io.loadmat(path)
    assert values["fc"].shape == values["cc"].shape == (2, 1)
    assert values["kc"].shape == (5, 1)
    np.testing.assert_allclose(values["KK"] @ values["inv_KK"], np.eye(3), atol=1e-12)
    return values["KK"], values["kc"]


def _by_python(path: Path) -> tuple[np.ndarray, np.ndarray]:
    text = path.read_text()
    assert text.index("'lensmodel'") < text.index("'intrinsics'")  # mrcal's parser in C asks for this order
    f_u, f_v, u0, v0, *terms = ast.literal_eval(text)["intrinsics"]
    return np.array([[f_u, 0, u0], [0, f_v, v0], [0, 0, 1]]), np.array(terms or [0.0] * 4)


OTHER_READERS = {"opencv": _by_opencv, "ros": _by_yaml, "bouguet": _by_scipy, "mrcal": _by_python}


@pytest.mark.parametrize("name", [*samples.TEXTS, "Calib_Results.mat"])
def test_files_as_the_programs_write_them(tmp_path, name):
    path = tmp_path / name
    if name in samples.TEXTS:
        path.write_text(samples.TEXTS[name])
    else:
        samples.bouguet(path)
    found = read_camera(path)
    k3 = 0.0 if name == "kalibr.yaml" else samples.TERMS[4]
    assert (found.image_size, found.lens.kind) == (samples.SIZE, "brown")
    assert numbers(found) == [*samples.PINHOLE, *samples.TERMS[:2], k3, *samples.TERMS[2:4]]


def test_a_term_that_is_zero_was_not_estimated(tmp_path):
    """Bouguet's est_dist = [1 1 0 0 0] leaves zeros in kc, OpenCV's flags in its coefficients: the lens is radial2."""
    assert (
        read_camera(samples.bouguet(tmp_path / "a.mat", kc=np.array([[-0.2, 0.1, 0, 0, 0]]).T)).lens.kind == "radial2"
    )
    assert read_camera(samples.bouguet(tmp_path / "a.mat", kc=np.array([[-0.2, 0.1, 0, 0]]).T)).lens.kind == "radial2"
    assert read_camera(samples.bouguet(tmp_path / "a.mat", kc=np.array([[-0.2, 0, 0, 1e-4, 0]]).T)).lens.kind == "brown"


def test_poses_corners_and_deviations_of_the_toolbox(tmp_path):
    path = samples.bouguet(tmp_path / "Calib_Results.mat")
    raw = scipy.io.loadmat(path)
    content = read_camera_file(path)
    assert content.sigma["camera.focal.1"] == 1.8 / 3
    assert content.sigma["camera.tangential.0"] == 0.003 / 3
    assert "camera.radial.2" not in content.sigma  # its error is zero: it was held
    assert [view.name for view in content.views] == ["image 1", "image 3"]
    for i, view in zip((1, 3), content.views, strict=True):
        np.testing.assert_array_equal(view.pixels, raw[f"x_{i}"].T)
        np.testing.assert_array_equal(view.points, raw[f"X_{i}"].T)
        np.testing.assert_array_equal(view.pose, [*raw[f"omc_{i}"].ravel(), *raw[f"Tc_{i}"].ravel()])
        np.testing.assert_array_equal(3 * view.pose_sigma[3:], raw[f"Tc_error_{i}"].ravel())
    write_camera_file(tmp_path / "again.mat", content)
    again = scipy.io.loadmat(tmp_path / "again.mat")
    for ours, theirs in ((1, 1), (2, 3)):
        for name in ("X", "x", "omc", "Tc"):
            np.testing.assert_array_equal(again[f"{name}_{ours}"], raw[f"{name}_{theirs}"])
        np.testing.assert_allclose(again[f"omc_error_{ours}"], raw[f"omc_error_{theirs}"], rtol=3e-16)
    for name in ("fc", "cc", "kc", "KK", "nx", "ny"):
        np.testing.assert_array_equal(again[name], raw[name])
    np.testing.assert_allclose(again["fc_error"], raw["fc_error"], rtol=3e-16)
    assert lost(content, "bouguet") == []
    assert lost(content, "ros") == ["the standard deviations", "2 photographs of the board"]


@pytest.mark.parametrize("deflated", [False, True])
def test_matlab_files_by_another_writer(tmp_path, deflated):
    """Matlab stores whole numbers in the smallest type that holds them."""
    path = tmp_path / "a.mat"
    variables: dict[str, Any] = {
        "fc": np.array([[700], [699]], np.uint16),
        "cc": np.array([[320.5], [239.25]], np.float32),
        "kc": np.zeros((5, 1), np.int8),
        "nx": np.uint16(640),
        "ny": np.int32(480),
        "calib_name": "left",
        "I_1": np.zeros((480, 640), np.uint8),
        "more": {"a": [1, 2]},
        "z": np.array([[1j]]),
    }
    scipy.io.savemat(path, variables, do_compression=deflated)
    found = read_camera(path)
    assert (found.lens.kind, numbers(found)) == ("none", [700.0, 699.0, 320.5, 239.25])


def test_corners_without_a_camera(tmp_path):
    intrinsics = dict.fromkeys(("fc", "cc", "kc", "alpha_c", "KK", "fc_error", "cc_error", "kc_error"))
    poses = {name: None for i in (1, 2, 3) for name in (f"omc_{i}", f"Tc_{i}", f"omc_error_{i}", f"Tc_error_{i}")}
    path = samples.bouguet(tmp_path / "calib_data.mat", **intrinsics, **poses)
    content = read_camera_file(path)
    assert (content.camera, content.image_size, len(content.views)) == (None, (640, 480), 2)
    assert np.isnan(content.views[0].pose).all()
    with pytest.raises(InputError, match=r"corners of photographs and no camera: name Calib_Results\.mat"):
        read_camera(path)
    write_camera_file(tmp_path / "again.mat", content)
    assert "fc" not in scipy.io.loadmat(tmp_path / "again.mat")
    for form in ("rig", "opencv", "ros", "kalibr", "mrcal"):
        with pytest.raises(InputError, match="no camera"):
            write_camera_file(tmp_path / f"a{FORMATS[form].endings[0]}", content, format=form)


def test_one_camera_of_a_camchain(tmp_path):
    path = tmp_path / "camchain.yaml"
    cam1 = samples.KALIBR.replace("cam0:", "cam1:").replace("532.795", "540.5")
    path.write_text(samples.KALIBR + cam1 + "  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, -0.11]\n")
    assert float(read_camera(path, name="cam0").focal[0]) == 532.795
    with pytest.warns(PassedOverWarning, match=r"passed over cam1\.T_cn_cnm1"):
        assert float(read_camera(path, name="cam1").focal[0]) == 540.5
    with pytest.raises(InputError, match="the cameras cam0, cam1: give the name of one"):
        read_camera(path)
    with pytest.raises(InputError, match='no camera "cam7", but cam0, cam1'):
        read_camera(path, name="cam7")
    path.write_text(samples.ROS)
    with pytest.raises(InputError, match='leave out the name "cam0"'):
        read_camera(path, name="cam0")


def test_what_is_passed_over_is_said(tmp_path):
    (tmp_path / "a.cameramodel").write_text(
        samples.MRCAL.replace("[ 0, 0, 0,", "[ 0, 0.1, 0,").replace("}", "'optimization_inputs': b'abc'}")
    )
    with pytest.warns(PassedOverWarning, match="passed over extrinsics, optimization_inputs"):
        read_camera(tmp_path / "a.cameramodel")
    (tmp_path / "a.yaml").write_text(
        samples.ROS.replace("233.3, 0,", "233.3, -12.5,").replace("341.2, 0, 0", "341.2, -40.1, 0")
    )
    with pytest.warns(PassedOverWarning, match="passed over projection_matrix"):
        read_camera(tmp_path / "a.yaml")


@pytest.mark.parametrize(
    ("k_name", "d_name"),
    [
        ("cameraMatrix", "distCoeffs"),
        ("Camera_Matrix", "Distortion_Coefficients"),
        ("K", "D"),
        ("camera_matrix", "dist_coeff"),
    ],
)
@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_opencvs_names_and_numbers_of_coefficients(tmp_path, k_name, d_name, count):
    terms = [*samples.TERMS, 0.01, 0.002, 0.0003, *[0.0] * 6][:count]
    storage = cv2.FileStorage(str(tmp_path / "a.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write(k_name, np.reshape(samples.K, (3, 3)))
    storage.write(d_name, np.array([terms]))
    storage.release()
    found = read_camera(tmp_path / "a.yml", image_size=(640, 480))
    assert found.lens.kind == ("brown" if count < 8 else "rational")
    assert opencv_terms(found)[: min(count, 8)] == terms[:8]
    with pytest.raises(InputError, match="image_width: is missing"):
        read_camera(tmp_path / "a.yml")


@pytest.mark.parametrize(
    ("form", "name"), [("opencv", "a.yml"), ("opencv", "a.xml"), ("ros", "a.yaml"), ("kalibr", "b.yaml")]
)
def test_a_fisheye_comes_back(tmp_path, form, name):
    with float64():
        own = Camera.create((640, 480), [322.1, 318.3], [312.3, 244.8], "fisheye", [-0.031, 0.012, 0.0, 1e-3 / 3])
        written = as_numpy(own)
    write_camera(tmp_path / name, written, format=form)
    found = read_camera(tmp_path / name)
    assert jax.tree.structure(found) == jax.tree.structure(written)
    assert jax.tree.leaves(found) == jax.tree.leaves(written)


def test_a_fisheye_is_refused_where_there_is_none(tmp_path):
    own = as_numpy(Camera.create((640, 480), [322.0, 318.0], [312.0, 244.0], "fisheye"))
    for name in ("a.mat", "a.cameramodel"):
        with pytest.raises(InputError, match='the lens "fisheye" has no counterpart'):
            write_camera(tmp_path / name, own)


@pytest.mark.parametrize("lens", ["radial1", "rational"])
@pytest.mark.parametrize("ending", ["yml", "xml"])
def test_a_tilted_sensor_is_opencvs(tmp_path, lens, ending):
    flat = camera(lens)
    tilt = (np.array(0.1745), np.array(-0.0512))
    tilted = Camera(flat.focal, flat.principal, flat.lens, flat.image_size, tilt)
    write_camera(tmp_path / f"a.{ending}", tilted, format="opencv")
    found = read_camera(tmp_path / f"a.{ending}")
    assert jax.tree.structure(found) == jax.tree.structure(tilted)
    assert jax.tree.leaves(found) == jax.tree.leaves(tilted)
    storage = cv2.FileStorage(str(tmp_path / f"a.{ending}"), cv2.FILE_STORAGE_READ)
    k = storage.getNode("distortion_coefficients").mat().ravel()
    np.testing.assert_array_equal(k[8:], [0, 0, 0, 0, 0.1745, -0.0512])
    for form in set(FORMATS) - {"rig", "opencv"}:
        name = "a.mat" if form == "bouguet" else "a.cameramodel" if form == "mrcal" else "a.yaml"
        if form != "kalibr":
            with pytest.raises(InputError, match=r"tilted by 0\.1745 and -0\.0512 rad, which has no counterpart"):
                write_camera(tmp_path / name, tilted, format=form)


def test_formats_are_known_by_ending_and_refused_by_name(tmp_path):
    flat = camera("none")
    with pytest.raises(InputError, match=r"a\.yaml: several formats .* give the format, opencv or ros or kalibr"):
        write_camera(tmp_path / "a.yaml", flat)
    with pytest.raises(InputError, match='no format "colmap": use one of rig, bouguet'):
        write_camera(tmp_path / "a.yaml", flat, format="colmap")
    with pytest.raises(InputError, match=r'no format of cameras is known by the ending "\.txt"'):
        write_camera(tmp_path / "a.txt", flat)
    with pytest.raises(InputError, match=r"end the name in \.mat"):
        write_camera(tmp_path / "a.yaml", flat, format="bouguet")
    assert list(tmp_path.iterdir()) == []
