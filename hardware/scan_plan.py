"""What a scan is to do, and what of it is done: the folder of a scan under way.

`scan.toml`, as every scan has it, lists the frames that are whole; `plan.json` beside it says where the others are to
be taken. Both are written beside and renamed.
"""

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from hardware.frame import Frame
from hardware.places import Axes, Place, axes_of, places_of
from jaxscan.atomic import check_writable, replacing
from jaxscan.errors import InputError, error_context
from jaxscan.exclusive import exclusive
from jaxscan.files.axes import STAGE, is_axis_name
from jaxscan.files.listing import common_size
from jaxscan.files.place_checks import PlaceCheck
from jaxscan.files.scan import SCAN_FILE, Scan, read_listed, write_scan
from jaxscan.files.text import read_json
from jaxscan.images import StripeSettings, read_image, write_image

PLAN_FILE: Final = "plan.json"
_FRAMES: Final = "frames"
# Whoever writes into the folder holds it.
_LOCK: Final = ".scan.lock"
_FORMAT: Final = "jaxscan-plan/2"
# Had `steps`, those of the stage, instead of `axes`.
_STAGE_ALONE: Final = "jaxscan-plan/1"


@dataclass(frozen=True)
class Plan:
    """A scan to take.

    Attributes:
        axes: for each axis where it is to stand, in motor steps, one position for each frame.
        settle_s: how long to wait at each place before the photograph.
        dark: whether every frame comes with one with the laser off.
        exposure_s: of every photograph; None leaves the camera as it is.
        gain: of the camera, with `exposure_s`.
        name: what is scanned.
        laser: how its stripe is looked for afterwards.
    """

    axes: Axes
    settle_s: float = 0.2
    dark: bool = False
    exposure_s: float | None = None
    gain: float = 1.0
    name: str = ""
    laser: StripeSettings = field(default_factory=StripeSettings)

    def __post_init__(self) -> None:
        """Refuse what is no scan.

        Raises:
            InputError: no axis, no frame, a place twice, or a time that is none.
        """
        if not all(is_axis_name(name) for name in self.axes):
            raise InputError(f"axes = {list(self.axes)}: the name of an axis has letters, digits, _ and - alone")
        if len({len(steps) for steps in self.axes.values()}) != 1:
            counts = {name: len(steps) for name, steps in self.axes.items()}
            raise InputError(
                f"axes have {counts} positions: a scan has an axis or more, with a position for each frame"
            )
        places = [tuple(place.values()) for place in self.places]
        if not places or len(set(places)) < len(places):
            raise InputError(f"axes = {dict(self.axes)}: a scan has one frame or more, each at a place of its own")
        if not 0 <= self.settle_s < math.inf:
            raise InputError(f"settle_s = {self.settle_s}: give 0 seconds or more")
        if self.exposure_s is not None and not 0 < self.exposure_s < math.inf:
            raise InputError(f"exposure_s = {self.exposure_s}: give a positive number of seconds")

    @property
    def places(self) -> tuple[Place, ...]:
        """The same, frame by frame."""
        return places_of(self.axes)


def alone_in(folder: Path) -> AbstractContextManager[None]:
    """Let no other program write into a scan's folder while the block lasts.

    Raises:
        InUseError: another process does.
        InputError: its lock cannot be made.
    """
    return exclusive(folder / _LOCK, str(folder))


