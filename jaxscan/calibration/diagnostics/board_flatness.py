"""Has the board the shape that it was taken to have? Told from the residuals, without another solve.

To first order a point of the board that stands h out of its plane moves its residuals as the whole board does when it
is moved along its normal by h. So the derivatives by the terms of a shape (`rig.board_shape`) are those by the board's
place, which the solve has, times the terms' values where each corner and each stripe point lies: a Gauss-Newton step in
all that was sought, with these terms and each board's own bulges set free, is linear algebra of what is there. What the
shape explains lowers σ and the correlation along stripes, which weigh it: these are found again, a few times over.

By how much χ² falls for the terms is χ² distributed where there is no such shape, and by how much the restricted
likelihood rises for bulges of each board likewise, half of the time zero (S. G. Self and K.-Y. Liang 1987). Sessions
are compared by terms of their own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import gammaincc

from jaxscan.calibration.bends import Reduced, by_pose, deviance, likeliest_bend, marginal, without_poses
from jaxscan.calibration.blocks import photographs_in_blocks
from jaxscan.calibration.correlation import weights_anew
from jaxscan.calibration.diagnostics.lens_rows import lens_rows, unsought_terms
from jaxscan.calibration.diagnostics.sheet_curves import bow_rows
from jaxscan.calibration.flatness import BY_CHANCE, BoardFlatness
from jaxscan.calibration.places import places_of_residuals
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined
from jaxscan.calibration.sheet_curve import SheetCurve
from jaxscan.geometry import vector_to_matrix
from jaxscan.rig.board_shape import BENDS, LEAST_BEND_MM, N_TERMS, basis, bent_by, half_diagonal_of

# How many times σ and correlation are estimated again.
_TIMES_ANEW = 3
# Eigenvalues of the scaled normal equations below this share of the largest.
_ROUNDING = 1e-11


def board_flatness(
    refined: Refined,
    calibration: Calibration,
    curves: Sequence[SheetCurve] = (),
    stages: Sequence[Float[np.ndarray, "_ _ _"]] | None = None,
) -> BoardFlatness:
    """What the residuals say of the board's shape.

    Where they say anything, it is asked again beside the terms of the lens that were not sought, which look alike.

    Args:
        refined: where the rounds ended.
        calibration: the same, assembled.
        curves: the sheets that were found to be curved: beside their bows it is asked.
        stages: of each group of boards, derivatives by the paths of stages that were found to be no lines, likewise.
    """
    bows = bow_rows(refined, [curve.laser for curve in curves])
    if stages is not None:
        bows = [np.concatenate(each, axis=-1) for each in zip(bows, stages, strict=True)]
    found = _judged(refined, calibration, bows)
    if (found.bent or found.session) and unsought_terms(calibration).any():
        both = zip(lens_rows(refined, calibration), bows, strict=True)
        again = _judged(refined, calibration, [np.concatenate(each, axis=-1) for each in both])
        if again.shift_in_sigma > found.shift_in_sigma:
            return replace(again, parameter=found.parameter, shift_in_sigma=found.shift_in_sigma)
        return again
    return found


def beside_shape(
    refined: Refined, calibration: Calibration, columns: list[Float[np.ndarray, "_ _ columns"]]
) -> tuple[Float[np.ndarray, "columns"], Float[np.ndarray, "columns columns"]]:
    """What numbers that were not sought would come out as, beside a shape of the board, and their covariance.

    Args:
        refined: where the rounds ended.
        calibration: the same, assembled.
        columns: of each group of boards, the derivatives of its residuals, in units of their σ, by these numbers.
    """
    groups = _columns(refined, calibration, columns)
    shared, known = groups[0].shared, len(jax.tree.leaves(refined.system.shape))
    half_diagonal = half_diagonal_of(calibration.observations.board.points())
    chosen = [each.only(shared + N_TERMS - known, each.normal(np.ones(2))) for each in groups]
    moved, _, covariance = _solution(chosen, likeliest_bend(chosen, half_diagonal))
    at = slice(shared - columns[0].shape[-1], shared)
    return moved[at], covariance[at, at]


def _judged(refined: Refined, calibration: Calibration, beside: list[Float[np.ndarray, "_ _ _"]]) -> BoardFlatness:
    groups = _columns(refined, calibration, beside)
    known = len(jax.tree.leaves(refined.system.shape))
    shared = groups[0].shared
    extra = list(range(shared, shared + N_TERMS - known))
    half_diagonal = half_diagonal_of(calibration.observations.board.points())
    count, scales = shared + len(extra), np.ones(2)

    def likeliest(scales: Float[np.ndarray, "2"]) -> tuple[list[np.ndarray], list[Reduced], float]:
        Q = [each.normal(scales) for each in groups]
        chosen = [each.only(count, q) for each, q in zip(groups, Q, strict=True)]
        return Q, chosen, likeliest_bend(chosen, half_diagonal)

    for _ in range(_TIMES_ANEW):
        Q, chosen, bends = likeliest(scales)
        scales = _scales(groups, refined, Q, _solution(chosen, bends)[0], bends)
    Q, chosen, bends = likeliest(scales)
    moved, cost, covariance = _solution(chosen, bends)
    without = [each.only(shared, q) for each, q in zip(groups, Q, strict=True)]
    basic = _solution(without, bends)
    p_terms = float(gammaincc(len(extra) / 2, max(basic[1] - cost, 0.0) / 2)) if extra else 1.0
    likeliest_one, unbent = deviance(chosen, np.array([bends, LEAST_BEND_MM]))
    own = refined.noise.bend is not None
    p_bends = 1.0 if own else 0.5 * float(gammaincc(0.5, max(unbent - likeliest_one, 0.0) / 2))
    # From where all that is free beside it brings the rig.
    before = _solution(without, LEAST_BEND_MM)[0] if beside[0].shape[-1] else np.zeros_like(moved)
    leaves = len(jax.tree.leaves(refined.system.rig))
    sigma = np.sqrt(np.diagonal(refined.precision.covariance))
    parameter, shift = calibration.most_moved(moved[:leaves] - before[:leaves], sigma)
    at = np.r_[leaves : leaves + known, extra].astype(int)
    terms = moved[at] + np.pad([float(x) for x in jax.tree.leaves(refined.system.shape)], (0, len(extra)))
    bent, bent_sigma = bent_by(terms, covariance[np.ix_(at, at)])
    session, differs = _other_session(groups, Q, calibration, bends, cost)
    p = min(1.0, 2 * min(p_terms, p_bends))
    return BoardFlatness(
        taken=calibration.board_shape,
        bent_mm=bent,
        bent_sigma_mm=bent_sigma,
        bends_mm=bends,
        p=p,
        p_bends=p_bends,
        parameter=parameter,
        shift_in_sigma=shift,
        views=len(calibration.observations.views),
        session=session,
        differs_mm=differs,
    )


@dataclass(frozen=True)
class _Group:
    """The rows of one group of blocks, as they were weighted.

    Attributes:
        poses: derivatives by the poses of the blocks.
        columns: by what is shared, what is free beside the shape at its end; then by the shape's terms that were not
            sought, those of each further session, the bulges of each block (where there are any); and the residual.
        shared: how many of the columns are what is shared.
        bulges: how many are the bulges'.
        corners: how many rows are corners'; the rest are the stripe's. None for what is no board.
    """

    poses: Float[np.ndarray, "blocks rows size"]
    columns: Float[np.ndarray, "blocks rows columns"]
    shared: int
    bulges: int
    corners: int | None

    def weighted(self, scales: Float[np.ndarray, "2"]) -> tuple[np.ndarray, np.ndarray]:
        """Poses and columns with other weights of corners and stripe."""
        if self.corners is None:
            return self.poses, self.columns
        rows = self.poses.shape[1]
        by_row = np.repeat(scales, [self.corners, rows - self.corners])[:, None]
        return self.poses * by_row, self.columns * by_row

    def normal(self, scales: Float[np.ndarray, "2"]) -> Float[np.ndarray, "blocks columns columns"]:
        """Their normal equations without the poses."""
        return without_poses(*self.weighted(scales))

    def only(self, count: int, Q: Float[np.ndarray, "blocks columns columns"]) -> Reduced:
        """The first `count` columns, the bulges and the residual."""
        last = Q.shape[-1]
        kept = np.r_[:count, last - 1 - self.bulges : last]
        return Reduced(Q[:, kept][:, :, kept], self.bulges)


def _columns(refined: Refined, calibration: Calibration, beside: list[Float[np.ndarray, "_ _ _"]]) -> list[_Group]:
    value, jacobian = refined.last
    shared = jacobian.shared.shape[1]
    free = beside[0].shape[-1]
    known = len(jax.tree.leaves(refined.system.shape))
    heights = _heights(refined, calibration)
    others = _sessions(calibration)[1:]
    of_block = _session_of_blocks(refined, calibration)
    groups = []
    for i, (r, J) in enumerate(zip(map(np.asarray, value.blocks), map(np.asarray, jacobian.blocks), strict=True)):
        if i >= len(refined.groups):
            none = np.zeros((*r.shape, free + N_TERMS - known + N_TERMS * len(others)))
            columns = np.concatenate([J[..., :shared], none, r[..., None]], axis=-1)
            groups.append(_Group(J[..., shared:], columns, shared + free, 0, None))
            continue
        poses, block = np.asarray(refined.system.poses[i]), refined.groups[i]
        rows = slice(0, heights[i].shape[2])
        J, r = J[:, rows], r[:, rows]
        if poses.shape[1] > 6:
            r = r - (J[..., shared + 6 :] @ poses[:, 6:, None])[..., 0]
        up = np.einsum("bri,bi->br", J[..., shared + 3 : shared + 6], vector_to_matrix(poses[:, :3])[:, :, 2])
        shape = np.moveaxis(np.where(up != 0, up * heights[i], 0.0), 0, -1)
        each = [shape * np.array([own == other for own in of_block[i]])[:, None, None] for other in others]
        # Of the same kind as those of the common shape: bulges that all boards have and lose again must be nothing.
        bulges = J[..., shared - known : shared - known + BENDS] if known else shape[..., :BENDS]
        terms = (beside[i], shape[..., known:], *each, bulges)
        columns = np.concatenate([J[..., :shared], *terms, r[..., None]], axis=-1)
        corners = 2 * block.weights[0].size
        groups.append(_Group(J[..., shared : shared + 6], columns, shared + free, BENDS, corners))
    return groups


def _heights(refined: Refined, calibration: Calibration) -> list[Float[np.ndarray, "_ _ _"]]:
    """The terms' values where each row's point lies, for each group; NaN where there is none."""
    places = places_of_residuals(refined, calibration)
    return [basis(each[..., 0], each[..., 1], N_TERMS) for each in places]


def _sessions(calibration: Calibration) -> list[str]:
    return list(dict.fromkeys(view.session for view in calibration.observations.photographs()))


def _session_of_blocks(refined: Refined, calibration: Calibration) -> list[list[str | None]]:
    found: list[list[str | None]] = [[None] * len(group.points) for group in refined.groups]
    for view, group, block, _ in photographs_in_blocks(calibration.observations):
        found[group][block] = view.session
    return found


def _solution(groups: Sequence[Reduced], bends: float) -> tuple[np.ndarray, float, np.ndarray]:
    """Where the shared unknowns go, χ² there, and their covariance; an unknown that appears in no row stays."""
    total = marginal(groups, bends)
    S, g = total[:-1, :-1], total[:-1, -1]
    seen = np.flatnonzero(np.diagonal(S) > 0)
    scale = 1 / np.sqrt(np.diagonal(S)[seen])
    inverse = np.linalg.pinv(scale[:, None] * S[np.ix_(seen, seen)] * scale, _ROUNDING, hermitian=True)
    covariance, moved = np.zeros_like(S), np.zeros(len(S))
    covariance[np.ix_(seen, seen)] = scale[:, None] * inverse * scale
    moved[seen] = -covariance[np.ix_(seen, seen)] @ g[seen]
    return moved, float(total[-1, -1] + g @ moved), covariance


def _scales(
    groups: Sequence[_Group],
    refined: Refined,
    Q: Sequence[np.ndarray],
    moved: Float[np.ndarray, "unknowns"],
    bends: float,
) -> Float[np.ndarray, "2"]:
    """How much more corners and stripe points weigh where the shape is followed."""
    squares, before = np.zeros(2), np.zeros(2)
    errors, used = [], []
    for group, q, blocks in zip(groups, Q, refined.groups, strict=False):
        first, last = len(moved), q.shape[-1] - 1
        own = slice(last - BENDS, last)
        pull = q[:, own, :first] @ moved + q[:, own, last]
        bulges = -np.linalg.solve(q[:, own, own] + np.eye(BENDS) / bends**2, pull[..., None])
        columns = group.columns
        left = (columns[..., :first] @ moved)[..., None] + columns[..., own] @ bulges + columns[..., last:]
        P = group.poses
        left = (left - P @ by_pose(P, left))[..., 0]
        n = group.corners
        squares += [(left[:, :n] ** 2).sum(), (left[:, n:] ** 2).sum()]
        before += [(columns[:, :n, last] ** 2).sum(), (columns[:, n:, last] ** 2).sum()]
        mask = np.asarray(blocks.stripe_used)
        errors += [row for rows in left[:, n:].reshape(mask.shape) for row in rows]
        used += [row for rows in mask for row in rows]
    return weights_anew(before, squares, refined.stripe_correlation, errors, used)


def _other_session(
    groups: Sequence[_Group], Q: Sequence[np.ndarray], calibration: Calibration, bends: float, cost: float
) -> tuple[str, float]:
    """The session whose board differs most from that of the first, and by how much; "" where none does."""
    others = _sessions(calibration)[1:]
    if not others:
        return "", 0.0
    first = groups[0].shared + N_TERMS - len(jax.tree.leaves(calibration.system.shape))
    whole = [each.only(first + N_TERMS * len(others), q) for each, q in zip(groups, Q, strict=True)]
    moved, least, _ = _solution(whole, bends)
    count = N_TERMS * len(others)
    if gammaincc(count / 2, max(cost - least, 0.0) / 2) > BY_CHANCE:
        return "", 0.0
    ranges = [bent_by(each)[0] for each in moved[first:].reshape(len(others), N_TERMS)]
    worst = int(np.argmax(ranges))
    return others[worst], ranges[worst]
