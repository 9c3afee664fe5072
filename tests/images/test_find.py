import cv2
import jax
import numpy as np
import pytest
import render

from jaxscan.errors import InputError
from jaxscan.images import Board, carry_order, find_board, read_image
from jaxscan.images.order import order_grid

SHAPE = (300, 400)
BOARD = Board.checkerboard((7, 6), 10.0)
EXTENT = [[-10, -10], [70, -10], [70, 60], [-10, 60]]
SEEN = np.array([[62, 45], [345, 60], [330, 262], [48, 240]], float)


def placed(extent=EXTENT, turn=0.0, at=SEEN):
    """The homography of a board seen in perspective, turned about the image's middle."""
    middle = np.array([199.5, 149.5])
    c, s = np.cos(turn), np.sin(turn)
    return render.homography(extent, (at - middle) @ np.array([[c, s], [-s, c]]) * (0.8 if turn else 1) + middle)


def to_bytes(image, dtype=np.uint8, gain=1.0):
    return np.rint(image * gain).clip(0, np.iinfo(dtype).max).astype(dtype)


def photograph(board=BOARD, H=None, **how):
    pattern = render.checkerboard(board.counts, board.pitch_mm)
    return render.photograph(pattern, placed() if H is None else H, SHAPE, **{"blur": 0.8, **how})


def distances(view, H, board=BOARD):
    return np.linalg.norm(view.corners - render.project(H, board.points()), axis=1)


@pytest.fixture(scope="module")
def sharp():
    return photograph(blur=0)


@pytest.mark.parametrize(("blur", "noise", "bound"), [(0, 0, 0.03), (0.7, 0, 0.02), (0.7, 2, 0.025), (1.5, 2, 0.04)])
def test_corners_are_exact_to_a_few_hundredths_of_a_pixel(sharp, blur, noise, bound):
    image = cv2.GaussianBlur(sharp, (0, 0), blur) if blur else sharp
    image = to_bytes(image + noise * np.random.default_rng(0).standard_normal(SHAPE))
    errors = distances(find_board(BOARD, image), placed())
    assert np.sqrt(np.mean(errors**2)) < bound
    # OpenCV's own refinement, from the truth, with the window that suits it best.
    start = render.project(placed(), BOARD.points()).astype(np.float32).reshape(-1, 1, 2)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    theirs = (cv2.cornerSubPix(image, start.copy(), (7, 7), (-1, -1), stop) - start)[:, 0]
    assert np.sqrt(np.mean(errors**2)) < np.sqrt(np.mean(np.sum(theirs**2, axis=1)))


def test_sigma_tells_the_errors_and_goes_with_its_corner(sharp):
    image = cv2.GaussianBlur(sharp, (0, 0), 0.8) + 2 * np.random.default_rng(1).standard_normal(SHAPE)
    # A finger over the last corners, which are then not seen.
    u, v = np.rint(render.project(placed(), BOARD.points())[-1]).astype(int)
    image[v - 6 :, u - 6 :] = 110
    view = find_board(BOARD, to_bytes(image))
    seen = np.isfinite(view.sigma)
    np.testing.assert_array_equal(seen, np.isfinite(view.corners).all(axis=1))
    assert not seen[-1]
    assert seen.sum() >= len(seen) - 4
    assert 0.7 < np.sqrt(np.mean((distances(view, placed())[seen] / view.sigma[seen]) ** 2) / 2) < 1.4


def test_depth_and_darkness_do_not_matter(sharp):
    image = cv2.GaussianBlur(sharp, (0, 0), 0.8)
    for dtype, gain in ((np.uint16, 15.0), (np.uint16, 250.0), (np.uint8, 0.15)):
        errors = distances(find_board(BOARD, to_bytes(image, dtype, gain)), placed())
        assert np.sqrt(np.mean(errors**2)) < 0.03
    colour = np.repeat(to_bytes(image)[..., None], 3, axis=-1)
    np.testing.assert_allclose(find_board(BOARD, colour).corners, find_board(BOARD, to_bytes(image)).corners, atol=0.01)


@pytest.mark.parametrize("turn", [0.4, 2.9, -1.7])
def test_the_same_corner_is_first_however_the_board_is_turned(turn):
    H = placed(turn=turn)
    view = find_board(BOARD, to_bytes(photograph(H=H)))
    assert not view.ambiguous
    # The renderer's first square, diagonally outside the first corner, is dark: this is the documented order.
    assert distances(view, H).max() < 0.2


