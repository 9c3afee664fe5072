"""Every option that takes numbers takes them with a minus in front."""

import argparse

import pytest

from hardware.cli import main as scanner
from jaxscan.cli import main as jaxscan
from jaxscan.cli.detector_options import depths_of
from jaxscan.reconstruction.sheet_band import check_depths

PROGRAMS = (jaxscan.Program("jaxscan", "", jaxscan.COMMANDS), jaxscan.Program("scanner", "", scanner.COMMANDS))
TEXTS = ("-1", "-.5", "-1e-3", *(",".join(["-2"] * count) for count in range(2, 8)), "-1,2,3:-4,5,6:7,8,9", "-1:2")


def parsers() -> dict[str, argparse.ArgumentParser]:
    """The parser of every command, by its name."""
    return {
        f"{program.name} {name}": parser
        for program in PROGRAMS
        for action in jaxscan.parser_of(program)._actions
        if isinstance(action, argparse._SubParsersAction)
        for name, parser in action.choices.items()
    }


def accepted(action: argparse.Action) -> list[str]:
    """The texts that it would take as its value, if they reached it."""
    texts = []
    for text in TEXTS:
        try:
            if action.nargs != 0 and (action.type is None or (callable(action.type) and action.type(text) is not None)):
                texts.append(text)
        except (ValueError, argparse.ArgumentTypeError):
            continue
    return [] if action.choices else texts


CASES = [
    pytest.param(parser, action, texts, id=f"{name} {(action.option_strings or [action.dest])[-1]}")
    for name, parser in parsers().items()
    for action in parser._actions
    if (texts := accepted(action))
]


@pytest.mark.parametrize(("parser", "action", "texts"), CASES)
def test_a_negative_value_is_a_value(parser, action, texts, monkeypatch):
    others = [other for other in parser._actions if other is not action]
    for needed in (*others, *parser._mutually_exclusive_groups):
        monkeypatch.setattr(needed, "required", False)
    monkeypatch.setattr(parser, "_actions", [action, *(other for other in others if other.option_strings)])
    for text in texts:
        texts_given = [text] * (action.nargs if isinstance(action.nargs, int) else 1)
        value = getattr(parser.parse_args([*action.option_strings[-1:], *texts_given]), action.dest)
        assert value not in (None, action.default)


def test_the_options_that_take_numbers_are_among_them():
    assert {"jaxscan compare --region", "jaxscan mesh --crop", "jaxscan mesh --floor", "jaxscan merge --turn"} <= {
        case.id for case in CASES
    }


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e999"])
@pytest.mark.parametrize(
    "words",
    [
        "merge a.npz b.npz -o c.stl --turn",
        "merge a.npz b.npz -o c.stl --cube",
        "merge a.npz b.npz -o c.stl --turn 90 --fit-turntable",
        "mesh a.npz -o c.stl --grid",
        "mesh a.npz -o c.stl --fill",
        "mesh a.npz --plateaus --plateau-area",
        "simulate world --noise",
    ],
)
def test_what_is_no_finite_number_is_refused_before_any_work(words, text, capsys):
    option = words.split()[-1]
    assert jaxscan.main([*words.split()[:-1], f"{option}={text}"]) == 2
    assert f"argument {option}: '{text}' is no" in capsys.readouterr().err.replace("is not a", "is no")


@pytest.mark.parametrize("words", ["mesh a.npz -o c.stl --crop=-1,-1,nan,1,1,1", "compare a.ply --region=0,0,inf,1"])
def test_not_finite_among_others(words, capsys):
    assert jaxscan.main(words.split()) == 2
    assert "finite numbers with commas between them" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["reconstruct scan --rig rig.json -o a.ply", "batch scans --rig rig.json -o out"])
def test_depths_without_an_end(command):
    """`0,inf` is what the help and the refusal of other depths advise."""
    args = jaxscan.parser_of(PROGRAMS[0]).parse_args([*command.split(), "--depths", "0,inf"])
    check_depths(depths_of(args) or (0.0, 0.0))


@pytest.mark.parametrize("text", ["nan,200", "200", "near,far"])
def test_depths_that_are_none(text, capsys):
    assert jaxscan.main(f"reconstruct scan --rig rig.json -o a.ply --depths {text}".split()) == 2
    assert f"argument --depths: '{text}' is not 2 numbers with commas" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["nan", "inf", "0", "-8", "f/8", "0,8"])
@pytest.mark.parametrize("command", ["calibrate session --report report", "inspect cup.npz --rig rig.json"])
def test_optics_that_no_lens_has(command, text, capsys):
    optics = f"--f-number={text} --wavelength-nm 650 --pixel-um 3.45"
    assert jaxscan.main([*command.split(), *optics.split()]) == 2
    assert f"argument --f-number: '{text}' is not " in capsys.readouterr().err


@pytest.mark.parametrize("command", ["calibrate session --report report", "inspect cup.npz --rig rig.json"])
@pytest.mark.parametrize(
    ("optics", "said"),
    [
        ("--f-number 8 --wavelength-nm 0.65 --pixel-um 4.8", "--wavelength-nm 0.65: in nanometres "),
        ("--f-number 8 --wavelength-nm 650e-9 --pixel-um 4.8", "--wavelength-nm 6.5e-07: in nanometres "),
        ("--f-number 8 --wavelength-nm 650 --pixel-um 4800", "--pixel-um 4800: in micrometres "),
        ("--f-number 80 --wavelength-nm 650 --pixel-um 4.8", "--f-number 80: focal length over "),
    ],
)
def test_optics_in_another_unit(command, optics, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cup.npz").touch()
    assert jaxscan.main([*command.split(), *optics.split()]) == 2
    assert f"error: {said}" in capsys.readouterr().err
