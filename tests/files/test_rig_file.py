"""Rig files: exact round trips, and everything that a reader must refuse."""

import copy
import json
import math
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.files.table import PassedOverWarning
from jaxscan.rig import Camera, Covariance, LightPlane, Rig, Stage
from jaxscan.rig.rig import parameter_names

# The example of the format's description, with numbers that no float32 holds.
GOOD: dict[str, Any] = {
    "format": "jaxscan-rig/1",
    "units": "mm",
    "camera": {
        "image_size": [640, 480],
        "focal": [697.70833123456789, 690.43328],
        "principal": [310.29604, 228.14934],
        "lens": "radial1",
        "radial": [-0.13396],
        "tangential": [],
    },
    "laser": {"plane": [0.0, -0.00494, 0.00303]},
    "stage": {"per_step": [0.00003, 0.00092, -0.00039]},
    "covariance": {"parameters": ["camera.focal.0", "laser.plane.2"], "matrix": [[0.25, 1e-7], [1e-7, 1e-12]]},
    "fit": {"corner_rms_px": 0.08, "stripe_rms_px": 0.11, "views": 12},
}


def written(folder: Path, **changes: Any) -> Path:
    """A good rig file with some of its keys, by dotted name, changed; None takes a key out."""
    values = copy.deepcopy(GOOD)
    for name, value in changes.items():
        *tables, key = name.split("__")
        inner = values
        for table in tables:
            inner = inner[table]
        if value is None:
            del inner[key]
        else:
            inner[key] = value
    path = folder / "rig.json"
    path.write_text(json.dumps(values))
    return path


def numpy_rig(camera: Camera, lasers: tuple[LightPlane, ...] = (), stage: Stage | None = None) -> Rig:
    rng = np.random.default_rng(5)
    # A relative change of 1e-10 gives every leaf digits that float32 would lose.
    return jax.tree.map(lambda x: np.asarray(float(x) * (1 + 1e-10 * rng.random())), Rig(camera, lasers, stage))


@pytest.mark.parametrize(
    ("lens", "radial", "tangential"),
    [
        ("none", [], []),
        ("radial1", [-0.13], []),
        ("radial2", [-0.13, 0.02], []),
        ("radial3", [-0.13, 0.02, -0.001], []),
        ("brown", [-0.13, 0.02, -0.001], [1e-4, -2e-4]),
        ("rational", [0.1, 0.02, -0.001, 0.2, 0.03, 1e-3], [1e-4, -2e-4]),
    ],
)
@pytest.mark.parametrize("x64", [False, True])
def test_every_bit_survives_the_file_whatever_the_precision_of_the_caller(tmp_path, lens, radial, tangential, x64):
    camera = Camera.create((640, 480), (697.7, 690.4), (310.3, 228.1), lens, radial, tangential)
    names = ("left", "right")
    lasers = tuple(
        LightPlane.create(w, name) for w, name in zip(([0.0, -0.005, 0.003], [0.1, 0.0, 0.01]), names, strict=True)
    )
    rig = numpy_rig(camera, lasers, Stage.create([3e-5, 9e-4, -4e-4]))
    n = len(parameter_names(rig))
    root = np.random.default_rng(0).normal(size=(n, n))
    content = RigFile(
        rig, Covariance(tuple(parameter_names(rig)), root @ root.T), {"corner_rms_px": 1 / 3, "views": 12}
    )
    with jax.enable_x64(x64):
        write_rig(tmp_path / "rig.json", content)
        back = read_rig(tmp_path / "rig.json")
    assert jax.tree.structure(back.rig) == jax.tree.structure(rig)
    for leaf, original in zip(jax.tree.leaves(back.rig), jax.tree.leaves(rig), strict=True):
        assert isinstance(leaf, np.ndarray)
        assert leaf.dtype == np.float64
        assert leaf == original
    assert back.covariance is not None
    assert back.covariance.names == content.covariance.names
    np.testing.assert_array_equal(back.covariance.matrix, content.covariance.matrix)
    assert back.fit == content.fit


def test_the_format_is_the_documented_one(tmp_path):
    content = read_rig(written(tmp_path))
    write_rig(tmp_path / "again.json", content)
    assert json.loads((tmp_path / "again.json").read_text()) == GOOD


def test_a_rig_without_laser_and_stage_leaves_the_keys_out(tmp_path):
    path = written(tmp_path, laser=None, stage=None, covariance=None, fit=None)
    content = read_rig(path)
    assert content.rig.lasers == ()
    assert content.rig.stage is None
    assert content.covariance is None
    write_rig(path, content)
    assert set(json.loads(path.read_text())) == {"format", "units", "camera"}