class ScanFolder:
    """A scan under way: what is in `done` is on the disk, whole, and stays.

    Attributes:
        plan: all that is to be done.
        done: the frames that are.
    """

    def __init__(self, plan: Plan, done: Scan):
        self.plan, self.done = plan, done

    @staticmethod
    def create(folder: Path, plan: Plan) -> "ScanFolder":
        """Begin a scan in a folder that is new or empty; what a beginning that was cut off has left is cleared away.

        Raises:
            InputError: the folder holds something, or cannot be made.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made ({error.strerror}): choose another folder") from error
        with alone_in(folder):
            if holds_something(folder):
                begun = (folder / PLAN_FILE).exists()
                hint = "continue it with --resume" if begun else "name a folder that is new or empty"
                raise InputError(f"{folder}: is not empty: {hint}")
            for path in (*folder.glob(".*.part"), folder / SCAN_FILE):
                path.unlink(missing_ok=True)
            check_writable(folder / SCAN_FILE)
            (folder / _FRAMES).mkdir(exist_ok=True)
            # The scan first: a folder with a plan has one that reads.
            exposures_s = None if plan.exposure_s is None else ()
            axes = dict.fromkeys(plan.axes, ())
            done = Scan(folder / SCAN_FILE, plan.laser, axes=axes, exposures_s=exposures_s, name=plan.name)
            write_scan(done)
            _write_plan(folder / PLAN_FILE, plan)
        return ScanFolder(plan, done)

    @staticmethod
    def resume(folder: Path) -> "ScanFolder":
        """Continue a scan that ended early, wherever that was.

        Raises:
            InputError: there is none, or a frame that it lists is not whole.
        """
        if not (folder / PLAN_FILE).is_file():
            raise InputError(f"{folder}: has no {PLAN_FILE}: begin a scan there without --resume")
        with alone_in(folder):
            for path in (*folder.glob(".*.part"), *(folder / _FRAMES).glob(".*.part")):
                path.unlink()
            return ScanFolder(*_begun(folder))

    @contextmanager
    def held(self) -> Iterator[None]:
        """Let nobody else take frames into it while the block lasts; what others took before counts as done.

        Raises:
            InUseError: another process does.
            InputError: the folder was changed by hand.
        """
        folder = self.done.path.parent
        with alone_in(folder):
            if read_listed(folder).frames != self.done.frames:
                self.plan, self.done = _begun(folder)
            yield

    @property
    def left(self) -> tuple[Place, ...]:
        """The places whose frames are still to be taken."""
        return self.plan.places[len(self.done.frames) :]

    @property
    def taken(self) -> tuple[Place, ...]:
        """The places of those that are done."""
        return self.plan.places[: len(self.done.frames)]

    def go_on_at(self, places: Sequence[Place], settle_s: float) -> None:
        """Take these after those that are done, in place of those that are left.

        Raises:
            InputError: a place twice, one of other axes, or the disk.
        """
        plan = replace(self.plan, axes=axes_of([*self.taken, *places]), settle_s=settle_s)
        _write_plan(self.done.path.parent / PLAN_FILE, plan)
        self.plan = plan

    def add(self, frame: Frame, dark: Frame | None = None) -> Path:
        """Make a frame durable, then list it; when this returns it counts.

        Raises:
            InputError: the disk is full or gone, or the frame is not like those before it.
        """
        folder, number = self.done.path.parent, len(self.done.frames)
        path = folder / _FRAMES / f"{number:04d}.png"
        backgrounds = self.done.backgrounds
        if dark is not None:
            beside = folder / _FRAMES / f"{number:04d}-dark.png"
            write_image(beside, dark.image)
            backgrounds = (*backgrounds, beside)
        write_image(path, frame.image)
        exposures = self.done.exposures_s
        done = replace(
            self.done,
            frames=(*self.done.frames, path),
            axes={name: (*steps, frame.positions[name]) for name, steps in self.done.axes.items()},
            backgrounds=backgrounds,
            exposures_s=None if exposures is None else (*exposures, frame.exposure_s),
        )
        write_scan(done)
        self.done = done
        return path

    def check(self, check: PlaceCheck) -> None:
        """Write down what a check of the axes has shown.

        Raises:
            InputError: the disk is full or gone.
        """
        done = replace(self.done, checks=(*self.done.checks, check))
        write_scan(done)
        self.done = done


def holds_something(folder: Path) -> bool:
    """Whether there is more in a folder than what a scan leaves that was cut off before it was planned."""
    files = {path for path in folder.rglob("*") if not (path.is_dir() and not path.is_symlink())}
    others = {path for path in files if path.suffix != ".part"} - {folder / _LOCK, folder / SCAN_FILE}
    folders = {path for path in folder.iterdir() if path not in files} - {folder / _FRAMES}
    if others or folders:
        return True
    try:
        return (folder / SCAN_FILE) in files and bool(read_listed(folder).frames)
    except InputError:
        return True


def _begun(folder: Path) -> tuple[Plan, Scan]:
    """What is to be done and what is, each frame seen to be whole.

    A frame that was cut off before it was listed is taken again, under the same name.
    """
    plan, done = _read_plan(folder / PLAN_FILE), read_listed(folder)
    if done.axes != {name: steps[: len(done.frames)] for name, steps in plan.axes.items()}:
        raise InputError(
            f"{folder / SCAN_FILE}: its positions are not the first of those in {PLAN_FILE}: it was changed by hand; "
            "keep it as it is, and begin another"
        )
    for path in (*done.frames, *done.backgrounds):
        read_image(path)
    if done.frames:
        common_size([*done.frames, *done.backgrounds])
    return plan, done


def _write_plan(path: Path, plan: Plan) -> None:
    with replacing(path, "w") as file:
        json.dump({"format": _FORMAT, **asdict(plan)}, file, indent=2)


def _read_plan(path: Path) -> Plan:
    """Read back what `create` wrote.

    Raises:
        InputError: it was changed.
    """
    keys = tuple(Plan.__dataclass_fields__)
    table = read_json(path).only("format", "steps", *keys)
    if (form := table.string("format")) not in (_FORMAT, _STAGE_ALONE):
        raise table.error("format", f"only {_FORMAT} and {_STAGE_ALONE} are read here")
    if form == _STAGE_ALONE:
        axes = {STAGE: table.wholes("steps")}
    else:
        listed = table.table("axes", "axes.")
        axes = {name: listed.wholes(name) for name in listed.values}
    laser = table.table("laser", "laser.").only("color", "columns", "name").values
    values: dict[str, Any] = {key: table.values[key] for key in keys if key in table}
    try:
        with error_context(path):
            return Plan(**values | {"axes": axes, "laser": StripeSettings(**laser)})
    except TypeError as error:
        raise InputError(f"{path}: is not what a scan writes ({error}): begin another scan") from error
