"""README and docs: the site builds, every command and option that they show is there, and what a guide says runs."""

import argparse
import importlib.util
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
import trimesh

import dev
import hardware.cli.main
import jaxscan
import jaxscan.cli.main
from benchmarks.__main__ import command_line as bench_command_line
from benchmarks.headline import command_line as headline_command_line
from benchmarks.pictures import command_line as pictures_command_line
from hardware.devices import read_scanner
from jaxscan.cli.board import EXAMPLE as BOARD_EXAMPLE
from jaxscan.cli.main import Program, main, parser_of
from jaxscan.files.artefact_file import read_artefact
from jaxscan.files.profiles import read_profiles
from jaxscan.files.rig_file import read_rig
from tests.small_world import CALIBRATE

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PARSERS = {
    "jaxscan": parser_of(Program("jaxscan", "", jaxscan.cli.main.COMMANDS)),
    "scanner": parser_of(Program("scanner", "", hardware.cli.main.COMMANDS)),
    "python -m benchmarks": bench_command_line(),
    "python -m benchmarks.headline": headline_command_line(),
    "python -m benchmarks.pictures": pictures_command_line(),
}
# Where these begin a line they are commands of others.
OTHERS = ("pip ", ". ", "dask ")
# What a guide shows and this test does not run: it never ends, or wants scans that are not there.
NOT_RUN = ("jaxscan view", "jaxscan merge", "scanner", "python3 dev.py")
# Snippets that want more than a folder of photographs: a lab server and its token; a scan that was reconstructed, which
# `tests/cli/test_measure_command.py` and `test_accept_command.py` have; a calibration (below).
COMPILED_ALONE = ("accept.md", "lab.md", "measure.md", "solve.md")


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a page in one language, "" for none."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    return [block for name, block in found if name == language]


def commands(page: Path) -> list[str]:
    """The lines of its blocks, without comments."""
    lines = chain.from_iterable(block.splitlines() for block in blocks(page, ""))
    return [line.partition("#")[0].strip() for line in lines if line.strip() and not line.startswith("#")]


def mentioned(page: Path) -> list[str]:
    """Commands in the midst of sentences: `jaxscan mesh`, `scanner move 20000`, `dev.py bench --only lab`."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    inline = re.findall(r"`((?:jaxscan|scanner|python3 dev\.py|(?:\.venv/bin/)?python -m benchmarks\S*) [^`]+)`", text)
    return [line for line in inline if not line.startswith("jaxscan[")]


def program(line: str) -> tuple[argparse.ArgumentParser | None, list[str]]:
    """The parser of a command line, and its words; no parser where the words are handed on to another's program."""
    words = shlex.split(line)
    if words[:2] == ["python3", "dev.py"]:
        _, command, _ = dev.COMMANDS[words[2]]
        name, own = " ".join(command[:3]), command[1:]
        words = [*own, *words[3:]]
        if name == "python -m benchmarks":
            return PARSERS[name], words[2:]
        return PARSERS.get(command[0]), words
    if "-m" in words:
        at = words.index("-m")
        return PARSERS[f"python -m {words[at + 1]}"], words[at + 2 :]
    return PARSERS[words[0]], words[1:]


