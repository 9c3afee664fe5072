"""What a rig's file warns of is said by every command that uses the rig, in words and as data."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from jaxscan.cli.calibrate import carry_on
from jaxscan.cli.main import main
from jaxscan.errors import InputError
from jaxscan.files.rig_file import read_rig, write_rig
from jaxscan.view.report import Box
from jaxscan.view.verdict import Verdict

WARNING = "The light plane does not fit the stripes that it was found from"


@pytest.fixture
def doubtful(world: Path, tmp_path: Path) -> Path:
    content = read_rig(world / "rig.json")
    write_rig(tmp_path / "rig.json", replace(content, fit={**content.fit, "warnings": [WARNING]}))
    return tmp_path / "rig.json"


def test_each_command_says_it(world: Path, doubtful: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    scan, rig, out = str(world / "scan"), str(doubtful), tmp_path / "out"
    commands = {
        "inspect": ["inspect", rig],
        "reconstruct": ["reconstruct", scan, "--rig", rig, "-o", str(tmp_path / "cup.ply")],
        "batch": ["batch", scan, "--rig", rig, "-o", str(out)],
    }
    for name, words in commands.items():
        assert main([*words, "--json"]) == 0
        (said,) = json.loads(capsys.readouterr().out)["warnings"]
        assert said.endswith(WARNING), name
        assert main(words) == 0
        assert f"{WARNING}." in capsys.readouterr().out


def test_a_good_rig_has_none(world: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["inspect", str(world / "rig.json"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []


def test_sigma_that_are_wider_than_noise_alone_are_said(doubtful: Path, capsys: pytest.CaptureFixture[str]):
    text = json.loads(doubtful.read_text())
    text["fit"]["sigma_over_noise_alone"] = {"camera.focal.0": 1.25, "camera.radial.0": 9.03}
    doubtful.write_text(json.dumps(text))
    assert main(["inspect", str(doubtful)]) == 0
    assert "1.2 to 9 times as large as from noise alone" in capsys.readouterr().out


@pytest.mark.parametrize("ratios", [{}, 1.25, {"camera.focal.0": "wide"}, {"camera.focal.0": 0.0}])
def test_ratios_of_sigma_that_are_none_are_refused(doubtful: Path, ratios: object):
    text = json.loads(doubtful.read_text())
    text["fit"]["sigma_over_noise_alone"] = ratios
    doubtful.write_text(json.dumps(text))
    with pytest.raises(InputError, match=r"fit\.sigma_over_noise_alone"):
        read_rig(doubtful)


def test_warnings_that_are_no_sentences_are_refused(doubtful: Path):
    text = json.loads(doubtful.read_text())
    text["fit"]["warnings"] = [1]
    doubtful.write_text(json.dumps(text))
    with pytest.raises(InputError, match=r"fit\.warnings"):
        read_rig(doubtful)


def test_calibrate_ends_with_the_verdict_and_has_it_as_data(
    world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    command = ["calibrate", str(world / "session"), "-o", str(tmp_path / "rig.json")]
    assert main(command) == 0
    lines = capsys.readouterr().out.rstrip().split("\n")
    assert [line.partition(":")[0] for line in lines[-3:]] == ["verdict", "what limits it", "photograph next"]
    assert not any(line.startswith("left out") for line in lines)
    # Of a session that is given twice there is a note, and nothing else changes.
    assert main(["calibrate", str(world / "session"), *command[1:], "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert any("counts once" in note or "count once" in note for note in said["notes"]), said["notes"]
    assert set(said["verdict"]) == {"level", "statement", "limits", "next", "thorough"}
    assert lines[-3] == f"verdict: {said['verdict']['statement']}"
    assert said["verdict"]["thorough"] is False
    assert said["report"] is None
    assert said["left_out"] == []
    assert all("rejected" in line or "of squares" in line or "beyond" in line for line in said["rejected"])
    for box in said["warnings"]:
        assert set(box) == {"level", "statement", "advice"}
        assert f"warning: {box['statement']} {box['advice']}" in lines


def test_a_red_verdict_is_carried_on_by_the_rigs_file(world: Path, doubtful: Path):
    content = read_rig(doubtful)
    boxes = (Box("stop", "The photographs are in another order."), Box("stop", f"{WARNING}."), Box("care", "Few."))
    judged = Verdict("stop", "Do not use this calibration yet.", "", "", boxes, False)
    carry_on(judged, content, doubtful)
    said = "The calibration was not to be used: The photographs are in another order"
    assert read_rig(doubtful).warnings == (WARNING, said)
    before = (world / "rig.json").read_bytes()
    carry_on(replace(judged, level="care", warnings=boxes[2:]), read_rig(world / "rig.json"), world / "rig.json")
    assert (world / "rig.json").read_bytes() == before
