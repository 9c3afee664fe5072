"""What the errors of given poses add to σ, and whether a scan's poses are such as the calibration's were.

A hand that was off by ε (mm) and turned by η (rad, about its own axes) moves a point that lies at p from it by
ε + η × p. Along the ray d that is a variance of σ_t² + σ_r² |p × d|². All points of a frame move together.
"""

from typing import Final

import numpy as np
from jaxtyping import Float, Float32

from jaxscan.axis_details import POSES
from jaxscan.errors import InputError
from jaxscan.files.pose_table import misread
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.reconstruction.pose_notes import turns_wildly
from jaxscan.rig import HeadPoses, ObjectPoses, PoseRange, Positions, given_poses

# Poses may turn by this multiple of σ of a given rotation about a direction about which the calibration's did not; by
# this, rad, where that σ is not known.
_TURNS: Final = 6.0
_A_TURN: Final = 0.002


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


def check_poses(content: RigFile, scan: Scan) -> None:
    """Refuse poses that a scan's table has in another form than the calibration's had.

    They turn about a direction along which the calibration has not found where the hand is, or they are nowhere near
    the calibration's, unless a usual mistake in the table is put right.

    Raises:
        InputError: they are such.
    """
    motion = content.rig.motion
    if not isinstance(motion, HeadPoses | ObjectPoses) or not scan.axes:
        return
    given = given_poses({axis: np.asarray(n, np.float64) for axis, n in scan.axes.items()})
    if "pose_range" in content.fit:
        usual = PoseRange.from_values(content.fit["pose_range"])
        still = len(scan.frames) > 1 and usual.is_still(given)
        # Rotations that jump from frame to frame are near anything now and then.
        odd = still or not (usual.is_near(given) or turns_wildly(motion, given))
        for words, meant in misread(given) if odd else ():
            if usual.is_near(meant) and not usual.is_still(meant):
                said = f"the poses do not go with those of the calibration, but they do {words}"
                raise InputError(f"{scan.path}: [scan] {POSES}: {said}")
    unknown = np.array(content.fit.get("pose_offset_unknown", []), float).reshape(-1, 3)
    if not len(unknown):
        return
    R = motion.carry(given).matrix()
    turned = np.linalg.norm((R @ R[0].T - np.eye(3)) @ unknown.T, axis=1).max()
    if turned > max(_A_TURN, _TURNS * np.radians(float(content.fit.get("pose_sigma_deg", 0.0)))):
        raise InputError(
            f"{scan.path}: [scan] {POSES}: the hand turns by {np.degrees(turned):.2g}°, as it did not where the rig "
            "was calibrated, so the rig does not say how: scan without such turns, or calibrate with photographs "
            "of the board with the hand turned in two directions"
        )
