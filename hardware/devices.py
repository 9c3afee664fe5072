"""`scanner.toml`: which camera, axes and laser there are; without one, all of it is simulated.

[camera]
kind = "opencv"                # opencv | folder | gphoto2 | genicam | simulated
source = 0                     # opencv: a number, a device, a URL or a video; folder: a folder; genicam: a .cti
exposure_s = 0.01              # optional, with gain

[stage]                        # the axis "stage"
kind = "bistep"                # bistep | grbl | marlin | simulated
port = "/dev/ttyUSB0"          # or any URL of pyserial
rate_steps_s = 800             # and ramp_steps_s2, first, last, switch, backlash, reference; baud
steps_per_mm = 250             # grbl and marlin; and reverse, axis

[axes.turntable]               # another axis, by its name; with the port of the stage, an axis of its controller
kind = "grbl"
port = "/dev/ttyUSB0"
axis = "Y"
steps_per_mm = 8.888889        # the controller's own number: here steps a degree
steps_per_turn = 3200          # of an axis that turns
reference = "here"             # it has no switch

[laser]
kind = "rts"                   # fixed | rts | controller | simulated
color = "red"                  # and columns, as in scan.toml
"""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import UInt

from hardware.cameras.folder import FolderCamera
from hardware.cameras.opencv import OpenCvCamera
from hardware.errors import CameraError, SettingsError
from hardware.lasers import ControllerLaser, FixedLaser, LaserSwitch, RtsLaser
from hardware.places import STAGE, TURNTABLE, places_of
from hardware.protocols import CameraDriver, LaserDriver, StageDriver
from hardware.scan import Devices
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import STAGE_KINDS, Line, Travel
from hardware.stages.kinds import StageKind
from hardware.stages.travel_settings import HERE, SWITCH
from jaxscan.errors import InputError
from jaxscan.files.axes import is_axis_name
from jaxscan.files.listing import natural_key
from jaxscan.files.settings import read_stripe_settings
from jaxscan.files.table import Table
from jaxscan.files.text import read_toml
from jaxscan.images import StripeSettings, read_image

SCANNER_FILE: Final = "scanner.toml"
_CAMERAS: Final = ("opencv", "folder", "gphoto2", "genicam", "simulated")
_LASERS: Final = ("fixed", "rts", "controller", "simulated")
_TRAVEL: Final = tuple(item.name for item in fields(Travel))
_IMAGES: Final = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
# The simulated rig of 2003 moves a board over 60 000 steps and an object over 72 000; its turntable has 3200 a turn.
_SIMULATED: Final = {STAGE: Travel(last=80_000), TURNTABLE: Travel(last=3200, steps_per_turn=3200)}


@dataclass(frozen=True)
class AxisSettings:
    """What `scanner.toml` says of one axis: its table, and its way and pace."""

    table: Table
    travel: Travel


@dataclass(frozen=True)
class ScannerSettings:
    """What `scanner.toml` says.

    Attributes:
        path: the file, None where there is none.
        camera, laser: their tables.
        axes: by their names; those that share a port are axes of one controller.
        stripe: how the laser's stripe is looked for.
        exposure_s: of all photographs, None to leave the camera as it is.
        gain: with it.
    """

    path: Path | None = None
    camera: Table = field(default_factory=lambda: _simulated("camera"))
    axes: Mapping[str, AxisSettings] = field(
        default_factory=lambda: {name: AxisSettings(_simulated(name), travel) for name, travel in _SIMULATED.items()}
    )
    laser: Table = field(default_factory=lambda: _simulated("laser"))
    stripe: StripeSettings = field(default_factory=StripeSettings)
    exposure_s: float | None = None
    gain: float = 1.0

    @property
    def travels(self) -> dict[str, Travel]:
        """Way and pace of each axis."""
        return {name: axis.travel for name, axis in self.axes.items()}

    @property
    def simulated(self) -> tuple[str, ...]:
        """Which parts are simulated: the camera, axes by their names, the laser."""
        tables = {"camera": self.camera, **{name: axis.table for name, axis in self.axes.items()}, "laser": self.laser}
        return tuple(name for name, table in tables.items() if table.values["kind"] == "simulated")


