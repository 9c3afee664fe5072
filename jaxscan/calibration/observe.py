"""From the photographs of a session to observations: corners and stripes, read and found on all cores."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.calibration.board_band import board_band
from jaxscan.calibration.observations import BoardSequence, HandSettings, Observations, StripePoints, View
from jaxscan.deadline import Workers, result_of
from jaxscan.detectors import DEFAULT, Detector, check_detector
from jaxscan.errors import InputError, error_context
from jaxscan.files.session import Session
from jaxscan.files.session_axes import StageImages, TurntableImages
from jaxscan.files.session_sweeps import Sweep
from jaxscan.files.settings import relative_name
from jaxscan.files.text_order import text_order_note
from jaxscan.geometry import Pose
from jaxscan.images import (
    Board,
    BoardView,
    StripeSettings,
    carry_order,
    detect_stripe,
    find_board,
    read_image,
    shows_checkerboard,
    shows_second_board,
)
from jaxscan.images.board import LEAST_POINTS
from jaxscan.images.decode import Image
from jaxscan.images.exposures import full_number
from jaxscan.images.hot_pixels import HOT_FRAMES, HotPixels
from jaxscan.images.light import no_bell
from jaxscan.images.stripes.brightest import brighter_color, miscoloured
from jaxscan.images.stripes.colourless import check_colours
from jaxscan.images.stripes.other_colour import colour_that_shows
from jaxscan.images.stripes.settle import Band
from jaxscan.phrases import stripe_of
from jaxscan.rig.stripe_way import STEEP, across_note

# The stripe's centre is taken from what exceeds half its height; the lens smears the edge of a square by this (px).
_SMEAR_PX = 1.0
# A photograph is nearly black where the levels of most of its pixels, from one quantile to another, end below this part
# of a full one and differ by less than that.
_FROM_TO, _DARKEST, _LEAST_CONTRAST = (0.05, 0.95), 0.1, 0.01
# Photographs that are asked whether they have colours, and in which other colours are tried.
_TRIED = 3


@dataclass(frozen=True)
class _Photograph:
    """What one photograph shows; `found` is None where the board is not in it."""

    name: str
    found: BoardView | None
    stripes: tuple[StripePoints, ...]
    second_board: bool


def _view(photograph: _Photograph, found: BoardView, usual_sigma: float, given: Pose[np.ndarray] | None = None) -> View:
    """The photograph with its corners weighted against a usual σ (px), and the pose that is given for it."""
    weights = None if found.sigma is None else np.nan_to_num(usual_sigma / found.sigma)
    return View(photograph.name, found.corners, weights, photograph.stripes, given=given)


def observe(
    session: Session, advance: Callable[[int], object] = lambda by: None, detector: Detector = DEFAULT
) -> Observations:
    """Find corners and stripes in every photograph of a session.

    Args:
        session: what `read_session` returns.
        advance: called with 1 after each photograph, `photograph_count` times in all.
        detector: how the stripe's centre is measured.

    Raises:
        InputError: a photograph that cannot be read, a board that is found in none of them, an unknown detector, or
            photographs of a coloured laser that have no colours.
        StalledError: the search in one of them did not end in time.
    """
    check_detector(detector)
    for laser in session.lasers:
        lit = _lit(session, laser)
        if lit:
            check_colours(map(read_image, lit[:_TRIED]), laser.color, lit[0])

    hot = _hot_pixels(session)

    def view(index: int) -> _Photograph:
        path = session.views.boards[index]
        lit = [session.views.lit(laser.name, index) for laser in session.lasers]
        return _Photograph(_name(session, path), *_look(path, session, lit, detector, hot))

    def along(sequence: StageImages, index: int) -> _Photograph:
        path = sequence.images[index]
        own = [
            sequence.stripes[laser.name][index] if laser.name in sequence.stripes else None for laser in session.lasers
        ]
        lit = [() if lit is None else ((0, lit),) for lit in own]
        return _Photograph(_name(session, path), *_look(path, session, lit, detector, hot))

    def looked_at(look: Callable[[Any], _Photograph], paths: Sequence[Path], each: Iterable[Any]) -> list[_Photograph]:
        seen = []
        for path, future in zip(paths, [workers.submit(look, one) for one in each], strict=True):
            seen.append(result_of(future, str(path)))
            advance(1)
        return seen

    with Workers() as workers:
        photographs = looked_at(view, session.views.boards, range(len(session.views.boards)))
        left_out = _not_found(session, photographs, "view")
        moved = []
        for axis, sequence in session.sequences.items():
            moved.append(looked_at(partial(along, sequence), sequence.images, range(len(sequence.images))))
            left_out += _not_found(session, moved[-1], f"{axis} photograph")
    usual = _usual_sigma([p.found for p in (*photographs, *(p for each in moved for p in each)) if p.found is not None])
    # Each sequence by itself: one may begin where another passes. A view that copies one of them is left out.
    moved, repeated = zip(*map(_once, moved), strict=True) if moved else ((), ())
    photographs, of_views = _once(photographs, [photograph for each in moved for photograph in each])
    left_out += [line for lines in (of_views, *repeated) for line in lines]
    staged = [photograph for each in moved for photograph in each]
    posed = session.poses.given() if session.poses else {}
    given = {_name(session, path): pose for path, pose in posed.items()}
    views = [_view(p, p.found, usual, given.get(p.name)) for p in photographs if p.found is not None]
    for seen in (*views, *(_view(p, p.found, usual) for p in staged if p.found is not None)):
        for stripe in seen.stripes:
            if not np.isfinite(stripe.pixels).any():
                laser = session.lasers[stripe.laser]
                at = f" at step {stripe.position:g}" if laser.name in session.light_axes else ""
                left_out.append(f"{seen.name}: no {stripe_of(laser.name)} was found{at}")
    notes = _in_text_order(session)
    twice = [p.name for p in (*photographs, *staged) if p.second_board]
    if twice:
        notes.append(
            f"a second board is in view in {', '.join(twice)}: which of the two was found is chance, so cover one "
            "of them and take these photographs again"
        )
    notes += [note for said in (_across, _miscoloured, _no_bell) for note in said(session.lasers, views)]
    notes += _in_another_colour(session, photographs, views) + hot.notes()
    if session.board.half_turn_ambiguous:
        columns, rows = session.board.counts
        notes.append(
            f"the board of {columns} x {rows} looks the same after half a turn: each view's order of corners is one of "
            "two valid ones; on stage and turntable it is carried from photograph to photograph"
        )
    return Observations(
        image_size=session.image_size,
        board=session.board,
        views=tuple(views),
        sequences=tuple(
            _sequence(session.board, sequence, each, usual)
            for sequence, each in zip(session.sequences.values(), moved, strict=True)
        ),
        lasers=tuple(laser.name for laser in session.lasers),
        left_out=tuple(left_out),
        notes=tuple(notes),
        radius_mm=_radius(session.board, [p.found for p in (*photographs, *staged) if p.found is not None]),
        hand=_hand(session),
        light_axes=dict(session.light_axes),
    )


def _in_text_order(session: Session) -> list[str]:
    """Which sequences list their photographs in alphabetical order; views have no order."""
    each = [
        text_order_note(f"[{axis}] images", sequence.images, [sequence.steps])
        for axis, sequence in session.sequences.items()
    ]
    return [note for note in each if note is not None]


def _hand(session: Session) -> HandSettings | None:
    posed = session.poses
    return None if posed is None else HandSettings(posed.moves, posed.sigma_mm, posed.sigma_deg, str(posed.file))


def unseen(session: Session) -> Observations:
    """What `observe` returns, before any photograph is looked at: whether sessions go together is known from it."""
    lasers = tuple(laser.name for laser in session.lasers)
    axes = dict(session.light_axes)
    return Observations(session.image_size, session.board, (), lasers=lasers, hand=_hand(session), light_axes=axes)


def photograph_count(session: Session) -> int:
    """How many poses `observe` looks at."""
    return len(session.views.boards) + sum(session.counts.values())


def photograph_names(session: Session) -> list[str]:
    """What `observe` calls the photographs of the board: those of the views, then those along the axes."""
    along = [path for sequence in session.sequences.values() for path in sequence.images]
    return [_name(session, path) for path in (*session.views.boards, *along)]


def _name(session: Session, path: Path) -> str:
    """As the session has it: photographs of the views and of the stage may share a file name."""
    return relative_name(path, session.path.parent)


def _across(lasers: Sequence[StripeSettings], views: Sequence[View]) -> list[str]:
    """Which lasers' stripes run across the direction in which they are searched."""
    notes = []
    for i, laser in enumerate(lasers):
        steep = []
        for stripe in (stripe for view in views for stripe in view.stripes if stripe.laser == i):
            seen = stripe.pixels[np.isfinite(stripe.pixels).all(axis=1)]
            if len(seen):
                # Some points may be no stripe's.
                wide, high = np.ptp(np.percentile(seen, (10, 90), axis=0), axis=0)
                steep.append(high > STEEP * wide if laser.columns else wide > STEEP * high)
        if steep and np.median(steep) == 1:
            notes.append(across_note(laser.name, "in most photographs", columns=laser.columns))
    return notes


