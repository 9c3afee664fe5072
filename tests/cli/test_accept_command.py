"""`jaxscan accept`: the guide's own example, run; its history, pictures and page; what is refused."""

import json
import re
import shlex
from dataclasses import replace

import pytest

from jaxscan.cli.main import main
from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.reconstruction import read_range_image, write_points
from tests.measurement.test_accept import scans
from tests.test_docs import ROOT, blocks, commands

GUIDE = ROOT / "docs" / "accept.md"


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plate")
    rig, several = scans(2)
    write_rig(folder / "rig.json", rig)
    for number, (_, image) in enumerate(several, 1):
        write_points(folder / f"place-{number}.npz", image)
    (text,) = blocks(GUIDE, "toml")
    (folder / "artefact.toml").write_text(text)
    return folder


def test_the_guide(plate, monkeypatch, capsys):
    monkeypatch.chdir(plate)
    test, drift = (shlex.split(line)[1:] for line in commands(GUIDE) if line.startswith("jaxscan accept"))
    for _ in range(2):
        assert main(test) == 0
    said = capsys.readouterr().out
    assert "plate, 2 scans: conforming" in said
    assert "note: distance: 2 of the 7 places that VDI/VDE 2634 part 2 asks for" in said
    page = (plate / "report" / "report.html").read_text()
    assert "probing_size" in page
    assert re.search(r"made 20\d\d-\d\d-\d\dT.*, jaxscan \d", page)
    assert re.search(r"artefact: .*toml, SHA-256 [0-9a-f]{16}", page)
    assert main(drift) == 0
    assert "nothing has changed by more than its uncertainty" in capsys.readouterr().out
    assert (plate / "drift.png").read_bytes().startswith(b"\x89PNG")
    assert main([*drift[:3], "--report", "drift", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["changes"]) == 6
    assert "0 of 6 figures have changed" in (plate / "drift" / "report.html").read_text()
    (snippet,) = blocks(GUIDE, "python")
    exec(compile(snippet, "accept.md", "exec"), {})
    assert "place-1.npz probing_form left" in capsys.readouterr().out


def test_json_and_a_picture_by_a_rig_without_covariance(plate, capsys):
    """The errors are those that the rig with its covariance gives: they do not depend on what is predicted."""
    given = ["accept", str(plate / "place-1.npz"), "--artefact", str(plate), "--json"]
    assert main([*given, "--rig", str(plate / "rig.json")]) == 0
    predicted = json.loads(capsys.readouterr().out)
    bare = plate / "bare.json"
    write_rig(bare, RigFile(read_rig(plate / "rig.json").rig))
    assert main([*given, "--rig", str(bare), "--png", str(plate / "a.png")]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["verdict"] == "conforming"
    assert result["places"] == "(1 of the 10 recommended places)"
    assert result["figures"][1]["sigma_rig"] is None
    noted = replace(read_range_image(plate / "place-1.npz"), notes=("it was dark",))
    write_points(plate / "noted.npz", noted)
    assert main(["accept", str(plate / "noted.npz"), *given[2:], "--rig", str(bare)]) == 0
    assert f"{plate / 'noted.npz'}: it was dark" in json.loads(capsys.readouterr().out)["notes"]
    assert main(["inspect", str(plate / "noted.npz")]) == 0
    assert re.search("note +it was dark", capsys.readouterr().out)
    assert any("nothing is predicted by a rig without a covariance" in note for note in result["notes"])
    for one, other in zip(predicted["figures"], result["figures"], strict=True):
        assert one["error"] == pytest.approx(other["error"], abs=2e-3)
    assert (plate / "a.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_refused_before_any_work(plate, capsys):
    scan, artefact = str(plate / "place-1.npz"), str(plate / "artefact.toml")
    rig = ["--rig", str(plate / "rig.json")]
    (plate / "no-history.jsonl").write_text("hello\n")
    for argv, words in (
        (["accept"], "there is no SURFACE"),
        (["accept", scan], "--artefact is missing"),
        (["accept", scan, "--artefact", artefact], "--rig is missing"),
        (["accept", "a.ply", "--artefact", artefact, *rig], "a scanner is tested by its range images"),
        (["accept", "--history", artefact, "--rig", "r"], "belong to a test"),
        (["accept", "--history", str(plate / "none.jsonl")], "there is no such history"),
        (
            ["accept", scan, "--artefact", artefact, *rig, "--history", str(plate / "no-history.jsonl")],
            "line 1: is no JSON",
        ),
        (
            ["accept", scan, "--artefact", artefact, *rig, "--history", artefact],
            "is read, and writing to it would replace",
        ),
        (["accept", scan, scan, "--artefact", artefact, *rig], "one scan is named twice"),
    ):
        assert main(argv) == 2
        assert words in capsys.readouterr().err
