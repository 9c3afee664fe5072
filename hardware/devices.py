"""`scanner.toml`: which camera, stage and laser there are; without one, all of it is simulated.

[camera]
kind = "opencv"                # opencv | folder | gphoto2 | genicam | simulated
source = 0                     # opencv: a number, a device, a URL or a video; folder: a folder; genicam: a .cti
exposure_s = 0.01              # optional, with gain

[stage]
kind = "bistep"                # bistep | grbl | marlin | simulated
port = "/dev/ttyUSB0"          # or any URL of pyserial
rate_steps_s = 800             # and ramp_steps_s2, first, last, switch, backlash; baud
steps_per_mm = 250             # grbl and marlin; and reverse

[laser]
kind = "rts"                   # fixed | rts | controller | simulated
color = "red"                  # and columns, as in scan.toml
"""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final

from hardware.cameras.folder import FolderCamera
from hardware.cameras.opencv import OpenCvCamera
from hardware.errors import SettingsError
from hardware.lasers import ControllerLaser, FixedLaser, RtsLaser
from hardware.protocols import CameraDriver, LaserDriver
from hardware.scan import Devices
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import BiStep2A04, Grbl, Line, Marlin, Travel
from hardware.stages.gcode import GcodeStage
from hardware.stages.serial_stage import SerialStage
from jaxscan.errors import InputError
from jaxscan.files.listing import natural_key
from jaxscan.files.settings import read_stripe_settings
from jaxscan.files.table import Table
from jaxscan.files.text import read_toml
from jaxscan.images import StripeSettings

SCANNER_FILE: Final = "scanner.toml"
_CAMERAS: Final = ("opencv", "folder", "gphoto2", "genicam", "simulated")
_STAGES: Final = ("bistep", "grbl", "marlin", "simulated")
_LASERS: Final = ("fixed", "rts", "controller", "simulated")
_TRAVEL: Final = tuple(item.name for item in fields(Travel))
_IMAGES: Final = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
# The simulated rig of 2003 moves a board over 60 000 steps and an object over 72 000.
_SIMULATED_LAST: Final = 80_000


@dataclass(frozen=True)
class ScannerSettings:
    """What `scanner.toml` says.

    Attributes:
        path: the file, None where there is none.
        camera, stage, laser: their tables.
        travel: of the stage.
        stripe: how the laser's stripe is looked for.
        exposure_s: of all photographs, None to leave the camera as it is.
        gain: with it.
    """

    path: Path | None = None
    camera: Table = field(default_factory=lambda: _simulated("camera"))
    stage: Table = field(default_factory=lambda: _simulated("stage"))
    laser: Table = field(default_factory=lambda: _simulated("laser"))
    travel: Travel = field(default_factory=lambda: Travel(last=_SIMULATED_LAST))
    stripe: StripeSettings = field(default_factory=StripeSettings)
    exposure_s: float | None = None
    gain: float = 1.0


def read_scanner(path: Path | None) -> ScannerSettings:
    """Read and check a scanner's description; without one, that of the simulated scanner.

    Args:
        path: the file; None for `scanner.toml` in the working folder, if it is there.

    Raises:
        InputError: whatever is wrong: file, key, value and the mend.
    """
    if path is None and not Path(SCANNER_FILE).is_file():
        return ScannerSettings()
    table = read_toml(path or Path(SCANNER_FILE), "the scanner.toml that describes the scanner").only(
        "camera", "stage", "laser"
    )
    camera = table.table("camera", "[camera] ").only("kind", "source", "size", "exposure_s", "gain", "serial_number")
    stage = table.table("stage", "[stage] ").only(
        "kind", "port", "baud", "steps_per_mm", "reverse", "speed", "play", *_TRAVEL
    )
    laser = table.table("laser", "[laser] ").only("kind", "port", "color", "columns", "name")
    camera.string("kind", choices=_CAMERAS)
    kind = laser.string("kind", choices=_LASERS)
    numbers = {key: stage.number(key) for key in _TRAVEL if key in stage}
    whole = {key: value if key.endswith(("_s", "_s2")) else stage.whole(key) for key, value in numbers.items()}
    if stage.string("kind", choices=_STAGES) == "simulated":
        whole.setdefault("last", _SIMULATED_LAST)
    try:
        travel = Travel(**whole)  # pyright: ignore[reportArgumentType]
    except SettingsError as error:
        raise InputError(f"{table.path}: [stage] {error}") from error
    if kind == "controller" and stage.values["kind"] not in ("grbl", "marlin"):
        raise laser.error("kind", "a BiStep2A04 switches no laser: use rts, or fixed")
    return ScannerSettings(
        path=table.path,
        camera=camera,
        stage=stage,
        laser=laser,
        travel=travel,
        stripe=read_stripe_settings(laser),
        exposure_s=_positive(camera, "exposure_s") if "exposure_s" in camera else None,
        gain=_positive(camera, "gain") if "gain" in camera else 1.0,
    )


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
        stage = open_stage(settings, homed)
        undo.callback(stage.close)
        laser = _laser(settings, stage)
        camera = _camera(settings, stage, laser, seed)
        undo.callback(camera.close)
        camera.open()
        if settings.exposure_s is not None:
            camera.configure(settings.exposure_s, settings.gain)
        undo.pop_all()
        return Devices(camera, stage, laser)