@pytest.mark.parametrize("turn", [0.0, 2.9])
def test_a_stripe_over_the_only_inner_row_turns_no_board(turn):
    """It takes a corner of every square, so that none is left to tell dark from light by."""
    board = Board.checkerboard((4, 3), 10.0)
    H = placed([[-10, -10], [40, -10], [40, 30], [-10, 30]], turn)
    truth = render.project(H, board.points())
    stripe = np.zeros(SHAPE, np.uint8)
    cv2.line(stripe, *(np.rint(end).astype(int).tolist() for end in truth[[4, 7]]), 255, 7)
    view = find_board(board, to_bytes(np.maximum(photograph(board, H), cv2.GaussianBlur(stripe, (0, 0), 0.8))))
    grid = view.corners.reshape(3, 4, 2)
    assert np.isnan(grid[1, 1:3]).all()
    assert np.nanmax(np.linalg.norm(grid - truth.reshape(3, 4, 2), axis=-1)) < 6


def test_an_ambiguous_board_turns_clockwise_and_is_carried_along_a_stage():
    board = Board.checkerboard((5, 5), 10.0)
    extent = [[-10, -10], [50, -10], [50, 50], [-10, 50]]
    at = np.array([[100, 45], [305, 50], [300, 250], [95, 240]], float)
    previous, end = None, None
    for turn in (0.1, 0.9, 1.7):
        H = placed(extent, turn, at)
        view = find_board(board, to_bytes(photograph(board, H)))
        assert view.ambiguous
        truth = render.project(H, board.points())
        x, y = view.corners[1] - view.corners[0], view.corners[5] - view.corners[0]
        assert x[0] * y[1] - x[1] * y[0] > 0
        corners = view.corners if previous is None else carry_order(board, previous, view.corners)
        either = [np.abs(corners - order).max() for order in (truth, truth[::-1])]
        assert min(either) < 0.2
        assert end in (None, np.argmin(either))
        end, previous = np.argmin(either), corners


def test_carrying_an_order_leaves_a_unique_one_alone_and_skips_what_was_not_seen():
    corners = np.random.default_rng(0).uniform(0, 100, (42, 2))
    assert carry_order(BOARD, corners[::-1], corners) is corners
    board = Board.circles((3, 4), 5.0)
    grid = board.points()[:, :2] * 4
    previous = grid + 0.5
    previous[2] = np.nan
    np.testing.assert_array_equal(carry_order(board, previous, grid[::-1]), grid)


@pytest.mark.parametrize(
    ("before", "now"), [("left", "left"), ("left", "right"), ("left", "first"), ("first", "first")]
)
def test_hidden_points_make_no_order_the_nearer(before, now):
    board = Board.circles((6, 5), 10.0)
    H = placed([[-10, -10], [60, -10], [60, 50], [-10, 50]])
    truth = render.project(H, board.points())
    x, y = board.points()[:, :2].T
    hidden = {"left": x < 30, "right": x >= 30, "first": (x > 15) | (y > 15)}
    previous = np.where(hidden[before][:, None], np.nan, truth + np.array([12, -9]))
    corners = np.where(hidden[now][:, None], np.nan, truth)
    for found in (corners, corners[::-1]):
        np.testing.assert_array_equal(carry_order(board, previous, found), corners)


def test_a_hidden_outermost_corner_does_not_leave_an_order_mirrored():
    board = Board.circles((6, 5), 10.0)
    truth = render.project(placed([[-10, -10], [60, -10], [60, 50], [-10, 50]]), board.points())
    truth[[0, -1]] = np.nan
    mirrored = truth.reshape(5, 6, 2)[::-1].reshape(-1, 2)
    np.testing.assert_array_equal(order_grid(board, mirrored, np.zeros(SHAPE, np.uint8)), truth)


def test_a_small_light_board_on_a_dark_ground():
    H = placed(at=SEEN * 0.3 + [120, 90])
    image = photograph(H=H)
    x, y = render.project(np.linalg.inv(H), np.stack(np.mgrid[:400, :300], axis=-1).reshape(-1, 2)).T
    off_paper = (np.abs(x - 30) > 45) | (np.abs(y - 25) > 40)
    image[off_paper.reshape(400, 300).T] = 5
    assert distances(find_board(BOARD, to_bytes(image)), H).max() < 0.3


