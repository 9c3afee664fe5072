"""`session.toml`: the photographs of a calibration, and what is on them."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, cast

import tomli_w

from jaxscan.atomic import replacing
from jaxscan.axis_details import POSES
from jaxscan.errors import InputError
from jaxscan.files.listing import common_size, files_of, files_or_gaps
from jaxscan.files.session_poses import PosedImages, posed_values, read_posed_images
from jaxscan.files.session_sweeps import STEPS, Sweep, read_light_axis, read_sweeps, sweeps_values
from jaxscan.files.settings import (
    read_listing,
    read_steps,
    read_stripe_settings,
    relative_name,
    stripe_values,
    write_toml,
)
from jaxscan.files.table import Table, show
from jaxscan.images import Board, StripeSettings
from jaxscan.rig import LENSES, LIGHTS, MOTIONS, LightPlane, Linear, Rotary
from jaxscan.rig.board_shape import BOARD_SHAPES
from jaxscan.rig.camera import camera_parameters
from jaxscan.rig.line import Line

SESSION_FILE: Final = "session.toml"
# Axes of which it can have photographs of the board, each a table.
SEQUENCES: Final = ("stage", "turntable")

# What follows the board in a file to be filled in.
_BLANK: Final = """
[views]
boards = "boards/*"           # the board in your hand, in 10 to 15 poses, with the laser on

[stage]
images = "stage/*"            # the board fixed on the stage, at 5 places or more along its travel
steps_per_image = 2000        # motor steps from one to the next; or steps = [0, 2000, 5000]
# mm_per_step = 0.001         # where you know it: it checks the size of the squares

