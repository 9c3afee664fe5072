"""A file that is not there: which was meant, or what is there."""

from pathlib import Path

import pytest

from jaxscan.cli.main import main
from jaxscan.missing import no_such_file


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("cup.npz", "cup.ply", "rig.json", ".hidden"):
        (tmp_path / name).touch()
    for name in ("scan", "truth", "many", "empty"):
        (tmp_path / name).mkdir()
    (tmp_path / "scan" / "scan.toml").touch()
    for number in range(9):
        (tmp_path / "many" / f"{number}.png").touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("path", "says"),
    [
        ("cup", "cup: there is no such file: did you mean cup.npz or cup.ply?"),
        ("cub.npz", "cub.npz: there is no such file: did you mean cup.npz?"),
        ("trut", "trut: there is no such file: did you mean truth?"),
        ("zzz", "this folder has cup.npz, cup.ply, empty/, many/, rig.json, scan/ and 1 more: check the path"),
        ("many/x.stl", "many has 0.png, 1.png, 2.png, 3.png, 4.png, 5.png and 3 more: check the path"),
        ("empty/x.stl", "empty is empty: check the path"),
        ("gone/deep/x.stl", "x.stl: there is no such file, nor its folder gone/deep: this folder has cup.npz"),
        (
            "scan",
            "scan: has the photographs of a scan, and a file is needed: make its points first: jaxscan reconstruct",
        ),
        ("many", "many: is a folder, and a file is needed: name one: many has 0.png"),
    ],
)
def test_what_was_meant_or_what_is_there(folder: Path, path: str, says: str):
    assert says in str(no_such_file(Path(path)))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            "scan truth",
            "scan: has the photographs of a scan, and its points are compared: jaxscan reconstruct scan --rig rig.json "
            "-o scan.npz, then jaxscan compare scan.npz truth; of points there are cup.npz and cup.ply",
        ),
        ("cup truth", "cup: there is no such file or folder: did you mean cup.npz or cup.ply?"),
        ("cup.npz trut", "trut: there is no such file or folder: did you mean truth?"),
        ("many truth", "many: is a folder: give the points first, then what they are compared with, as in jaxscan "),
    ],
)
def test_compare_says_what_it_compares(folder: Path, words: str, says: str, capsys: pytest.CaptureFixture[str]):
    assert main(["compare", *words.split()]) == 2
    assert says in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("words", ["mesh scan -o x.stl", "view scan --png x.png"])
def test_points_are_made_of_a_scan_first(folder: Path, words: str, capsys: pytest.CaptureFixture[str]):
    assert main(words.split()) == 2
    assert "jaxscan reconstruct scan --rig rig.json -o scan.npz" in " ".join(capsys.readouterr().err.split())


def test_a_name_without_its_ending_is_completed(folder: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["mesh", "cup", "-o", "x.stl"]) == 2
    assert "did you mean cup.npz or cup.ply?" in capsys.readouterr().err


def test_a_link_to_nothing(tmp_path: Path) -> None:
    """Its own name was suggested in its place."""
    (tmp_path / "rig.json").symlink_to("nowhere.json")
    said = str(no_such_file(tmp_path / "rig.json"))
    assert said.endswith("rig.json: is a link to nowhere.json, which is not there: copy the file, or link it again")
