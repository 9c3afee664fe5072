"""Sessions whose light moves: several stripes on each board, with the positions of the light's axis."""

from pathlib import Path

import numpy as np
import pytest

from jaxscan.cli.format_summary import format_summary
from jaxscan.cli.summary import session_summary
from jaxscan.errors import InputError
from jaxscan.files.session import read_session, write_session
from jaxscan.files.shared import listed_once
from jaxscan.images.decode import write_image

HEAD = "[board]\ninner_corners = [9, 6]\nsquare_mm = 16\n"


def session(folder: Path, views: str, laser: str = 'sheet = "swept"', boards: int = 2, stripes: int = 6) -> Path:
    folder.mkdir(exist_ok=True)
    for name, count in (("b", boards), ("s", stripes)):
        for i in range(count):
            write_image(folder / f"{name}{i}.png", np.full((8, 8), 10 * i + ord(name), np.uint8))
    (folder / "session.toml").write_text(f"{HEAD}[views]\n{views}\n[laser]\n{laser}\n")
    return folder


GOOD = 'boards = "b*.png"\nstripes = "s*.png"\nstripe_steps = [0, 50, 90]'


def test_each_board_has_its_stripes_with_their_steps(tmp_path):
    read = read_session(session(tmp_path, GOOD))
    assert read.light_axes == {"": "sweep"}
    assert [[(step, path.name) for step, path in read.views.lit("", i)] for i in (0, 1)] == [
        [(0, "s0.png"), (50, "s1.png"), (90, "s2.png")],
        [(0, "s3.png"), (50, "s4.png"), (90, "s5.png")],
    ]
    assert [path.name for path in read.photographs()] == ["b0.png", "b1.png", *(f"s{i}.png" for i in range(6))]


@pytest.mark.parametrize(
    ("views", "laser"),
    [
        (GOOD, 'sheet = "swept"\naxis = "mirror"'),
        (GOOD.replace("[0, 50, 90]", "[0, 50, 90, 5, 55, 95]"), 'sheet = "swept"'),
        ('boards = "b*.png"\nstripes = ["s0.png", "", "s2.png", "s3.png"]\nstripe_steps = [3, 4]', 'sheet = "swept"'),
        ('boards = "b*.png"\nstripe_steps = [3, 4]', 'sheet = "swept"'),
    ],
)
def test_it_is_written_and_read_back(tmp_path, views, laser):
    read = read_session(session(tmp_path, views, laser))
    write_session(read)
    again = read_session(tmp_path)
    assert again.views == read.views
    assert again.light_axes == read.light_axes
    assert again.sheets == ("swept",)


def test_a_board_has_one_stripe_at_each_position(tmp_path):
    with pytest.raises(InputError, match=r"stripe_steps = .*: 2 stripes on b1.png are at step 50"):
        read_session(session(tmp_path, GOOD.replace("[0, 50, 90]", "[0, 50, 90, 0, 50, 50]")))


def test_it_is_shown(tmp_path):
    found = session_summary(session(tmp_path, GOOD))
    sweep = {"axis": "sweep", "boards": 2, "photographs": 6, "positions": [0, 50, 90]}
    assert found["lasers"][0]["sweep"] == sweep
    said = format_summary(found)
    assert "in 6 photographs, sheet swept" in said
    assert '2 boards × 3 positions of axis "sweep": 0, 50, 90' in said


def test_several_lasers_have_steps_of_their_own(tmp_path):
    views = 'boards = "b*.png"'
    laser = 'name = "a"\nsheet = "swept"\nstripes = ["s0.png", "s1.png"]\nstripe_steps = [7]\n'
    still = 'name = "b"\nstripes = ["s2.png", "s3.png"]\n'
    folder = session(tmp_path, views)
    (folder / "session.toml").write_text(f"{HEAD}[views]\n{views}\n[[laser]]\n{laser}\n[[laser]]\n{still}")
    read = read_session(folder)
    assert read.light_axes == {"a": "sweep"}
    assert [[(step, path.name) for step, path in read.views.lit(name, 1)] for name in "ab"] == [
        [(7, "s1.png")],
        [(0, "s3.png")],
    ]
    write_session(read)
    assert read_session(folder).views == read.views


@pytest.mark.parametrize(
    ("views", "laser", "match"),
    [
        ('boards = "b*.png"\nstripes = "s*.png"', 'sheet = "swept"', "stripe_steps: is missing: the light is moved"),
        (GOOD.replace("[0, 50, 90]", "[0, 50]"), 'sheet = "swept"', "2 positions for 3 stripes on each board: give 3"),
        (GOOD.replace('"s*.png"', '["s0.png"]'), 'sheet = "swept"', "1 photographs of the stripe for 2 of the board"),
        (GOOD, "columns = true", 'stripe_steps .*stands still: leave it out, or set sheet = "swept"'),
        (GOOD, 'sheet = "swept"\naxis = "a b"', "is no name of an axis"),
        ('boards = "b*.png"', 'axis = "mirror"', 'a sheet that is "plane" stands still'),
    ],
)
def test_what_does_not_go_together_is_refused(tmp_path, views, laser, match):
    with pytest.raises(InputError, match=match):
        read_session(session(tmp_path, views, laser))


def test_stripes_on_a_stage_are_refused(tmp_path):
    folder = session(tmp_path, GOOD)
    with (folder / "session.toml").open("a") as file:
        file.write('[stage]\nimages = ["b0.png", "b1.png"]\nsteps = [0, 9]\nstripes = ["s0.png", "s1.png"]\n')
    with pytest.raises(InputError, match="has its stripes on boards under \\[views\\]"):
        read_session(folder)


def test_photographs_that_two_sessions_list_count_once(tmp_path):
    """The second session has one more board, and one more stripe of the first board."""
    first = read_session(
        session(tmp_path, 'boards = ["b0.png"]\nstripes = ["s0.png", "s1.png"]\nstripe_steps = [0, 5]')
    )
    views = 'boards = "b*.png"\nstripes = ["s0.png", "s2.png", "s3.png", "s4.png"]\nstripe_steps = [0, 9, 0, 5]'
    second = read_session(session(tmp_path, views))
    (one, rest), notes = listed_once([first, second])
    assert [(step, path.name) for step, path in one.views.lit("", 0)] == [(0, "s0.png"), (5, "s1.png"), (9, "s2.png")]
    assert [path.name for path in rest.views.boards] == ["b1.png"]
    assert [(step, path.name) for step, path in rest.views.lit("", 0)] == [(0, "s3.png"), (5, "s4.png")]
    assert len(notes) == 1