[laser]
color = "red"                 # red, green, blue or grey
"""

_BOARD_KEYS: Final = {
    "checkerboard": ("inner_corners", "square_mm"),
    "circles": ("circles", "pitch_mm", "diameter_mm"),
    "charuco": ("squares", "square_mm", "marker_mm", "dictionary"),
}


@dataclass(frozen=True)
class CameraSettings:
    """What the calibration is to find of the camera.

    Attributes:
        lens: a rung of the lens ladder.
        principal_point: found, or held at the centre of the image.
        hold: further parameters that are not sought, by their names in `rig.json`, in the order of these.
        tilt: whether the tilt of the sensor is sought.
    """

    lens: str = "radial1"
    principal_point: Literal["free", "centre"] = "free"
    hold: tuple[str, ...] = ()
    tilt: bool = False


@dataclass(frozen=True)
class Views:
    """The board held in many poses.

    Attributes:
        boards: the photographs of the board.
        stripes: for each laser by name, and in the order of `boards`, the photograph of the same pose with that laser
            on, or None where there is none. None in place of it all: the stripe is in the photographs of the board.
        sweeps: for each laser whose light is moved, by name, and in the order of `boards`, its stripes.
    """

    boards: tuple[Path, ...]
    stripes: Mapping[str, tuple[Path | None, ...]] | None = None
    sweeps: Mapping[str, tuple[Sweep, ...]] = field(default_factory=dict, kw_only=True)

    def lit(self, laser: str, index: int) -> Sweep:
        """The photographs of the pose of a board in which a laser is on, with the steps of what moves its light."""
        if laser in self.sweeps:
            return self.sweeps[laser][index]
        path = self.boards[index] if self.stripes is None else self.stripes[laser][index]
        return () if path is None else ((0, path),)


@dataclass(frozen=True)
class StageImages:
    """The board fixed on the stage, photographed along its travel.

    Attributes:
        images: the photographs.
        steps: the motor step count of each.
        stripes: for each laser by name, and in the order of `images`, the photograph of the same place with that laser
            on, or None where there is none; empty where no stripe is looked for. It may be the same photograph.
        motion: the kind of its motion, one of `stage_motions`.
        screw_steps: steps of one turn of its screw, where they are known; of use where the motion has a screw.
        mm_per_step: travel for one motor step where it is known otherwise, mm: it checks the size of the squares.
    """

    images: tuple[Path, ...]
    steps: tuple[int, ...]
    stripes: Mapping[str, tuple[Path | None, ...]] = field(default_factory=dict, kw_only=True)
    motion: str = field(default=Linear.kind, kw_only=True)
    screw_steps: float | None = field(default=None, kw_only=True)
    mm_per_step: float | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class TurntableImages(StageImages):
    """The board fixed on the turntable, photographed as it turns.

    Attributes:
        stage_step: motor step of the stage at which they were taken.
        motion: the kind of its motion, one of `turntable_motions`.
    """

    stage_step: int = 0
    motion: str = field(default=Rotary.kind, kw_only=True)


@dataclass(frozen=True)
class Session:
    """A calibration session.

    Attributes:
        path: its TOML file.
        board: the board.
        views: the board held in many poses.
        camera: what is to be found of the camera.
        stage: the board on the stage, where the rig has one.
        turntable: the board on the turntable, where the rig has one.
        lasers: how to look for the stripe of each laser; none for a rig without a laser.
        sheets: the kind of each laser's sheet of light, in their order; empty where all are planes.
        light_axes: of each laser whose light is moved, by its name, the axis that moves it.
        image_size: columns and rows of all its photographs.
        board_shape: what of the board's shape is to be found, one of `BOARD_SHAPES`.
        poses: those of the views, the last, for which a pose is given.
    """

    path: Path
    board: Board
    views: Views
    camera: CameraSettings = field(default_factory=CameraSettings)
    stage: StageImages | None = None
    turntable: TurntableImages | None = None
    lasers: tuple[StripeSettings, ...] = ()
    sheets: tuple[str, ...] = field(default=(), kw_only=True)
    light_axes: Mapping[str, str] = field(default_factory=dict, kw_only=True)
    image_size: tuple[int, int] = (0, 0)
    board_shape: str = "flat"
    poses: PosedImages | None = None

    @property
    def sequences(self) -> dict[str, StageImages]:
        """Those of the board on an axis that there are, by the axis's name."""
        each = zip(SEQUENCES, (self.stage, self.turntable), strict=True)
        return {axis: sequence for axis, sequence in each if sequence is not None}

    @property
    def counts(self) -> dict[str, int]:
        """How many photographs of the board there are on each axis."""
        return {axis: len(sequence.images) for axis, sequence in self.sequences.items()}

    def photographs(self) -> list[Path]:
        """All its photographs: of the board, on stage and turntable, of the stripes."""
        stripes = (self.views.stripes or {}).values()
        moved = self.sequences.values()
        paths = [*self.views.boards, *(path for sequence in moved for path in sequence.images)]
        lit = [*stripes, *(own for sequence in moved for own in sequence.stripes.values())]
        lit += [[path for _, path in sweep] for own in self.views.sweeps.values() for sweep in own]
        return list(dict.fromkeys(paths + [path for own in lit for path in own if path is not None]))


def stage_motions() -> tuple[str, ...]:
    """The kinds of motion that a stage may have: those along a line, more or less."""
    return tuple(name for name, kind in MOTIONS.items() if issubclass(kind, Line))


def turntable_motions() -> tuple[str, ...]:
    """The kinds of motion that a turntable may have: those about an axis."""
    return tuple(name for name, kind in MOTIONS.items() if issubclass(kind, Rotary))


def read_session(path: str | os.PathLike[str], *, whole: bool = True) -> Session:
    """Read and check a session, given its folder or its `session.toml`.

    Every photograph is seen to be there and of one size; none is decoded.

    Args:
        path: of the folder, or of its `session.toml`.
        whole: whether each photograph is read to its end, so that one that is cut off is refused.

    Raises:
        InputError: whatever is wrong: file, key, value, and how to fix it.
    """
    table = read_listing(Path(path), SESSION_FILE, ("board", "camera", "views", POSES, *SEQUENCES, "laser"))
    (board, shape), camera = _board(table), _camera(table)
    posed = read_posed_images(table)
    if "views" not in table and posed is None:
        fix = "add it, with boards = the photographs of the board held in the hand, in three poses or more"
        raise table.error("views", f"is missing: {fix}; the camera is found from them")
    views = table.optional_table("views", "[views] ").only("boards", "stripes", STEPS)
    boards = files_of(views, "boards") if "views" in table else ()
    if not boards and posed is None:
        raise views.error("boards", "names no photograph: name those of the board")
    lasers, sheets, axes, stripes, sweeps = _lasers(table, views, boards)
    if posed is not None:
        if axes:
            raise InputError(f"{table.path}: [{POSES}]: a light that is swept goes with boards under [views] alone")
        boards, stripes = _with_posed(posed, lasers, boards, stripes)
    moved = _stage(table, lasers, axes), _turntable(table, lasers, axes)
    session = Session(
        table.path,
        board,
        Views(boards, stripes, sweeps=sweeps),
        camera,
        *moved,
        lasers,
        sheets=sheets,
        light_axes=axes,
        board_shape=shape,
        poses=posed[0] if posed else None,
    )
    if posed and session.sequences:
        also = next(iter(session.sequences))
        raise InputError(
            f"{table.path}: [{POSES}] and [{also}]: a scanner moves by given poses or by axes: calibrate the two apart"
        )
    _check_each_shows_one_pose(session)
    return replace(session, image_size=common_size(session.photographs(), to_their_ends=whole))


