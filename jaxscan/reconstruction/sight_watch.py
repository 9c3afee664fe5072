"""Whether each point of a scan could be seen from where the camera is said to have been.

Poses in the reverse order, rotation matrices that are transposed, a stage that moved the other way than its steps say,
a laser that was not the one that is named: all of them make a smooth surface, and nothing in a single frame is wrong.
But where one thing stands before another, the camera would have looked through it. The line of sight from the camera of
frame i to its point crosses the sheet of frame j at X; if frame j saw its surface before X, and clearly nearer, frame i
looked through it. Rightly carried scans have few such points: under a handle, at strays.

A mistake is named only where it explains them: with it put right, most of these points can be seen.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.axis_details import POSES, is_detail
from jaxscan.files.pose_table import transposed
from jaxscan.geometry import Pose
from jaxscan.precision import as_numpy
from jaxscan.reconstruction.range_image import RangeImage
from jaxscan.rig import HeadPoses, Light, Motion, MovingLight, ObjectPoses, given_poses, positions_of

# Lines of each frame that are remembered, and frames that are compared.
_LINES, _FRAMES = 96, 64
# Fewer frames or points say nothing.
_FEWEST_FRAMES, _FEWEST_POINTS = 8, 400
# A point is behind a surface by this part of the distance at the least: poses have errors.
_CLEARLY: Final = 0.003
# Frames that look in directions further apart, cosine, may see behind what the other sees.
_ALIKE: Final = float(np.cos(np.radians(20.0)))
# Lines of the other frame between which X lies are neighbours if they are no further apart than this many of its gaps.
_GAP: Final = 3.0
# By this multiple of how far a sheet is bowed, points lie beside its plane.
_BOWED: Final = 3.0
# Of 54 drawn scans 0.8 % of the points are behind a surface at the most, in the reverse order 2.7 % at the least, and
# with transposed rotations 22 %. Of 18 drawn full turns 0.4 % are at the most, the other way round 2.4 % at the least.
_MANY: Final = 0.02
# A mistake explains them where putting it right leaves less than this part.
_LEFT: Final = 0.35

_Seen = Float[np.ndarray, "frames lines 3"]


class SightWatch:
    """Watches the points of a scan as its frames are measured.

    Args:
        motion: of the object.
        others: the rig's lights that the scan does not name.
    """

    def __init__(self, motion: Motion, others: Sequence[Light] = ()) -> None:
        self._motion = motion
        # One that an axis moves stands elsewhere in each frame: a scan by another light has no positions of that.
        self._others = [light for light in others if not isinstance(light, MovingLight)]
        self._kept: list[tuple[Float[np.ndarray, "lines 3"], dict[str, float]]] = []
        self._count, self._every = 0, 1

    def see(self, image: RangeImage) -> None:
        """Some more frames."""
        thin = image[:, :: max(1, image.valid.shape[1] // _LINES)]
        seen = np.where(thin.valid[..., None], thin.seen(), np.nan)
        for i, profile in enumerate(seen):
            if self._count % self._every == 0:
                self._kept.append((profile.copy(), {axis: float(q[i]) for axis, q in image.positions.items()}))
            self._count += 1
            # A long scan is remembered more and more coarsely.
            if len(self._kept) >= 4 * _FRAMES:
                self._kept, self._every = self._kept[::2], 2 * self._every

    def notes(self) -> list[str]:
        """What is said of a scan whose camera would have looked through what it saw.

        Of given poses, and where one axis alone moves.
        """
        some = self._kept[:: -(-len(self._kept) // _FRAMES) or 1]
        if len(some) < _FEWEST_FRAMES:
            return []
        seen = np.stack([profile for profile, _ in some])
        positions = {axis: np.array([q[axis] for _, q in some]) for axis in some[0][1]}
        moving = [axis for axis, q in positions.items() if not is_detail(axis) and np.ptp(q) > 0]
        if len(moving) != 1 or np.isfinite(seen[..., 0]).sum() < _FEWEST_POINTS:
            return []
        cameras = _cameras(self._motion, positions)
        found = hidden_share(seen, cameras)
        if found <= _MANY:
            return []
        tried = {_by(light): (_met(light, seen), cameras) for light in self._others}
        tried |= {words: (seen, at) for words, at in _mended(self._motion, positions, moving[0])}
        left = {words: hidden_share(*case) for words, case in tried.items()}
        words = min(left, key=lambda each: left[each])
        if left[words] > min(_LEFT * found, _MANY):
            return []
        return [
            f"{found:.0%} of the points lie behind others, where the camera could not have seen them, but "
            f"{left[words]:.1%} {words}"
        ]


def _cameras(motion: Motion, positions: Mapping[str, Float[np.ndarray, "frames"]]) -> Pose[np.ndarray]:
    """T_object_camera of each frame."""
    return as_numpy(motion.pose(positions)).inverse()


def _by(light: Light) -> str:
    """Words that follow "but 0.1 %"."""
    return f'by the light of laser "{light.name}": check which laser was on, and name it in [laser]'


def _met(light: Light, seen: _Seen) -> _Seen:
    """Where the same rays meet another light; NaN where they do not."""
    rays = seen / seen[..., 2:]
    inverse = np.asarray(light.inverse_depth(np.nan_to_num(rays)))
    return np.where((inverse > 0)[..., None], rays / np.where(inverse > 0, inverse, 1)[..., None], np.nan)


def _mended(
    motion: Motion, positions: Mapping[str, Float[np.ndarray, "frames"]], axis: str
) -> Iterator[tuple[str, Pose[np.ndarray]]]:
    """The usual mistakes, in words that follow "but 0.1 %", and T_object_camera of each frame without them."""
    at = _cameras(motion, positions)
    # A motion along a line may have one rotation for all frames.
    rotation = np.broadcast_to(at.rotation, at.translation.shape)
    backwards = Pose(rotation[::-1], at.translation[::-1])
    if axis != POSES:
        yield (
            f"in the reverse order: the {axis} moved the other way than its steps say, or the photographs are sorted "
            "in the reverse order, and the surface is mirrored",
            backwards,
        )
        return
    yield (
        f"with the {POSES} in the reverse order: check in the table which pose belongs to which photograph",
        backwards,
    )
    if isinstance(motion, HeadPoses | ObjectPoses):
        given = given_poses(positions)
        words, meant = transposed(given)
        turned = {name: n.astype(float) for name, n in positions_of(meant).items()}
        yield words, _cameras(motion, turned)


def hidden_share(seen: _Seen, at: Pose[np.ndarray]) -> float:
    """Which part of the points lies clearly behind what another frame saw.

    Args:
        seen: points, camera frame, mm; NaN for none.
        at: T_object_camera of each frame.
    """
    known = np.isfinite(seen).all(axis=-1)
    points = seen[known]
    # The sheet, w · X = 1; one that is bowed lies beside it.
    w = np.linalg.lstsq(points, np.ones(len(points)), rcond=None)[0]
    bowed = float(np.quantile(np.abs(points @ w - 1.0), 0.95) / np.linalg.norm(w))
    clear = _CLEARLY * float(np.median(points[:, 2])) + _BOWED * bowed
    R, t = np.broadcast_to(at.matrix(), (len(seen), 3, 3)), at.translation
    hidden = np.zeros(known.shape, bool)
    for j in range(len(seen)):
        # Frames whose points may be looked at through what this one saw, in its camera's frame.
        some = np.flatnonzero((R[:, :, 2] @ R[j, :, 2] > _ALIKE) & (np.arange(len(seen)) != j))
        turn = R[j].T @ R[some]
        start = (t[some] - t[j]) @ R[j]
        way = np.einsum("fij,flj->fli", turn, seen[some])
        hidden[some] |= _behind(seen[j], start[:, None], way, w, clear)
    return float(hidden[known].mean())


def _behind(
    surface: Float[np.ndarray, "lines 3"],
    start: Float[np.ndarray, "frames 1 3"],
    way: _Seen,
    w: Float[np.ndarray, "3"],
    clear: float,
) -> Bool[np.ndarray, "frames lines"]:
    """Whether lines of sight pass behind the profile of another frame, all in its camera's frame.

    Args:
        surface: the profile; NaN for none.
        start: of the lines.
        way: from there to their points.
        w: of the sheet.
        clear: by how much they must, mm.
    """
    profile = surface[np.isfinite(surface).all(axis=-1)]
    if len(profile) < 2:
        return np.zeros(way.shape[:-1], bool)
    # The stripe runs along the image's rows, or along its columns.
    along = int(abs(w[0]) > abs(w[1]))
    slope = profile[:, along] / profile[:, 2]
    order = np.argsort(slope)
    slope, depth = slope[order], profile[order, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        part = (1 - start @ w) / (way @ w)
        X = start + part[..., None] * way
        place = X[..., along] / X[..., 2]
        # It is crossed on the way to the point, and before the camera.
        crossed = (part > 0) & (part < 1) & (X[..., 2] > 0)
    after = np.clip(np.searchsorted(slope, place), 1, len(slope) - 1)
    apart = np.diff(slope)
    within = (place >= slope[after - 1]) & (place <= slope[after]) & (apart[after - 1] < _GAP * np.median(apart))
    with np.errstate(invalid="ignore"):
        return crossed & within & (X[..., 2] > np.maximum(depth[after - 1], depth[after]) + clear)
