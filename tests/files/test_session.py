"""Calibration sessions: what the format allows, and every mistake with its fix."""

import argparse
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from jaxscan.calibration.model import Model
from jaxscan.cli.estimate_options import Estimate, add_estimate_arguments, estimate_asked
from jaxscan.cli.one_rig import stage_motion
from jaxscan.cli.solve_sessions import solve_sessions
from jaxscan.errors import InputError
from jaxscan.files.session import CameraSettings, Session, Views, read_session, write_session
from jaxscan.files.session_axes import StageImages
from jaxscan.images import Board, StripeSettings
from tests.other_lenses import Division, registered

BOARD = "[board]\ninner_corners = [9, 6]\nsquare_mm = 10.0\n"
LASERS = '[[laser]]\nname = "{}"\nstripes = "stripes/*.png"\n[[laser]]\nname = "{}"\nstripes = "stripes/*.png"'
VIEWS = '[views]\nboards = "boards/*.png"\n'


@pytest.fixture
def folder(tmp_path: Path, photographs) -> Path:
    """Three board photographs, numbered so that text order is not their order, three with stripe, three of a stage."""
    for kind in ("boards", "stripes", "stage"):
        photographs(tmp_path / kind, ["v10.png", "v2.png", "v1.png"])
    return tmp_path


def session(folder: Path, *parts: str) -> Session:
    (folder / "session.toml").write_text("\n".join(parts), encoding="utf-8")
    return read_session(folder)


def refusal(folder: Path, *parts: str) -> str:
    with pytest.raises(InputError) as caught:
        session(folder, *parts)
    message = str(caught.value)
    assert message.startswith(str(folder))
    return message


def test_the_least_session_has_the_defaults_of_the_format(folder):
    read = session(folder, BOARD, VIEWS)
    assert read == Session(
        path=folder / "session.toml",
        board=Board.checkerboard((9, 6), 10.0),
        views=Views(tuple(folder / "boards" / name for name in ("v1.png", "v2.png", "v10.png"))),
        camera=CameraSettings("radial1", "free"),
        image_size=(32, 24),
    )
    assert read_session(str(folder / "session.toml")) == read


def test_a_lens_that_was_registered(folder):
    asked = BOARD, VIEWS, '[camera]\nlens = "division"\nhold = ["camera.division.0"]'
    with registered(Division):
        assert session(folder, *asked).camera == CameraSettings("division", hold=("camera.division.0",))
    with pytest.raises(InputError, match=r"\[camera\] lens = \"division\": must be one of none, .*, splined$"):
        session(folder, *asked)


def test_everything_that_the_format_has(folder):
    read = session(
        folder,
        BOARD,
        '[camera]\nlens = "brown"\nprincipal_point = "centre"\nhold = ["camera.radial.2", "camera.focal.0"]',
        VIEWS,
        'stripes = ["stripes/v1.png", "", "stripes/v10.png"]',
        '[stage]\nimages = "stage/*.png"\nsteps = [-100000, 0, 2000]',
        '[laser]\ncolor = "green"\ncolumns = false',
    )
    assert read.camera == CameraSettings("brown", "centre", ("camera.focal.0", "camera.radial.2"))
    assert not read.camera.tilt
    assert read.views.stripes == {"": (folder / "stripes/v1.png", None, folder / "stripes/v10.png")}
    assert read.stage is not None
    assert read.stage.steps == (-100_000, 0, 2000)
    assert [path.name for path in read.stage.images] == ["v1.png", "v2.png", "v10.png"]
    assert read.lasers == (StripeSettings(color="green", columns=False),)


def test_the_kind_of_a_turntables_motion(folder):
    turn = TURN + "steps = [0, 400, 200]\n"
    assert session(folder, BOARD, VIEWS, turn).turntable.motion == "rotary"
    read = session(folder, BOARD, VIEWS, turn + 'motion = "rotary_with_play"')
    assert read.turntable.motion == "rotary_with_play"
    write_session(read)
    assert read_session(folder) == read
    said = refusal(folder, BOARD, VIEWS, turn + 'motion = "linear"')
    assert "[turntable] motion" in said
    assert "rotary, rotary_with_play" in said


