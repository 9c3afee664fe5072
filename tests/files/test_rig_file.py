"""Rig files of both formats: exact round trips, and everything that a reader must refuse."""

import copy
import json
import math
import re
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.files.table import PassedOverWarning
from jaxscan.rig import Camera, Chain, Covariance, Fixed, LightPlane, Linear, Rig, Rotary
from jaxscan.rig.rig import parameter_names

# The examples of the formats' descriptions, with numbers that no float32 holds.
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
# The same rig in format 2.
SAME_2: dict[str, Any] = {
    **{key: GOOD[key] for key in ("units", "camera", "fit")},
    "format": "jaxscan-rig/2",
    "lights": [{"name": "", "kind": "plane", "plane": GOOD["laser"]["plane"]}],
    "motion": [{"axis": "stage", "kind": "linear", "per_step": GOOD["stage"]["per_step"]}],
    "covariance": {**GOOD["covariance"], "parameters": ["camera.focal.0", "lights.0.plane.2"]},
}
TURNTABLE = {
    "axis": "turntable",
    "kind": "rotary",
    "per_step": [0.0, 0.0157, 0.0],
    "centre": [1.2345678901234567, 0.0, 331.0],
}
GOOD_2: dict[str, Any] = {
    **SAME_2,
    "camera": {**GOOD["camera"], "tilt": [0.0, 0.0]},
    "motion": [*SAME_2["motion"], TURNTABLE],
    "covariance": {
        "parameters": ["camera.focal.0", "lights.0.plane.2", "motion.turntable.centre.2"],
        "matrix": [[0.25, 1e-7, 0.0], [1e-7, 1e-12, 0.0], [0.0, 0.0, 1e-4]],
    },
}


def written(folder: Path, good: dict[str, Any] = GOOD, **changes: Any) -> Path:
    """A good rig file with some of its keys, by dotted name, changed; None takes a key out."""
    values = copy.deepcopy(good)
    for name, value in changes.items():
        *tables, key = name.split("__")
        inner: Any = values
        for table in tables:
            inner = inner[int(table) if isinstance(inner, list) else table]
        if value is None:
            del inner[key]
        else:
            inner[key] = value
    path = folder / "rig.json"
    path.write_text(json.dumps(values))
    return path


def numpy_rig(rig: Rig) -> Rig:
    rng = np.random.default_rng(5)
    # A relative change of 1e-10 gives every leaf digits that float32 would lose.
    return jax.tree.map(lambda x: np.asarray(float(x) * (1 + 1e-10 * rng.random())), rig)


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
@pytest.mark.parametrize(
    "motion",
    [
        Linear.create([3e-5, 9e-4, -4e-4]),
        Chain((Linear.create([3e-5, 9e-4, -4e-4]), Rotary.create([0.0, 0.0157, 1e-3], [1.2, 0.0, 331.0]))),
        Chain(
            (Rotary.create([0.0, 0.0, 0.01], [1.0, 2.0, 0.0], "arm"), Linear.create([3e-5, 9e-4, -4e-4], "z_lift-2"))
        ),
    ],
    ids=["stage", "stage_and_turntable", "other_axes"],
)
@pytest.mark.parametrize("x64", [False, True])
def test_every_bit_survives_the_file_whatever_the_precision_of_the_caller(
    tmp_path, lens, radial, tangential, motion, x64
):
    camera = Camera.create((640, 480), (697.7, 690.4), (310.3, 228.1), lens, radial, tangential)
    names = ("left", "right")
    lasers = tuple(
        LightPlane.create(w, name) for w, name in zip(([0.0, -0.005, 0.003], [0.1, 0.0, 0.01]), names, strict=True)
    )
    rig = numpy_rig(Rig(camera, lasers, motion))
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
    content = read_rig(written(tmp_path, GOOD_2))
    assert [light.name for light in content.rig.lights] == [""]
    assert {axis: part.kind for axis, part in content.rig.axes().items()} == {"stage": "linear", "turntable": "rotary"}
    write_rig(tmp_path / "again.json", content)
    without_tilt = {**GOOD_2, "camera": GOOD["camera"]}
    assert json.loads((tmp_path / "again.json").read_text()) == without_tilt


def test_a_tilted_sensor_is_kept(tmp_path):
    tilted = {**GOOD_2, "camera": {**GOOD["camera"], "tilt": [0.1745, -0.05]}}
    content = read_rig(written(tmp_path, tilted))
    assert content.rig.camera.tilt == (0.1745, -0.05)
    write_rig(tmp_path / "again.json", content)
    assert json.loads((tmp_path / "again.json").read_text()) == tilted


