"""What the photographs of a session must not be, and what is said of it."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxscan.calibration import View
from jaxscan.calibration.observations import StripePoints
from jaxscan.calibration.observe import _across, _miscoloured, _no_bell, _once, _Photograph, _radius, observe
from jaxscan.errors import InputError
from jaxscan.files.session import read_session
from jaxscan.images import Board, StripeSettings
from jaxscan.images.find import BoardView
from tests.images import render


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A photograph of a board of 5 x 4 corners, and one of nothing."""
    folder = tmp_path_factory.mktemp("session")
    H = render.homography([[-10, -10], [50, -10], [50, 40], [-10, 40]], [[40, 40], [280, 50], [270, 210], [50, 200]])
    image = render.photograph(render.checkerboard((5, 4), 10.0), H, (240, 320), noise=1.0)
    cv2.imwrite(str(folder / "board.png"), image.clip(0, 255).astype(np.uint8))
    # The laser alone is seen.
    dark = np.full((240, 320), 3, np.uint8)
    dark[118:123] = 200
    cv2.imwrite(str(folder / "dark.png"), dark)
    return folder


@pytest.mark.parametrize(
    ("counts", "views", "said"),
    [
        ("[6, 5]", 'boards = ["board.png"]', r"board\.png shows one of 5 x 4\. .* inner_corners = \[5, 4\]"),
        (
            "[5, 4]",
            'boards = ["dark.png"]\nstripes = ["board.png"]',
            r"board\.png, .* exchange boards and stripes",
        ),
        ("[5, 4]", 'boards = ["dark.png"]', r"dark\.png is nearly black: photograph the board with a lamp"),
        ("[9, 7]", 'boards = ["board.png"]', r"check \[board\]"),
    ],
)
def test_why_the_board_is_nowhere(folder: Path, counts: str, views: str, said: str) -> None:
    (folder / "session.toml").write_text(f"[board]\ninner_corners = {counts}\nsquare_mm = 10\n[views]\n{views}\n")
    with pytest.raises(InputError, match=said):
        observe(read_session(folder))


def test_a_copy_of_a_photograph_counts_once() -> None:
    def photograph(name: str, corners: np.ndarray | None) -> _Photograph:
        return _Photograph(name, None if corners is None else BoardView(corners, None, False), (), False)

    a, b = np.random.default_rng(0).uniform(0, 100, (2, 20, 2))
    given = [photograph(*each) for each in (("0", a), ("1", None), ("2", b), ("3", a.copy()), ("4", None))]
    once, repeated = _once(given)
    assert [photograph.name for photograph in once if photograph.found is not None] == ["0", "2"]
    assert repeated == ["3: a copy of 0, which counts once"]


def test_a_copy_on_the_stage_counts_once_and_one_among_the_views_does_not_count(folder: Path) -> None:
    """A copy on the stage has another step count, at which the board did not stand."""
    image = cv2.imread(str(folder / "board.png"), 0)
    cv2.imwrite(str(folder / "moved.png"), np.roll(image, 3, axis=0))
    cv2.imwrite(str(folder / "held.png"), np.roll(image, 5, axis=0))
    for name in ("again.png", "as_view.png"):
        cv2.imwrite(str(folder / name), image)
    (folder / "session.toml").write_text(
        "[board]\ninner_corners = [5, 4]\nsquare_mm = 10\n[views]\nboards = ['held.png', 'as_view.png']\n"
        "[stage]\nimages = ['board.png', 'moved.png', 'again.png']\nsteps_per_image = 100\n"
    )
    found = observe(read_session(folder))
    assert found.left_out == (
        "as_view.png: a copy of board.png, which counts once",
        "again.png: a copy of board.png, which counts once",
    )
    (stage,) = found.sequences
    assert [view.name for view in stage.views] == ["board.png", "moved.png"]
    assert list(stage.steps) == [0.0, 100.0]
    assert [view.name for view in found.views] == ["held.png"]