def test_a_turntable_there_and_back(folder):
    parts = BOARD, VIEWS, '[turntable]\nimages = "stage/*.png"\nsteps_per_image = 400\nstage_step = -1000'
    read = session(folder, *parts)
    assert read.turntable is not None
    assert (read.turntable.steps, read.turntable.stage_step) == ((0, 400, 800), -1000)
    assert read.photographs()[-3:] == list(read.turntable.images)
    assert session(folder, BOARD, VIEWS, TURN + "steps = [0, 1, 5]").turntable.stage_step == 0
    write_session(read)
    assert read_session(folder) == read


def test_stripes_on_a_board_that_moves_there_and_back(folder):
    turn = '[turntable]\nimages = "stage/*.png"\nsteps_per_image = 400\n'
    read = session(folder, BOARD, VIEWS, turn + 'stripes = ["stage/v1.png", "", "stage/v10.png"]', "[laser]")
    assert read.turntable is not None
    first, _, last = read.turntable.images
    assert read.turntable.stripes == {"": (first, None, last)}
    write_session(read)
    assert read_session(folder) == read
    lasers = '[[laser]]\nname = "a"\nstripes = "stripes/*.png"\n[[laser]]\nname = "b"\nstripes = "stripes/*.png"\n'
    two = session(folder, BOARD, VIEWS, lasers, turn + '[turntable.stripes]\nb = "stage/*.png"')
    assert two.turntable is not None
    assert two.turntable.stripes == {"b": two.turntable.images}
    write_session(two)
    assert read_session(folder) == two
    with pytest.raises(InputError, match=r"\[turntable\] stripes.*2 photographs of the stripe for 3"):
        session(folder, BOARD, VIEWS, turn + 'stripes = ["stage/v1.png", "stage/v2.png"]', "[laser]")
    with pytest.raises(InputError, match=r"\[turntable\] stripes.*no laser"):
        session(folder, BOARD, VIEWS, turn + 'stripes = "stage/*.png"')


def test_one_photograph_of_one_pose_may_be_listed_for_all_that_it_shows(folder):
    """Board and stripe of a view; the stripes of two lasers; the turntable's first, on the way of the stage."""
    read = session(folder, BOARD, VIEWS + 'stripes = "boards/*.png"')
    assert read.views.stripes == {"": read.views.boards}
    session(folder, BOARD, VIEWS, LASERS.format("a", "b"))
    turn = '[turntable]\nimages = ["stage/v2.png", "boards/../stripes/v1.png", "stripes/v2.png"]\nsteps = {}\n'
    along = BOARD, VIEWS, '[stage]\nimages = "stage/*.png"\nsteps_per_image = 100'
    assert session(folder, *along, turn.format("[0, 5, 9]") + "stage_step = 100").turntable is not None
    for elsewhere in (turn.format("[0, 5, 9]"), turn.format("[1, 5, 9]") + "stage_step = 100"):
        assert '"stage/v2.png" stands under [stage] images and under [turntable]' in refusal(folder, *along, elsewhere)


def test_steps_per_image_count_from_zero(folder):
    stage = session(folder, BOARD, VIEWS, '[stage]\nimages = "stage/*.png"\nsteps_per_image = -2000').stage
    assert stage is not None
    assert stage.steps == (0, -2000, -4000)


@pytest.mark.parametrize(
    ("parts", "lasers", "stripes"),
    [
        ([VIEWS], 0, None),
        ([VIEWS, "[laser]"], 1, None),
        ([VIEWS, 'stripes = "stripes/*.png"'], 1, {""}),
        ([VIEWS, '[laser]\nstripes = "stripes/*.png"'], 1, {""}),
        ([VIEWS, '[[laser]]\nname = "a"\nstripes = "stripes/*.png"'], 1, {"a"}),
        ([VIEWS, LASERS.format("a", "b")], 2, {"a", "b"}),
    ],
)
def test_where_the_stripe_is_looked_for(folder, parts, lasers, stripes):
    read = session(folder, BOARD, *parts)
    assert len(read.lasers) == lasers
    assert (set(read.views.stripes) if read.views.stripes else None) == stripes


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ('kind = "checkerboard"\ninner_corners = [9, 6]\nsquare_mm = 10', Board.checkerboard((9, 6), 10.0)),
        ('kind = "circles"\ncircles = [7, 7]\npitch_mm = 37.5', Board.circles((7, 7), 37.5)),
        ('kind = "circles"\ncircles = [7, 7]\npitch_mm = 37.5\ndiameter_mm = 18', Board.circles((7, 7), 37.5, 18.0)),
        (
            'kind = "charuco"\nsquares = [10, 7]\nsquare_mm = 20\nmarker_mm = 15\ndictionary = "DICT_4X4_50"',
            Board.charuco((10, 7), 20.0, 15.0, "DICT_4X4_50"),
        ),
    ],
)
def test_boards_there_and_back(folder, text, board):
    read = session(folder, f"[board]\n{text}", VIEWS)
    assert read.board == board
    write_session(read)
    assert read_session(folder) == read


