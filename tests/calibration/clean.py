"""Sessions that several tests of diagnostics look at, calibrated once."""

from functools import cache

from benchmarks.changes import changed_session
from benchmarks.drawn_bent import clean_session
from jaxscan.calibration import Calibration, calibrate


@cache
def clean(seed: int) -> Calibration:
    """A session in which nothing is amiss."""
    return calibrate(clean_session(seed))


@cache
def refocused() -> Calibration:
    """A session whose lens was refocused once, taken as if it had not been."""
    return calibrate(changed_session(0, "refocus")[0])
