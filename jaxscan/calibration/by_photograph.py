"""The information of each photograph on the unknowns that it shares with others.

From residuals and Jacobian of the last solve come each photograph's normal equations N_i and gradient g_i by what is
shared, its own pose eliminated.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.bends import without_poses
from jaxscan.calibration.blocks import photographs_in_blocks
from jaxscan.calibration.determined import inverse_where_determined
from jaxscan.calibration.observations import Observations, View
from jaxscan.calibration.rounds import Refined


@dataclass(frozen=True)
class ByPhotograph:
    """Normal equations of each photograph, by what is shared and by what each sequence has of its own.

    Attributes:
        views: the photographs, in the order of `Observations.in_order`.
        at: of each the group, the block and the place in it.
        N: the normal equations of each.
        g: its gradient.
        square: of each the sum of its squared residuals, in σ, its own pose moved along.
        others: the normal equations of what else is known.
        pull_of_others: its gradient.
        own: where what each sequence has of its own stands among the unknowns.
    """

    views: tuple[View, ...]
    at: tuple[tuple[int, int, int], ...]
    N: Float[np.ndarray, "photographs unknowns unknowns"]
    g: Float[np.ndarray, "photographs unknowns"]
    square: Float[np.ndarray, "photographs"]
    others: Float[np.ndarray, "unknowns unknowns"]
    pull_of_others: Float[np.ndarray, "unknowns"]
    own: tuple[range, ...]

    @staticmethod
    def create(refined: Refined, observations: Observations, scales: Float[np.ndarray, "2"]) -> "ByPhotograph":
        """From residuals and Jacobian of the last solve; those of corners and stripes are multiplied by `scales`."""
        value, jacobian = refined.last
        n = jacobian.shared.shape[1]
        blocks = [(np.asarray(J), np.asarray(r)) for J, r in zip(jacobian.blocks, value.blocks, strict=True)]
        each = blocks[1][0].shape[-1] - n if observations.sequences else 0
        own = tuple(range(n + each * b, n + each * (b + 1)) for b in range(len(observations.sequences)))
        photographs = list(photographs_in_blocks(observations))
        order = [photographs[i] for i in observations.in_order()]
        count = n + each * len(own)
        N, g, square = np.zeros((len(order), count, count)), np.zeros((len(order), count)), np.zeros(len(order))
        for group in {group for _, group, *_ in order}:
            # All of a group at once: of hundreds of small matrices the calls are what takes time.
            some = [(i, b, k) for i, (_, its, b, k) in enumerate(order) if its == group]
            J, r = blocks[group]
            rows, weights = zip(*(rows_of(refined, group, k, J.shape[1], scales) for _, _, k in some), strict=True)
            at, weight = (np.array([b for _, b, _ in some])[:, None], np.array(rows)), np.stack(weights)
            J, r = weight[..., None] * J[at], weight * r[at]
            shared = np.concatenate([J if group else J[..., :n], r[..., None]], axis=-1)
            for (i, b, _), Q in zip(some, without_poses(J[..., J.shape[-1] if group else n :], shared), strict=True):
                to = [*range(n), *(own[b] if group else ())]
                N[i][np.ix_(to, to)], g[i, to], square[i] = Q[:-1, :-1], Q[:-1, -1], Q[-1, -1]
        others, pull_of_others = np.zeros((count, count)), np.zeros(count)
        # What is known of the bends of boards that an axis moves is of no one photograph.
        for b, at in enumerate(own):
            rows = slice(refined.groups[1].corners[b].size + refined.groups[1].stripe_used[b].size, None)
            J, r = blocks[1][0][b, rows, n:], blocks[1][1][b, rows]
            others[np.ix_(at, at)] += J.T @ J
            pull_of_others[list(at)] += J.T @ r
        for J, r in blocks[len(refined.groups) :]:
            Q = without_poses(J[..., n:], np.concatenate([J[..., :n], r[..., None]], axis=-1)).sum(axis=0)
            others[:n, :n] += Q[:-1, :-1]
            pull_of_others[:n] += Q[:-1, -1]
        views, places = tuple(view for view, *_ in order), tuple((group, b, k) for _, group, b, k in order)
        return ByPhotograph(views, places, N, g, square, others, pull_of_others, own)

    def inverse(self) -> Float[np.ndarray, "unknowns unknowns"]:
        """T⁻¹, the inverse of the sum of all: the covariance of the unknowns."""
        return inverse_where_determined(self.total())[0]

    def total(self) -> Float[np.ndarray, "unknowns unknowns"]:
        """T, the normal equations of all."""
        return self.N.sum(axis=0) + self.others

    def beside(self, D: Float[np.ndarray, "unknowns d"], courses: Float[np.ndarray, "n photographs"]) -> "ByPhotograph":
        """The same where some numbers may also go along some courses from photograph to photograph.

        Args:
            D: derivatives of all unknowns by these numbers.
            courses: by how much of the numbers each photograph differs; the numbers of each stand behind the unknowns.
        """
        n, d = D.shape
        more = d * len(courses)
        E = np.broadcast_to(np.eye(n, n + more), (len(self.views), n, n + more)).copy()
        for i, course in enumerate(courses):
            E[:, :, n + i * d : n + (i + 1) * d] = D * course[:, None, None]
        others, pull = (np.pad(each, (0, more)) for each in (self.others, self.pull_of_others))
        return replace(
            self,
            N=E.mT @ self.N @ E,
            g=(E.mT @ self.g[..., None])[..., 0],
            others=others,
            pull_of_others=pull,
        )


def rows_of(
    refined: Refined, group: int, k: int, count: int, scales: Float[np.ndarray, "2"]
) -> tuple[list[int], Float[np.ndarray, "rows"]]:
    """The residuals of a block's k-th photograph, and their scales.

    What is known of the bends of a board that no axis moves is among them.
    """
    blocks = refined.groups[group]
    photographs, corners = blocks.corners.shape[1], 2 * blocks.corners.shape[2]
    stripe, begin = blocks.stripe_used.shape[2], photographs * corners
    rest = range(begin + photographs * stripe, count) if group == 0 else ()
    rows = [*range(k * corners, (k + 1) * corners), *range(begin + k * stripe, begin + (k + 1) * stripe), *rest]
    return rows, np.repeat([*scales, 1.0], [corners, stripe, len(rest)])