def test_the_shape_of_the_board_there_and_back(folder):
    read = session(folder, BOARD, 'shape = "bend"', VIEWS)
    assert read.board_shape == "bend"
    write_session(read)
    assert read_session(folder) == read
    assert '[board] shape = "curly"' in refusal(folder, BOARD, 'shape = "curly"', VIEWS)
    assert session(folder, BOARD, VIEWS).board_shape == "flat"


@pytest.mark.parametrize("names", [(), ("",), ("left",), ("left", "right")])
@pytest.mark.parametrize("own", [False, True])
def test_what_is_written_reads_the_same(folder, names, own):
    boards = tuple(folder / "boards" / f"v{i}.png" for i in (10, 1))
    stripes = {name: (folder / "stripes/v2.png", None) for name in names} if own or len(names) > 1 else None
    written = Session(
        path=folder / "session.toml",
        board=Board.checkerboard((7, 6), 12.345678901234567),
        views=Views(boards, stripes or None),
        camera=CameraSettings(
            "rational", "centre", ("camera.radial.5", "camera.tangential.0", "camera.tilt.0"), tilt=True
        ),
        stage=StageImages(tuple(folder / "stage" / path.name for path in boards), (5, -7)),
        lasers=tuple(StripeSettings(color="blue", columns=False, name=name) for name in names),
        image_size=(32, 24),
    )
    write_session(written)
    assert read_session(folder) == written


def test_photographs_elsewhere(tmp_path, folder, photographs):
    other = photographs(tmp_path / "other place [1]", ["a1.png", "a2.png"])
    read = session(folder, BOARD, f'[views]\nboards = "{other[0].parent.as_posix().replace("[1]", "[[]1]")}/*.png"')
    assert read.views.boards == tuple(other)
    assert session(folder, BOARD, f'[views]\nboards = ["{other[1].as_posix()}"]').views.boards == (other[1],)
    write_session(dataclasses.replace(read, path=folder / "boards" / "session.toml"))
    assert read_session(folder / "boards").views.boards == tuple(other)


def test_a_name_that_looks_like_a_pattern_and_globs_through_folders(folder, photographs):
    photographs(folder, ["a[1].png"])
    assert session(folder, BOARD, '[views]\nboards = "a[1].png"').views.boards == (folder / "a[1].png",)
    assert len(session(folder, BOARD, '[views]\nboards = "**/v*.png"').views.boards) == 9


def test_byte_order_mark_and_carriage_returns(folder):
    text = BOARD + VIEWS
    (folder / "session.toml").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert len(read_session(folder).views.boards) == 3


@pytest.mark.parametrize("name", ["etna-2", "etna-3", "opencv-left", "stage-boards"])
def test_real_sessions(data, name):
    read = read_session(data / name)
    assert len(read.views.boards) == {"etna-2": 8, "etna-3": 16, "opencv-left": 13, "stage-boards": 11}[name]
    assert read.image_size == ((1280, 1024) if "etna" in name else (640, 480))
    assert len(read.lasers) == ("etna" in name)


STAGE = '[stage]\nimages = "stage/*.png"\n'
STAGE_3 = STAGE + "steps_per_image = 2000\n"
TURN = '[turntable]\nimages = "stage/*.png"\n'

