"""Sessions of a stage and a laser on an emulated controller at the end of a bad line, each from its seed alone.

In every session the stage is homed, the laser switched on, the stage sent to three places, the laser switched off. The
emulator knows where the load really is, so that every position which the driver believes can be compared.
"""

import random
import time
from dataclasses import dataclass

from hardware.errors import HardwareError
from hardware.lasers import ControllerLaser, RtsLaser
from hardware.safety import safely
from hardware.stages import BiStep2A04, Grbl, Marlin, Travel

TRAVEL = Travel(rate_steps_s=800, ramp_steps_s2=2000, last=12000, switch=-1000, backlash=200)
_KINDS = ("bistep", "bistep", "bistep", "grbl", "marlin")
# Where the motor is, from the switch, at the count of `TRAVEL.switch`: GRBL pulls off by a millimetre.
AT_SWITCH = {"bistep": 0, "grbl": 250, "marlin": 0}
# Words that an error has when it cannot know.
_MAY = "MAY STILL BE"
_LONGEST_S = 600.0


@dataclass(frozen=True)
class Outcome:
    """How a session ended.

    Attributes:
        kind: of the controller.
        seed: of everything.
        url: the emulator's.
        error: the driver's words, "" for success.
        places: how many positions were believed.
        wrong: those of them that were not true, as (believed, true).
        moving, laser: what was still so at the end, in truth.
        pulled: whether the cable was out by then.
        seconds: of the emulated time.
        wall_s: of the wall's.
    """

    kind: str
    seed: int
    url: str
    error: str
    places: int
    wrong: tuple[tuple[int, float], ...]
    moving: bool
    laser: bool
    pulled: bool
    seconds: float
    wall_s: float

    @property
    def fault(self) -> str:
        """What must never be, "" for none of it."""
        if self.wrong:
            return f"believed {self.wrong}"
        if self.seconds > _LONGEST_S:
            return f"took {self.seconds:.0f} s"
        if not self.error and (self.moving or self.laser):
            return "ended well with stage or laser on"
        if (self.moving or self.laser) and _MAY not in self.error:
            return f"left on without a word: {self.error}"
        return ""


def fault_free(kind: str) -> str:
    """The emulator on a line without faults."""
    return f"emulator://{kind}?length=14000&start=1500&play=150&stall_rate=2000"


def session_url(kind: str, random_: random.Random) -> str:
    """An emulator with some of the faults, each seldom or often."""
    url = f"{fault_free(kind)}&seed={random_.randrange(1 << 30)}"
    if kind == "bistep":
        url += f"&echo={random_.randrange(2)}"
    for fault in random_.sample(("drop", "double", "garble", "delay"), random_.randint(1, 4)):
        url += f"&{fault}={10 ** random_.uniform(-4, -2):.6f}"
    if random_.random() < 0.25:
        url += f"&pull_s={random_.uniform(0.1, 40):.3f}&silent={random_.randrange(2)}"
    return url


def session(seed: int) -> Outcome:
    """A session with random faults."""
    random_ = random.Random(seed)
    kind = random_.choice(_KINDS)
    url = session_url(kind, random_)
    places = [random_.randint(TRAVEL.first, TRAVEL.last) for _ in range(3)]
    return run(kind, url, places, seed)


def struck(kind: str, index: int, byte: int) -> Outcome:
    """A session on a perfect line, but for one byte on its way to the controller, which becomes another."""
    return run(kind, f"{fault_free(kind)}&strike_at={index}&strike_with={byte}", [2000, 1200])


def run(kind: str, url: str, places: list[int], seed: int = 0) -> Outcome:
    """Home, laser on, to each place, laser off; and what became of it."""
    begin = time.perf_counter()
    if kind == "bistep":
        stage = BiStep2A04(url, TRAVEL)
        laser = RtsLaser(stage.line)
    else:
        stage = Grbl(url, TRAVEL, steps_per_mm=250) if kind == "grbl" else Marlin(url, TRAVEL, steps_per_mm=80)
        laser = ControllerLaser(stage)
    port = stage.line.port
    error, believed, wrong = "", 0, []

    def check(count: int) -> None:
        nonlocal believed
        believed += 1
        true = port.axis.load(port.clock.now_s()) - AT_SWITCH[kind] + TRAVEL.switch
        if abs(true - count) > 0.01:
            wrong.append((count, true))

    try:
        with safely({"stage": stage}, laser):
            stage.home()
            check(0)
            laser.on()
            for target in places:
                stage.move_to(target)
                check(target)
                check(stage.position())
    except HardwareError as refused:
        error = str(refused)
    now_s = port.clock.now_s()
    return Outcome(
        kind=kind,
        seed=seed,
        url=url,
        error=error,
        places=believed,
        wrong=tuple(wrong),
        moving=port.axis.moving(now_s),
        laser=port.laser,
        pulled=port.pulled,
        seconds=now_s,
        wall_s=time.perf_counter() - begin,
    )