def read_scanner(path: Path | None) -> ScannerSettings:
    """Read and check a scanner's description; without one, that of the simulated scanner.

    Args:
        path: the file; None for `scanner.toml` in the working folder, if it is there.

    Raises:
        InputError: whatever is wrong: file, key, value and the fix.
    """
    if path is None and not Path(SCANNER_FILE).is_file():
        return ScannerSettings()
    table = read_toml(path or Path(SCANNER_FILE), "the scanner.toml that describes the scanner").only(
        "camera", STAGE, "axes", "laser"
    )
    camera = table.table("camera", "[camera] ").only("kind", "source", "size", "exposure_s", "gain", "serial_number")
    laser = table.table("laser", "[laser] ").only("kind", "port", "color", "columns", "name")
    camera.string("kind", choices=_CAMERAS)
    axes = _read_axes(table)
    kind = laser.string("kind", choices=_LASERS)
    if kind == "controller" and not any(map(_switches_laser, axes.values())):
        raise laser.error(
            "kind", "no controller of an axis here switches a laser, GRBL and Marlin do: use rts, or fixed"
        )
    return ScannerSettings(
        path=table.path,
        camera=camera,
        axes=axes,
        laser=laser,
        stripe=read_stripe_settings(laser),
        exposure_s=_positive(camera, "exposure_s") if "exposure_s" in camera else None,
        gain=_positive(camera, "gain") if "gain" in camera else 1.0,
    )


def _read_axes(table: Table) -> dict[str, AxisSettings]:
    """`[stage]`, and the tables in `[axes]` in their order."""
    axes = {}
    if STAGE in table or "axes" not in table:
        axes[STAGE] = _read_axis(STAGE, table.table(STAGE, "[stage] "))
    if "axes" in table:
        others = table.table("axes", "[axes] ")
        for name in others.values:
            if not is_axis_name(name):
                raise others.error(name, "is no name of an axis: write letters, digits, _ and - alone")
            if name in axes:
                raise others.error(name, f"[{STAGE}] is given too: keep one of them")
            axes[name] = _read_axis(name, others.table(name, f"[axes.{name}] "))
        if not axes:
            raise table.error("axes", f"has no axis: add [axes.{TURNTABLE}], or [{STAGE}]")
    return axes


def _read_axis(name: str, table: Table) -> AxisSettings:
    kind = STAGE_KINDS[table.string("kind", choices=tuple(STAGE_KINDS))]
    table = table.only("kind", *kind.settings, *_TRAVEL)
    numbers: dict[str, Any] = {}
    for key in _TRAVEL:
        if key in table and key != "reference":
            value = table.number(key)
            numbers[key] = value if key.endswith(("_s", "_s2")) else table.whole(key)
    if "reference" in table:
        numbers["reference"] = table.string("reference", choices=(SWITCH, HERE))
    if kind is STAGE_KINDS["simulated"] and name in _SIMULATED:
        known = _SIMULATED[name]
        numbers = {"last": known.last, "steps_per_turn": known.steps_per_turn} | numbers
    if numbers.get("steps_per_turn") is not None:
        numbers.setdefault("last", numbers.get("first", 0) + numbers["steps_per_turn"])
    try:
        return AxisSettings(table, Travel(**numbers))
    except SettingsError as error:
        raise InputError(f"{table.path}: {table.prefix}{error}") from error


def open_scanner(settings: ScannerSettings, seed: int = 0, homed: bool = False) -> Devices:
    """Connect to all of it.

    Args:
        settings: of the scanner.
        seed: of the simulated world.
        homed: take it that a BiStep2A04 has kept its count since it was last homed.

    Raises:
        HardwareError: something is not there.
        InputError: a value is wrong.
    """
    with ExitStack() as undo:
        axes: dict[str, StageDriver] = {}
        for name in settings.axes:
            axes[name] = open_stage(settings, name, homed, axes)
            undo.callback(axes[name].close)
        laser = _laser(settings, axes)
        camera = _camera(settings, axes, laser, seed)
        undo.callback(camera.close)
        camera.open()
        if settings.exposure_s is not None:
            camera.configure(settings.exposure_s, settings.gain)
        undo.pop_all()
        return Devices(camera, axes, laser)


def open_stage(
    settings: ScannerSettings, name: str = STAGE, homed: bool = False, opened: Mapping[str, StageDriver] | None = None
) -> StageDriver:
    """Connect to one axis.

    Args:
        settings: of the scanner.
        name: of the axis.
        homed: take it that a BiStep2A04 has kept its count since it was last homed.
        opened: other axes that are open already; one with the same port is one of the same controller.

    Raises:
        HardwareError: it is not there.
        InputError: the scanner has no such axis, or a value is wrong.
    """
    if name not in settings.axes:
        raise InputError(
            f"{settings.path or SCANNER_FILE}: has no axis {name}, but {', '.join(settings.axes)}: name one, or "
            f"describe it as [axes.{name}]"
        )
    table, travel = settings.axes[name].table, settings.axes[name].travel
    kind = STAGE_KINDS[table.string("kind", choices=tuple(STAGE_KINDS))]
    how = {key: _setting(kind, table, key) for key in kind.settings if key in table or kind.needs(key)}
    if homed and kind.takes("homed"):
        how["homed"] = True
    if "port" in how:
        for other, driver in (opened or {}).items():
            if settings.axes[other].table.values.get("port") == how["port"]:
                if not kind.takes("beside"):
                    raise table.error("port", f"is that of the {other} too: a {table.values['kind']} has one axis")
                how["beside"] = driver
                break
    return kind.make(travel=travel, **how)