BAD = {
    "no board": ([VIEWS], ["board", "is missing"]),
    "no views": ([BOARD], ["views", "is missing", "held in the hand", "three poses"]),
    "board is a number": (["board = 3", VIEWS], ["board = 3", "must be a table"]),
    "mistyped table": ([BOARD, VIEWS, "[lazer]"], ["lazer", 'did you mean "laser"?']),
    "mistyped key": ([BOARD.replace("square_mm", "squares_mm"), VIEWS], ["[board] squares_mm = 10.0", '"square_mm"?']),
    "circles that touch": (
        ['[board]\nkind = "circles"\ncircles = [7, 7]\npitch_mm = 10\ndiameter_mm = 11', VIEWS],
        ["[board] diameter_mm = 11", "touch"],
    ),
    "key of another board": ([BOARD + "circles = [7, 7]", VIEWS], ["[board] circles = [7, 7]", "unknown key"]),
    "unknown kind": (['[board]\nkind = "hexagons"', VIEWS], ['[board] kind = "hexagons"', "checkerboard, circles"]),
    "one number of corners": ([BOARD.replace("[9, 6]", "[9]"), VIEWS], ["inner_corners = [9]", "columns, rows"]),
    "corners as text": ([BOARD.replace("[9, 6]", '"9x6"'), VIEWS], ['[board] inner_corners = "9x6"', "list"]),
    "too few corners": ([BOARD.replace("[9, 6]", "[9, 1]"), VIEWS], ["[board] inner_corners = [9, 1]", "3 or more"]),
    "no size": (["[board]\ninner_corners = [9, 6]", VIEWS], ["[board] square_mm", "is missing"]),
    "negative size": ([BOARD.replace("10.0", "-1"), VIEWS], ["[board] square_mm = -1", "positive"]),
    "size in other units": ([BOARD.replace("10.0", "1e9"), VIEWS], ["[board] square_mm = 1000000000.0", "to 100000"]),
    "size of no world": ([BOARD.replace("10.0", "1e300"), VIEWS], ["[board] square_mm = 1e+300", "at most 1e+18"]),
    "size not a number": ([BOARD.replace("10.0", "nan"), VIEWS], ["[board] square_mm = NaN", "finite"]),
    "size as text": ([BOARD.replace("10.0", '"10"'), VIEWS], ['[board] square_mm = "10"', "number"]),
    "unknown dictionary": (
        ['[board]\nkind="charuco"\nsquares=[9,6]\nsquare_mm=9\nmarker_mm=5\ndictionary="DICT_9"', VIEWS],
        ["[board] dictionary", "DICT_4X4_50"],
    ),
    "unknown lens": ([BOARD, VIEWS, '[camera]\nlens = "radial9"'], ['[camera] lens = "radial9"', "radial1, radial2"]),
    "no term of this lens": (
        [BOARD, VIEWS, '[camera]\nlens = "radial2"\nhold = ["camera.radial.2"]'],
        ["[camera] hold", 'of the lens "radial2"', "camera.radial.0, camera.radial.1"],
    ),
    "a name to hold": ([BOARD, VIEWS, '[camera]\nhold = "camera.radial.0"'], ["[camera] hold", "must be a list"]),
    "centre in American": ([BOARD, VIEWS, '[camera]\nprincipal_point = "center"'], ["principal_point", "free, centre"]),
    "glob without files": ([BOARD, '[views]\nboards = "board/*.png"'], ["[views] boards", "matches no file"]),
    "glob of a folder": ([BOARD, '[views]\nboards = "boards"'], ["[views] boards", "matches no file"]),
    "empty glob": ([BOARD, '[views]\nboards = ""'], ["[views] boards", "glob"]),
    "no boards": ([BOARD, "[views]"], ["[views] boards", "is missing"]),
    "boards a number": ([BOARD, "[views]\nboards = 3"], ["[views] boards = 3", "list of names"]),
    "numbers for names": ([BOARD, "[views]\nboards = [1, 2]"], ["[views] boards", "entry 0 is 1"]),
    "gap in boards": ([BOARD, '[views]\nboards = ["boards/v1.png", ""]'], ["[views] boards", 'entry 1 is ""']),
    "missing file": (
        [BOARD, '[views]\nboards = ["boards/v1.png", "boards/v3.png"]'],
        ["[views] boards", "1 of 2 files", "v3.png"],
    ),
    "name with a null": ([BOARD, '[views]\nboards = ["a\\u0000b"]'], ["[views] boards", "1 of 1 files"]),
    "glob with a null": ([BOARD, '[views]\nboards = "a\\u0000*"'], ["[views] boards", "matches no file"]),
    "name without end": ([BOARD, f'[views]\nboards = ["{"a" * 5000}"]'], ["[views] boards", "1 of 1 files"]),
    "named twice": ([BOARD, '[views]\nboards = ["boards/v1.png", "boards/v1.png"]'], ['"boards/v1.png" appears twice']),
    "named twice in two ways": ([BOARD, '[views]\nboards = ["boards/v1.png", "./boards/v1.png"]'], ["appears twice"]),
    "none named": ([BOARD, "[views]\nboards = []"], ["[views] boards = []", "names no photograph"]),
    "too few stripes": (
        [BOARD, VIEWS + 'stripes = ["stripes/v1.png"]'],
        ["[views] stripes", "1 photographs of the stripe for 3 of the board", "paired in order"],
    ),
    "stripe missing": ([BOARD, VIEWS + 'stripes = ["stripes/v1.png", "", "stripes/x.png"]'], ["stripes", "x.png"]),
    "stripes twice": (
        [BOARD, VIEWS + 'stripes = "stripes/*.png"\n[laser]\nstripes = "stripes/*.png"'],
        ["[views] stripes", "[laser] stripes is given too"],
    ),
    "whose stripes": ([BOARD, VIEWS + 'stripes = "stripes/*.png"', LASERS.format("a", "b")], ["each [[laser]]"]),
    "a sheet that is none": ([BOARD, VIEWS, '[laser]\nsheet = "round"'], ["[laser] sheet", "plane", "bowed"]),
    "a motion that is none": ([BOARD, VIEWS, STAGE_3 + 'motion = "rotary"'], ["[stage] motion", "linear", "guide"]),
    "a screw of no steps": ([BOARD, VIEWS, STAGE_3 + "screw_steps = 0"], ["[stage] screw_steps = 0", "above 0"]),
    "lasers of one name": ([BOARD, VIEWS, LASERS.format("a", "a")], ["[[laser]] name", '["a", "a"]']),
    "laser without stripes": (
        [BOARD, VIEWS, LASERS.format("a", "b").removesuffix('stripes = "stripes/*.png"')],
        ["[[laser]] 2: stripes", "is missing"],
    ),
    "laser is a number": (["laser = 3", BOARD, VIEWS], ["laser = 3", "[[laser]]"]),
    "purple": ([BOARD, VIEWS, '[laser]\ncolor = "purple"'], ['[laser] color = "purple"', "red, green, blue, grey"]),
    "colour": ([BOARD, VIEWS, '[laser]\ncolour = "red"'], ["[laser] colour", 'did you mean "color"?']),
    "columns as text": ([BOARD, VIEWS, '[laser]\ncolumns = "true"'], ['[laser] columns = "true"', "true or false"]),
    "steps of another number": ([BOARD, VIEWS, STAGE + "steps = [0, 1]"], ["[stage] steps", "2 step counts for 3"]),
    "no steps": ([BOARD, VIEWS, STAGE], ["[stage] steps", "is missing", "steps_per_image"]),
    "steps twice": ([BOARD, VIEWS, STAGE + "steps = [0, 1, 2]\nsteps_per_image = 3"], ["[stage] steps", "given too"]),
    "steps with fractions": ([BOARD, VIEWS, STAGE + "steps = [0, 1.0, 2]"], ["entry 1 is 1.0", "write 1"]),
    "half steps": ([BOARD, VIEWS, STAGE + "steps = [0, 1.5, 2]"], ["entry 1 is 1.5", "whole number"]),
    "steps true and false": ([BOARD, VIEWS, STAGE + "steps = [0, true, 2]"], ["entry 1 is true", "whole number"]),
    "steps as text": ([BOARD, VIEWS, STAGE + 'steps = [0, "1", 2]'], ['entry 1 is "1"', "whole number"]),
    "steps one number": ([BOARD, VIEWS, STAGE + "steps = 2000"], ["[stage] steps = 2000", "list of whole numbers"]),
    "steps beyond bounds": ([BOARD, VIEWS, STAGE + "steps = [0, 1, 99999999999999999]"], ["entry 2", "whole number"]),
    "steps all equal": ([BOARD, VIEWS, STAGE + "steps = [5, 5, 5]"], ["[stage] steps", "two different step counts"]),
    "turntable: too few": ([BOARD, VIEWS, TURN + "steps = [0, 9, 9]"], ["[turntable] steps", "at three different"]),
    "turntable: another number": (
        [BOARD, VIEWS, TURN + "steps = [0, 1]"],
        ["[turntable] steps", "2 step counts for 3"],
    ),
    "turntable: no steps": ([BOARD, VIEWS, TURN], ["[turntable] steps", "is missing", "steps_per_image"]),
    "turntable: it stands": (
        [BOARD, VIEWS, TURN + "steps_per_image = 0"],
        ["[turntable] steps_per_image = 0", "not move"],
    ),
    "turntable: stage_step": (
        [BOARD, VIEWS, TURN + "steps_per_image = 9\nstage_step = 0.5"],
        ["[turntable] stage_step"],
    ),
    "turntable: a key": ([BOARD, VIEWS, TURN + "steps_per_image = 9\nstep = 5"], ["[turntable] step", "did you mean"]),
    "on the stage and in the hand": (
        [BOARD, VIEWS, '[stage]\nimages = ["stage/v1.png", "stage/../boards/v2.png"]\nsteps_per_image = 9'],
        ["session.toml: ", '/boards/v2.png" stands under [views] boards and under [stage] images', "out of [views]"],
    ),
    "its stripe on the turntable, too": (
        [
            BOARD,
            VIEWS + 'stripes = "stripes/*.png"',
            TURN + 'steps_per_image = 9\nstripes = ["stripes/v1.png", "", ""]',
        ],
        ['"stripes/v1.png" stands under the stripes of [views] and under [turntable] stripes', "out of [views]"],
    ),
    "the stripe of another pose": (
        [BOARD, VIEWS + 'stripes = ["boards/v2.png", "", ""]'],
        ['"boards/v2.png" stands under the stripes of [views] and under [views] boards', "name it for one of them"],
    ),
    "on stage and turntable": (
        [BOARD, VIEWS, STAGE + "steps_per_image = 100", TURN + "steps_per_image = 9"],
        ['"stage/v2.png" stands under [stage] images and under [turntable] images', "name it for one of them"],
    ),
    "a stage that stands": ([BOARD, VIEWS, STAGE + "steps_per_image = 0"], ["steps_per_image = 0", "does not move"]),
}


