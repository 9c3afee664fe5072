"""Is a sheet of light curved that was taken as flat? Told from the last step of the solve, without another one.

At the solution the residuals r, in σ, have the derivatives J by what was sought. A bow of a sheet, whose numbers are
held at zero, moves each of its stripe points by its column E of derivatives, and so does each way in which the board
may bend, with corners and stripes. With the poses projected out, the step that all of them take together would lower
χ² most: the Lagrange multiplier test (C. R. Rao 1948), as in `missing_terms`. A bent board curves its stripes too, but
on the board, not in the sheet, and it moves corners: sought beside the bow, it takes what is its own.

σ of the bow is the larger of two: as the solve has it, and by how the photographs contradict each other (the sandwich
of H. White 1980, photograph by photograph), which holds for errors that neighbours on a stripe share.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration.residuals import Blocks
from jaxscan.calibration.rounds import Refined
from jaxscan.calibration.sheet_curve import SheetCurve
from jaxscan.files.rig_checks import image_rays
from jaxscan.geometry import Pose, dual_plane_of
from jaxscan.phrases import of_laser
from jaxscan.precision import as_numpy
from jaxscan.rig import BowedSheet, Covariance, LightPlane, Motion, Rig
from jaxscan.rig.board_shape import N_TERMS, basis, middle_and_half, places_on_board
from jaxscan.rig.light import sheet_axes
from jaxscan.rig.rig import parameter_names
from jaxscan.rig.summary import HALF_WIDTH_MM, light_summary

# A bow above this number of its σ is real: noise shows it once in 2000 calibrations.
_CLEAR = 3.5
# A bow that was estimated and is below this number of its σ is treated as none.
_UNCLEAR = 3.0
# A curve of less than this share of the distance is not worth a word: 0.02 mm over 200 mm at 400 mm.
_WORTH = 5e-5
# Of rays flatter to the image than this cosine, beyond 80° of a fisheye, a bow says nothing.
_LEAST_AHEAD = 0.17
# A round width is one of these times a power of ten.
_ROUND = np.array([1.0, 2.0, 5.0, 10.0])
# Singular values of the columns below this share of the largest.
_ROUNDING = 1e-9


def sheet_curves(
    refined: Refined, stages: Sequence[Float[np.ndarray, "_ _ _"]] | None = None
) -> tuple[SheetCurve, ...]:
    """For each sheet that was assumed flat and is clearly curved, by how much.

    Args:
        refined: where the rounds ended.
        stages: of each group of boards, derivatives of its residuals by the paths of stages that were found to be no
            lines: beside them it is asked.
    """
    flat = _flat_sheets(refined)
    if not flat or not any(np.asarray(group.stripe_used).any() for group in refined.groups):
        return ()
    shared = refined.last[1].shared.shape[1]
    rows = _rows(refined, flat)
    beside = [np.zeros((*r.shape, 0)) for *_, r in rows] if stages is None else stages
    parts = [
        (group, stripes, _beside_the_blocks(group, stripes, J, r, shared, also))
        for (group, stripes, J, r), also in zip(rows, beside, strict=True)
    ]
    bows, sigmas = _bows([(group, columns) for group, _, columns in parts], len(flat))
    found = []
    for k, (i, light) in enumerate(flat.items()):
        X = np.concatenate(
            [stripes.points[stripes.used & (np.asarray(group.stripe_light) == i)] for group, stripes, _ in parts]
        )
        if not len(X) or not 0 < sigmas[k] < np.inf:
            continue
        depth, length = float(X[:, 2].mean()), float(np.ptp(X @ sheet_axes(light)[0]))
        width = _round(length)
        to_mm = BowedSheet.unbowed(light).of_bow(width / 2, depth)
        curve = float(bows[k] * to_mm)
        if abs(bows[k]) > _CLEAR * sigmas[k] and abs(curve) * (length / width) ** 2 > _WORTH * depth:
            found.append(SheetCurve(light.name, curve, float(sigmas[k] * to_mm), width, depth))
    return tuple(found)


def unclear_bows(rig: Rig, covariance: Covariance) -> tuple[str, ...]:
    """One note on each sheet that was calibrated as bowed and may be flat."""
    notes = []
    for light in light_summary(rig, covariance, image_rays(rig.camera)):
        if light["kind"] != BowedSheet.kind:
            continue
        (bow,), (sigma,) = light["bow"]["value"], light["bow"]["sigma"]
        if sigma is None or abs(bow) > _UNCLEAR * sigma:
            continue
        by = ""
        if "curved_mm" in light:
            by = f", {light['curved_mm']:.2g} ± {light['curved_mm_sigma']:.1g} mm over {2 * HALF_WIDTH_MM:g} mm,"
        notes.append(
            f"the bow of the sheet of light{of_laser(light['name'])}{by} cannot be distinguished from none: calibrate "
            "with --sheet plane, or let the stripe cross the boards at both of its ends"
        )
    return tuple(notes)


def bow_rows(refined: Refined, lasers: Sequence[str]) -> list[Float[np.ndarray, "blocks residuals bows"]]:
    """The derivatives of each group's residuals, in units of their σ, by the bows of some flat sheets.

    Args:
        refined: where the rounds ended.
        lasers: the names of the sheets.
    """
    flat = {i: light for i, light in _flat_sheets(refined).items() if light.name in lasers}
    return [stripes.rows(J.shape[1]) for _, stripes, J, _ in _rows(refined, flat)]


def _flat_sheets(refined: Refined) -> dict[int, LightPlane]:
    lights = enumerate(as_numpy(refined.system.rig).lights)
    return {i: light for i, light in lights if isinstance(light, LightPlane)}


def _rows(
    refined: Refined, flat: Mapping[int, LightPlane]
) -> list[tuple[Blocks, "_Stripes", Float[np.ndarray, "_ _ _"], Float[np.ndarray, "_ _"]]]:
    """Each group of boards, its stripes, and the derivatives and residuals of its corners and stripe points."""
    rig, (value, jacobian) = as_numpy(refined.system.rig), refined.last
    names, found = parameter_names(rig), []
    for group, unknowns, J, r in zip(refined.groups, refined.system.poses, jacobian.blocks, value.blocks, strict=False):
        # Behind corners and stripe stands what is known of the boards' bends.
        rows = group.corners[0].size + group.stripe_used[0].size
        J, r = np.asarray(J)[:, :rows], np.asarray(r)[:, :rows]
        poses = Pose.from_vector(np.asarray(unknowns)[:, :6])
        found.append((group, _Stripes.create(group, rig.motion, flat, names, poses, J), J, r))
    return found


@dataclass(frozen=True)
class _Stripes:
    """Derivatives and geometry of the stripe points of a group.

    Attributes:
        bow: derivative of each residual by the bow of each flat sheet.
        points: where they lie on their boards, camera frame, mm.
        places: the same as s and t of `rig.board_shape`.
        used: which take part.
        normals: of each block's board at its positions of reference.
    """

    bow: Float[np.ndarray, "blocks photographs stripe flat"]
    points: Float[np.ndarray, "blocks photographs stripe 3"]
    places: Float[np.ndarray, "blocks photographs stripe 2"]
    used: Bool[np.ndarray, "blocks photographs stripe"]
    normals: Float[np.ndarray, "blocks 3"]

    def rows(self, residuals: int) -> Float[np.ndarray, "blocks residuals flat"]:
        """The derivatives by the bows of all residuals of each block: those of corners, which come first, are 0."""
        blocks, photographs, stripe, flat = self.bow.shape
        bow = self.bow.reshape(blocks, photographs * stripe, flat)
        return np.pad(bow, ((0, 0), (residuals - bow.shape[1], 0), (0, 0)))

    @staticmethod
    def create(
        group: Blocks,
        motion: Motion,
        flat: Mapping[int, LightPlane],
        names: Sequence[str],
        poses: Pose[np.ndarray],
        J: Float[np.ndarray, "blocks residuals columns"],
    ) -> "_Stripes":
        """From the Jacobian, whose columns by ω are in proportion to the ray: −x / (∂h/∂v) by ω₁."""
        shape = group.stripe_used.shape
        J = J[:, J.shape[1] - shape[1] * shape[2] :].reshape(*shape, J.shape[2])
        light = np.asarray(group.stripe_light)
        by_plane, bow = np.zeros((*shape, 3)), np.zeros((*shape, len(flat)))
        for k, (i, sheet) in enumerate(flat.items()):
            own = (light == i)[..., None]
            by_plane = np.where(own, J[..., [names.index(f"lights.{i}.plane.{n}") for n in range(3)]], by_plane)
            with np.errstate(divide="ignore", invalid="ignore"):
                column = by_plane[..., 2] * as_numpy(BowedSheet.unbowed(sheet)).by_bow(by_plane / by_plane[..., 2:])
            bow[..., k] = np.where(own[..., 0], column, 0.0)
        used = np.asarray(group.stripe_used) & (by_plane[..., 2] != 0) & np.isfinite(bow).all(axis=-1)
        ray = np.where(used[..., None], by_plane, 1.0)
        R, t = _stands(group, motion, poses)
        X = ray / np.einsum("bpsi,bpi->bps", ray, dual_plane_of(R, t))[..., None]
        on_board = np.einsum("bpsi,bpij->bpsj", X - t[:, :, None], R)[..., :2]
        # A bow is one of light that comes from beside the camera.
        used &= X[..., 2] > _LEAST_AHEAD * np.linalg.norm(X, axis=-1)
        middle, half = middle_and_half(np.asarray(group.points)[0])
        places = (on_board - middle) / half
        return _Stripes(np.where(used[..., None], bow, 0.0), X, places, used, poses.matrix()[..., 2])


def _stands(
    group: Blocks, motion: Motion, poses: Pose[np.ndarray]
) -> tuple[Float[np.ndarray, "blocks photographs 3 3"], Float[np.ndarray, "blocks photographs 3"]]:
    """T_cam_board of each photograph, as R and t."""
    if not group.q:
        return poses.matrix()[:, None], poses.translation[:, None]
    stood = []
    for b in range(len(poses.rotation)):
        q = {axis: np.asarray(steps)[b] for axis, steps in group.q.items()}
        at_0 = motion.pose({axis: np.asarray(steps)[b] for axis, steps in group.reference.items()}).inverse()
        moved = motion.pose(q) @ (at_0 @ Pose(poses.rotation[b], poses.translation[b]))
        stood.append((moved.matrix(), moved.translation))
    return np.stack([R for R, _ in stood]), np.stack([t for _, t in stood])


def _beside_the_blocks(
    group: Blocks,
    stripes: _Stripes,
    J: Float[np.ndarray, "blocks residuals columns"],
    r: Float[np.ndarray, "blocks residuals"],
    shared: int,
    beside: Float[np.ndarray, "blocks residuals others"],
) -> Float[np.ndarray, "blocks residuals all"]:
    """The columns of all that is shared, of bows, of the board's shape and of what else there is, and r.

    All are without what the blocks can take.
    A board that bends away by h at a point moves what is seen there as if all of it had moved by h along its normal.
    """
    own = J[..., shared:]
    away = np.einsum("bmi,bi->bm", own[..., 3:6], stripes.normals)
    shots, striped = stripes.used.shape[1], stripes.used[0].size
    corners = np.stack(places_on_board(np.asarray(group.points)[0]), axis=-1)
    at_corners = np.broadcast_to(
        np.tile(np.repeat(corners, 2, axis=0), (shots, 1)), (len(J), 2 * shots * len(corners), 2)
    )
    at = np.concatenate([at_corners, stripes.places.reshape(len(J), striped, 2)], axis=1)
    bends = away[..., None] * np.moveaxis(basis(at[..., 0], at[..., 1], N_TERMS), 0, -1)
    columns = np.concatenate([J[..., :shared], beside, bends, stripes.rows(J.shape[1]), r[..., None]], axis=-1)
    Q = np.linalg.qr(own)[0]
    return columns - Q @ (np.swapaxes(Q, 1, 2) @ columns)


def _bows(
    parts: Sequence[tuple[Blocks, Float[np.ndarray, "_ _ all"]]], count: int
) -> tuple[Float[np.ndarray, "flat"], Float[np.ndarray, "flat"]]:
    """The bow of each sheet and its σ, mm."""
    A = np.concatenate([columns.reshape(-1, columns.shape[-1]) for _, columns in parts])
    A, r = A[:, :-1], A[:, -1]
    scale = np.linalg.norm(A, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    inverse = np.linalg.pinv((A / scale).T @ (A / scale), _ROUNDING, hermitian=True) / np.outer(scale, scale)
    step = -inverse @ (A.T @ r)
    left = r + A @ step
    # What each residual adds to each bow, summed over each photograph.
    pull = (A @ inverse[:, -count:]) * left[:, None]
    each, first = [], 0
    for group, columns in parts:
        blocks, shots, _ = group.stripe_used.shape
        rows = pull[first : first + blocks * columns.shape[1]].reshape(blocks, columns.shape[1], count)
        first += blocks * columns.shape[1]
        striped = group.stripe_used[0].size
        corners, stripe = rows[:, : columns.shape[1] - striped], rows[:, columns.shape[1] - striped :]
        of_photographs = [
            part.reshape(blocks, shots, part.shape[1] // shots, count).sum(2) for part in (corners, stripe)
        ]
        each.append((of_photographs[0] + of_photographs[1])[np.asarray(group.stripe_used).any(axis=2)])
    photographs = np.concatenate(each)
    n = len(photographs)
    by_photographs = np.sqrt((photographs**2).sum(axis=0) * n / max(n - 1, 1))
    by_solve = np.sqrt(np.diagonal(inverse)[-count:])
    return step[-count:], np.maximum(by_solve, by_photographs)


def _round(length_mm: float) -> float:
    """The round number of mm that is nearest to a length."""
    power = 10.0 ** np.floor(np.log10(length_mm))
    return float(power * _ROUND[np.argmin(np.abs(np.log(_ROUND * power / length_mm)))])