def check_stage_known(sessions: Sequence[Session]) -> None:
    """Refuse sessions of one rig whose turntable stood away from step 0 of a stage that none of them shows.

    Raises:
        InputError: there is one.
    """
    for session in sessions:
        table = session.turntable
        if table is not None and table.stage_step and not any(other.stage for other in sessions):
            raise InputError(
                f"{session.path}: [turntable] stage_step = {table.stage_step}: no [stage] says how far that is: "
                "photograph the board along the stage too, or leave stage_step out"
            )


def write_session(session: Session) -> None:
    """Write `session.path`, whole or not at all, with its photographs listed by name.

    Raises:
        InputError: the file cannot be written.
    """
    folder = session.path.parent
    values: dict[str, Any] = {"board": _board_values(session.board)}
    values["board"] |= {"shape": session.board_shape} if session.board_shape != "flat" else {}
    asked = session.camera
    values["camera"] = {"lens": asked.lens, "principal_point": asked.principal_point}
    values["camera"] |= {"hold": list(asked.hold)} if asked.hold else {}
    values["camera"] |= {"tilt": True} if asked.tilt else {}
    held = len(session.views.boards) - (len(session.poses.images) if session.poses else 0)
    values["views"] = {"boards": [relative_name(path, folder) for path in session.views.boards[:held]]}
    lasers = [stripe_values(laser) for laser in session.lasers]
    for laser, sheet in zip(lasers, session.sheets, strict=False):
        laser["sheet"] = sheet
    for laser, own in zip(lasers, session.lasers, strict=True):
        if (axis := session.light_axes.get(own.name)) is not None:
            place = values["views"] if len(lasers) == 1 else laser
            place |= sweeps_values(session.views.sweeps[own.name], folder)
            laser["axis"] = axis
    names: dict[str, list[str]] = {}
    if session.views.stripes:
        names = {
            laser: [relative_name(path, folder) if path else "" for path in paths]
            for laser, paths in session.views.stripes.items()
        }
        if len(lasers) == 1:
            (values["views"]["stripes"],) = (own[:held] for own in names.values())
        else:
            for laser in lasers:
                if laser["name"] in names:
                    laser["stripes"] = names[laser["name"]][:held]
    if session.poses is not None:
        lit = {laser: own[held:] for laser, own in names.items() if any(own[held:])}
        own_stripes = {"stripes": lit if len(lasers) > 1 else next(iter(lit.values()))} if lit else {}
        values[POSES] = posed_values(session.poses, folder, own_stripes)
    for axis, sequence in session.sequences.items():
        images = [relative_name(path, folder) for path in sequence.images]
        values[axis] = {"images": images, "steps": list(sequence.steps)}
        if sequence.stripes:
            lit = {
                laser: [relative_name(path, folder) if path else "" for path in paths]
                for laser, paths in sequence.stripes.items()
            }
            values[axis]["stripes"] = lit if len(lasers) > 1 else next(iter(lit.values()))
    if (stage := session.stage) is not None:
        values["stage"] |= {"motion": stage.motion} if stage.motion != Linear.kind else {}
        values["stage"] |= {"screw_steps": stage.screw_steps} if stage.screw_steps is not None else {}
        values["stage"] |= {"mm_per_step": stage.mm_per_step} if stage.mm_per_step is not None else {}
    if session.turntable is not None:
        values["turntable"]["stage_step"] = session.turntable.stage_step
        turn = session.turntable.motion
        values["turntable"] |= {"motion": turn} if turn != Rotary.kind else {}
    if lasers:
        values["laser"] = lasers[0] if len(lasers) == 1 else lasers
    write_toml(session.path, values)