@pytest.mark.parametrize("name", BAD)
def test_mistakes_are_named_with_their_mend(folder, name):
    parts, texts = BAD[name]
    message = refusal(folder, *parts)
    for text in texts:
        assert text in message


def test_a_photograph_of_another_size_is_named_with_both_sizes(folder, photographs):
    photographs(folder / "stage", ["v2.png"], (24, 32))
    message = refusal(folder, BOARD, VIEWS, STAGE, "steps_per_image = 1")
    assert "stage/v2.png: is 24 × 32 pixels" in message
    assert "boards/v1.png is 32 × 24" in message


def test_a_photograph_that_is_none_is_named(folder):
    (folder / "boards" / "v2.png").write_bytes(np.random.default_rng(0).bytes(1000))
    assert "boards/v2.png" in refusal(folder, BOARD, VIEWS)


def test_a_link_to_nothing_is_not_passed_over(folder):
    (folder / "boards" / "v4.png").symlink_to(folder / "nowhere.png")
    assert "matches v4.png, a broken link" in refusal(folder, BOARD, VIEWS)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "is empty"),
        (b"[board\n", "not valid TOML.*line 1"),
        (b"a = 1\na = 2\n", "not valid TOML.*line 2"),
        (b"\x00\xff\xfe" * 50, "is not text"),
        (b"a = " + b"[" * 100_000, "nested too deeply"),
        (b"a = " + b"9" * 5000, "not valid TOML"),
        (b"steps", "not valid TOML"),
    ],
)
def test_what_is_no_toml(tmp_path, content, text):
    (tmp_path / "session.toml").write_bytes(content)
    with pytest.raises(InputError, match=rf"(?s)session\.toml: .*{text}"):
        read_session(tmp_path)


