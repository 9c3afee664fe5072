"""The scanner on bad days: serial lines with faults, and programs that are killed."""

from concurrent.futures import ProcessPoolExecutor

from benchmarks.metric import Metric
from benchmarks.serial_sessions import Outcome, session, struck

_SESSIONS, _QUICK_SESSIONS = 1000, 200
# A session on a perfect line sends fewer bytes than this to the controller.
_BYTES = 400


def measure(quick: bool) -> list[Metric]:
    """Sessions with random faults; in full also one fault at a time, everywhere."""
    return [*_sessions(_QUICK_SESSIONS if quick else _SESSIONS), *([] if quick else _one_byte())]


def _sessions(count: int) -> list[Metric]:
    with ProcessPoolExecutor(2) as pool:
        outcomes = list(pool.map(session, range(count), chunksize=20))
    whole = [outcome for outcome in outcomes if not outcome.pulled]
    carried = [outcome for outcome in whole if outcome.moving or outcome.laser]
    return [
        Metric("hardware.sessions", len(outcomes)),
        *_faults("hardware.sessions", outcomes),
        Metric("hardware.sessions.positions_believed", sum(outcome.places for outcome in outcomes)),
        Metric("hardware.sessions.well_ended", sum(not outcome.error for outcome in whole) / len(whole), "", "higher"),
        Metric("hardware.sessions.left_on_and_said", len(carried)),
        Metric("hardware.sessions.longest_wall", max(outcome.wall_s for outcome in outcomes), "s"),
    ]


def _one_byte() -> list[Metric]:
    with ProcessPoolExecutor(2) as pool:
        work = [pool.submit(struck, "bistep", i, byte) for byte in b"=g!" for i in range(_BYTES)]
        outcomes = [done.result() for done in work]
    return [Metric("hardware.one_byte.sessions", len(outcomes)), *_faults("hardware.one_byte", outcomes)]


def _faults(name: str, outcomes: list[Outcome]) -> list[Metric]:
    for outcome in outcomes:
        if outcome.fault:
            print(f"  {outcome.url}: {outcome.fault}")
    wrong = sum(len(outcome.wrong) for outcome in outcomes)
    return [
        Metric(f"{name}.wrong_positions_believed", wrong, "", "lower", 0),
        Metric(f"{name}.faults", sum(bool(outcome.fault) for outcome in outcomes), "", "lower", 0),
    ]
