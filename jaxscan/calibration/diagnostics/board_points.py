"""Are the board's points where they should be? What all photographs share of their residuals, as a variance component.

Beyond the shape that was sought, each point of the board may stand off its place, along columns, rows and the normal,
by a smooth field that is the same in all photographs: products of Legendre's polynomials up to the fourth degree of
s and t (`rig.board_shape`), normal with σ_k / degree, one σ_k in the plane and one out of it. With the poses
eliminated, S the normal equations of what is shared, g its gradient, G those that tie it to the fields, F and f the
fields' own,

    F' = F − Gᵀ S⁻¹ G        f' = f − Gᵀ S⁻¹ g        −2 log L = log |1 + W F'| − f'ᵀ (W⁻¹ + F')⁻¹ f'

is the restricted likelihood of the variances W (H. D. Patterson and R. Thompson 1971). What was found without the
fields is off by S⁻¹ G times what they are, so its covariance grows by S⁻¹ G W Gᵀ S⁻¹. A field alike in all photographs
cannot average out, so no residual shows its errors directly; but it is not likely that only those parts of it are
small that the rig would take for its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy.polynomial.legendre import legvander
from scipy.optimize import minimize

from jaxscan.calibration.bends import without_poses
from jaxscan.calibration.determined import inverse_where_determined
from jaxscan.calibration.off_grid import OffGrid
from jaxscan.calibration.places import places_of_residuals
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined
from jaxscan.geometry import vector_to_matrix
from jaxscan.rig.board_shape import BOARD_SHAPES, half_diagonal_of, places_on_board

_DEGREE: Final = 4
# A variance component that raises −2 log L by less than this when it is left out is none: once in 10 000 by chance.
_CLEAR = 13.8
# σ is searched from the first share of the board's half diagonal up to the second; first in this number of steps.
_LEAST, _MOST, _STEPS = 1e-6, 0.1, 9
# Degrees along columns and rows of what the shapes of `rig.board_shape` have, in the order of its terms.
_OF_SHAPE: Final = ((2, 0), (0, 2), (1, 1), (2, 1), (1, 2))
_IN_PLANE, _HEIGHT = 0, 1


def board_point_errors(
    refined: Refined, calibration: Calibration
) -> tuple[OffGrid, Float[np.ndarray, "shared shared"]] | None:
    """How far the board's points are off, and by how much the covariance of what is shared grows for it.

    None where nothing shows beyond noise.

    Args:
        refined: where the rounds ended.
        calibration: the same, assembled.
    """
    fields = _Fields.create(refined, calibration)
    sigmas, deviance = fields.likeliest(half_diagonal_of(calibration.observations.board.points()))
    if not sigmas.any():
        return None
    widens, off = fields.widens(sigmas), fields.rms(sigmas, calibration)
    sigma = np.sqrt(np.maximum(np.diagonal(fields.inverse), 0.0))
    parameter, wider = calibration.most_moved(np.sqrt(np.diagonal(widens) + sigma**2), sigma)
    p = 0.5 * float(np.exp(deviance / 2))
    return OffGrid(float(off[_IN_PLANE]), float(off[_HEIGHT]), wider, parameter, p), widens


@dataclass(frozen=True)
class _Fields:
    """Fields of displacement, and the information of corners and stripes on them.

    Attributes:
        terms: of each its axis (0, 1, 2) and its degrees along columns and rows.
        inverse: S⁻¹.
        tied: G.
        own: F'.
        pull: f'.
    """

    terms: tuple[tuple[int, int, int], ...]
    inverse: Float[np.ndarray, "shared shared"]
    tied: Float[np.ndarray, "shared terms"]
    own: Float[np.ndarray, "terms terms"]
    pull: Float[np.ndarray, "terms"]

    @staticmethod
    def create(refined: Refined, calibration: Calibration) -> "_Fields":
        """The fields from residuals and Jacobian of the last solve."""
        terms = _terms(calibration)
        value, jacobian = refined.last
        n = jacobian.shared.shape[1]
        total = np.zeros((n + len(terms) + 1,) * 2)
        places = places_of_residuals(refined, calibration)
        for i, (r, J) in enumerate(zip(map(np.asarray, value.blocks), map(np.asarray, jacobian.blocks), strict=True)):
            columns = np.zeros((*r.shape, len(terms)))
            if i < len(places):
                rows, corners = places[i].shape[1], 2 * refined.groups[i].weights[0].size
                R = np.asarray(vector_to_matrix(np.asarray(refined.system.poses[i])[:, :3]))
                by_axis = np.einsum("bri,bik->kbr", J[:, :rows, n + 3 : n + 6], R)
                # A point that moves in the board's plane takes no stripe along.
                by_axis[:2, :, corners:] = 0.0
                each = [
                    by_axis[axis] * value for (axis, *_), value in zip(terms, _values(terms, places[i]), strict=True)
                ]
                columns[:, :rows] = np.where(np.isfinite(each), each, 0.0).transpose(1, 2, 0)
            both = np.concatenate([J[..., :n], columns, r[..., None]], axis=-1)
            total += without_poses(J[..., n:], both).sum(axis=0)
        inverse, _ = inverse_where_determined(total[:n, :n])
        tied = total[:n, n:-1]
        own = total[n:-1, n:-1] - tied.T @ inverse @ tied
        return _Fields(terms, inverse, tied, own, total[n:-1, -1] - tied.T @ inverse @ total[:n, -1])

    def likeliest(self, half_diagonal: float) -> tuple[Float[np.ndarray, "2"], float]:
        """σ of the fields in the plane and out of it, mm, 0 where none shows; and −2 log L over that without any."""
        grid = np.log(half_diagonal) + np.linspace(np.log(_LEAST), np.log(_MOST), _STEPS)

        def best(free: Sequence[int]) -> tuple[Float[np.ndarray, "2"], float]:
            def at(logs: Float[np.ndarray, "free"]) -> Float[np.ndarray, "2"]:
                sigmas = np.zeros(2)
                sigmas[list(free)] = np.exp(np.clip(logs, grid[0], grid[-1]))
                return sigmas

            starts = np.stack(np.meshgrid(*[grid] * len(free)), axis=-1).reshape(-1, len(free))
            first = min(starts, key=lambda logs: self._deviance(at(logs)))
            found = minimize(lambda logs: self._deviance(at(logs)), first, method="Nelder-Mead")
            return at(found.x), float(found.fun)

        alone = [best([_IN_PLANE]), best([_HEIGHT])]
        both = best([_IN_PLANE, _HEIGHT])
        simpler = min(alone, key=lambda each: each[1])
        if both[1] < simpler[1] - _CLEAR:
            return both
        return simpler if simpler[1] < -_CLEAR else (np.zeros(2), 0.0)

    def _scale(self, sigmas: Float[np.ndarray, "2"]) -> Float[np.ndarray, "terms"]:
        """σ of each term."""
        return np.array([sigmas[_HEIGHT if axis == 2 else _IN_PLANE] / (i + j) for axis, i, j in self.terms])

    def _deviance(self, sigmas: Float[np.ndarray, "2"]) -> float:
        w = self._scale(sigmas)
        M, f = np.eye(len(w)) + w[:, None] * self.own * w, w * self.pull
        return float(np.linalg.slogdet(M)[1] - f @ np.linalg.solve(M, f))

    def widens(self, sigmas: Float[np.ndarray, "2"]) -> Float[np.ndarray, "shared shared"]:
        """How much the covariance of what is shared grows for fields of these σ."""
        off = self.inverse @ self.tied * self._scale(sigmas)
        return off @ off.T

    def rms(self, sigmas: Float[np.ndarray, "2"], calibration: Calibration) -> Float[np.ndarray, "2"]:
        """How far the points are off in the plane and out of it as the residuals have it, RMS, mm."""
        w = self._scale(sigmas)
        found = -w * np.linalg.solve(np.eye(len(w)) + w[:, None] * self.own * w, w * self.pull)
        s, t = places_on_board(calibration.observations.board.points())
        values = found[:, None] * np.array(_values(self.terms, np.stack([s, t], axis=-1)))
        axes = np.array([axis for axis, *_ in self.terms])
        moved = np.stack([values[axes == axis].sum(axis=0) for axis in range(3)])
        return np.sqrt(np.array([(moved[:2] ** 2).sum(axis=0).mean(), (moved[2] ** 2).mean()]))


def _terms(calibration: Calibration) -> tuple[tuple[int, int, int], ...]:
    """The fields that are not sought, nor one with the board's pose; those in its plane turn with it in one sum."""
    sought = _OF_SHAPE[: BOARD_SHAPES[calibration.board_shape][0]]
    s, t = places_on_board(calibration.observations.board.points())
    # A polynomial of as high a degree as there are columns is one of a lower degree on them.
    most = min(_DEGREE, len(np.unique(s.round(6))) - 1), min(_DEGREE, len(np.unique(t.round(6))) - 1)
    degrees = [(i, j) for i in range(most[0] + 1) for j in range(most[1] + 1) if 0 < i + j <= _DEGREE]
    return tuple(
        (axis, i, j) for axis in range(3) for i, j in degrees if axis < 2 or (i + j > 1 and (i, j) not in sought)
    )


def _values(
    terms: Sequence[tuple[int, int, int]], places: Float[np.ndarray, "*points 2"]
) -> list[Float[np.ndarray, "*points"]]:
    along, across = (legvander(places[..., i], _DEGREE) for i in range(2))
    return [along[..., i] * across[..., j] for _, i, j in terms]