def test_folders_and_missing_files(tmp_path):
    with pytest.raises(InputError, match=r"has no session\.toml"):
        read_session(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        read_session(tmp_path / "nowhere")
    (tmp_path / "session.toml").mkdir()
    with pytest.raises(InputError, match=r"has no session\.toml"):
        read_session(tmp_path)
    with pytest.raises(InputError, match=r"has no session\.toml"):
        read_session(tmp_path / "session.toml")


@pytest.mark.parametrize(("share", "problem"), [(0.0, "is empty"), (0.7, "is cut off after")])
def test_a_photograph_that_is_not_whole_is_found_before_any_work(folder, share, problem):
    photograph = folder / "boards" / "v2.png"
    data = photograph.read_bytes()
    photograph.write_bytes(data[: int(share * len(data))])
    message = refusal(folder, BOARD, VIEWS)
    assert message.startswith(str(photograph))
    assert problem in message


def test_sessions_of_one_rig_hold_the_same(folder):
    session(folder, BOARD, VIEWS)
    other = folder / "other.toml"
    other.write_text(f'{BOARD}{VIEWS}[camera]\nhold = ["camera.radial.0"]', encoding="utf-8")
    with pytest.raises(InputError, match=r"other.toml: its lens radial1, .*, camera.radial.0 held; those of"):
        solve_sessions([folder / "session.toml", other])


def test_sessions_of_one_rig_show_a_board_of_one_shape(folder):
    session(folder, BOARD, VIEWS)
    other = folder / "other.toml"
    other.write_text(f'{BOARD}shape = "warp"\n{VIEWS}', encoding="utf-8")
    with pytest.raises(InputError, match=r'other.toml: its board has shape = "warp", that of .* "flat"'):
        solve_sessions([folder / "session.toml", other])


def test_too_few_poses_are_refused_before_they_are_looked_at(folder, capsys):
    session(folder, BOARD, '[views]\nboards = ["boards/v1.png"]\n')
    with pytest.raises(InputError, match=r"the board is shown in 1 pose; at least 3 are needed") as refused:
        solve_sessions([folder])
    assert str(refused.value).startswith(str(folder))
    assert "finding boards" not in capsys.readouterr().err


def test_too_few_poses_for_the_board_s_shape_are_refused_before_they_are_looked_at(folder, capsys):
    """The photographs were searched before."""
    session(folder, BOARD, VIEWS)
    text = r'3 usable views of the board; board_shape = "bend" needs 6, .* or ask for board_shape = "flat"'
    with pytest.raises(InputError, match=text) as refused:
        solve_sessions([folder], estimate=Estimate(board_shape="bend"))
    assert str(refused.value).startswith(f"{folder}: ")
    assert "finding boards" not in capsys.readouterr().err


def test_a_turntable_away_from_a_stage_that_nobody_shows(folder, capsys):
    """It was said after the photographs had been looked at, and without the file."""
    session(folder, BOARD, VIEWS, TURN + "steps = [0, 1, 5]\nstage_step = 1800")
    with pytest.raises(InputError, match=r"session.toml: \[turntable\] stage_step = 1800: no \[stage\] says how far"):
        solve_sessions([folder])
    assert "finding boards" not in capsys.readouterr().err


def test_the_limit_of_speckle_needs_a_laser(folder):
    session(folder, BOARD, VIEWS)
    with pytest.raises(InputError, match=r"has no \[laser\], and --f-number, --wavelength-nm and --pixel-um are for"):
        solve_sessions([folder], needs_laser=True)


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r"gone: there is no such file or folder"):
        read_session(tmp_path / "gone")


