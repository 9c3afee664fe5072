"""A board that rides on the axes of a scan, in view of its photographs: whether the axes stood where they said.

The board's pose on the axes X and, for each photograph i but the first, by how many steps d_i the axes were off, make
the corners' errors least:

    sum |project(pose(q_i + d_i) X p) - corner|^2

d_i is met in its own photograph alone, and so is eliminated (Schur complement); the cost is linear in photographs.
The first photograph that shows the board is the reference, d = 0.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxscan.calibration.initial import board_poses
from jaxscan.errors import InputError
from jaxscan.files.place_checks import PlaceCheck
from jaxscan.geometry import Pose
from jaxscan.kept_programs import compiled
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Rig
from jaxscan.rig.projection import pixel_rays

# A pose and a step need few; with fewer a corner that was found wrongly decides.
FEWEST_CORNERS: Final = 8
_ROUNDS: Final = 20
_SETTLED_PX: Final = 1e-7
# A board that fits no better than this is not where the rig has it.
_WORST_PX: Final = 1.0
# What a switch is met again within; times its own sigma; and the part of the way that a rig may be wrong by.
_STEPS, _SIGMAS, _OF_WAY = 4.0, 4.0, 1e-3
# Of the way that was ordered: a board that went no further than this stands still.
_STILL: Final = 0.1


@dataclass(frozen=True)
class Landmark:
    """What a board in the photographs of a scan shows.

    Attributes:
        frames: the photographs that show it, counted from 0.
        off: by the axis's name, by how many motor steps each of these was further than its position says.
        sigma: of these, steps.
        missed: whether it is too much to be chance, for each of these.
        rms_px: of the corners' errors.
    """

    frames: tuple[int, ...]
    off: Mapping[str, Float[np.ndarray, "seen"]]
    sigma: Mapping[str, Float[np.ndarray, "seen"]]
    missed: tuple[bool, ...]
    rms_px: float

    def checks(self, frames: int) -> tuple[PlaceCheck, ...]:
        """As `scan.toml` lists them, for a scan of `frames` photographs.

        A photograph with the board answers for those since the one before it that shows it too.
        """
        found: list[PlaceCheck] = []

        def add(first: int, last: int, off: Mapping[str, int], unverified: bool = False) -> None:
            if first > last:
                return
            if found and bool(found[-1].off) == bool(off) and found[-1].unverified == unverified:
                before = found.pop()
                first, off = before.first, {axis: max(before.off[axis], off[axis], key=abs) for axis in off}
            found.append(PlaceCheck(first, last, off, unverified, by_board=True))

        begin = self.frames[0]
        add(0, begin - 1, {}, unverified=True)
        for i, (frame, missed) in enumerate(zip(self.frames, self.missed, strict=True)):
            add(begin, frame, {axis: round(float(off[i])) for axis, off in self.off.items()} if missed else {})
            begin = frame + 1
        add(begin, frames - 1, {}, unverified=True)
        return tuple(found)


def landmark(
    rig: Rig,
    moving: Sequence[str],
    positions: Mapping[str, Sequence[int]],
    points: Float[np.ndarray, "corners 3"],
    corners: Sequence[Float[np.ndarray, "corners 2"] | None],
) -> Landmark:
    """Find out by a board that rides on the axes whether they stood where they said.

    Args:
        rig: of the scanner.
        moving: the axes that move from photograph to photograph.
        positions: of all axes at each photograph, motor steps.
        points: of the board, mm.
        corners: of the board in each photograph, pixels, NaN where there is none; None where it was not seen.

    Raises:
        InputError: too few photographs show enough of it, nothing moves between them, it does not fit the rig, or it
            stands still.
    """
    counts = [0 if uv is None else int(np.isfinite(uv).all(axis=1).sum()) for uv in corners]
    frames = [i for i, count in enumerate(counts) if count >= FEWEST_CORNERS]
    if len(frames) < 2:
        raise InputError(
            f"the board is in {len(frames)} of {len(corners)} photographs with {FEWEST_CORNERS} corners or more (most: "
            f"{max(counts, default=0)} of {len(points)}): two are the least; put it in view, and into even light"
        )
    q = {axis: np.array([steps[i] for i in frames], float) for axis, steps in positions.items()}
    moving = [axis for axis in moving if np.ptp(q[axis])]
    if not moving:
        raise InputError("nothing moves between the photographs that show the board: their positions show nothing")
    seen = np.stack([uv for i in frames if (uv := corners[i]) is not None])
    used = np.isfinite(seen.sum(axis=2))
    with float64():
        rig = as_float64(rig)
        pose = _first_pose(rig, {axis: steps[0] for axis, steps in q.items()}, points, seen[0], used[0])
        off, sigma, rms = _fit(rig, moving, q, points, np.nan_to_num(seen), used, pose)
    if not rms < _WORST_PX:
        raise InputError(
            f"the board is {rms:.1f} px from where the rig has it: is it fixed on the {' and '.join(moving)}, is "
            "--square right, and is this the rig of the scan?"
        )
    way = np.stack([q[axis] - q[axis][0] for axis in moving], axis=1)
    if np.all(np.abs(off + way) <= _STILL * np.abs(way) + _STEPS):
        raise InputError(f"the board stands still while the {' and '.join(moving)} moves: fix it on what moves")
    missed: np.ndarray = np.abs(off) > np.maximum(np.maximum(_STEPS, _SIGMAS * sigma), _OF_WAY * np.abs(way))
    return Landmark(
        tuple(frames),
        dict(zip(moving, off.T, strict=True)),
        dict(zip(moving, sigma.T, strict=True)),
        tuple(bool(one.any()) for one in missed),
        rms,
    )


def _first_pose(
    rig: Rig,
    q: Mapping[str, float],
    points: Float[np.ndarray, "corners 3"],
    uv: Float[np.ndarray, "corners 2"],
    used: np.ndarray,
) -> Float[np.ndarray, "6"]:
    """T_object_board from one photograph."""
    rays = pixel_rays(rig.camera, uv[None])
    R, t = board_poses(points[:, :2], rays, used[None] & np.isfinite(rays).all(axis=2))
    at = rig.pose(q)
    there = Pose(np.asarray(at.rotation), np.asarray(at.translation))
    return np.asarray((there.inverse() @ Pose.from_matrix(R[0], t[0])).as_vector())


@compiled(filtered=True)
def _errors(
    rig: Rig,
    moving: tuple[str, ...],
    q: Mapping[str, Float[Array | np.ndarray, "seen"]],
    off: Float[Array | np.ndarray, "seen axes"],
    pose: Float[Array | np.ndarray, "6"],
    points: Float[Array | np.ndarray, "corners 3"],
    uv: Float[Array | np.ndarray, "seen corners 2"],
) -> tuple[Array, Array, Array]:
    """Errors of the corners, px, and how they go with the board's pose and with the steps, photograph by photograph."""

    def one(pose: Any, d: Any, q: Mapping[str, Any], uv: Any) -> Array:
        there = rig.pose({**q, **{axis: q[axis] + d[i] for i, axis in enumerate(moving)}})
        return rig.camera.project((there @ Pose.from_vector(pose)).apply(points)) - uv

    def each(d: Any, q: Mapping[str, Any], uv: Any) -> tuple[Array, Array, Array]:
        return one(pose, d, q, uv), *jax.jacfwd(one, (0, 1))(pose, d, q, uv)

    return jax.vmap(each)(off, q, uv)


