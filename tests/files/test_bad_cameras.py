"""What readers of other programs' cameras refuse: the text names the file, the key and the fix, whatever the bytes."""

import warnings
from pathlib import Path

import foreign_samples as samples
import numpy as np
import pytest
import scipy.io

from jaxscan import read_camera
from jaxscan.errors import InputError
from jaxscan.files.table import PassedOverWarning

# A file, what to replace in it by what, and what the error says.
BAD = {
    "opencv, no matrix": ("opencv.yml", "camera_matrix:", "other:", ["camera_matrix", "is missing"]),
    "opencv, no coefficients": ("opencv.yml", "distortion_coefficients:", "x:", ["distortion_coefficients", "missing"]),
    "opencv, NaN": ("opencv.yml", "5.32795e+02", ".Nan", ["camera_matrix.data", "entry 0 is", "finite"]),
    "opencv, negative focal": ("opencv.yml", "5.32919e+02", "-5.32919e+02", ["camera_matrix", "positive"]),
    "opencv, zero focal": ("opencv.yml", "5.32919e+02", "0.", ["camera_matrix", "positive"]),
    "opencv, skew": ("opencv.yml", "5.32795e+02, 0.,", "5.32795e+02, 0.5,", ["camera_matrix", "skew 0.5"]),
    "opencv, no camera matrix": ("opencv.yml", "0., 0., 1. ]", "0., 0., 2. ]", ["is no camera matrix"]),
    "opencv, size": ("opencv.yml", "rows: 3\n   cols: 3", "rows: 3\n   cols: 4", ["camera_matrix.data", "rows × cols"]),
    "opencv, a number": ("opencv.yml", "camera_matrix: !!", "camera_matrix: 3\nx: !!", ["camera_matrix = 3", "a list"]),
    "opencv, no table": ("opencv.yml", "!!opencv-matrix\n", "!!opencv-matrix 3\nx:\n", ["not valid YAML", "line"]),
    "opencv, a text": ("opencv.yml", "image_width: 640", 'image_width: "wide"', ["image_width", "finite number"]),
    "opencv, half a pixel": ("opencv.yml", "image_width: 640", "image_width: 640.5", ["whole and positive"]),
    "opencv, cut off": ("opencv.yml", "1.634e-01 ]", "", ["not valid YAML", "line"]),
    "opencv, xml cut off": ("opencv.xml", "</opencv_storage>", "", ["not valid OpenCV FileStorage", "line"]),
    "opencv, other xml": ("opencv.xml", "opencv_storage>", "svg>", ["not valid OpenCV FileStorage"]),
    "opencv, xml text": ("opencv.xml", "342.458", "wide", ["Camera_Matrix.data", 'entry 2 is "wide"']),
    "opencv, xml size": ("opencv.xml", "<image_Width>640", "<image_Width>", ["image_Width", "finite number"]),
    "opencv, fisheye": ("opencv.yml", "flags: 0", "fisheye_model: 1", ["a fisheye has 4", "here are 5"]),
    "opencv, six": ("opencv.yml", "1.634e-01 ]", "1.634e-01, 1. ]", ["distortion_coefficients.data", "it holds 6"]),
    "ros, fisheye": ("ros.yaml", "plumb_bob", "equidistant", ["a fisheye has 4", "here are 5"]),
    "ros, a list": ("ros.yaml", "plumb_bob", "[1]", ["distortion_model = [1]", "no such lens"]),
    "ros, six coefficients": ("ros.yaml", "cols: 5\n  data: [", "cols: 6\n  data: [1, ", ["coefficients, it holds 6"]),
    "ros, rational of five": ("ros.yaml", "plumb_bob", "rational_polynomial", ["8 or 12 or 14", "holds 5"]),
    "ros, uncalibrated": ("ros.yaml", samples.ROS_K, "[0,0,0,0,0,0,0,0,0]", ["no camera matrix"]),
    "ros, eight numbers": ("ros.yaml", "[532.795, 0,", "[532.795,", ["camera_matrix.data", "rows × cols"]),
    "ros, no width": ("ros.yaml", "image_width: 640\n", "", ["image_width", "missing"]),
    "ros, width 0": ("ros.yaml", "image_width: 640", "image_width: 0", ["whole and positive"]),
    "ros, NaN": ("ros.yaml", "342.458", ".nan", ["camera_matrix.data", "entry 2 is NaN"]),
    "ros, text": ("ros.yaml", "342.458", "wide", ["camera_matrix.data", 'entry 2 is "wide"']),
    "ros, binned": ("message.yaml", "binning_x: 0", "binning_x: 2", ["binning_x = 2", "without binning"]),
    "ros, region": ("message.yaml", "width: 0", "width: 320", ["roi.width = 320", "without a region"]),
    "ros, two messages": ("message.yaml", "---\n", "---\n" + samples.ROS_MESSAGE, ["2 documents"]),
    "ros, twice": ("ros.yaml", "image_height: 480", "image_width: 480", ["not valid YAML", "twice"]),
    "ros, references": ("ros.yaml", "camera_name: narrow_stereo", "a: &a [1]\nb: [*a, *a]", ["refers back"]),
    "ros, no yaml": ("ros.yaml", "[532.795", "[[532.795", ["not valid YAML", "line"]),
    "kalibr, omni": ("kalibr.yaml", "pinhole", "omni", ['cam0.camera_model = "omni"', "no such camera"]),
    "kalibr, fov": ("kalibr.yaml", "radtan", "fov", ['"fov"', "no such lens"]),
    "kalibr, three": ("kalibr.yaml", ", -0.000135]", "]", ["cam0.distortion_coeffs", "4 numbers"]),
    "kalibr, no resolution": ("kalibr.yaml", "  resolution: [640, 480]\n", "", ["cam0.resolution", "missing"]),
    "kalibr, negative": ("kalibr.yaml", "[532.795", "[-532.795", ["cam0.intrinsics", "positive"]),
    "mrcal, splines": ("mrcal.cameramodel", "OPENCV5", "SPLINED_STEREOGRAPHIC", ["SPLINED", "no such lens"]),
    "mrcal, cahvor": ("mrcal.cameramodel", "OPENCV5", "CAHVOR", ['lensmodel = "LENSMODEL_CAHVOR"', "OPENCV8"]),
    "mrcal, twelve": ("mrcal.cameramodel", "OPENCV5", "OPENCV12", ["LENSMODEL_OPENCV12", "no such lens"]),
    "mrcal, one less": ("mrcal.cameramodel", "OPENCV5", "OPENCV8", ["intrinsics", "must hold 12 numbers, it holds 9"]),
    "mrcal, no model": ("mrcal.cameramodel", "'lensmodel'", "'x'", ["lensmodel", "missing"]),
    "mrcal, code": ("mrcal.cameramodel", "532.795", "__import__('os').getpid()", ["not valid mrcal camera model"]),
    "mrcal, no braces": ("mrcal.cameramodel", "{", "[", ["not valid mrcal camera model"]),
    "mrcal, size": ("mrcal.cameramodel", "[ 640, 480,]", "[ 640, 480, 3]", ["imagersize", "2 numbers"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_refused_with_file_key_and_mend(tmp_path, case):
    name, old, new, texts = BAD[case]
    assert old in samples.TEXTS[name]
    path = tmp_path / name
    path.write_text(samples.TEXTS[name].replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_camera(path)
    assert str(caught.value).startswith(f"{path}: ")
    for text in texts:
        assert text in str(caught.value)


def test_a_damaged_type_of_numbers_does_not_crash(tmp_path):
    """The one byte that makes SciPy's reader read where there is nothing."""
    path = samples.bouguet(tmp_path / "a.mat")
    data = bytearray(path.read_bytes())
    at = data.index(b"fc\0\0") + 4
    assert data[at] == 9  # double
    data[at] = 200
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match=r"a\.mat: is damaged \(fc holds numbers of the type 200"):
        read_camera(path)


def test_opencvs_terms_beyond_k6_are_named(tmp_path):
    path = tmp_path / "a.yml"
    more = "1.634e-01, 0., 0., 0., 0., 0., 0.001, 0. ]"
    path.write_text(samples.OPENCV.replace("rows: 5", "rows: 12").replace("1.634e-01 ]", more))
    with pytest.raises(InputError, match=r"the lens term s3 = 0\.001 has no counterpart"):
        read_camera(path)


BAD_MAT = {
    "skew": ({"alpha_c": 0.01}, ["alpha_c", "skew 0.01", "no counterpart"]),
    "no fc": ({"fc": None}, ["fc", "is missing"]),
    "no kc": ({"kc": None}, ["kc", "is missing"]),
    "NaN": ({"fc": np.array([[np.nan], [1.0]])}, ["fc", "entry 0 is NaN"]),
    "negative": ({"fc": np.array([[-500.0], [500.0]])}, ["fc", "positive"]),
    "three": ({"cc": np.array([[1.0], [2.0], [3.0]])}, ["cc", "2 numbers, it holds 3"]),
    "six": ({"kc": np.zeros((6, 1))}, ["kc", "4 or 5 coefficients"]),
    "text": ({"fc": "wide"}, ["fc is not a matrix of real numbers"]),
    "complex": ({"cc": np.array([[1j], [2.0]])}, ["cc is not a matrix of real numbers"]),
    "half a pixel": ({"nx": 640.5}, ["nx", "whole and positive"]),
    "no size": ({"nx": None}, ["nx", "missing", "image size"]),
    "corners and points": ({"X_1": np.zeros((3, 5))}, ["x_1 has 54 corners, X_1 has 5"]),
    "rows": ({"x_3": np.zeros((3, 54))}, ["x_3 has the shape (3, 54)"]),
    "pose": ({"omc_1": np.zeros((3, 3))}, ["omc_1 holds 9 numbers"]),
}


@pytest.mark.parametrize("case", BAD_MAT)
def test_bad_mat_files(tmp_path, case):
    changes, texts = BAD_MAT[case]
    path = samples.bouguet(tmp_path / "Calib_Results.mat", **changes)
    with pytest.raises(InputError) as caught:
        read_camera(path)
    assert str(caught.value).startswith(f"{path}: ")
    for text in texts:
        assert text in str(caught.value)


def test_mat_files_of_other_programs(tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"cameraParams": {"K": np.eye(3)}, "T": np.eye(4)})
    with pytest.raises(InputError, match=r"a\.mat: has neither fc, cc and kc, .* check which program wrote it"):
        read_camera(path)
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + b"\x89HDF\r\n\x1a\n" * 9)
    with pytest.raises(InputError, match=r"version 7\.3: save it with -v7 or -v6"):
        read_camera(path)
    path.write_text("# Created by Octave 8.4\n# name: fc\n# type: matrix\n")
    with pytest.raises(InputError, match=r"is no Matlab file of version 5 to 7: save it in Matlab or Octave with -v7"):
        read_camera(path)


@pytest.mark.parametrize("name", ["a.mat", "a.yml", "a.yaml", "a.xml", "a.cameramodel", "a.json"])
@pytest.mark.parametrize(
    "content", [b"", b"\n", b"\xff\xfe\x00\x01", b"hello", b"{", b"[1, 2]", b"<a>", b"%YAML:1.0\n---\n"]
)
def test_what_is_no_camera_at_all(tmp_path, name, content):
    path = tmp_path / name
    with pytest.raises(InputError, match="no such file"):
        read_camera(path)
    path.write_bytes(content)
    with pytest.raises(InputError, match=name):
        read_camera(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError, match="is a folder"):
        read_camera(path)


@pytest.mark.parametrize("target", ["a.mat", "a.cameramodel", "a.json"])
def test_one_format_under_the_ending_of_another(tmp_path, target):
    path = tmp_path / target
    for name, text in samples.TEXTS.items():
        if Path(name).suffix != path.suffix:
            path.write_text(text)
            with pytest.raises(InputError, match=target):
                read_camera(path)
    path.write_bytes(samples.bouguet(tmp_path / "good.mat").read_bytes())
    if target != "a.mat":
        with pytest.raises(InputError, match=f"{target}: is not text"):
            read_camera(path)


@pytest.mark.parametrize("name", [*samples.TEXTS, "Calib_Results.mat"])
def test_damaged_files_are_read_or_refused(tmp_path, name):
    """Cut off, and with some of their bytes others: what is read is a camera, all else an error that names the file."""
    path = tmp_path / name
    binary = name not in samples.TEXTS
    data = samples.bouguet(path).read_bytes() if binary else samples.TEXTS[name].encode()
    rng = np.random.default_rng(0)
    outcomes = []
    for i in range(300):
        damaged = bytearray(data[: rng.integers(len(data))] if i % 5 == 0 else data)
        for at in rng.integers(len(damaged), size=1 + i % 3) if len(damaged) else ():
            damaged[at] = rng.integers(256) if binary else rng.integers(32, 127)
        path.write_bytes(bytes(damaged))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PassedOverWarning)
            outcomes.append(_outcome(path))
    assert {outcome.split(":")[0] for outcome in outcomes} == {"a camera", str(path)}


def _outcome(path: Path) -> str:
    try:
        camera = read_camera(path)
    except InputError as error:
        return str(error)
    numbers = [float(leaf) for leaf in (*camera.focal, *camera.principal, *camera.lens.radial, *camera.lens.tangential)]
    return "a camera" if np.isfinite(numbers).all() and min(numbers[:2]) > 0 else f"no camera: {numbers}"
