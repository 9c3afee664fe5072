"""What the errors of given poses add to σ.

A hand that was off by ε (mm) and turned by η (rad, about its own axes) moves a point that lies at p from it by
ε + η × p. Along the ray d that is a variance of σ_t² + σ_r² |p × d|². All points of a frame move together.
"""

import numpy as np
from jaxtyping import Float, Float32

from jaxscan.files.rig_file import RigFile
from jaxscan.rig import HeadPoses, ObjectPoses, Positions, given_poses


class PoseSigma:
    """The σ of given poses, as points of a scan have it."""

    def __init__(self, motion: HeadPoses | ObjectPoses, sigma_mm: float, sigma_deg: float) -> None:
        self._motion, self._mm, self._rad = motion, sigma_mm, np.radians(sigma_deg)

    @staticmethod
    def of(content: RigFile) -> "PoseSigma | None":
        """That of a rig; None where nothing of it moves by given poses, or their σ is not known."""
        motion, fit = content.rig.motion, content.fit
        if not isinstance(motion, HeadPoses | ObjectPoses) or "pose_sigma_mm" not in fit:
            return None
        return PoseSigma(motion, float(fit["pose_sigma_mm"]), float(fit.get("pose_sigma_deg", 0.0)))

    def along_rays(
        self, points: Float[np.ndarray, "frames lines 3"], q: Positions
    ) -> Float32[np.ndarray, "frames lines"]:
        """σ of each point along its ray by its frame's pose alone, mm.

        Args:
            points: object frame, mm.
            q: positions of each frame.
        """
        at = {axis: np.asarray(steps, np.float64) for axis, steps in q.items()}
        given, camera = given_poses(at), self._motion.pose(at).inverse().translation
        p = self._motion.from_hand(given, np.asarray(points, np.float64))
        d = p - self._motion.from_hand(given, np.asarray(camera)[:, None])
        lever = np.linalg.norm(np.cross(p, d), axis=-1) / np.linalg.norm(d, axis=-1)
        return np.hypot(self._mm, self._rad * lever).astype(np.float32)