def write_blank_session(path: Path, board: Board) -> None:
    """Write a `session.toml` for a board, with the names that photographs usually have, to be filled in.

    Raises:
        InputError: the file cannot be written.
    """
    with replacing(path, "w") as file:
        file.write(tomli_w.dumps({"board": _board_values(board)}) + _BLANK)


def _check_each_shows_one_pose(session: Session) -> None:
    """Refuse a photograph that is listed for two poses: it would count twice, and σ would be too small."""
    first: dict[str, tuple[str, tuple[str, int]]] = {}
    for place, pose, path in _listed(session):
        before, other = first.setdefault(os.path.realpath(path), (place, pose))
        if pose != other:
            name = show(relative_name(path, session.path.parent))
            held = "view" in (pose[0], other[0]) and pose[0] != other[0]
            fix = "leave it out of [views], which is for the board in the hand" if held else "name it for one of them"
            where = f"twice under {place}" if place == before else f"under {before} and under {place}"
            raise InputError(f"{session.path}: {name} stands {where}, for two poses, and would count twice: {fix}")


def _listed(session: Session) -> Iterator[tuple[str, tuple[str, int], Path]]:
    """Each photograph as often as it is listed: where, and of which pose of the board.

    A board on a turntable at step 0 may be in a photograph along the stage too.
    """
    for i, board in enumerate(session.views.boards):
        yield "[views] boards", ("view", i), board
        for paths in (session.views.stripes or {}).values():
            if (stripe := paths[i]) is not None:
                yield "the stripes of [views]", ("view", i), stripe
        for sweeps in session.views.sweeps.values():
            for _, path in sweeps[i]:
                yield "the stripes of [views]", ("view", i), path
    for axis, sequence in session.sequences.items():
        for i, (image, step) in enumerate(zip(sequence.images, sequence.steps, strict=True)):
            pose = (axis, step)
            if isinstance(sequence, TurntableImages) and step == 0:
                pose = ("stage", sequence.stage_step)
            yield f"[{axis}] images", pose, image
            for paths in sequence.stripes.values():
                if (stripe := paths[i]) is not None:
                    yield f"[{axis}] stripes", pose, stripe


def _board(table: Table) -> tuple[Board, str]:
    """The board, and what of its shape is to be found."""
    board = table.table("board", "[board] ")
    kind = board.string("kind", "checkerboard", tuple(_BOARD_KEYS))
    board.only("kind", "shape", *_BOARD_KEYS[kind])
    shape = board.string("shape", "flat", tuple(BOARD_SHAPES))
    if kind == "circles":
        diameter = board.number("diameter_mm") if "diameter_mm" in board else None
        make = partial(Board.circles, board.size("circles"), board.number("pitch_mm"), diameter)
    elif kind == "charuco":
        lengths = board.number("square_mm"), board.number("marker_mm")
        make = partial(Board.charuco, board.size("squares"), *lengths, board.string("dictionary"))
    else:
        make = partial(Board.checkerboard, board.size("inner_corners"), board.number("square_mm"))
    try:
        return make(), shape
    except InputError as error:
        raise InputError(f"{table.path}: [board] {error}") from error


def _board_values(board: Board) -> dict[str, Any]:
    columns, rows = board.counts
    if board.kind == "circles":
        diameter = {"diameter_mm": board.diameter_mm} if board.diameter_mm else {}
        return {"kind": board.kind, "circles": [columns, rows], "pitch_mm": board.pitch_mm, **diameter}
    if board.kind == "charuco":
        values = {"square_mm": board.pitch_mm, "marker_mm": board.marker_mm, "dictionary": board.dictionary}
        return {"kind": board.kind, "squares": [columns + 1, rows + 1], **values}
    return {"kind": board.kind, "inner_corners": [columns, rows], "square_mm": board.pitch_mm}