def test_the_sheet_of_each_laser_is_said_and_written(folder):
    assert session(folder, BOARD, VIEWS, "[laser]").sheets == ()
    assert session(folder, BOARD, VIEWS, '[laser]\nsheet = "plane"').sheets == ()
    lasers = LASERS.format("a", "b").replace('name = "b"', 'name = "b"\nsheet = "bowed"')
    read = session(folder, BOARD, VIEWS, lasers)
    assert read.sheets == ("plane", "bowed")
    write_session(read)
    assert read_session(folder) == read


def test_sessions_of_one_rig_have_one_sheet(folder, tmp_path, photographs):
    other = tmp_path / "other"
    photographs(other / "boards", ["v10.png", "v2.png", "v1.png"])
    (folder / "session.toml").write_text("\n".join([BOARD, VIEWS, "[laser]"]))
    (other / "session.toml").write_text("\n".join([BOARD, VIEWS, '[laser]\nsheet = "bowed"']))
    with pytest.raises(InputError, match=r"other: its .laser. sheet is bowed, that of .* is plane: sessions"):
        solve_sessions([folder, other])


def test_a_sheet_of_the_command_line_takes_the_place_of_the_sessions(folder):
    read = session(folder, BOARD, VIEWS, LASERS.format("a", "b"))
    assert Estimate().sheets(read) == ("plane", "plane")
    assert Estimate(sheet="bowed").sheets(read) == ("bowed", "bowed")
    assert Estimate(sheet="plane").sheets(dataclasses.replace(read, sheets=("plane", "bowed"))) == ("plane", "plane")
    without = session(folder, BOARD, VIEWS)
    with pytest.raises(InputError, match=r"has no \[laser\], and --sheet needs one"):
        solve_sessions([without.path], estimate=Estimate(sheet="bowed"))
    parser = argparse.ArgumentParser()
    add_estimate_arguments(parser)
    parser.add_argument("--camera")
    with pytest.raises(InputError, match="--sheet round: this version knows plane, bowed"):
        estimate_asked(parser.parse_args(["--sheet", "round"]))


