"""`dev.py`: what it does before anything is installed."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import dev


@pytest.fixture
def nothing_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    def set_up(extra: str) -> None:
        raise AssertionError(f"{extra} is being installed")

    monkeypatch.setattr(dev, "set_up", set_up)


@pytest.mark.parametrize(
    ("words", "said"),
    [("bench --help", "usage: python -m benchmarks"), ("bench -h", "--only"), ("demo --help", "usage: jaxscan demo")],
)
@pytest.mark.usefixtures("nothing_installed")
def test_help_of_what_is_here_needs_no_installation(
    words: str, said: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["dev.py", *words.split()])
    assert dev.main() == 0
    assert said in capfd.readouterr().out


@pytest.mark.usefixtures("nothing_installed")
def test_what_runs_is_installed_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["dev.py", "bench", "--only", "metric"])
    with pytest.raises(AssertionError, match="dev is being installed"):
        dev.main()


def test_the_benchmarks_list_needs_the_standard_library_alone(capfd: pytest.CaptureFixture[str]) -> None:
    """As the Python of a machine has it, on which nothing is installed."""
    import subprocess

    done = subprocess.run(
        [sys.executable, "-S", "-m", "benchmarks", "--help"], cwd=dev.ROOT, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert "throughput" in done.stdout


def test_a_python_is_found_if_it_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for version, works in (("3.98.2", True), ("3.98.10", False), ("3.99.0", False)):
        program = tmp_path / "versions" / version / "bin" / "python"
        program.parent.mkdir(parents=True)
        program.write_text(f"#!/bin/sh\nexit {int(not works)}\n")
        program.chmod(0o755)
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path))
    assert dev.python_of("3.98") == str(tmp_path / "versions" / "3.98.2" / "bin" / "python")
    assert dev.python_of("3.99") is None
    own = f"{sys.version_info.major}.{sys.version_info.minor}"
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / f"python{own}").symlink_to(sys.executable)
    assert dev.python_of(own) == str(tmp_path / "bin" / f"python{own}")


def test_each_python_that_is_here_is_tested_with_the_newest(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran = []

    def run(argv: list, **rest: object) -> SimpleNamespace:
        ran.append([str(word) for word in argv])
        return SimpleNamespace(returncode=3 if "pytest" in str(argv[0]) and ".venv-3.12" in str(argv[0]) else 0)

    monkeypatch.setattr(dev, "python_of", lambda version: None if version == "3.13" else f"/python{version}")
    monkeypatch.setattr(dev, "_processor", bytes)
    monkeypatch.setattr(dev.subprocess, "run", run)
    assert dev.newest([]) == 3
    assert "Python 3.13: not on this machine, not tested" in capsys.readouterr().out
    tests = [words for words in ran if words[0].endswith("pytest")]
    assert [words[0].split("/")[-3] for words in tests] == [".venv-3.11", ".venv-3.12"]
    assert all("--ignore=tests/hardware" in words for words in tests)
    assert not any("constraints.txt" in word for words in ran for word in words)
    assert dev.newest(["3.11"]) == 0
    # Nothing tested is no success.
    assert dev.newest(["3.13"]) == 1
