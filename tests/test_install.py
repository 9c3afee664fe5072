"""Installing: every line of the pages that installs is known and, in the long form, run in a clean environment."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import hardware.cli.main
from jaxscan.cli.main import Program, parser_of

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
# Lines of other packages' own, and those for which a machine needs more than pip: a GPU, a library of the system's.
NOT_RUN = ("jax[cuda13]", "vision-calibration", "gphoto2", "genicam")
# What cannot be had here by pip alone: a library of the system's, a GPU.
NOT_HERE = ("gphoto2", "genicam", "docs", "dev")


def install_lines() -> list[tuple[str, str]]:
    """Each line of a page that calls pip, with the page's name; those in the midst of a sentence too."""
    found = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        found += [
            (page.name, line) for line in re.findall(r"(?:^|`)((?:\S*python3? -m )?pip install [^`\n#]+)", text, re.M)
        ]
    return found


def install_scripts() -> list[tuple[str, str]]:
    """What the pages have a reader type to install, literally, with the page's name: blocks of several lines whole."""
    page = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
    blocks = [block for block in re.findall(r"^```sh\n(.*?)^```", page, re.M | re.S) if "docker" not in block]
    scripts = [("install.md", block) for block in blocks]
    known = "".join(blocks)
    return scripts + [
        (page, line)
        for page, line in dict.fromkeys(install_lines())
        if line not in known and not any(name in line for name in NOT_RUN)
    ]


def test_the_scripts_are_the_pages_own() -> None:
    scripts = install_scripts()
    assert len([script for page, script in scripts if page == "install.md" and script.count("\n") > 2]) == 2
    assert any("-m build" in script for _, script in scripts)
    assert {page for page, _ in scripts} >= {"install.md", "lab.md"}


def test_every_line_asks_for_something_that_there_is() -> None:
    lines = install_lines()
    assert len(lines) >= 8
    for page, line in lines:
        (what,) = (word for word in shlex.split(line)[line.split().index("install") + 1 :] if not word.startswith("-"))
        name, _, extras = what.removesuffix("]").partition("[")
        assert set(extras.split(",")) - {""} <= {*EXTRAS, "cuda13"}, f"{page}: {line}"
        known = {
            ".",
            "jaxscan",
            "jax",
            "build",
            "httpx",
            "vision-calibration",
            f"dist/jaxscan-{PROJECT['version']}-py3-none-any.whl",
        }
        assert name in known, f"{page}: {line}"


def test_the_page_has_every_extra() -> None:
    page = (ROOT / "docs" / "install.md").read_text()
    table = re.findall(r"^\| (`[^|]+) \|", page, re.M)
    assert set(re.findall(r"`([\w-]+)`", " ".join(table))) == set(EXTRAS)


def test_the_container_as_far_as_it_can_be_read() -> None:
    """No container can be built or run here: its files and its commands are looked at, and nothing more."""
    lines = (ROOT / "Dockerfile").read_text().replace("\\\n", " ").splitlines()
    for line in lines:
        if line.startswith("COPY") and "--from" not in line:
            *sources, _ = line.split()[1:]
            assert all((ROOT / source).exists() for source in sources), line
    (extras,) = re.findall(r"\*\.whl\)\[([\w,-]+)\]", "\n".join(lines))
    assert set(extras.split(",")) <= set(EXTRAS)
    (words,) = (line.removeprefix("CMD ") for line in lines if line.startswith("CMD "))
    program, *argv = re.findall(r'"([^"]*)"', words)
    assert program == "scanner"
    args = parser_of(Program("scanner", "", hardware.cli.main.COMMANDS)).parse_args(argv)
    (exposed,) = (line.split()[1] for line in lines if line.startswith("EXPOSE"))
    assert (str(args.port), args.host) == (exposed, "0.0.0.0")
    shown = re.findall(r"^docker (?:build|run) .*$", (ROOT / "docs" / "install.md").read_text(), re.M)
    assert len(shown) == 4
    assert any(f"-p 127.0.0.1:{exposed}:{exposed}" in line for line in shown)
    volumes = re.findall(r'VOLUME \["([^"]+)"\]', "\n".join(lines))
    assert all(f"-v jaxscan-lab:{volume}" in "\n".join(shown) for volume in volumes)
    assert str(args.data) in volumes


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel and the source archive, as `python -m build` makes them."""
    pytest.importorskip("build", reason="build is not installed (extra dev)")
    out = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "build", "--outdir", str(out), str(ROOT)], check=True, timeout=280)
    return out


def clean(folder: Path) -> Path:
    """The Python of a new environment."""
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    return folder / "bin" / "python"


def pip(python: Path, *what: str) -> None:
    argv = [
        str(python),
        "-m",
        "pip",
        "install",
        "-q",
        "--disable-pip-version-check",
        "-c",
        str(ROOT / "constraints.txt"),
    ]
    subprocess.run([*argv, *what], check=True, timeout=900)


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("kind", ["*.whl", "*.tar.gz"])
def test_what_is_built_works_in_a_clean_environment(kind: str, built: Path, tmp_path: Path) -> None:
    (archive,) = built.glob(kind)
    python = clean(tmp_path / "venv")
    pip(python, str(archive))
    program = str(python.parent / "jaxscan")
    for argv in (["--version"], ["board", "-o", "board.pdf"], ["simulate", "--help"], ["calibrate", "--help"]):
        subprocess.run([program, *argv], cwd=tmp_path, check=True, timeout=120)
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
    subprocess.run([str(python.parent / "scanner"), "--version"], check=True, timeout=120)
    templates = "import hardware.lab, pathlib; print(*pathlib.Path(hardware.lab.__file__).parent.glob('templates/*'))"
    listed = subprocess.run([str(python), "-c", templates], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert listed.stdout.count(".html") == len(list((ROOT / "hardware" / "lab" / "templates").glob("*.html")))


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("extra", [name for name in EXTRAS if name not in NOT_HERE])
def test_each_extra_installs_from_the_wheel(extra: str, built: Path, tmp_path: Path) -> None:
    if extra == "features" and sys.version_info >= (3, 13):
        pytest.skip("kiss-matcher has no wheel for Python 3.13 or later")
    (wheel,) = built.glob("*.whl")
    python = clean(tmp_path / "venv")
    pip(python, f"{wheel}[{extra}]")
    check = f"from jaxscan.extras import EXTRAS, extra; extra({extra!r}) if {extra!r} in EXTRAS else None"
    subprocess.run([str(python), "-c", check], check=True, cwd=tmp_path, timeout=300)


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("page", "script"), install_scripts())
def test_the_lines_run_as_they_are_written(page: str, script: str, built: Path, tmp_path: Path) -> None:
    """In a copy of the tree, its own Python first; the folder of the wheel stands for an index that has jaxscan."""
    copy = tmp_path / "jaxscan"
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    for name in listed.decode().split("\0"):
        if name and (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, copy / name)
    programs = clean(tmp_path / "venv").parent
    env = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    env |= {
        "PATH": f"{programs}:{env['PATH']}",
        "PIP_FIND_LINKS": str(built),
        "PIP_CONSTRAINT": str(ROOT / "constraints.txt"),
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
    }
    subprocess.run(["bash", "-euc", script], cwd=copy, env=env, check=True, timeout=1500, stdin=subprocess.DEVNULL)
    installed = copy / "venv" / "bin" if (copy / "venv").is_dir() else programs
    said = subprocess.run([str(installed / "jaxscan"), "--version"], cwd=tmp_path, capture_output=True, text=True)
    assert PROJECT["version"] in said.stdout, f"{page}: {script}"