@pytest.mark.parametrize("seed", [10, 15, 26])
def test_a_small_board_in_a_dark_scene_with_lamps_needs_no_slow_finder(monkeypatch, seed):
    """A fifth of the image's width; spreading the levels cuts off what the plain photograph shows."""
    image = dark_scene(seed)
    monkeypatch.setattr("cv2.findChessboardCornersSB", lambda *_, **__: (False, None))
    assert find_board(Board.checkerboard((9, 6), 10.0), image) is not None


def test_a_board_that_the_first_finder_misses_costs_no_search_for_thresholds(monkeypatch):
    """A stripe across the board is such a case; the thresholds take ten times as long as both finders before them."""
    asked = []

    def misses(_, counts, flags):
        asked.append(flags)
        return False, None

    monkeypatch.setattr("cv2.findChessboardCorners", misses)
    assert distances(find_board(BOARD, to_bytes(photograph())), placed()).max() < 0.2
    assert asked == [cv2.CALIB_CB_NORMALIZE_IMAGE]


@pytest.mark.parametrize("seed", [12, 16, 25, 39, 48, 55])
def test_a_bright_stripe_across_many_corners(seed):
    """Of a grey camera: no colour tells the stripe from the board. Of 60 seeds all are found, without an opening 50."""
    rng = np.random.default_rng(seed)
    outline = np.array([[0, 0], [80, 0], [80, 50], [0, 50]])
    at, turn = np.array([rng.uniform(80, 330), rng.uniform(80, 220)]), rng.uniform(-0.3, 0.3)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    H = render.homography(outline, 2.6 * outline @ R.T + at + rng.uniform(-15, 15, (4, 2)))
    board = render.checkerboard((9, 6), 10.0)

    def pattern(x, y):
        paper = (x > -18) & (x < 98) & (y > -18) & (y < 68)
        return np.where(paper, np.where(board(x, y), 1.0, 0.2), 0.0)

    image = render.photograph(pattern, H, (480, 640), dark=6.0, light=75.0, blur=0.7)
    ends = np.array([[-15.0, rng.uniform(5, 45)], [95.0, rng.uniform(5, 45)]])
    (u0, v0), (u1, v1) = render.project(H, ends)
    v, u = np.mgrid[:480, :640]
    stripe = 400 * np.exp(-0.5 * ((v - v0 - (v1 - v0) / (u1 - u0) * (u - u0)) / 1.5) ** 2)
    image += np.where(image > 10, stripe, 0) * np.where(image > 37, 1, 0.3)
    view = find_board(Board.checkerboard((9, 6), 10.0), to_bytes(image + rng.normal(0, 1.5, image.shape)))
    # Corners that the stripe covers are left out.
    seen = np.isfinite(view.corners[:, 0])
    assert seen.sum() >= 30
    assert distances(view, H, Board.checkerboard((9, 6), 10.0))[seen].max() < 0.3


def dark_scene(seed):
    rng = np.random.default_rng(seed)
    corners_mm = np.array([[0, 0], [80, 0], [80, 50], [0, 50]])
    at, turn = np.array([rng.uniform(150, 400), rng.uniform(120, 300)]), rng.uniform(-0.4, 0.4)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    H = render.homography(corners_mm, 1.28 * corners_mm @ R.T + at + rng.uniform(-4, 4, (4, 2)))
    board = render.checkerboard((9, 6), 10.0)

    def pattern(x, y):
        paper = (x > -13) & (x < 93) & (y > -13) & (y < 63)
        return np.where(paper, np.where(board(x, y), 1.0, 0.15), 0.0)

    light = rng.uniform(25, 60)
    image = render.photograph(pattern, H, (480, 640), dark=rng.uniform(2, 8), light=light, blur=0.7)
    v, u = np.mgrid[:480, :640]
    for _ in range(rng.integers(2, 9)):
        across, down, size = rng.uniform(0, 640), rng.uniform(0, 480), rng.uniform(4, 40)
        if abs(across - at[0] - 50) >= 110 or abs(down - at[1] - 30) >= 90:
            spot = np.exp(-((u - across) ** 2 + (v - down) ** 2) / 2 / size**2)
            image += rng.uniform(40, 260) * spot
    return to_bytes(image + rng.uniform(0.5, 2.5) * rng.standard_normal(image.shape))


