"""Photographs that two sessions list: each counts once, where both say the same of it."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxscan.calibration import Observations
from jaxscan.cli.solve_sessions import solve_sessions
from jaxscan.errors import InputError
from jaxscan.files.session import Session, read_session
from jaxscan.files.shared import listed_once
from tests.images import render

BOARD = "[board]\ninner_corners = [5, 4]\nsquare_mm = 10.0\n"


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """Two sessions' folders, a and b, and beside them photographs that both can name, no two alike."""
    for kind in ("boards", "stripes", "stage"):
        (tmp_path / kind).mkdir()
        for i in range(4):
            assert cv2.imwrite(str(tmp_path / kind / f"{i}.png"), np.full((24, 32), 40 * i + len(kind), np.uint8))
    return tmp_path


def session(room: Path, name: str, boards: list[str], rest: str = "", stripes: list[str] | None = None) -> Session:
    (room / name).mkdir(exist_ok=True)
    own = "" if stripes is None else f"stripes = {stripes}\n"
    (room / name / "session.toml").write_text(f"{BOARD}[views]\nboards = {boards}\n{own}{rest}", encoding="utf-8")
    return read_session(room / name)


def names(*kinds: str) -> list[str]:
    return [f"../{kind}.png" for kind in kinds]


def test_a_board_photograph_of_two_sessions_counts_once(room):
    first = session(room, "a", names("boards/0", "boards/1", "boards/2"))
    stage = f"[stage]\nimages = {names('stage/0', 'stage/1')}\nsteps_per_image = 100\n"
    second = session(room, "b", names("boards/1", "boards/3", "boards/2"), stage)
    (same, rest), (note,) = listed_once([first, second])
    assert same == first
    assert [path.name for path in rest.views.boards] == ["3.png"]
    assert rest.stage == second.stage
    assert note.startswith(f"2 photographs count once, listed by {first.path} and by {second.path}: 1.png, 2.png")


def test_links_and_copies_are_the_photograph_itself(room):
    (room / "link.png").symlink_to(room / "boards" / "0.png")
    shutil.copy(room / "boards" / "1.png", room / "copy.png")
    first = session(room, "a", names("boards/0", "boards/1"))
    (_, rest), (note,) = listed_once([first, session(room, "b", names("link", "copy", "boards/2"))])
    assert [path.name for path in rest.views.boards] == ["2.png"]
    assert "2 photographs count once" in note


def test_sessions_that_share_nothing_stay_as_they_are(room):
    given = [session(room, "a", names("boards/0", "boards/1")), session(room, "b", names("boards/2", "boards/3"))]
    assert listed_once(given) == (given, [])


def test_a_stripe_that_only_the_second_session_names_stays_with_its_board(room):
    first = session(room, "a", names("boards/0", "boards/1"), stripes=[*names("stripes/0"), ""])
    second = session(room, "b", names("boards/1", "boards/2"), stripes=names("stripes/1", "stripes/2"))
    (one, rest), _ = listed_once([first, second])
    stripes = [[path and path.name for path in (own.views.stripes or {})[""]] for own in (one, rest)]
    assert stripes == [["0.png", "1.png"], ["2.png"]]


def test_runs_that_share_a_photograph_are_one_run(room):
    """The board stood in one place: left apart, the second would lose what ties it to the shared photograph."""

    def run(images: list[str], steps: list[int]) -> str:
        return f"[stage]\nimages = {images}\nsteps = {steps}\n"

    first = session(room, "a", names("boards/0"), run(names("stage/0", "stage/1"), [0, 200]))
    second = session(room, "b", names("boards/1"), run(names("stage/1", "stage/2"), [200, 100]))
    (one, rest), _ = listed_once([first, second])
    assert one.stage is not None
    assert [path.name for path in one.stage.images] == ["0.png", "2.png", "1.png"]
    assert one.stage.steps == (0, 100, 200)
    assert rest.stage is None
    assert [path.name for path in rest.views.boards] == ["1.png"]


@pytest.mark.parametrize(
    ("boards", "rest", "stripes", "said"),
    [
        (
            names("boards/3"),
            f"[stage]\nimages = {names('boards/0', 'stage/1')}\nsteps = [4000, 0]\n",
            names("stripes/3"),
            r"is a photograph of the board in .*/a/session.toml, and an image at step 4000 of the stage in .*/b/",
        ),
        (
            names("boards/3"),
            f"[stage]\nimages = {names('stage/0', 'stage/1')}\nsteps = [0, 50]\n",
            names("stripes/3"),
            r"stage/1.png: is an image at step 100 of the stage in .*, and an image at step 50 of the stage in",
        ),
        (names("boards/0"), "", names("stripes/1"), r"boards/0.png: the stripe in its pose is .*stripes/0.png in "),
        (names("boards/3"), "", names("stripes/0"), r"is the stripe in the pose of .*0.png in .* of .*3.png in .*/b/"),
    ],
)
def test_contradictions_are_refused(room, boards, rest, stripes, said):
    stage = f"[stage]\nimages = {names('stage/0', 'stage/1')}\nsteps = [0, 100]\n"
    first = session(room, "a", names("boards/0"), stage, names("stripes/0"))
    with pytest.raises(InputError, match=said):
        listed_once([first, session(room, "b", boards, rest, stripes)])


def test_what_is_shared_is_looked_at_and_solved_once(room, monkeypatch):
    """σ is that of one session: the second adds nothing but a note."""
    corners = [[-10, -10], [50, -10], [50, 40], [-10, 40]]
    for i in range(4):
        H = render.homography(corners, [[40 + 9 * i, 40], [280, 50 + 9 * i], [270 - 9 * i, 210], [50, 200]])
        image = render.photograph(render.checkerboard((5, 4), 10.0), H, (240, 320), noise=1.0)
        assert cv2.imwrite(str(room / "boards" / f"{i}.png"), image.clip(0, 255).astype(np.uint8))
    every = names(*(f"boards/{i}" for i in range(4)))
    session(room, "a", every)
    session(room, "b", every[::-1])
    solved: list[Observations] = []
    monkeypatch.setattr(
        "jaxscan.calibration.calibrate_by_evidence", lambda observations, *_, **__: solved.append(observations)
    )
    solve_sessions([room / "a"])
    solve_sessions([room / "a", room / "b"])
    alone, both = solved
    assert [view.name for view in both.views] == [view.name for view in alone.views] == every
    np.testing.assert_array_equal([view.corners for view in both.views], [view.corners for view in alone.views])
    assert [note for note in both.notes if note not in alone.notes] == [
        f"4 photographs count once, listed by {room}/a/session.toml and by {room}/b/session.toml: "
        "3.png, 2.png, 1.png and 1 more"
    ]