def _miscoloured(lasers: Sequence[StripeSettings], views: Sequence[View]) -> list[str]:
    """Which lasers' stripes have another colour than the one that is searched."""
    notes = []
    for i, laser in enumerate(lasers):
        found = [stripe.brighter for view in views for stripe in view.stripes if stripe.laser == i]
        said = miscoloured(found, laser)
        if said is not None:
            notes.append(f"the {stripe_of(laser.name)} {said}")
    return notes


def _in_another_colour(session: Session, photographs: Sequence[_Photograph], views: Sequence[View]) -> list[str]:
    """Which lasers have no stripe in any view, and the colour under which there is one."""
    notes = []
    for i, laser in enumerate(session.lasers):
        own = [stripe for view in views for stripe in view.stripes if stripe.laser == i]
        if not own or any(np.isfinite(stripe.pixels).any() for stripe in own):
            continue
        found = [i for i, seen in enumerate(photographs) if seen.found is not None]
        with_board = [path for i in found for _, path in session.views.lit(laser.name, i)]
        shown = colour_that_shows(map(read_image, with_board[:_TRIED]), laser)
        if shown is not None:
            notes.append(
                f'no {stripe_of(laser.name)} was found with color = "{laser.color}", but with color = "{shown}" there '
                "is one: set this under [laser]"
            )
    return notes