def _fit(
    rig: Rig,
    moving: Sequence[str],
    q: Mapping[str, Float[np.ndarray, "seen"]],
    points: Float[np.ndarray, "corners 3"],
    uv: Float[np.ndarray, "seen corners 2"],
    used: np.ndarray,
    pose: Float[np.ndarray, "6"],
) -> tuple[Float[np.ndarray, "seen axes"], Float[np.ndarray, "seen axes"], float]:
    """Steps by which each photograph is off, their sigma, and the rms of the corners' errors, px."""
    n, axes = len(uv), len(moving)
    weight = np.repeat(used[:, :, None], 2, axis=2).reshape(n, -1)
    off, sigma = np.zeros((n, axes)), np.zeros((n, axes))
    rms, before = np.inf, np.inf
    for _ in range(_ROUNDS):
        found = _errors(rig, tuple(moving), q, off, pose, points, uv)
        r, J, K = (np.asarray(part).reshape(n, weight.shape[1], -1) * weight[..., None] for part in found)
        K[0] = 0.0
        rms = float(np.sqrt(np.square(r).sum() / max(weight.sum() - 6 - (n - 1) * axes, 1)))
        A, B, C = np.einsum("nki,nkj->ij", J, J), np.einsum("nki,nkj->nij", J, K), np.einsum("nki,nkj->nij", K, K)
        C[0] = np.eye(axes)
        V = np.linalg.inv(C)
        BV = B @ V
        S = A - np.einsum("nij,nkj->ik", BV, B)
        g, h = np.einsum("nki,nkl->i", J, r), np.einsum("nki,nkl->ni", K, r)
        step = -np.linalg.lstsq(S, g - np.einsum("nij,nj->i", BV, h), rcond=1e-14)[0]
        pose = pose + step
        off = off - np.einsum("nij,nj->ni", V, h + np.einsum("nij,i->nj", B, step))
        variance = np.einsum("nii->ni", V) + np.einsum("nij,ik,nkj->nj", BV, np.linalg.pinv(S), BV)
        sigma = rms * np.sqrt(variance)
        if not np.isfinite(rms) or abs(before - rms) < _SETTLED_PX:
            break
        before = rms
    # The first is the reference.
    sigma[0] = 0.0
    return off, sigma, rms
