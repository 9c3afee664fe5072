"""`artefact.toml`: read as it is meant, and refused with the key and what to do."""

import pytest

from jaxscan.errors import InputError
from jaxscan.files.artefact_file import read_artefact

BALL = '[[ball]]\nname = "a"\ndiameter = 1.0\nuncertainty = 0.001\n'
OTHER = BALL.replace('"a"', '"b"')
DISTANCE = '[[distance]]\nof = ["a", "b"]\nlength = 4.0\nuncertainty = 0.01\n'


def read(tmp_path, text):
    (tmp_path / "bar.toml").write_text(text)
    return read_artefact(tmp_path / "bar.toml")


def test_lengths_are_in_the_files_unit(tmp_path):
    found = read(tmp_path, f'[artefact]\nunits = "inch"\n{BALL}{OTHER}{DISTANCE}[limits]\ndistance = 0.01\n')
    assert found.name == "bar"
    assert [ball.diameter for ball in found.balls] == [25.4, 25.4]
    assert found.distances[0].length == pytest.approx(101.6)
    assert found.limits == {"distance": pytest.approx(0.254)}
    assert found.plane is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[artefact]\nname = "bar"\n', "ball: is missing, and .*plane.* too"),
        (BALL + BALL, "two balls have this name"),
        (BALL + DISTANCE, "no ball is called 'b': there are a"),
        (BALL + OTHER + DISTANCE.replace("4.0", "0.5"), "length = 0.5: the balls touch at 1 mm"),
        (BALL + OTHER + DISTANCE.replace('"b"', '"a"'), "of .*: must name two balls"),
        (BALL.replace("1.0", "0"), "diameter = 0: must be more than 0"),
        (BALL.replace("0.001", "-1"), "uncertainty = -1: must be 0 or more"),
        (BALL.replace("0.001", "0.5"), "is more than a tenth of the diameter: give both in one unit"),
        (BALL.replace("uncertainty", "uncertanty"), 'did you mean "uncertainty"'),
        (BALL.replace("name", "nmae"), 'nmae = "a": unknown key; did you mean "name"'),
        (BALL + OTHER + DISTANCE.replace("length", "lenght"), 'unknown key; did you mean "length"'),
        (BALL.replace("diameter", "diametre"), 'unknown key; did you mean "diameter"'),
        (BALL + "[limits]\nflat = 1.0\n", 'did you mean "flatness"'),
        ("[[plane]]\nflatness = 0.1\n" * 2, "plane.*there are two"),
        (BALL.replace("1.0", "0.014"), r"diameter = 0.014: is 0.014 mm, which .* write units = \"m\" under"),
        (BALL.replace("1.0", "0.0381"), r'write units = "m", or units = "inch" under'),
        ('[artefact]\nunits = "m"\n' + BALL.replace("1.0", "14"), r'is 14000 mm, .* write units = "mm", or'),
        (BALL.replace("1.0", "1e9"), "sees: correct it"),
        ("".join(BALL.replace('"a"', f'"{k}"') for k in range(7)), "there are 7, and at most 6"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read(tmp_path, text)
