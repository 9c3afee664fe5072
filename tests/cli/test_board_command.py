"""`jaxscan board`: a page, and a session that has the same board."""

from pathlib import Path

import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.files.session import read_session
from jaxscan.images import write_image


@pytest.mark.parametrize("kind", ["checkerboard", "circles", "charuco"])
def test_the_session_has_the_board_that_is_printed(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = ["board", "-o", str(tmp_path / "b.pdf"), "--kind", kind, "--square", "20", "--session", str(tmp_path / "s")]
    assert main(argv) == 0
    said = capsys.readouterr().out
    assert "at 100 %" in said
    for folder in ("boards", "stage"):
        (tmp_path / "s" / folder).mkdir()
        for i in range(3):
            write_image(tmp_path / "s" / folder / f"{i}.png", np.zeros((4, 6, 3), np.uint8))
    session = read_session(tmp_path / "s")
    assert (session.board.kind, session.board.pitch_mm) == (kind, 20.0)
    assert session.stage is not None
    assert len(session.stage.images) == len(session.views.boards) == 3
    assert main(argv) == 2
    assert "is there already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--board 9", "--board 9: give columns and rows, as 9x6"),
        ("--board 9x²", "--board 9x²: give columns and rows, as 9x6"),
        ("--board 9x٣", "--board 9x٣: give columns and rows, as 9x6"),
        ("--board 0x6", "--board 0x6: give columns and rows, as 9x6"),
        ("--board 9x6x2", "--board 9x6x2: give columns and rows, as 9x6"),
        ("--marker 5", "--marker: only a board of --kind charuco has it"),
        ("--kind charuco --marker 30", "marker_mm = 30.0: a marker stands inside a square"),
        ("--kind charuco --dictionary DICT_9", 'dictionary = "DICT_9"'),
        ("--square 40", "too large for A4"),
        ("--board 2x2", "inner_corners"),
    ],
)
def test_what_cannot_be_is_refused(words: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["board", "-o", str(tmp_path / "b.svg"), *words.split()]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