def _camera(table: Table) -> CameraSettings:
    if "camera" not in table:
        return CameraSettings()
    camera = table.table("camera", "[camera] ").only("lens", "principal_point", "hold", "tilt")
    principal_point = camera.string("principal_point", "free", ("free", "centre"))
    lens = camera.string("lens", "radial1", tuple(LENSES))
    tilt = camera.boolean("tilt", default=False)
    names = camera_parameters(lens, tilted=tilt)
    hold = camera.values.get("hold", [])
    if not isinstance(hold, list) or not all(name in names for name in hold):
        raise camera.error("hold", f'must be a list of parameters of the lens "{lens}": {", ".join(names)}')
    held = tuple(name for name in names if name in hold)
    return CameraSettings(lens, cast(Literal["free", "centre"], principal_point), held, tilt)


def _stage(table: Table, lasers: Sequence[StripeSettings], axes: Mapping[str, str]) -> StageImages | None:
    if "stage" not in table:
        return None
    stage = table.table("stage", "[stage] ").only(*_SEQUENCE_KEYS, "motion", "screw_steps", "mm_per_step")
    images, steps, stripes = _sequence(stage, lasers, axes, "two", 2)
    motion = stage.string("motion", Linear.kind, stage_motions())
    screw = stage.number("screw_steps") if "screw_steps" in stage else None
    if screw is not None and screw <= 0:
        raise stage.error("screw_steps", "must be the steps of one turn of the screw, above 0")
    known = stage.number("mm_per_step") if "mm_per_step" in stage else None
    if known is not None and known <= 0:
        raise stage.error("mm_per_step", "must be the millimetres of one motor step, above 0")
    return StageImages(images, steps, stripes=stripes, motion=motion, screw_steps=screw, mm_per_step=known)


def _turntable(table: Table, lasers: Sequence[StripeSettings], axes: Mapping[str, str]) -> TurntableImages | None:
    if "turntable" not in table:
        return None
    turntable = table.table("turntable", "[turntable] ").only(*_SEQUENCE_KEYS, "stage_step", "motion")
    stood = turntable.whole("stage_step") if "stage_step" in turntable else 0
    images, steps, stripes = _sequence(turntable, lasers, axes, "three", 3)
    motion = turntable.string("motion", Rotary.kind, turntable_motions())
    return TurntableImages(images, steps, stood, stripes=stripes, motion=motion)


_LASER_KEYS: Final = ("name", "color", "columns", "stripes", STEPS, "sheet", "axis")
_SEQUENCE_KEYS: Final = ("images", "steps", "steps_per_image", "stripes")
_Stripes = Mapping[str, tuple[Path | None, ...]]


def _sequence(
    table: Table, lasers: Sequence[StripeSettings], axes: Mapping[str, str], fewest_in_words: str, fewest: int
) -> tuple[tuple[Path, ...], tuple[int, ...], _Stripes]:
    """The photographs of a board that something moves, the motor step count of each, and those of the stripe on it."""
    images = files_of(table, "images")
    steps = read_steps(table, "steps_per_image", images, "images")
    if len(set(steps)) < fewest:
        raise table.error(
            "steps" if "steps" in table else "images",
            f"photographs at {fewest_in_words} different step counts or more are needed",
        )
    if axes and "stripes" in table:
        raise table.error("stripes", "a light that is swept has its stripes on boards under [views]: leave this out")
    return images, steps, _stripes_of(table, lasers, len(images))


def _stripes_of(table: Table, lasers: Sequence[StripeSettings], n_images: int) -> _Stripes:
    """The photographs of each laser's stripe that are paired with those of a table."""
    if "stripes" not in table:
        return {}
    if not lasers:
        raise table.error("stripes", "the session has no laser whose stripe this could be: add [laser]")
    if len(lasers) == 1:
        return {lasers[0].name: _stripes(table, n_images)}
    names = [laser.name for laser in lasers]
    inner = table.table("stripes", f"{table.prefix}stripes.").only(*names)
    return {name: _stripes(inner, n_images, name) for name in names if name in inner}


