"""The camera calibration that others write: the same least squares, by dense normal equations and by SciPy.

Both have exact derivatives, from `cv2.projectPoints`, and the start that `cv2.calibrateCamera` takes: planar
homographies, then a pose of each board by PnP. They know f, the principal point, k1 and six numbers for each board.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from jaxscan.calibration import Observations

_CAMERA = 5
# Marquardt's factor at the start, and what a step that helps or does not changes it by; when to stop.
_DAMPING, _CHANGE, _STEPS, _ENOUGH = 1e-3, 10.0, 30, 1e-12


@dataclass
class _Problem:
    """Residuals and their derivatives, one block for each board."""

    session: Observations

    def start(self) -> Float[np.ndarray, "parameters"]:
        """Camera, then boards."""
        points, size = self.session.board.points(), self.session.image_size
        corners = [view.corners.astype(np.float32) for view in self.session.views]
        K = cv2.initCameraMatrix2D([points.astype(np.float32)] * len(corners), corners, size)
        x = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], 0.0]
        for seen in corners:
            _, rotation, translation = cv2.solvePnP(points, seen.astype(np.float64), K, np.zeros(4))
            x += [*rotation.ravel(), *translation.ravel()]
        return np.array(x)

    def blocks(
        self, x: Float[np.ndarray, "parameters"]
    ) -> tuple[Float[np.ndarray, "boards numbers"], Float[np.ndarray, "boards numbers 11"]]:
        """Residuals, and their derivatives by the camera and the board's own pose."""
        points, lens = self.session.board.points(), np.array([x[4], 0.0, 0.0, 0.0])
        K = np.array([[x[0], 0, x[2]], [0, x[1], x[3]], [0, 0, 1]])
        residuals, derivatives = [], []
        for pose, view in zip(x[_CAMERA:].reshape(-1, 6), self.session.views, strict=True):
            seen, jacobian = cv2.projectPoints(points, pose[:3], pose[3:], K, lens)[:2]
            residuals.append((seen.reshape(-1, 2) - view.corners).ravel())
            derivatives.append(jacobian[:, [6, 7, 8, 9, 10, 0, 1, 2, 3, 4, 5]])
        return np.array(residuals), np.array(derivatives)


def dense(session: Observations) -> float:
    """Levenberg and Marquardt with all parameters in one dense matrix, as OpenCV 4 has it; the RMS distance, px."""
    problem = _Problem(session)
    x, damping = problem.start(), _DAMPING
    r, blocks = problem.blocks(x)
    for _ in range(_STEPS):
        J = _jacobian(blocks)
        normal, right = J.T @ J, J.T @ r.ravel()
        while True:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), right)
            new, new_blocks = problem.blocks(x - step)
            if (new**2).sum() <= (r**2).sum() or damping > 1 / _ENOUGH:
                break
            damping *= _CHANGE
        gain = 1 - (new**2).sum() / (r**2).sum()
        x, r, blocks, damping = x - step, new, new_blocks, damping / _CHANGE
        if gain < _ENOUGH:
            break
    return _rms(r)


def scipys(session: Observations) -> float:
    """`scipy.optimize.least_squares` by MINPACK; the RMS distance, px.

    With a sparse Jacobian `trf` and its `lsmr` take a hundred times as long.
    """
    problem = _Problem(session)
    found = least_squares(
        lambda x: problem.blocks(x)[0].ravel(),
        problem.start(),
        lambda x: _jacobian(problem.blocks(x)[1]),  # pyright: ignore[reportArgumentType]
        method="lm",
        x_scale="jac",
        ftol=_ENOUGH,
        xtol=_ENOUGH,
        gtol=_ENOUGH,
    )
    return _rms(found.fun)


PEERS: dict[str, Callable[[Observations], float]] = {"dense": dense, "scipy": scipys}


def _jacobian(blocks: Float[np.ndarray, "boards numbers 11"]) -> Float[np.ndarray, "residuals parameters"]:
    camera = blocks[..., :_CAMERA].reshape(-1, _CAMERA)
    return np.hstack([camera, np.asarray(block_diag(*list(blocks[..., _CAMERA:])))])


def _rms(residuals: Float[np.ndarray, "..."]) -> float:
    return float(np.sqrt(2 * np.mean(residuals**2)))