def options_of(parser: argparse.ArgumentParser, command: str) -> set[str]:
    """All options of a program's command, or of a program without commands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            parser = action.choices[command]
    return set(chain.from_iterable(action.option_strings for action in parser._actions))


def boards_shown() -> list[str]:
    """All `jaxscan board` lines of pages and help, and a line for each `--square N` in the midst of a sentence."""
    whole = [*chain.from_iterable((*commands(page), *mentioned(page)) for page in PAGES), *BOARD_EXAMPLE.splitlines()]
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    squares = [f"jaxscan board -o board.svg {square}" for square in re.findall(r"`(--square [\d.]+)`", text)]
    return [*(line.strip() for line in whole if re.match(r"\s*jaxscan board .*-o ", line)), *squares]


@pytest.mark.parametrize("line", boards_shown())
def test_every_board_that_is_shown_fits_its_page(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(line)[1:]) == 0
    assert list(tmp_path.glob("board.*"))


@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="mkdocs is not installed (extra docs)")
def test_the_site_builds_and_asks_nobody(tmp_path: Path):
    argv = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    env = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(argv, cwd=ROOT, env=env, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout + done.stderr == ""
    for page in tmp_path.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert not re.findall(r'<(?:script|img|iframe)[^>]*src="https?:|<link[^>]*stylesheet[^>]*href="https?:', text)
    reference = (tmp_path / "api.html").read_text(encoding="utf-8")
    assert [name for name in jaxscan.__all__ if f">{name}<" not in reference.replace("</span>", "<")] == []


@pytest.mark.skipif(importlib.util.find_spec("griffe") is None, reason="griffe is not installed (extra docs)")
def test_the_page_of_public_names_is_that_of_the_sources():
    reference = runpy.run_path(str(ROOT / "docs" / "reference"), run_name="reference")
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    assert reference["written"](page) == page, "write it again: python docs/reference"
    assert [name for name in jaxscan.__all__ if f"### {name}\n" not in page] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_are_as_the_programs_have_them(page: Path, capsys: pytest.CaptureFixture[str]):
    for line in commands(page):
        if line.startswith(OTHERS):
            continue
        parser, words = program(line)
        if parser is None:
            continue
        try:
            parser.parse_args(words)
        except SystemExit:
            pytest.fail(f"{page.name}: {line}\n{capsys.readouterr().err}")
    for line in mentioned(page):
        parser, words = program(line.replace("…", ""))
        if parser is None:
            continue
        known = options_of(parser, words[0] if words else "")
        unknown = [word for word in words if word.startswith("--") and word.partition("=")[0] not in known]
        assert unknown == [], f"{page.name}: {line}"


def write_profiles(folder: Path) -> None:
    """Three profiles of each kind that docs/profiles.md shows."""
    (folder / "profiles").mkdir(exist_ok=True)
    for i in range(3):
        (folder / "profiles" / f"{i}.csv").write_text("X [mm],Z [mm]\n-1.0,3.5\n1.0,-9999\n")
    (folder / "map.raw").write_bytes(np.full((3, 1280, 2), 9000, "<u2").tobytes())


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "toml")], ids=lambda page: page.name)
def test_files_are_as_the_readers_want_them(page: Path, world: Path, tmp_path: Path):
    for folder in ("boards", "stage"):
        (tmp_path / folder).symlink_to(world / "session" / folder)
    (tmp_path / "stripes").symlink_to(world / "session" / "boards")
    (tmp_path / "sweeps").mkdir()
    for board in (world / "session" / "boards").iterdir():
        for i in range(7):
            (tmp_path / "sweeps" / f"{board.stem}-{i}.png").symlink_to(board)
    # A photograph is of one pose: copies, not links.
    for folder in ("turntable", "poses"):
        shutil.copytree(world / "session" / "stage", tmp_path / folder)
    (tmp_path / "frames").symlink_to(world / "scan" / "frames")
    (tmp_path / "dark.png").symlink_to(world / "scan" / "frames" / "000.png")
    names = [path.name for folder in ("stage", "frames") for path in sorted((tmp_path / folder).iterdir())]
    (tmp_path / "poses.csv").write_text("".join(f"{name},0,{i},0,1,0,0,0\n" for i, name in enumerate(names)))
    whole_session, _ = blocks(ROOT / "README.md", "toml")
    for text in blocks(page, "toml"):
        path = tmp_path / "file.toml"
        # What may be added to a session is shown by itself.
        text = whole_session + text if text.startswith("[turntable]") else text
        text = whole_session.partition("[views]")[0] + text if text.startswith("[poses]") else text
        path.write_text(text)
        if "[profiles]" in text:
            write_profiles(tmp_path)
            assert len(read_profiles(path).z) == 3
        elif "[scan]" in text:
            assert jaxscan.read_scan(path).listed == 5
        elif "[board]" in text:
            assert len(jaxscan.read_session(path).views.boards) == (5 if "[poses]" in text else 6)
        elif "[[feature]]" in text:
            green = trimesh.creation.box(face_colors=[0x20, 0xA0, 0x30, 255])
            green.export(tmp_path / "block.ply")
            assert jaxscan.read_part(path).dimensions
        elif "[artefact]" in text:
            assert read_artefact(path).limits
        else:
            assert read_scanner(path).path == path


@pytest.fixture
def guided(world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folders of photographs without their TOML files, as the working folder."""
    for name, folders in (("session", ("boards", "stage")), ("scan", ("frames",))):
        (tmp_path / name).mkdir()
        for folder in folders:
            (tmp_path / name / folder).symlink_to(world / name / folder)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def follow(page: Path) -> list[str]:
    """Write a guide's TOML files, then run its commands, in order; those that were run."""
    for text, name in zip(blocks(page, "toml"), ("session", "scan"), strict=True):
        Path(name, f"{name}.toml").write_text(text)
    ran = [line for line in commands(page) if not line.startswith((*NOT_RUN, *OTHERS))]
    for line in ran:
        if not (line == CALIBRATE and Path("rig.json").exists()):
            assert main(shlex.split(line)[1:]) == 0, line
    return [line.split()[1] for line in ran]