def test_the_example_of_the_documentation_is_read(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```json\n(.*?)^```$", page, flags=re.M | re.S)
    (tmp_path / "rig.json").write_text(example)
    content = read_rig(tmp_path / "rig.json")
    assert list(content.rig.axes()) == ["stage", "turntable"]
    assert content.covariance is not None
    assert content.covariance.sigma("motion.turntable.centre.2") == 0.01


def test_format_1_is_written_as_format_2(tmp_path):
    content = read_rig(written(tmp_path))
    write_rig(tmp_path / "again.json", content)
    assert json.loads((tmp_path / "again.json").read_text()) == SAME_2


def test_format_1_has_its_own_names(tmp_path):
    lasers = [{"name": name, "plane": [0.0, -0.005, z]} for name, z in (("left", 0.003), ("up.right", 0.002))]
    turntable = {key: TURNTABLE[key] for key in ("per_step", "centre")}
    known = {
        "camera.focal.0": "camera.focal.0",
        "laser.up.right.plane.1": "lights.1.plane.1",
        "laser.left.plane.2": "lights.0.plane.2",
        "stage.per_step.1": "motion.stage.per_step.1",
        "turntable.centre.2": "motion.turntable.centre.2",
    }
    covariance = {"parameters": list(known), "matrix": np.diag([1.0, 4.0, 9.0, 16.0, 25.0]).tolist()}
    content = read_rig(written(tmp_path, laser=lasers, turntable=turntable, covariance=covariance))
    assert content.covariance is not None
    assert content.covariance.names == tuple(known.values())
    assert [content.covariance.sigma(name) for name in known.values()] == [1, 2, 3, 4, 5]
    # The turntable stands on the stage.
    assert list(content.rig.axes()) == ["stage", "turntable"]
    with pytest.raises(InputError, match=r'no "lights.0.plane.2"; it has .*laser.plane.0.*, stage.per_step.2$'):
        read_rig(written(tmp_path, covariance__parameters=["camera.focal.0", "lights.0.plane.2"]))


@pytest.mark.parametrize("good", [GOOD, SAME_2], ids=["format_1", "format_2"])
def test_a_rig_without_laser_and_stage(tmp_path, good):
    parts = ("laser", "stage") if good is GOOD else ("lights", "motion")
    path = written(tmp_path, good, covariance=None, fit=None, **dict.fromkeys(parts))
    content = read_rig(path)
    assert content.rig.lights == ()
    assert content.rig.motion == Fixed()
    assert content.covariance is None
    write_rig(path, content)
    values = json.loads(path.read_text())
    assert set(values) == {"format", "units", "camera", "lights", "motion"}
    assert (values["lights"], values["motion"]) == ([], [])
    assert read_rig(path).rig.axes() == {}


def test_a_single_named_laser_keeps_its_name(tmp_path):
    content = read_rig(written(tmp_path, laser=[{"name": "left", "plane": [0.0, -0.005, 0.003]}], covariance=None))
    write_rig(tmp_path / "again.json", content)
    assert [laser.name for laser in read_rig(tmp_path / "again.json").rig.lights] == ["left"]


def test_standard_deviations_by_name(tmp_path):
    covariance = read_rig(written(tmp_path)).covariance
    assert covariance is not None
    assert covariance.sigma("camera.focal.0") == 0.5
    assert covariance.sigma("motion.stage.per_step.0") is None


def test_the_real_rig(data):
    rig = read_rig(data / "stage-pyramid" / "rig.json").rig
    assert rig.camera.lens.kind == "none"
    assert [float(x) for x in rig.lights[0].plane] == [-0.0268097, 0.0, 0.0125]


def test_unknown_keys_are_said_and_passed_over(tmp_path):
    path = written(tmp_path, colour={"a": 1}, camera__serial="x", stage__axis=1, laser__kind="bowed")
    with pytest.warns(PassedOverWarning, match=r"rig\.json.*colour, camera\.serial, laser\.kind, stage\.axis"):
        content = read_rig(path)
    assert content.rig.camera.image_size == (640, 480)
    path = written(tmp_path, GOOD_2, laser={}, lights__0__width=2, motion__1__steps_per_turn=400)
    with pytest.warns(PassedOverWarning, match=r"laser, lights\.0\.width, motion\.1\.steps_per_turn"):
        content = read_rig(path)
    assert list(content.rig.axes()) == ["stage", "turntable"]


BAD = {
    "another format": ({"format": "jaxscan-rig/3"}, ['format = "jaxscan-rig/3"', "jaxscan-rig/2", "jaxscan-rig/1"]),
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
    "negative thickness": ({"fit": {"sheet_sigma_mm": [-0.1]}}, ["fit.sheet_sigma_mm", "a number for each light"]),
    "thickness of another light": (
        {"fit": {"sheet_sigma_mm": [0.1, 0.2]}},
        ["fit.sheet_sigma_mm", "must hold 1 number"],
    ),
    "negative stripe error": ({"fit": {"stripe_rms_px": -1.0}}, ["fit.stripe_rms_px", "not negative"]),
    "a number of no rig": ({"stage__per_step": [1e300, 0.0, 0.0]}, ["stage.per_step.0 is 1e+300", "larger"]),
    "NaN in an unknown key": ({"more": {"a": math.nan}}, ["more.a is nan"]),
    "unknown lens": ({"camera__lens": "omni"}, ['camera.lens = "omni"', "radial1"]),
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

LIGHT = SAME_2["lights"][0]
STAGE = SAME_2["motion"][0]
BAD_2 = {
    "a light of no kind": ({"lights": [{"plane": [0, 0, 1]}]}, ["lights.0.kind", "missing"]),
    "a light of another kind": (
        {"lights": [LIGHT, {"kind": "curtain", "name": "b"}]},
        ['lights.1.kind = "curtain"', "knows plane, bowed"],
    ),
    "a kind that is no text": ({"lights__0__kind": ["plane"]}, ["lights.0.kind", "text in quotes"]),
    "lights as an object": ({"lights": {"plane": [0, 0, 1]}}, ["lights = ", "list of lights"]),
    "lights of one name": ({"lights": [{**LIGHT, "name": "a"}] * 2}, ["lights.1.name", '"name" of its own']),
    "lights without names": ({"lights": [LIGHT] * 2}, ["lights.0.name", '"name" of its own']),
    "a name that is a number": ({"lights__0__name": 0}, ["lights.0.name", "text in quotes"]),
    "plane of two": ({"lights__0__plane": [0.1, 0.2]}, ["lights.0.plane", "3 numbers"]),
    "plane behind": ({"lights__0__plane": [0.0, 0.00494, -0.1]}, ["lights.0.plane", "no pixel sees"]),
    "plane through the camera": ({"lights__0__plane": [1e9, 0.0, 1.0]}, ["lights.0.plane", "through the camera"]),
    "an axis of another kind": (
        {"motion__1__kind": "robot"},
        ['motion.1.kind = "robot"', "knows linear, guide, screw, screw_on_guide, linear_with_play", "register"],
    ),
    "an axis of no kind": ({"motion__0__kind": None}, ["motion.0.kind", "missing"]),
    "an axis of no name": ({"motion__0__axis": None}, ["motion.0.axis", "missing"]),
    "an axis of an empty name": ({"motion__0__axis": ""}, ["motion.0.axis", "not empty"]),
    "an axis that no scan can name": ({"motion__0__axis": "my.stage"}, ['motion.0.axis = "my.stage"', "letters"]),
    "an axis twice": ({"motion": [STAGE, STAGE]}, ['motion.1.axis = "stage"', "twice"]),
    "an axis twice, of two kinds": (
        {"motion": [STAGE, {**TURNTABLE, "axis": "stage"}]},
        ['motion.1.axis = "stage"', "twice"],
    ),
    "an axis that stands": ({"motion__1__per_step": [0, 0, 0]}, ["motion.1.per_step", "the turntable does not move"]),
    "a turntable of no place": ({"motion__1__centre": None}, ["motion.1.centre", "missing"]),
    "motion as an object": ({"motion": STAGE}, ["motion = ", "list of axes"]),
    "motion as numbers": ({"motion": [3]}, ["motion = [3]", "list of axes"]),
    "the names of format 1": (
        {"covariance__parameters": ["camera.focal.0", "laser.plane.2", "motion.turntable.centre.2"]},
        ['"laser.plane.2"', "lights.0.plane.2"],
    ),
    "an infinite centre": ({"motion__1__centre": [0.0, math.inf, 0.0]}, ["motion.1.centre.1 is inf"]),
    "a sensor tilted by a quarter turn": (
        {"camera__tilt": [1.6, 0.0]},
        ["camera.tilt = [1.6, 0.0]", "below a quarter"],
    ),
    "a tilt of one angle": ({"camera__tilt": [0.1]}, ["camera.tilt", "2"]),
}


@pytest.mark.parametrize(("good", "name"), [*((GOOD, name) for name in BAD), *((GOOD_2, name) for name in BAD_2)])
def test_bad_rigs_are_refused_with_file_key_and_mend(tmp_path, good, name):
    changes, texts = (BAD if good is GOOD else BAD_2)[name]
    with pytest.raises(InputError) as caught:
        read_rig(written(tmp_path, good, **changes))
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
        (b'{"units": "mm", "units": "mm"}', '"units" appears twice'),
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
    assert read_rig(rig).rig.lights
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