def test_a_single_named_laser_keeps_its_name(tmp_path):
    content = read_rig(written(tmp_path, laser=[{"name": "left", "plane": [0.0, -0.005, 0.003]}], covariance=None))
    write_rig(tmp_path / "again.json", content)
    assert [laser.name for laser in read_rig(tmp_path / "again.json").rig.lasers] == ["left"]


def test_standard_deviations_by_name(tmp_path):
    covariance = read_rig(written(tmp_path)).covariance
    assert covariance is not None
    assert covariance.sigma("camera.focal.0") == 0.5
    assert covariance.sigma("stage.per_step.0") is None


def test_the_real_rig(data):
    rig = read_rig(data / "stage-pyramid" / "rig.json").rig
    assert rig.camera.lens == "none"
    assert [float(x) for x in rig.lasers[0].plane] == [-0.0268097, 0.0, 0.0125]


def test_unknown_keys_are_said_and_passed_over(tmp_path):
    path = written(tmp_path, colour={"a": 1}, camera__serial="x", stage__axis=1)
    with pytest.warns(PassedOverWarning, match=r"rig\.json.*colour, camera\.serial, stage\.axis"):
        content = read_rig(path)
    assert content.rig.camera.image_size == (640, 480)


BAD = {
    "another format": ({"format": "jaxscan-rig/2"}, ['format = "jaxscan-rig/2"', "jaxscan-rig/1"]),
    "no format": ({"format": None}, ["format", "missing"]),
    "inches": ({"units": "inch"}, ['units = "inch"', '"mm"']),
    "no camera": ({"camera": None}, ["camera", "missing"]),
    "camera is null": ({"camera": [None]}, ["camera", "must be a table"]),
    "null focal": ({"camera__focal": [None, 1.0]}, ["camera.focal", "entry 0 is null"]),
    "text focal": ({"camera__focal": ["697", 1.0]}, ["camera.focal", 'entry 0 is "697"']),
    "true focal": ({"camera__focal": [True, 1.0]}, ["camera.focal", "entry 0 is true"]),
    "three focals": ({"camera__focal": [1.0, 1.0, 1.0]}, ["camera.focal", "must hold 2 numbers, it holds 3"]),
    "zero focal": ({"camera__focal": [0.0, 690.0]}, ["camera.focal", "positive"]),
    "negative focal": ({"camera__focal": [690.0, -690.0]}, ["camera.focal", "positive"]),
    "endless focal": ({"camera__focal": [10**400, 690.0]}, ["camera.focal", "finite"]),
    "NaN principal": ({"camera__principal": [math.nan, 1.0]}, ["camera.principal.0 is nan", "finite"]),
    "infinite plane": ({"laser__plane": [0.0, math.inf, 1.0]}, ["laser.plane.1 is inf"]),
    "NaN in the fit": ({"fit": {"rms": {"a": [1.0, math.nan]}}}, ["fit.rms.a.1 is nan"]),
    "stripe error as text": ({"fit": {"stripe_sigma_px": "x"}}, ["fit.stripe_sigma_px", "finite number"]),
    "negative stripe error": ({"fit": {"stripe_rms_px": -1.0}}, ["fit.stripe_rms_px", "not negative"]),
    "a number of no rig": ({"stage__per_step": [1e300, 0.0, 0.0]}, ["stage.per_step.0 is 1e+300", "larger"]),
    "NaN in an unknown key": ({"more": {"a": math.nan}}, ["more.a is nan"]),
    "unknown lens": ({"camera__lens": "fisheye"}, ['camera.lens = "fisheye"', "radial1"]),
    "a term too many": ({"camera__radial": [0.1, 0.2]}, ["camera.radial", '"radial1" has 1', "here are 2"]),
    "a term too few": ({"camera__radial": []}, ["camera.radial", "here are 0"]),
    "tangential of none": ({"camera__tangential": [0.1, 0.2]}, ["camera.tangential", "has 0"]),
    "size of one": ({"camera__image_size": [640]}, ["camera.image_size = [640]", "columns, rows"]),
    "size with fraction": ({"camera__image_size": [640.0, 480]}, ["camera.image_size", "write 640"]),
    "empty size": ({"camera__image_size": [0, 480]}, ["camera.image_size", "positive"]),
    "plane of two": ({"laser__plane": [0.1, 0.2]}, ["laser.plane", "3 numbers"]),
    "no plane": ({"laser": {}}, ["laser.plane", "missing"]),
    "plane of zeros": ({"laser__plane": [0.0, 0.0, 0.0]}, ["laser.plane", "no pixel sees"]),
    "plane behind": ({"laser__plane": [0.0, 0.00494, -0.1]}, ["laser.plane", "no pixel sees"]),
    "plane through the camera": ({"laser__plane": [1e9, 0.0, 1.0]}, ["laser.plane", "through the camera"]),
    "laser is a number": ({"laser": 3}, ["laser = 3", "list"]),
    "laser list of numbers": ({"laser": [3]}, ["laser", "entry 0"]),
    "lasers of one name": (
        {"laser": [{"name": "a", "plane": [0, 0, 0.01]}, {"name": "a", "plane": [0, 0, 0.02]}]},
        ["laser", '"name" of its own'],
    ),
    "stage that stands": ({"stage__per_step": [0.0, 0.0, 0.0]}, ["stage.per_step", "does not move"]),
    "stage without steps": ({"stage": {}}, ["stage.per_step", "missing"]),
    "covariance of another": (
        {"covariance__parameters": ["camera.focal.0", "camera.radial.1"]},
        ["covariance.parameters", '"camera.radial.1"'],
    ),
    "a name twice": ({"covariance__parameters": ["camera.focal.0"] * 2}, ["covariance.parameters", "twice"]),
    "names that are lists": ({"covariance__parameters": [["a"], {}]}, ["covariance.parameters", '["a"]']),
    "not square": ({"covariance__matrix": [[1.0, 0.0]]}, ["covariance.matrix", "2 rows of 2"]),
    "ragged": ({"covariance__matrix": [[1.0, 0.0], [1.0]]}, ["covariance.matrix", "2 rows of 2"]),
    "text in it": ({"covariance__matrix": [[1.0, 0.0], [1.0, "x"]]}, ["covariance.matrix.1", 'entry 1 is "x"']),
    "not symmetric": ({"covariance__matrix": [[1.0, 0.5], [0.4, 1.0]]}, ["covariance.matrix", "not symmetric"]),
    "not positive": ({"covariance__matrix": [[1.0, 2.0], [2.0, 1.0]]}, ["covariance.matrix", "semidefinite"]),
    "negative variance": ({"covariance__matrix": [[-1.0, 0.0], [0.0, 1.0]]}, ["covariance.matrix", "semidefinite"]),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_rigs_are_refused_with_file_key_and_mend(tmp_path, name):
    changes, texts = BAD[name]
    with pytest.raises(InputError) as caught:
        read_rig(written(tmp_path, **changes))
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'rig.json'}: ")
    for text in texts:
        assert text in message


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "is empty"),
        (b"  \n", "is empty"),
        (b"{", "not valid JSON.*line 1"),
        (b'{"format": "jaxscan-rig/1",\n "units" "mm"}', "not valid JSON.*line 2"),
        (b"[1, 2]", "an object in braces"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "is not text"),
        (b"[" * 100_000, "nested too deeply"),
        (b'{"format": 1' + b"0" * 5000 + b"}", "not valid JSON"),
        (b'{"units": "mm", "units": "mm"}', '"units" stands twice'),
    ],
)
def test_what_is_no_rig_at_all(tmp_path, content, text):
    path = tmp_path / "rig.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=f"(?s)rig.json: .*{text}"):
        read_rig(path)


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_rig(tmp_path / "none.json")
    with pytest.raises(InputError, match="is a folder"):
        read_rig(tmp_path)


