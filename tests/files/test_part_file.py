"""part.toml: what it may hold, and what is refused, with the key and how to fix it."""

import pytest

from jaxscan.errors import InputError
from jaxscan.files.part_file import read_part

PLANES = """
[[feature]]
name = "base"
kind = "plane"
ball = [0, 0, 300, 8]

[[feature]]
name = "top"
kind = "plane"
box = [[0, 0, 290], [10, 10, 300]]
"""
STEP = """
[[dimension]]
name = "step"
kind = "step"
of = ["base", "top"]
nominal = 10
tolerance = 0.1
"""


def read(tmp_path, text):
    path = tmp_path / "part.toml"
    path.write_text(text)
    return read_part(path)


def test_features_and_dimensions(tmp_path):
    part = read(tmp_path, '[part]\nname = "block"\n' + PLANES + STEP)
    assert [each.name for each in part.features] == ["base", "top"]
    assert part.features[0].region.radius == 8
    (step,) = part.dimensions
    assert (step.nominal, step.tolerance, step.unit) == (10, (-0.1, 0.1), "mm")
    assert read_part(tmp_path) == part


def test_a_part_in_inches_is_in_millimetres_then(tmp_path):
    part = read(tmp_path, '[part]\nunits = "inch"\n' + PLANES + STEP)
    assert part.features[0].region.low == (0, 0, pytest.approx(7620))
    assert part.dimensions[0].nominal == pytest.approx(254)
    assert part.dimensions[0].tolerance == (pytest.approx(-2.54), pytest.approx(2.54))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("[part]\nname = 'x'\n", "feature: is missing"),
        (PLANES.replace("ball", "bell"), 'bell.*did you mean "ball"'),
        (PLANES.replace("name", "nmae"), 'nmae = "base": unknown key; did you mean "name"'),
        (PLANES.replace("kind", "kin"), 'kin = "plane": unknown key; did you mean "kind"'),
        (PLANES + STEP.replace("name", "nmae"), 'nmae = "step": unknown key; did you mean "name"'),
        (PLANES.replace("ball", "grow = true\npoint = [0, 0, 0]\nball"), "point = .*unknown key; the keys here are"),
        (PLANES.replace("plane", "sphere"), "must be one of plane, ball"),
        (PLANES.replace("top", "base"), "two features have this name"),
        (PLANES + STEP + STEP, "two dimensions have this name"),
        (PLANES.replace("300, 8]", "300, 0]"), "radius, the fourth number, must be more than 0"),
        (PLANES.replace("ball = [0, 0, 300, 8]", ""), "give one of box"),
        (PLANES.replace("[10, 10, 300]", "[10, 10, 280]"), "each number of the second corner"),
        (PLANES.replace("[10, 10, 300]", "[10, 10]"), "corner 2.*must hold 3 numbers"),
        (PLANES + STEP.replace("top", "lid"), "no feature above is called 'lid': those above are base, top"),
        (PLANES + STEP.replace('"base", ', ""), "must name 2 features"),
        (PLANES + STEP.replace('"top"', '"base"'), "names one feature twice"),
        (
            PLANES + STEP.replace('kind = "step"', 'kind = "radius"').replace('["base", "top"]', '"top"'),
            "is a plane, but",
        ),
        (PLANES + STEP.replace("0.1", "-0.1"), "must be a number above 0"),
        (PLANES + STEP.replace("nominal = 10\n", ""), "a tolerance is about a nominal"),
        ('[part]\nunits = "yard"\n' + PLANES, "must be one of mm, cm, m, inch"),
        (
            PLANES + "[[feature]]\nname = 'c'\nkind = 'circle'\nsection = 'base'\n",
            "no section of this name stands above",
        ),
        (PLANES + "[[feature]]\nname='s'\nkind='section'\npoint=[0,0,0]\nnormal=[0,0,0]\n", "has no direction"),
        (PLANES + "[[dimension]]\nname='f'\nkind='flatness'\nof='top'\nnominal=1\n", "a flatness has none"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, words):
    with pytest.raises(InputError, match=words) as error:
        read(tmp_path, text)
    assert str(error.value).startswith(str(tmp_path / "part.toml"))


def test_a_mesh_that_is_not_there_is_named(tmp_path):
    surface = "[[feature]]\nname='s'\nkind='surface'\nball=[0,0,0,1]\n[[dimension]]\nname='p'\nkind='profile'\nof='s'\n"
    with pytest.raises(InputError, match=r"there is no file .*cad\.stl: give the mesh"):
        read(tmp_path, surface + "reference = 'cad.stl'\n")