def test_hot_pixels_of_the_camera_are_left_out(tmp_path: Path) -> None:
    """They made the stripe of a rig twice as noisy, and its own advice was a brighter one."""
    random = np.random.default_rng(0)
    places = tuple(random.integers(0, (240, 320), (40, 2)).T)
    for name, level in (("clean", 0), ("hot", 230)):
        (tmp_path / name).mkdir()
        for i in range(9):
            corners = np.add([[40, 40], [280, 50], [270, 210], [50, 200]], (3 * i, 2 * i))
            H = render.homography([[-10, -10], [50, -10], [50, 40], [-10, 40]], corners)
            image = render.photograph(render.checkerboard((5, 4), 10.0), H, (240, 320), noise=1.0, seed=i) * 0.3
            image[118:123] += 120 * np.exp(-0.5 * ((np.arange(5) - 2) / 1.2)[:, None] ** 2)
            image[places] = np.maximum(image[places], level)
            cv2.imwrite(str(tmp_path / name / f"{i}.png"), image.clip(0, 255).astype(np.uint8))
        (tmp_path / name / "session.toml").write_text(
            "[board]\ninner_corners = [5, 4]\nsquare_mm = 10\n[views]\nboards = '*.png'\n[laser]\ncolor = 'grey'\n"
        )
    clean, hot = (observe(read_session(tmp_path / name), detector="gravity") for name in ("clean", "hot"))
    assert not any("hot pixels" in note for note in clean.notes)
    assert sum("hot pixels of the sensor" in note for note in hot.notes) == 1
    pairs = zip(clean.views, hot.views, strict=True)
    off = [view.stripes[0].pixels[:, 1] - other.stripes[0].pixels[:, 1] for view, other in pairs]
    assert np.nanmean(np.abs(off)) < 0.005


def test_the_stripe_is_looked_for_where_the_session_says_so(folder: Path) -> None:
    """In a photograph of its own, or in that of the board; where nothing is said of it nothing is looked for."""
    image = cv2.imread(str(folder / "board.png"))
    lit = image.astype(float)
    lit[118:123, :, 2] += 150
    cv2.imwrite(str(folder / "lit.png"), lit.clip(0, 255).astype(np.uint8))
    cv2.imwrite(str(folder / "moved.png"), np.roll(image, 3, axis=0))
    cv2.imwrite(str(folder / "first.png"), np.roll(image, 1, axis=1))
    cv2.imwrite(str(folder / "first_lit.png"), np.roll(lit, 1, axis=1).clip(0, 255).astype(np.uint8))
    text = (
        "[board]\ninner_corners = [5, 4]\nsquare_mm = 10\n[views]\nboards = ['board.png']\nstripes = ['lit.png']\n"
        "[laser]\n[stage]\nimages = ['first.png', 'moved.png']\nsteps_per_image = 100\n"
    )
    (folder / "session.toml").write_text(text)
    assert [view.stripes for view in observe(read_session(folder), detector="gravity").sequences[0].views] == [(), ()]
    (folder / "session.toml").write_text(text + "stripes = ['first_lit.png', '']\n")
    first, second = observe(read_session(folder), detector="gravity").sequences[0].views
    assert second.stripes == ()
    (stripe,) = first.stripes
    seen = stripe.pixels[np.isfinite(stripe.pixels).all(axis=1)]
    assert len(seen) > 100
    assert abs(np.median(seen[:, 1]) - 120) < 0.5