def _no_bell(lasers: Sequence[StripeSettings], views: Sequence[View]) -> list[str]:
    """Which lasers have a stripe whose cross-section is not bell-shaped."""
    notes = []
    for i, laser in enumerate(lasers):
        found = [stripe for view in views for stripe in view.stripes if stripe.laser == i]
        seen = [stripe for stripe in found if np.isfinite(stripe.pixels).any()]
        said = no_bell([stripe.odd for stripe in seen], [stripe.black for stripe in seen], "photographs")
        if said is not None:
            notes.append(f"the {stripe_of(laser.name)}: its {said}")
    return notes


def _once(
    photographs: Sequence[_Photograph], before: Sequence[_Photograph] = ()
) -> tuple[list[_Photograph], list[str]]:
    """The photographs, with nothing found in copies of others or of those before them, and which these are.

    To the last bit, corners do not fall alike.
    """
    first = {one.found.corners.tobytes(): one.name for one in before if one.found is not None}
    once, repeated = [], []
    for photograph in photographs:
        name = photograph.name
        if photograph.found is not None:
            name = first.setdefault(photograph.found.corners.tobytes(), name)
        if name == photograph.name:
            once.append(photograph)
        else:
            once.append(replace(photograph, found=None))
            repeated.append(f"{photograph.name}: a copy of {name}, which counts once")
    return once, repeated


def _lit(session: Session, laser: StripeSettings) -> list[Path]:
    """The photographs of the views in which a laser is on."""
    views = session.views
    return [path for i in range(len(views.boards)) for _, path in views.lit(laser.name, i)]


def _usual_sigma(found: Sequence[BoardView]) -> float:
    """The median σ of all corners, px."""
    known = [view.sigma[np.isfinite(view.sigma)] for view in found if view.sigma is not None]
    return float(np.median(np.concatenate(known))) if known else 1.0


def _radius(board: Board, found: Sequence[BoardView]) -> float:
    """That of the board's circles, as it is given or as most photographs show it, mm; 0 for corners."""
    seen = [view.radius for view in found if view.radius is not None and np.isfinite(view.radius)]
    if board.diameter_mm or not seen:
        return board.diameter_mm / 2
    return board.pitch_mm * float(np.median(seen))


def _look(
    path: Path, session: Session, lit: Sequence[Sweep], detector: Detector, hot: HotPixels
) -> tuple[BoardView | None, tuple[StripePoints, ...], bool]:
    """Corners and stripes of one pose, of each laser from photographs in which it is on; is there a second board?"""

    def read(path: Path) -> Image:
        image = read_image(path)
        hot.correct(image[None])
        return image

    image = read(path)
    found = find_board(session.board, image)
    if found is None:
        return None, (), False
    stripes = []
    for i, (laser, own) in enumerate(zip(session.lasers, lit, strict=True)):
        band = board_band(session.board, found.corners, image.shape[1::-1], columns=laser.columns) if own else None
        for position, photograph in own:
            with error_context(photograph):
                seen = stripe_points(image if photograph == path else read(photograph), laser, i, detector, band)
                stripes.append(replace(seen, position=float(position)))
    return found, tuple(stripes), _second(session.board, image, found)


def _hot_pixels(session: Session) -> HotPixels:
    """Those of the camera, by photographs of the board, which stands elsewhere in each."""
    hot = HotPixels(session.lasers[0].columns if session.lasers else True)
    along = [path for sequence in session.sequences.values() for path in sequence.images]
    paths = [*session.views.boards, *along][:HOT_FRAMES]
    first = read_image(paths[0]) if paths else None
    if first is None or first.ndim != 2:
        return hot
    images = [first, *map(read_image, paths[1:])]
    if len({image.shape for image in images}) == 1:
        hot.correct(np.stack(images))
    return hot