def _setting(kind: StageKind, table: Table, key: str) -> Any:
    of = kind.settings[key]
    if of is str:
        return table.string(key)
    if of is bool:
        return table.boolean(key, False)
    value = table.whole(key) if of is int else table.number(key)
    if key == "baud" and value <= 0:
        raise table.error(key, "must be positive")
    return value


def _switches_laser(axis: AxisSettings) -> bool:
    return hasattr(STAGE_KINDS[axis.table.values["kind"]].make, "set_laser")


def _laser(settings: ScannerSettings, axes: Mapping[str, StageDriver]) -> LaserDriver:
    table = settings.laser
    kind = table.string("kind", choices=_LASERS)
    if kind == "simulated":
        return SimulatedLaser()
    if kind == "fixed":
        return FixedLaser()
    if kind == "controller":
        return ControllerLaser(next(axis for axis in axes.values() if isinstance(axis, LaserSwitch)))
    lines = [line for axis in axes.values() if isinstance(line := getattr(axis, "line", None), Line)]
    if "port" in table:
        port = table.string("port")
        # A port is opened once: the laser may share that of an axis.
        return RtsLaser(next((line for line in lines if line.name == port), None) or Line(port, 9600))
    if lines:
        return RtsLaser(lines[0])
    raise table.error("kind", "no axis has a serial line for it: give the laser's own port")


def _camera(settings: ScannerSettings, axes: Mapping[str, StageDriver], laser: LaserDriver, seed: int) -> CameraDriver:
    table = settings.camera
    kind = table.string("kind", choices=_CAMERAS)
    if kind == "simulated":
        simulated = {name: axis for name, axis in axes.items() if isinstance(axis, SimulatedStage)}
        if len(simulated) < len(axes) or not isinstance(laser, SimulatedLaser) or not set(axes) <= set(_SIMULATED):
            raise table.error(
                "kind", f"a simulated camera needs a simulated laser, and simulated axes: {' and '.join(_SIMULATED)}"
            )
        from hardware.simulated.camera import SimulatedCamera, SimulatedWorld
        from jaxscan.simulation.rig_2003 import OBJECT_Y
        from jaxscan.simulation.shapes import cup

        return SimulatedCamera(SimulatedWorld(seed, cup(OBJECT_Y)), simulated, laser)
    if kind == "opencv":
        source = table.values.get("source", 0)
        size = table.size("size") if "size" in table else None
        return OpenCvCamera(source if isinstance(source, int) else table.string("source"), size)
    if kind == "gphoto2":
        from hardware.cameras.gphoto import GPhotoCamera

        return GPhotoCamera()
    source = (settings.path or Path()).parent / table.string("source")
    if kind == "genicam":
        from hardware.cameras.genicam import GenICamCamera

        return GenICamCamera(source, table.string("serial_number") if "serial_number" in table else None)
    return folder_camera(source)


def folder_camera(folder: Path) -> FolderCamera:
    """The photographs of a folder; of a scan those of its places.

    Raises:
        InputError: the folder is not there, or its scan cannot be read.
    """
    from jaxscan.files.scan import SCAN_FILE, read_scan

    if (folder / SCAN_FILE).is_file():
        scan = read_scan(folder)
        return FolderCamera(scan.frames, read_photograph, places_of(scan.axes))
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder: check [camera] source")
    paths = [path for path in folder.iterdir() if path.suffix.lower() in _IMAGES]
    return FolderCamera(sorted(paths, key=lambda path: natural_key(path.name)), read_photograph)


def read_photograph(path: Path) -> UInt[np.ndarray, "rows columns *rgb"]:
    """A photograph of a folder, for a camera driver, which knows `HardwareError` alone.

    Raises:
        CameraError: it cannot be read.
    """
    try:
        return read_image(path)
    except InputError as error:
        raise CameraError(str(error)) from error


def _simulated(key: str) -> Table:
    return Table(Path(SCANNER_FILE), f"[{key}] ", {"kind": "simulated"})


def _positive(table: Table, key: str, read: Callable[[str], float] | None = None) -> Any:
    value = (read or table.number)(key)
    if value <= 0:
        raise table.error(key, "must be positive")
    return value
