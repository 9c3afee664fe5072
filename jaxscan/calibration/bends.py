"""How far boards bend from photograph to photograph: σ of their own bulges, a variance component like those of noise.

The bulges b of a board are unknowns beside its pose, normal about zero with a σ that is to be found. The bulges that a
solve finds are drawn towards zero, so their own scatter is too small a σ. What is maximised is the restricted
likelihood (H. D. Patterson and R. Thompson 1971): that of what the data say of the bulges once camera, poses and all
else that was sought is taken out. With Q the normal equations of [shared, bulges, residual], poses eliminated, and
K = (Q_bb + I / σ²)⁻¹ of each board,

    −2 log L = Σ log |I + σ² Q_bb| + log |S| + Q_rr − Σ Q_rb K Q_br − gᵀ S⁻¹ g
    S = Σ (Q_ss − Q_sb K Q_bs)        g = Σ (Q_sr − Q_sb K Q_br)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.block_arrow import Arrow, Jacobian
from jaxscan.rig.board_shape import BENDS, LEAST_BEND_MM

# σ is searched up to this share of the board's half diagonal, first in this number of steps.
_MOST_BEND = 0.05
_STEPS = 33
_NARROWINGS = 4
# Eigenvalues of a pose's scaled normal equations below this share of the largest.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Reduced:
    """Normal equations of a group of blocks, their poses eliminated.

    Attributes:
        Q: of each block, of [shared, bulges, residual].
        bulges: how many of the columns are bulges.
    """

    Q: Float[np.ndarray, "blocks columns columns"]
    bulges: int

    @cached_property
    def flat(self) -> Float[np.ndarray, "others others"]:
        """Those of [shared, residual] for bulges of zero, of all blocks together."""
        rest = self._rest()
        return self.Q.sum(axis=0)[np.ix_(rest, rest)]

    @cached_property
    def bends(self) -> tuple[Float[np.ndarray, "bends"], Float[np.ndarray, "bends others"]]:
        """Independent directions of each block's bulges: the information on each, λ, and its coupling c to the rest.

        So the sum over all blocks is one product for each σ: Σ σ² / (1 + σ² λ) c cᵀ.
        """
        if not self.bulges:
            return np.zeros(0), np.zeros((0, self.Q.shape[-1]))
        own = np.setdiff1d(np.arange(self.Q.shape[-1]), self._rest())
        size, U = np.linalg.eigh(self.Q[:, own[:, None], own])
        cross = U.mT @ self.Q[:, own[:, None], self._rest()]
        return np.maximum(size, 0.0).ravel(), cross.reshape(size.size, -1)

    def _rest(self) -> np.ndarray:
        count = self.Q.shape[-1]
        return np.r_[: count - 1 - self.bulges, count - 1]


def without_poses(
    poses: Float[np.ndarray, "blocks rows own"], columns: Float[np.ndarray, "blocks rows columns"]
) -> Float[np.ndarray, "blocks columns columns"]:
    """Columnsᵀ (1 − P Pᵀ) columns of each block, P an orthonormal basis of the columns of its pose, or of none."""
    return columns.mT @ (columns - poses @ by_pose(poses, columns))


def by_pose(
    poses: Float[np.ndarray, "blocks rows own"], columns: Float[np.ndarray, "blocks rows columns"]
) -> Float[np.ndarray, "blocks own columns"]:
    """The steps of each block's pose that come nearest to columns; what too few corners leave open stays."""
    V = poses.mT @ poses
    diagonal = np.diagonal(V, axis1=-2, axis2=-1)
    scale = (1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)))[..., None]
    inverse = np.linalg.pinv(scale * V * scale.mT, _ROUNDING, hermitian=True) if V.shape[-1] else V
    return scale * (inverse @ (scale * (poses.mT @ columns)))


def reduced(value: Arrow, jacobian: Jacobian, boards: int, sigma: float) -> list[Reduced]:
    """The reduced equations of a solve, as it came out with bends of this σ.

    Args:
        value: its residuals, NumPy leaves.
        jacobian: its Jacobian, NumPy leaves.
        boards: how many of the groups, the first ones, have boards that bend.
        sigma: of the bends, mm.
    """
    groups = []
    for i, (r, J) in enumerate(zip(map(np.asarray, value.blocks), map(np.asarray, jacobian.blocks), strict=True)):
        n = jacobian.shared.shape[1]
        shared, poses, r = J[..., :n], J[..., n:], r[..., None]
        if i >= boards:
            groups.append(Reduced(without_poses(poses, np.concatenate([shared, r], axis=-1)), 0))
            continue
        # The last rows are what was known of the bends; without it and from bends of zero.
        bends, data = sigma * r[:, -BENDS:], slice(None, -BENDS)
        own = J[:, data, n + 6 :]
        columns = np.concatenate([shared[:, data], own, r[:, data] - own @ bends], axis=-1)
        groups.append(Reduced(without_poses(poses[:, data, :6], columns), BENDS))
    return groups


def marginal(groups: Sequence[Reduced], sigma: float | Float[np.ndarray, "*tried"]) -> Float[np.ndarray, "*tried c c"]:
    """The normal equations of [shared, residual] for bends of a σ: S, g and Q_rr − Σ Q_rb K Q_br; of each σ."""
    variance, total = np.square(sigma)[..., None], np.zeros(())
    for group in groups:
        size, cross = group.bends
        weight = variance / (1 + variance * size)
        total = total + group.flat - (cross.T * weight[..., None, :]) @ cross
    return total


def deviance(groups: Sequence[Reduced], sigma: Float[np.ndarray, "tried"]) -> Float[np.ndarray, "tried"]:
    """−2 log of the restricted likelihood of each σ of the bends, but for a constant."""
    variance = np.square(sigma)[..., None]
    penalty = sum(np.log1p(variance * group.bends[0]).sum(axis=-1) for group in groups)
    total = marginal(groups, sigma)
    S, g = total[..., :-1, :-1], total[..., :-1, -1]
    diagonal = np.diagonal(S, axis1=-2, axis2=-1)
    known = diagonal > 0
    scale = 1 / np.sqrt(np.where(known, diagonal, 1.0))
    # An unknown that appears in no row adds nothing.
    S = np.where(known[..., :, None] & known[..., None, :], scale[..., :, None] * S * scale[..., None, :], 0.0)
    S, g = S + np.eye(S.shape[-1]) * ~known[..., None, :], np.where(known, scale * g, 0.0)
    size = np.linalg.slogdet(S)[1] - 2 * np.log(scale).sum(axis=-1)
    return penalty + size + total[..., -1, -1] - (g * np.linalg.solve(S, g[..., None])[..., 0]).sum(axis=-1)


def likeliest_bend(groups: Sequence[Reduced], half_diagonal: float) -> float:
    """The likeliest σ of the bends, mm; `LEAST_BEND_MM` of boards that do not bend.

    Args:
        groups: the normal equations.
        half_diagonal: of the board, mm.
    """
    tried = np.linspace(np.log(LEAST_BEND_MM), np.log(_MOST_BEND * half_diagonal), _STEPS)
    best = 0
    for _ in range(_NARROWINGS):
        best = int(np.argmin(deviance(groups, np.exp(tried))))
        around = tried[max(best - 1, 0)], tried[best], tried[min(best + 1, len(tried) - 1)]
        tried, best = np.concatenate([np.linspace(*around[:2], 5), np.linspace(*around[1:], 5)[1:]]), 4
    return float(np.exp(tried[best]))