def test_the_motion_of_the_stage_is_said_and_written(folder):
    plain = session(folder, BOARD, VIEWS, STAGE_3)
    assert (plain.stage.motion, plain.stage.screw_steps) == ("linear", None)
    write_session(plain)
    assert "motion" not in (folder / "session.toml").read_text()
    read = session(folder, BOARD, VIEWS, STAGE_3 + 'motion = "screw_on_guide"\nscrew_steps = 3200')
    assert (read.stage.motion, read.stage.screw_steps) == ("screw_on_guide", 3200)
    write_session(read)
    assert read_session(folder) == read


def test_sessions_of_one_rig_have_one_motion(folder, tmp_path, photographs):
    other = tmp_path / "other"
    photographs(other / "boards", ["v10.png", "v2.png", "v1.png"])
    photographs(other / "stage", ["s0.png", "s1.png", "s2.png"])
    (folder / "session.toml").write_text("\n".join([BOARD, VIEWS, STAGE_3]))
    (other / "session.toml").write_text("\n".join([BOARD, VIEWS, STAGE_3 + 'motion = "guide"']))
    with pytest.raises(InputError, match=r'other: its .stage. has motion = "guide", no screw_steps, that of .*linear"'):
        solve_sessions([folder, other])


def test_a_motion_of_the_command_line_needs_a_stage(folder):
    without = session(folder, BOARD, VIEWS)
    with pytest.raises(InputError, match=r"has no \[stage\], and --motion needs one"):
        solve_sessions([without.path], estimate=Estimate(stage_motion="guide"))
    parser = argparse.ArgumentParser()
    add_estimate_arguments(parser)
    parser.add_argument("--camera")
    with pytest.raises(InputError, match="--motion rotary: a stage's is one of linear, guide, screw, screw_on_guide"):
        estimate_asked(parser.parse_args(["--motion", "rotary"]))
    assert estimate_asked(parser.parse_args(["--motion", "screw"])).stage_motion == "screw"


def test_the_motion_reaches_the_solve(folder):
    """The session and the command line name the motion; a screw's turn is there only where the motion has a screw."""
    read = session(folder, BOARD, VIEWS, STAGE_3 + 'motion = "screw"\nscrew_steps = 3200')

    def asked(motion=None):
        return stage_motion([read.path], [read], Estimate(stage_motion=motion))

    assert asked() == ({"stage": "screw"}, {"stage": 3200.0})
    assert asked("screw_on_guide") == ({"stage": "screw_on_guide"}, {"stage": 3200.0})
    motion, periods = asked("linear")
    assert Model(motion=motion, periods=periods).asked()["periods"] == {}


@pytest.mark.parametrize(("kind", "fewest"), [("guide", 4), ("screw", 8)])
def test_too_few_places_for_a_motion_are_refused_before_they_are_looked_at(folder, capsys, kind, fewest):
    """The photographs were searched before, and the kind was not named."""
    session(folder, BOARD, VIEWS, '[stage]\nimages = "stage/*.png"\nsteps = [0, 100, 200]')
    text = (
        rf"3 usable stage photographs .* at least {fewest} are needed to find a motion of the kind {kind}: photograph"
    )
    with pytest.raises(InputError, match=text) as refused:
        solve_sessions([folder], estimate=Estimate(stage_motion=kind))
    assert str(refused.value).startswith(f"{folder}: ")
    assert "finding boards" not in capsys.readouterr().err