def test_deeply_nested_fit_is_read_or_refused(tmp_path):
    deep: Any = 1.0
    for _ in range(400):
        deep = [deep]
    assert read_rig(written(tmp_path, fit={"deep": deep})).fit["deep"]


@pytest.mark.parametrize("depth_sign", [1, -1])
def test_a_sheet_seen_at_the_border_alone(tmp_path, depth_sign):
    # ω · x = 0.01 x ± …: zero on the optical axis side, positive only for x beyond 0.3, and the image reaches 0.47.
    rig = written(tmp_path, laser__plane=[0.01 * depth_sign, 0.0, -0.003], covariance=None)
    assert read_rig(rig).rig.lasers
    with pytest.raises(InputError, match="no pixel sees"):
        read_rig(written(tmp_path, laser__plane=[0.01 * depth_sign, 0.0, -0.008], covariance=None))


def test_nothing_unsound_is_written_and_the_old_file_stays(tmp_path):
    path = written(tmp_path)
    good = read_rig(path)
    before = path.read_bytes()
    matrix = np.array([[1.0, 2.0], [2.0, 1.0]])
    with pytest.raises(InputError, match="semidefinite"):
        write_rig(path, RigFile(good.rig, Covariance(("camera.focal.0", "camera.focal.1"), matrix)))
    broken = jax.tree.map(lambda leaf: leaf * np.nan, good.rig)
    with pytest.raises(InputError, match="is nan"):
        write_rig(path, RigFile(broken))
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["rig.json"]