@pytest.mark.parametrize("inverted", [False, True])
def test_circles(inverted):
    board = Board.circles((6, 5), 10.0)
    H = placed([[-10, -10], [60, -10], [60, 50], [-10, 50]])
    image = render.photograph(render.circles(board.counts, 10.0, 2.5), H, SHAPE, blur=0.8, noise=1)
    view = find_board(board, to_bytes(240 - image if inverted else image))
    assert view.ambiguous
    truth = render.project(H, board.points())
    errors = min((np.linalg.norm(view.corners - order, axis=1) for order in (truth, truth[::-1])), key=np.max)
    # A few hundredths of it are perspective: the middle of an ellipse is not the image of the circle's.
    assert errors.max() < 0.08
    np.testing.assert_allclose(view.radius, 0.25, rtol=0.01)


def test_charuco_whole_and_in_part():
    board = Board.charuco((7, 6), 10.0, 7.0, "DICT_4X4_50")
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    dots = 60
    print_ = cv2.aruco.CharucoBoard((7, 6), 10.0, 7.0, dictionary).generateImage((7 * dots, 6 * dots))

    def pattern(x, y):
        i, j = (np.floor((c / 10 + 1) * dots).astype(int) for c in (x, y))
        inside = (i >= 0) & (i < 7 * dots) & (j >= 0) & (j < 6 * dots)
        return ~inside | (print_[j.clip(0, 6 * dots - 1), i.clip(0, 7 * dots - 1)] > 127)

    H = placed([[-10, -10], [60, -10], [60, 50], [-10, 50]])
    image = to_bytes(render.photograph(pattern, H, SHAPE, blur=0.7, noise=1))
    view = find_board(board, image)
    assert not view.ambiguous
    assert distances(view, H, board).max() < 0.1
    part = distances(find_board(board, image[:, :250]), H, board)
    assert 10 < np.isfinite(part).sum() < 30
    assert np.nanmax(part) < 0.1


@pytest.mark.parametrize("board", [BOARD, Board.circles((5, 4), 5.0), Board.charuco((5, 4), 9.0, 6.0, "DICT_4X4_50")])
def test_no_board_is_none(board):
    noise = np.random.default_rng(0).integers(0, 255, (120, 160), np.uint8)
    for image in (np.zeros((120, 160), np.uint8), noise, np.full((10, 10), 99, np.uint8)):
        assert find_board(board, image) is None


@pytest.mark.parametrize(
    ("folder", "pattern", "counts", "bound"),
    [
        ("opencv-left", "*.jpg", (9, 6), 0.18),
        ("etna-2", "images/*.png", (7, 6), 0.28),
        ("etna-3", "images/*.png", (7, 6), 0.70),
    ],
)
def test_real_boards_are_all_found_and_fit_better_than_before(data, folder, pattern, counts, bound):
    # With OpenCV's corners the same calibration leaves 0.195, 0.361 and 0.748 px.
    board = Board.checkerboard(counts, 10.0)
    images = [read_image(path) for path in sorted((data / folder).glob(pattern))]
    views = [find_board(board, image) for image in images]
    assert all(view is not None and np.isfinite(view.corners).all() for view in views)
    lens = cv2.CALIB_FIX_K3 | (cv2.CALIB_ZERO_TANGENT_DIST if folder.startswith("etna") else 0)
    points = [board.points().astype(np.float32)] * len(views)
    corners = [view.corners.astype(np.float32) for view in views]
    rms = cv2.calibrateCamera(points, corners, images[0].shape[::-1], None, None, flags=lens)[0]
    assert rms < bound


def test_the_boards_under_the_stage_are_all_found(data):
    board = Board.checkerboard((5, 5), 5.0)
    for path in sorted((data / "stage-boards").glob("*.jpg")):
        view = find_board(board, read_image(path))
        assert view is not None, path.name
        assert view.ambiguous
        assert np.isfinite(view.corners).all()


def test_boards_are_found_the_same_in_float64_mode(x64):
    image = to_bytes(photograph())
    found = find_board(BOARD, image)
    with jax.enable_x64(False):
        other = find_board(BOARD, image)
    np.testing.assert_array_equal(found.corners, other.corners)
    np.testing.assert_array_equal(found.sigma, other.sigma)


@pytest.mark.parametrize("image", [np.zeros((90, 120)), np.zeros((90, 120, 4), np.uint8), np.zeros(90, np.uint8)])
def test_what_is_no_photograph_is_refused_by_its_shape(image):
    with pytest.raises((InputError, TypeError), match=r"the photograph has the shape|image"):
        find_board(BOARD, image)
