"""Photographs that are listed in alphabetical order are pointed out, and those in any other order are not."""

from pathlib import Path

import pytest

from jaxscan.calibration.observe import _in_text_order
from jaxscan.files.scan import Scan
from jaxscan.files.session import Session, Views
from jaxscan.files.session_axes import StageImages
from jaxscan.files.text_order import text_order_note
from jaxscan.images import Board, StripeSettings
from jaxscan.reconstruction.scan_notes import order_notes

COUNT = 24
TAKEN = [Path("left", f"frame{i}.png") for i in range(COUNT)]
AS_TEXT = sorted(TAKEN, key=str)
STEPS = tuple(range(0, 80 * COUNT, 80))


@pytest.mark.parametrize("form", ["frame{}.png", "frame{}_on.png", "{}.jpg", "2026-{}-a.png"])
def test_alphabetical_order_is_pointed_out(form):
    paths = sorted((Path("left", form.format(i)) for i in range(COUNT)), key=str)
    note = text_order_note("frames", paths, [STEPS])
    assert note is not None
    assert note.startswith("frames are listed in alphabetical order, ")
    two, last = form.format(2), form.format(19)
    assert f"{two} after {last}, not by" in note or "_on" in form
    # Numbers may have been filled up with zeros since.
    filled = [Path("left", f"{int(path.stem[5:]):03d}.png") for path in AS_TEXT]
    assert "002.png after 019.png" in str(text_order_note("frames", filled))


def test_other_orders_are_not_spoken_of():
    filled = [Path(f"{i:03d}.png") for i in range(COUNT)]
    times = [Path(f"{t}.png") for t in ("1700.1", "1700.15", "1700.2", "1700.25", "1700.3")]
    hand = [Path(f"{name}.png") for name in ("front", "left", "back", "right", "top", "under")]
    for paths in (TAKEN, TAKEN[::-1], filled, times, hand, AS_TEXT[:3], []):
        assert text_order_note("frames", paths) is None
    # Each was listed with its own steps.
    own = tuple(80 * TAKEN.index(path) for path in AS_TEXT)
    assert text_order_note("frames", AS_TEXT, [own, (5,) * COUNT]) is None
    assert text_order_note("frames", AS_TEXT, [STEPS, own]) is not None


def test_a_scan_says_it_of_frames_or_else_of_its_laser_off_photographs():
    def said(frames: list[Path], dark: list[Path], **more: object) -> list[str]:
        scan = Scan(
            Path("scan.toml"),
            StripeSettings(),
            tuple(frames),
            backgrounds=tuple(dark),
            **{"axes": {"stage": STEPS}, **more},
        )
        return order_notes(scan)

    assert said(TAKEN, TAKEN) == []
    (note,) = said(AS_TEXT, AS_TEXT)
    assert note.startswith("frames are listed")
    (note,) = said(TAKEN, AS_TEXT)
    assert note.startswith("the photographs of background are listed")
    # By their names, poses belong to their photographs.
    assert said(AS_TEXT, [], poses=Path("poses.csv")) == []


def test_a_session_says_it_of_photographs_with_steps():
    board = Board.checkerboard((7, 5), 10.0)
    views = Views(tuple(AS_TEXT))
    listed, taken = (StageImages(tuple(paths), STEPS) for paths in (AS_TEXT, TAKEN))
    assert _in_text_order(Session(Path("session.toml"), board, views, stage=taken)) == []
    (note,) = _in_text_order(Session(Path("session.toml"), board, views, stage=listed))
    assert note.startswith("[stage] images are listed in alphabetical order")
