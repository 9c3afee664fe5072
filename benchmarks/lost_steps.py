"""Scans by motors that stall and loads that are pushed, each from its seed alone: which wrong places nothing marks.

A session takes a scan of a few places on an emulated BiStep2A04, GRBL or Marlin, at the end of a line that may be bad,
with the check that `scanner scan` makes by default. The emulator knows where the load really was at each photograph.
"""

import random
import tempfile
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.metric import Metric
from benchmarks.serial_sessions import AT_SWITCH
from hardware.errors import HardwareError
from hardware.frame import Frame
from hardware.scan import Devices, take
from hardware.scan_plan import Plan, ScanFolder
from hardware.simulated.laser import SimulatedLaser
from hardware.stages import BiStep2A04, Grbl, Marlin, Travel

KINDS = ("bistep", "grbl", "marlin")
TRAVEL = Travel(last=20000)
_SESSIONS, _QUICK_SESSIONS = 500, 20
# The motor's own least rate of losing steps is never met, or lies below the axis's rate of 800 steps/s.
_STALLS = (1e6, 1e6, 250.0, 400.0, 600.0, 790.0)
# Beyond what the check takes for right.
_WRONG = 4


@dataclass(frozen=True)
class Session:
    """What a session left.

    Attributes:
        kind: of the controller.
        error: how the scan ended, "" for well.
        wrong: photographs that were taken elsewhere than their places say.
        called_right: those of them that a check in `scan.toml` says to be right: this must never be.
        unchecked: those of them of which no check tells, after a scan that ended in an error.
        right: photographs that are right and said to be.
        photographs: in all.
    """

    kind: str
    error: str
    wrong: int
    called_right: int
    unchecked: int
    right: int
    photographs: int


class _Camera:
    """Photographs nothing, and notes where the load is."""

    def __init__(self) -> None:
        self.at: list[float] = []
        self.load = lambda: 0.0

    def open(self) -> None:
        """It is."""

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Nothing to set."""

    def expose(self, positions: Mapping[str, int]) -> Frame:
        """A grey image."""
        self.at.append(self.load())
        return Frame(np.full((4, 5, 3), 9, np.uint8), positions, 0.0, 0.01)

    def close(self) -> None:
        """Nothing to do."""


def session(seed: int, kind: str | None = None, *, sound: bool = False) -> Session:
    """A scan, of any controller or of one; `sound` for a motor that loses nothing on a line without faults."""
    random_ = random.Random(seed)
    kind = kind or random_.choice(KINDS)
    play, stall = random_.randrange(200), 1e9 if sound else random_.choice(_STALLS)
    faults = f"length={TRAVEL.span + 1000}&play={play}&stall_rate={stall}&seed={seed}"
    if not sound and random_.random() < 0.3:
        faults += "".join(f"&{fault}={10 ** random_.uniform(-4, -2.5):.6f}" for fault in ("drop", "garble"))
    stage = stage_of(kind, faults)
    port, camera = stage.line.port, _Camera()
    camera.load = lambda: port.axis.load(port.clock.now_s()) - AT_SWITCH[kind] + TRAVEL.switch
    places = tuple(1000 * place for place in random_.sample(range(20), random_.randint(1, 4)))
    pushed = -1 if sound or random_.random() < 0.7 else random_.randrange(len(places))

    def taken(path: Path, frame: Frame) -> None:
        if len(folder.done.frames) - 1 == pushed:
            port.axis.push(random_.choice((-30, 30, 250)), port.clock.now_s())

    error = ""
    with tempfile.TemporaryDirectory() as name:
        folder = ScanFolder.create(Path(name) / "cup", Plan({"stage": places}, settle_s=0.0))
        try:
            devices = Devices(camera, {"stage": stage}, SimulatedLaser())
            take(folder, devices, taken=taken, verify=random_.choice((0, 2)))
        except HardwareError as refused:
            error = str(refused)
        count, checks = len(folder.done.frames), folder.done.checks
    wrong = np.abs(np.array(camera.at[:count]) - places[:count]) > _WRONG
    said, clean = np.zeros(count, bool), np.zeros(count, bool)
    for check in checks:
        said[check.first : check.last + 1] = True
        clean[check.first : check.last + 1] = not check.off and not check.unverified
    return Session(
        kind=kind,
        error=error,
        wrong=int(wrong.sum()),
        called_right=int((wrong & clean).sum()),
        unchecked=int((wrong & ~said).sum()),
        right=int((~wrong & clean).sum()),
        photographs=count,
    )


def stage_of(kind: str, faults: str) -> BiStep2A04 | Grbl | Marlin:
    """A stage on an emulated controller; its faults as in the emulator's URL."""
    url = f"emulator://{kind}?{faults}"
    if kind == "bistep":
        return BiStep2A04(url, TRAVEL)
    return Grbl(url, TRAVEL, steps_per_mm=250.0) if kind == "grbl" else Marlin(url, TRAVEL, steps_per_mm=80.0)


def measure(quick: bool) -> list[Metric]:
    """Sessions with stalls, pushes and bad lines."""
    with ProcessPoolExecutor(2) as pool:
        found = list(pool.map(session, range(_QUICK_SESSIONS if quick else _SESSIONS), chunksize=10))
    return [
        Metric("lost_steps.sessions", len(found)),
        Metric("lost_steps.photographs", sum(one.photographs for one in found)),
        Metric("lost_steps.wrong_places", sum(one.wrong for one in found)),
        Metric("lost_steps.wrong_places_called_right", sum(one.called_right for one in found), "", "lower", 0),
        Metric("lost_steps.wrong_places_unverified", sum(one.unchecked for one in found)),
        Metric("lost_steps.right_places_called_right", sum(one.right for one in found)),
        *[
            Metric(f"lost_steps.{kind}.right_of_sessions_that_lost_none", _verified(found, kind), "", "higher")
            for kind in KINDS
        ],
    ]


def _verified(found: list[Session], kind: str) -> float:
    """The share of photographs that is said to be right, in sessions of a controller without a wrong place."""
    sound = [one for one in found if one.kind == kind and not one.wrong]
    return sum(one.right for one in sound) / max(1, sum(one.photographs for one in sound))
