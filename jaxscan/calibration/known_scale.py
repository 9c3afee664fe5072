"""A second scale: the millimetres of a motor step that are known otherwise, against those that the squares give.

All lengths scale with the size of the squares. A screw's pitch is known from its maker, so the travel of the stage for
one step shows whether the board is as large as `session.toml` says.
"""

from collections.abc import Iterable
from typing import Final

from jaxscan.calibration.result import Calibration
from jaxscan.files.session import Session
from jaxscan.rig.line import Line
from jaxscan.rig.summary import step_of

# A board measured with a ruler, and a screw, are better than this share; more than this number of σ is not noise.
_SHARE: Final = 0.01
_SIGMAS: Final = 5.0


def scale_note(calibration: Calibration, sessions: Iterable[Session]) -> str | None:
    """What to say where `mm_per_step` of a session contradicts its board; None where it does not, or is not given.

    Args:
        calibration: what was found.
        sessions: what it was found from, all of one rig.
    """
    stages = [(session.board, session.stage.mm_per_step) for session in sessions if session.stage]
    known = next(((board, mm) for board, mm in stages if mm is not None), None)
    axis = calibration.rig.axes().get("stage")
    if known is None or not isinstance(axis, Line):
        return None
    board, given = known
    found, sigma = step_of(axis, calibration.covariance)
    if abs(found - given) < max(_SHARE * given, _SIGMAS * sigma):
        return None
    size = "pitch_mm" if board.kind == "circles" else "square_mm"
    return (
        f"by the board one motor step is {found:.4g} mm, but mm_per_step = {given:g} under [stage]. One of the two "
        f"scales is wrong: with {size} = {board.pitch_mm * given / found:.4g} in place of {board.pitch_mm:g} they "
        "would agree. Measure ten squares with a ruler, and check the screw's pitch and the steps of a turn"
    )