def open_stage(settings: ScannerSettings, homed: bool = False) -> SerialStage:
    """Connect to the stage alone.

    Raises:
        HardwareError: it is not there.
    """
    table, travel = settings.stage, settings.travel
    kind = table.string("kind", choices=_STAGES)
    if kind == "simulated":
        speed = table.number("speed") if "speed" in table else 0.0
        return SimulatedStage(travel, play=table.whole("play") if "play" in table else 0, speed=speed)
    how: dict[str, Any] = {"baud": _positive(table, "baud", table.whole)} if "baud" in table else {}
    port = table.string("port")
    if kind == "bistep":
        return BiStep2A04(port, travel, homed=homed, **how)
    make = Grbl if kind == "grbl" else Marlin
    reverse = table.boolean("reverse", False)
    return make(port, travel, steps_per_mm=table.number("steps_per_mm"), reverse=reverse, **how)


def _laser(settings: ScannerSettings, stage: SerialStage) -> LaserDriver:
    table = settings.laser
    kind = table.string("kind", choices=_LASERS)
    if kind == "simulated":
        return SimulatedLaser()
    if kind == "fixed":
        return FixedLaser()
    if kind == "controller":
        assert isinstance(stage, GcodeStage)  # read_scanner saw to it
        return ControllerLaser(stage)
    if "port" in table:
        return RtsLaser(Line(table.string("port"), 9600))
    return RtsLaser(stage.line)


def _camera(settings: ScannerSettings, stage: SerialStage, laser: LaserDriver, seed: int) -> CameraDriver:
    table = settings.camera
    kind = table.string("kind", choices=_CAMERAS)
    if kind == "simulated":
        if not isinstance(stage, SimulatedStage) or not isinstance(laser, SimulatedLaser):
            raise table.error("kind", "a simulated camera needs a simulated stage and a simulated laser")
        from hardware.simulated.camera import SimulatedCamera, SimulatedWorld
        from jaxscan.simulation.rig_2003 import OBJECT_Y
        from jaxscan.simulation.shapes import cup

        return SimulatedCamera(SimulatedWorld(seed, cup(OBJECT_Y)), stage, laser)
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
    """The photographs of a folder; of a scan those of its steps.

    Raises:
        InputError: the folder is not there, or its scan cannot be read.
    """
    from jaxscan.files.scan import SCAN_FILE, read_scan

    if (folder / SCAN_FILE).is_file():
        scan = read_scan(folder)
        return FolderCamera(scan.frames, scan.steps)
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder: check [camera] source")
    paths = [path for path in folder.iterdir() if path.suffix.lower() in _IMAGES]
    return FolderCamera(sorted(paths, key=lambda path: natural_key(path.name)))


def _simulated(key: str) -> Table:
    return Table(Path(SCANNER_FILE), f"[{key}] ", {"kind": "simulated"})


def _positive(table: Table, key: str, read: Callable[[str], float] | None = None) -> Any:
    value = (read or table.number)(key)
    if value <= 0:
        raise table.error(key, "must be positive")
    return value