def test_what_the_readme_says(world: Path, guided: Path):
    """Its commands, then its Python snippet, which does the same."""
    assert follow(ROOT / "README.md") == ["board", "calibrate", "reconstruct", "mesh"]
    for name in ("board.pdf", "cup.npz", "cup.stl"):
        assert (guided / name).stat().st_size > 1000
    by_command = (guided / "rig.json").read_bytes(), (guided / "cup.ply").read_bytes()
    (snippet,) = blocks(ROOT / "README.md", "python")
    exec(compile(snippet, "README.md", "exec"), {})
    assert (guided / "rig.json").read_bytes() == by_command[0]
    assert (guided / "cup.ply").read_bytes() == by_command[1]
    found, again = read_rig(world / "rig.json").rig, read_rig(guided / "rig.json").rig
    np.testing.assert_allclose(again.camera.focal, found.camera.focal, rtol=1e-9)


def test_the_first_scan(world: Path, guided: Path):
    page = ROOT / "docs" / "first-scan.md"
    # By the README's file the world's rig is found again (above), and its own command has made it, with the report.
    assert blocks(page, "toml") == blocks(ROOT / "README.md", "toml")
    shutil.copy(world / "rig.json", guided)
    shutil.copytree(world / "report", guided / "report")
    ran = follow(page)
    assert ran == ["board", "inspect", "calibrate", "inspect", "inspect", "reconstruct", "inspect", "mesh"]
    for name in ("board.pdf", "report/report.html", "stripe.png", "cup.ply", "cup.stl", "cup-mesh.png"):
        assert (guided / name).stat().st_size > 1000


@pytest.mark.parametrize("name", ["README.md", "docs/first-scan.md"])
def test_the_board_that_is_drawn_is_the_one_that_is_configured(name: str, tmp_path: Path):
    """What is printed, what session.toml says and what the guide's commands say are one board."""
    page = ROOT / name
    (drawing,) = (line for line in commands(page) if line.startswith("jaxscan board"))
    args = PARSERS["jaxscan"].parse_args([*shlex.split(drawing)[1:], "--session", str(tmp_path / "session")])
    args.output = [tmp_path / "board.pdf"]
    args.command.run(args)
    (configured,) = (tomllib.loads(text)["board"] for text in blocks(page, "toml") if "[board]" in text)
    printed = tomllib.loads((tmp_path / "session" / "session.toml").read_text())["board"]
    assert printed == {"kind": "checkerboard", **configured}
    for command in (line for line in commands(page) if line.startswith("scanner calibrate")):
        taken = PARSERS["scanner"].parse_args(shlex.split(command)[1:])
        columns, rows = configured["inner_corners"]
        assert (taken.board, taken.square) == (f"{columns}x{rows}", configured["square_mm"])


@pytest.mark.usefixtures("own_kinds")
@pytest.mark.parametrize("page", [page for page in PAGES[1:] if blocks(page, "python")], ids=lambda page: page.name)
def test_snippets(page: Path, world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def camera():
        scan = jaxscan.read_scan(world / "scan")
        return (
            (jaxscan.images.read_image(path), step) for path, step in zip(scan.frames, scan.axes["stage"], strict=True)
        )

    monkeypatch.chdir(tmp_path)
    shutil.copy(world / "rig.json", tmp_path)
    for snippet in blocks(page, "python"):
        code = compile(snippet, page.name, "exec")
        if page.name not in COMPILED_ALONE:
            exec(code, {"camera": camera})


@pytest.mark.long
def test_derivatives_through_the_solution(world: Path):
    """In a process of its own: the snippet switches x64 on for good."""
    (snippet,) = blocks(ROOT / "docs" / "solve.md", "python")
    script = "\n".join(
        [
            "import jax.numpy as jnp, jaxscan",
            "session = jaxscan.read_session('session')",
            "calibration = jaxscan.calibrate(jaxscan.observe(session))",
            "pixel, steps = jnp.array([320.0, 240.0]), 0.0",
            snippet,
            "assert jnp.isfinite(gradient.groups[0].corners).any()",
        ]
    )
    subprocess.run([sys.executable, "-c", script], cwd=world, check=True, timeout=280)
