"""`session.toml`: the photographs of a calibration, and what is on them."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal, cast

import tomli_w

from jaxscan.atomic import replacing
from jaxscan.axis_details import POSES
from jaxscan.errors import InputError
from jaxscan.files.listing import common_size, files_of
from jaxscan.files.session_axes import (
    SEQUENCES,
    StageImages,
    TurntableImages,
    read_stage,
    read_turntable,
    sequence_values,
)
from jaxscan.files.session_board import board_values, read_board
from jaxscan.files.session_lasers import Stripes, of_lasers, read_lasers, read_stripes, stripes_values
from jaxscan.files.session_poses import PosedImages, posed_values, read_posed_images
from jaxscan.files.session_sweeps import STEPS, Sweep, sweeps_values
from jaxscan.files.settings import read_listing, relative_name, stripe_values, write_toml
from jaxscan.files.table import Table, show
from jaxscan.images import Board, StripeSettings
from jaxscan.rig import LENSES
from jaxscan.rig.camera import camera_parameters

SESSION_FILE: Final = "session.toml"

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
class Session:
    """A calibration session.

    Attributes:
        path: its TOML file.
        board: the board.
        views: the board held in many poses.
        camera: what to estimate of the camera.
        stage: the board on the stage, where the rig has one.
        turntable: the board on the turntable, where the rig has one.
        lasers: how to search for the stripe of each laser; none for a rig without a laser.
        sheets: the kind of each laser's sheet of light, in their order; empty where all are planes.
        light_axes: of each laser whose light is moved, by its name, the axis that moves it.
        image_size: columns and rows of all its photographs.
        board_shape: which shape of the board to estimate, one of `BOARD_SHAPES`.
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
        """Those of the board on an axis, by the axis's name."""
        each = zip(SEQUENCES, (self.stage, self.turntable), strict=True)
        return {axis: sequence for axis, sequence in each if sequence is not None}

    @property
    def counts(self) -> dict[str, int]:
        """The number of photographs of the board on each axis."""
        return {axis: len(sequence.images) for axis, sequence in self.sequences.items()}

    def photographs(self) -> list[Path]:
        """All its photographs: of the board, on stage and turntable, of the stripes."""
        stripes = (self.views.stripes or {}).values()
        moved = self.sequences.values()
        paths = [*self.views.boards, *(path for sequence in moved for path in sequence.images)]
        lit = [*stripes, *(own for sequence in moved for own in sequence.stripes.values())]
        lit += [[path for _, path in sweep] for own in self.views.sweeps.values() for sweep in own]
        return list(dict.fromkeys(paths + [path for own in lit for path in own if path is not None]))


def read_session(path: str | os.PathLike[str], *, whole: bool = True) -> Session:
    """Read and check a session, given its folder or its `session.toml`.

    It is checked that every photograph exists and that all have one size; none is decoded.

    Args:
        path: of the folder, or of its `session.toml`.
        whole: whether each photograph is read to its end, so that one that is cut off is refused.

    Raises:
        InputError: whatever is wrong: file, key, value, and how to fix it.
    """
    table = read_listing(Path(path), SESSION_FILE, ("board", "camera", "views", POSES, *SEQUENCES, "laser"))
    (board, shape), camera = read_board(table), _camera(table)
    posed = read_posed_images(table)
    if "views" not in table and posed is None:
        fix = "add it, with boards = the photographs of the board held in the hand, in three poses or more"
        raise table.error("views", f"is missing: {fix}; the camera is found from them")
    views = table.optional_table("views", "[views] ").only("boards", "stripes", STEPS)
    boards = files_of(views, "boards") if "views" in table else ()
    if not boards and posed is None:
        raise views.error("boards", "names no photograph: name those of the board")
    lasers, sheets, axes, stripes, sweeps = read_lasers(table, views, boards)
    if posed is not None:
        if axes:
            raise InputError(f"{table.path}: [{POSES}]: a light that is swept needs boards under [views] only")
        boards, stripes = _with_posed(posed, lasers, boards, stripes)
    moved = read_stage(table, lasers, axes), read_turntable(table, lasers, axes)
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
    values: dict[str, Any] = {"board": board_values(session.board)}
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
        names = stripes_values(session.views.stripes, folder)
        if len(lasers) == 1:
            (values["views"]["stripes"],) = (own[:held] for own in names.values())
        else:
            for laser in lasers:
                if laser["name"] in names:
                    laser["stripes"] = names[laser["name"]][:held]
    if session.poses is not None:
        lit = {laser: own[held:] for laser, own in names.items() if any(own[held:])}
        own_stripes = {"stripes": of_lasers(lit, len(lasers))} if lit else {}
        values[POSES] = posed_values(session.poses, folder, own_stripes)
    for axis, sequence in session.sequences.items():
        values[axis] = sequence_values(sequence, folder, len(lasers))
    if lasers:
        values["laser"] = lasers[0] if len(lasers) == 1 else lasers
    write_toml(session.path, values)


def write_blank_session(path: Path, board: Board) -> None:
    """Write a `session.toml` for a board, with the names that photographs usually have, to be filled in.

    Raises:
        InputError: the file cannot be written.
    """
    with replacing(path, "w") as file:
        file.write(tomli_w.dumps({"board": board_values(board)}) + _BLANK)


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


def _with_posed(
    posed: tuple[PosedImages, Table],
    lasers: Sequence[StripeSettings],
    boards: tuple[Path, ...],
    stripes: Stripes | None,
) -> tuple[tuple[Path, ...], Stripes | None]:
    """The views, and behind them those for which a pose is given; with the photographs of their stripes."""
    images, own = posed[0].images, read_stripes(posed[1], lasers, len(posed[0].images))
    if stripes is None and not own:
        return (*boards, *images), None
    # A view without a photograph of its stripe shows it itself, where no view has one.
    before = {laser.name: boards if stripes is None else stripes[laser.name] for laser in lasers}
    none = (None,) * len(images)
    return (*boards, *images), {name: (*held, *own.get(name, none)) for name, held in before.items()}