def _second(board: Board, image: np.ndarray, found: BoardView | None) -> bool:
    return found is not None and shows_second_board(board, image, found.corners)


def stripe_points(
    image: np.ndarray, settings: StripeSettings, laser: int, detector: Detector = DEFAULT, band: Band | None = None
) -> StripePoints:
    """The stripe of one photograph as pixels (u, v); NaN where there is none, and beyond the band where it can be."""
    stripe = detect_stripe(image, settings, detector=detector, band=band)
    position = stripe.position.astype(np.float64).ravel()
    index = np.where(np.isfinite(position), np.arange(position.size), np.nan)
    pixels = np.stack([index, position] if settings.columns else [position, index], axis=-1)
    widths = np.asarray(stripe.width, np.float64).ravel()
    known = widths[np.isfinite(position)]
    half = 0.5 * float(np.median(known)) + _SMEAR_PX if known.size else _SMEAR_PX
    sigmas = np.asarray(stripe.sigma, np.float64).ravel()
    brighter = brighter_color(image, pixels, settings)
    odd, light, black = bool(stripe.odd[0]), stripe.light[0], float(stripe.black()[0])
    return StripePoints(pixels, settings.columns, laser, half, sigmas, brighter, odd, light, widths, black)


def _sequence(
    board: Board, sequence: StageImages, photographs: Sequence[_Photograph], usual_sigma: float
) -> BoardSequence:
    """The photographs on stage or turntable on which the board was found, their corners in one order."""
    views, steps, previous = [], [], None
    for photograph, count in zip(photographs, sequence.steps, strict=True):
        if photograph.found is None:
            continue
        previous = photograph.found if previous is None else _carried(board, previous, photograph.found)
        views.append(_view(photograph, previous, usual_sigma))
        steps.append(float(count))
    counts = np.asarray(steps)
    if isinstance(sequence, TurntableImages):
        stood = np.full(len(counts), float(sequence.stage_step))
        return BoardSequence({"stage": stood, "turntable": counts}, tuple(views), "turntable", "rotary")
    return BoardSequence({"stage": counts}, tuple(views))


def _carried(board: Board, previous: BoardView, found: BoardView) -> BoardView:
    """The view with its points, and what is known of each, in the order nearest to the view before."""
    if found.sigma is None:
        return replace(found, corners=carry_order(board, previous.corners, found.corners))
    points = carry_order(board, previous.corners, np.column_stack([found.corners, found.sigma]))
    return replace(found, corners=points[:, :2], sigma=points[:, 2])


def _not_found(session: Session, photographs: Sequence[_Photograph], what: str) -> list[str]:
    """Which photographs do not show the board; an error when none does."""
    board, missing = session.board, [p.name for p in photographs if p.found is None]
    columns, rows = board.counts
    if photographs and len(missing) == len(photographs):
        raise InputError(
            f"the {board.kind} of {columns} x {rows} points was found in none of {len(photographs)} {what}s "
            f"({missing[0]} … {missing[-1]}): "
            + (_mistaken(session) or _nearly_black(session.path.parent / missing[0]) or _CHECK)
        )
    return [f"{name}: the board of {columns} x {rows} points was not found" for name in missing]


_CHECK = (
    "check [board] (inner corners are where four squares meet, one fewer than the squares in a row), that the whole "
    "board is in view, and that the photographs are sharp"
)


def _mistaken(session: Session) -> str | None:
    """Which usual mistake has been made where a checkerboard is found nowhere, by the photographs of the first pose.

    Nothing is reported for a session that shares its poses with another and itself lists only the stage's photographs.
    """
    if session.board.kind != "checkerboard" or not session.views.boards:
        return None
    columns, rows = session.board.counts
    first = session.views.boards[0]
    if min(columns, rows) > LEAST_POINTS and shows_checkerboard((columns - 1, rows - 1), read_image(first)):
        return (
            f"{first} shows one of {columns - 1} x {rows - 1}. Inner corners are where four squares meet, one fewer "
            f"than the squares in a row: inner_corners = [{columns - 1}, {rows - 1}]"
        )
    for laser in session.lasers:
        for _, lit in session.views.lit(laser.name, 0)[:1]:
            if lit != first and shows_checkerboard((columns, rows), read_image(lit)):
                return f"it is in {lit}, a photograph of the stripe: exchange boards and stripes"
    return None


def _nearly_black(path: Path) -> str | None:
    """What is said of a photograph in which hardly anything is brighter than the rest but what a laser lights."""
    image = read_image(path)
    dark, bright = np.quantile(image, _FROM_TO) / full_number(int(image.max()), image.dtype)
    if bright > _DARKEST or bright - dark > _LEAST_CONTRAST:
        return None
    return f"{path} is nearly black: photograph the board with a lamp"