def _with_posed(
    posed: tuple[PosedImages, Table],
    lasers: Sequence[StripeSettings],
    boards: tuple[Path, ...],
    stripes: _Stripes | None,
) -> tuple[tuple[Path, ...], _Stripes | None]:
    """The views, and behind them those for which a pose is given; with the photographs of their stripes."""
    images, own = posed[0].images, _stripes_of(posed[1], lasers, len(posed[0].images))
    if stripes is None and not own:
        return (*boards, *images), None
    # A view without a photograph of its stripe shows it itself, where no view has one.
    before = {laser.name: boards if stripes is None else stripes[laser.name] for laser in lasers}
    none = (None,) * len(images)
    return (*boards, *images), {name: (*held, *own.get(name, none)) for name, held in before.items()}


def _lasers(
    table: Table, views: Table, boards: tuple[Path, ...]
) -> tuple[
    tuple[StripeSettings, ...], tuple[str, ...], dict[str, str], _Stripes | None, Mapping[str, tuple[Sweep, ...]]
]:
    """The lasers, the kind of each one's sheet, what moves them, and the photographs of each one's stripe."""
    tables = _laser_tables(table)
    lasers = tuple(read_stripe_settings(laser) for laser in tables)
    sheets = tuple(laser.string("sheet", LightPlane.kind, tuple(LIGHTS)) for laser in tables)
    moved = [read_light_axis(laser, sheet) for laser, sheet in zip(tables, sheets, strict=True)]
    sheets = sheets if set(sheets) - {LightPlane.kind} else ()
    if len(lasers) > 1:
        _check_names(table, lasers)
        for key in ("stripes", STEPS):
            if key in views:
                raise views.error(key, f"there are several lasers: give each [[laser]] its own {key} instead")
    axes = {laser.name: axis for laser, axis in zip(lasers, moved, strict=True) if axis}
    places = dict(zip([laser.name for laser in lasers], tables, strict=True))
    if len(lasers) <= 1:
        own = [inner for inner in tables if "stripes" in inner or STEPS in inner]
        if own and ("stripes" in views or STEPS in views):
            raise views.error("stripes", f"{own[0].prefix}stripes is given too: keep one of them")
        # Photographs of a stripe mean a laser, even if there is nothing to say about it.
        lasers = lasers or ((StripeSettings(),) if "stripes" in views else ())
        places = {laser.name: own[0] if own else views for laser in lasers}
    for name, place in places.items():
        if name not in axes and STEPS in place:
            raise place.error(STEPS, 'the light stands still: leave it out, or set sheet = "swept" under [laser]')
    sweeps = {name: read_sweeps(places[name], boards, axis) for name, axis in axes.items()}
    still = {name: place for name, place in places.items() if name not in axes}
    if len(lasers) <= 1 and not any("stripes" in place for place in still.values()):
        return lasers, sheets, axes, {} if axes else None, sweeps
    return lasers, sheets, axes, {name: _stripes(place, len(boards)) for name, place in still.items()}, sweeps


def _laser_tables(table: Table) -> list[Table]:
    """One table for each laser, from `[laser]` or from several `[[laser]]`."""
    value = table.values.get("laser", [])
    if isinstance(value, dict):
        return [table.table("laser", "[laser] ").only(*_LASER_KEYS)]
    if not isinstance(value, list) or not all(isinstance(inner, dict) for inner in value):
        raise table.error("laser", "must be a table, [laser], or several, each under [[laser]]")
    return [Table(table.path, f"[[laser]] {i + 1}: ", inner).only(*_LASER_KEYS) for i, inner in enumerate(value)]


def _check_names(table: Table, lasers: tuple[StripeSettings, ...]) -> None:
    names = [laser.name for laser in lasers]
    if "" in names or len(set(names)) < len(names):
        raise InputError(f"{table.path}: [[laser]] name: each of several lasers needs its own; they are {show(names)}")


def _stripes(table: Table, n_boards: int, key: str = "stripes") -> tuple[Path | None, ...]:
    paths = files_or_gaps(table, key)
    if len(paths) != n_boards:
        raise table.error(
            key,
            f"{len(paths)} photographs of the stripe for {n_boards} of the board: they are paired in order, "
            'so give as many, in a list with "" where there is none',
        )
    return paths
