"""The outermost layer: statuses, streams and words, whatever a command does."""

import argparse
import json
import os
import subprocess
import sys
import types
import warnings
from collections.abc import Callable
from typing import Any

import pytest

from hardware.cli import main as scanner
from jaxscan.cli import main as cli
from jaxscan.errors import InputError, SolveError


@pytest.fixture
def command(monkeypatch) -> Callable[..., None]:
    """Put a command `try` in place of all the others, which does what it is given."""

    def install(run: Callable[[argparse.Namespace], Any]) -> None:
        module: Any = types.ModuleType("jaxscan_test_command")
        module.HELP = "try something"
        module.EXAMPLE = "jaxscan try 3"
        module.add_arguments = lambda parser: parser.add_argument("number", type=int)
        module.run = run
        module.describe = lambda result: f"the answer is {result['answer']}"
        monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setattr(cli, "COMMANDS", {"try": module.__name__})

    return install


def fail(error: BaseException) -> Callable[[argparse.Namespace], Any]:
    def run(args: argparse.Namespace) -> None:
        raise error

    return run


def test_words_and_json(command, capsys):
    command(lambda args: {"answer": 2 * args.number, "é": None})
    assert cli.main(["try", "21"]) == 0
    assert capsys.readouterr() == ("the answer is 42\n", "")
    assert cli.main(["try", "21", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == {"answer": 42, "é": None}
    assert err == ""


def test_a_command_without_a_result_prints_nothing(command, capsys):
    command(lambda args: None)
    assert cli.main(["try", "1"]) == 0
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("error", "status", "text"),
    [
        (InputError("a.toml: [scan] steps: wrong"), 2, "jaxscan: error: a.toml: [scan] steps: wrong\n"),
        (SolveError("no minimum"), 1, "jaxscan: error: no minimum\n"),
        (OSError(28, "No space left on device", "out.ply"), 1, "jaxscan: error: out.ply: No space left on device\n"),
        (KeyboardInterrupt(), 130, "jaxscan: interrupted\n"),
    ],
)
def test_errors_become_words_and_a_status(command, capsys, error, status, text):
    command(fail(error))
    assert cli.main(["try", "1"]) == status
    assert capsys.readouterr() == ("", text)


def test_the_unexpected_is_said_to_be_our_fault(command, capsys, monkeypatch):
    command(fail(ZeroDivisionError("division by zero")))
    assert cli.main(["try", "1"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("jaxscan: unexpected error: ZeroDivisionError: division by zero")
    assert "Traceback" not in err
    assert cli.main(["try", "1", "--debug"]) == 1
    assert "Traceback" in capsys.readouterr().err
    monkeypatch.setenv("JAXSCAN_DEBUG", "1")
    assert cli.main(["try", "1"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_a_result_that_is_no_json_is_a_fault(command, capsys):
    command(lambda args: {"answer": float("nan")})
    assert cli.main(["try", "1", "--json"]) == 1
    assert "unexpected error" in capsys.readouterr().err


def test_warnings_are_one_line_each(command, capsys):
    def run(args: argparse.Namespace) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn("rig.json: passed over: colour", UserWarning, stacklevel=1)

    command(run)
    assert cli.main(["try", "1"]) == 0
    assert capsys.readouterr() == ("", "jaxscan: warning: rig.json: passed over: colour\n")


@pytest.mark.parametrize("argv", [[], ["nonsense"], ["try"], ["try", "x"], ["try", "1", "--nonsense"]])
def test_bad_usage_is_status_2(command, capsys, argv):
    command(lambda args: None)
    assert cli.main(argv) == 2
    err = capsys.readouterr().err
    assert err.startswith("jaxscan")
    assert err.endswith(" --help lists what it takes\n")
    assert err.count("\n") == 2


@pytest.mark.parametrize(
    ("main", "argv", "usage", "said"),
    [
        (
            cli.main,
            "calibrate --repot x",
            "jaxscan calibrate",
            "unrecognized arguments: --repot; did you mean --report?",
        ),
        (cli.main, "reconstruct a --rgi r.json", "jaxscan reconstruct", "--rgi; did you mean --rig?"),
        (cli.main, "mesh a.npz --fil=x", "jaxscan mesh", "argument --fill: 'x' is not a finite number"),
        (cli.main, "calibrate s --qqq", "jaxscan calibrate", "unrecognized arguments: --qqq\n"),
        (cli.main, "calibrat s", "jaxscan", "); did you mean calibrate?"),
        (cli.main, "calibrate s --detector gravty", "jaxscan calibrate", "); did you mean gravity?"),
        (cli.main, "--vesion calibrate s", "jaxscan", "unrecognized arguments: --vesion; did you mean --version?"),
        (scanner.main, "scan cup --frmes 3", "scanner scan", "--frmes; did you mean --frames?"),
        (scanner.main, "scna cup", "scanner", "); did you mean scan?"),
    ],
)
def test_what_is_misspelt_is_told_by_its_command(main, argv, usage, said, capsys):
    assert main(argv.split()) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"{usage}: error: ")
    assert err.endswith(f"{usage} --help lists what it takes\n")
    assert said in err


@pytest.mark.parametrize("argv", ["calibrate a -o r.json b", "calibrate -o r.json a b", "merge a -o m.stl b"])
def test_options_may_stand_between_the_files(argv):
    args = cli.parser_of(cli.Program("jaxscan", "", cli.COMMANDS)).parse_args(argv.split())
    files = args.session if "calibrate" in argv else args.scans
    assert [str(path) for path in files] == ["a", "b"]


def test_help_has_an_example(command, capsys):
    command(lambda args: None)
    assert cli.main(["try", "--help"]) == 0
    out = capsys.readouterr().out
    assert "Try something." in out
    assert "example:\n  jaxscan try 3" in out
    assert cli.main(["--help"]) == 0
    assert "try something" in capsys.readouterr().out


def test_version(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("jaxscan 0.")


@pytest.mark.parametrize(("module", "name"), [("jaxscan", "jaxscan"), ("hardware", "scanner")])
def test_as_a_module(module, name):
    command = [sys.executable, "-m", module, "--version"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.startswith(f"{name} 0.")


def test_a_reader_that_goes_away_is_no_accident(tmp_path):
    (tmp_path / "rig.json").write_text(
        '{"format": "jaxscan-rig/1", "units": "mm", "camera": {"image_size": [2, 2], "focal": [1, 1], '
        '"principal": [1, 1], "lens": "none"}}'
    )
    command = [sys.executable, "-m", "jaxscan", "inspect", str(tmp_path / "rig.json")]
    read_end, write_end = os.pipe()
    os.close(read_end)
    done = subprocess.run(command, stdout=write_end, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    os.close(write_end)
    assert done.returncode == 1
    # A command that takes long says so; nothing else is said.
    assert [line for line in done.stderr.splitlines() if not line.startswith("inspect: ")] == []
