"""σ that admit what is left: the covariance of a solve, grown by what its residuals show beyond noise.

What the model does not follow has no part in the covariance of the solve, which knows of noise alone. Two kinds of it
are measured and added: errors of the board's points that all photographs share, and a drift from the first photograph
to the last. The covariance grows in what is shared; the boards' poses go along as the solve ties them to it.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.by_photograph import ByPhotograph
from jaxscan.calibration.diagnostics.board_points import board_point_errors
from jaxscan.calibration.diagnostics.drift import find_drift
from jaxscan.calibration.drifted import Drift
from jaxscan.calibration.off_grid import OffGrid
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined
from jaxscan.calibration.uncertainty import Precision


def widened(
    refined: Refined, calibration: Calibration, each: ByPhotograph, *, drifts: bool
) -> tuple[Refined, OffGrid | None, Drift | None]:
    """The same with a wider covariance, where residuals show more than noise, and what they show.

    Args:
        refined: where the rounds ended.
        calibration: the same, assembled.
        each: the normal equations of its photographs.
        drifts: whether a drift is looked for: a step, or a term of the model that is not followed, looks like one.
    """
    points = board_point_errors(refined, calibration)
    drift = find_drift(refined, calibration, each) if drifts else None
    found = [each for each in (points, drift) if each is not None]
    if not found:
        return refined, None, None
    grows = sum((by for _, by in found), np.zeros(1))
    precision = _grown(refined.precision, grows)
    return replace(refined, precision=precision), points[0] if points else None, drift[0] if drift else None


def _grown(precision: Precision, by: Float[np.ndarray, "shared shared"]) -> Precision:
    C = precision.covariance
    n, scale = len(C), np.sqrt(np.diagonal(C))
    blocks = []
    for joint in map(np.asarray, precision.blocks):
        # How a board's pose goes with what is shared.
        along = np.linalg.solve(C / np.outer(scale, scale), (joint[:, n:, :n] / scale).mT).mT / scale
        E = np.concatenate([np.broadcast_to(np.eye(n), (len(joint), n, n)), along], axis=1)
        blocks.append(joint + E @ by @ E.mT)
    return replace(precision, covariance=C + by, blocks=tuple(blocks))