@pytest.mark.parametrize("columns", [True, False])
def test_a_stripe_that_is_looked_for_the_wrong_way(columns: bool) -> None:
    """A level stripe; a single point far from it does not turn it round."""
    level = np.stack([np.linspace(0, 600, 101), np.linspace(200, 300, 101)], axis=-1)
    level[7] = [300, 4000]
    level[9] = np.nan
    stripe = StripePoints(level, columns, 0, 1.0, None)
    views = [View("0", np.zeros((4, 2)), None, (stripe,)), View("1", np.zeros((4, 2)), None, ())]
    laser = StripeSettings(columns=columns)
    notes = _across([laser], views)
    assert len(notes) == (0 if columns else 1)
    assert all("from left to right" in note and "columns = true" in note for note in notes)
    turned = [replace(views[0], stripes=(replace(stripe, pixels=level[:, ::-1]),))]
    assert [("up and down" in note, "columns = false" in note) for note in _across([laser], turned)] == (
        [(True, True)] if columns else []
    )


def test_a_stripe_of_another_colour_is_pointed_out() -> None:
    """Once most photographs say so, and where the laser is not grey."""

    def notes(*brighter: str | None) -> list[str]:
        stripes = [StripePoints(np.zeros((1, 2)), brighter=one) for one in brighter]
        return _miscoloured([StripeSettings("green")], [View("0", np.zeros((4, 2)), None, (s,)) for s in stripes])

    assert notes("red", None, None) == notes() == []
    (note,) = notes("red", "red", None)
    assert 'set color = "red"' in note


def test_a_stripe_that_is_no_bell_is_pointed_out() -> None:
    lasers = [StripeSettings(name="upper"), StripeSettings(name="lower")]

    def notes(*odd: bool, black: float = 0.0) -> list[str]:
        stripes = [StripePoints(np.zeros((1, 2)), laser=1, odd=one, black=black) for one in odd]
        unseen = StripePoints(np.full((1, 2), np.nan), laser=1)
        return _no_bell(lasers, [View("0", np.zeros((4, 2)), None, (s, unseen)) for s in stripes])

    assert notes() == notes(False) == notes(True, False, False) == []
    (note,) = notes(True, False, True)
    assert note.startswith("the stripe of laser lower: its cross-section is not bell-shaped, all along it, in 2 of 3")
    assert "too small: focus camera and laser, " in note
    assert "switch off a gamma curve in the camera, raise a black level that cuts off what is dark, or" in note
    (note,) = notes(True, black=0.6)
    assert "too small: raise a black level that cuts off what is dark (60% of the pixels are 0), focus" in note


def test_the_circles_radius_is_given_or_that_of_most_photographs():
    views = [BoardView(np.zeros((9, 2)), None, True, radius) for radius in (0.2, 0.21, 0.4, np.nan)]
    assert _radius(Board.circles((3, 3), 10.0), views) == pytest.approx(2.1)
    assert _radius(Board.circles((3, 3), 10.0, 5.0), views) == 2.5
    assert _radius(Board.checkerboard((3, 4), 10.0), [BoardView(np.zeros((12, 2)), np.ones(12), False)]) == 0


def test_corners_as_opencv_gives_them() -> None:
    corners = np.arange(108.0).reshape(54, 2)
    np.testing.assert_array_equal(View("a", corners.astype(np.float32)[:, None]).corners, corners)
    with pytest.raises(InputError, match=r"a: corners has the shape \(54, 2, 2\): give \(points, 2\)"):
        View("a", np.zeros((54, 2, 2)))


def test_three_equal_channels_are_no_colours(folder: Path) -> None:
    image = cv2.imread(str(folder / "board.png"))
    image[118:123] = 250
    cv2.imwrite(str(folder / "equal.png"), image)
    (folder / "session.toml").write_text(
        "[board]\ninner_corners = [5, 4]\nsquare_mm = 10\n[views]\nboards = ['equal.png']\n[laser]\ncolor = 'blue'\n"
    )
    with pytest.raises(InputError, match=r'equal\.png: .*the laser\'s colour is blue: write color = "grey"'):
        observe(read_session(folder))


def test_a_detector_that_there_is_not_is_named_before_any_work(folder: Path) -> None:
    with pytest.raises(InputError, match='no detector "steger": use one of likelihood, gravity'):
        observe(read_session(folder), detector="steger")
