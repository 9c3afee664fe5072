"""One side of a session that was solved in two parts at once, as a solve of its own.

The other side's photographs have the normal equations N and the gradient g by what is shared, poses eliminated. What
differs is eliminated too, and what is left, M = N_SS − N_SD N_DD⁻¹ N_DS, is what they say of the shared numbers S: a
normal distribution about the place where they alone would have them. A side with it beside its own photographs has its
minimum where the joint solve has its own, and the same covariance.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from jaxscan.buckets import bucket
from jaxscan.calibration.bends import without_poses
from jaxscan.calibration.block_arrow import Arrow, Jacobian
from jaxscan.calibration.determined import determined_directions, inverse_where_determined
from jaxscan.calibration.observations import Observations
from jaxscan.calibration.residuals import Blocks, Noise
from jaxscan.calibration.rounds import Refined
from jaxscan.calibration.uncertainty import UNDETERMINED, arrow_precision
from jaxscan.precision import as_float64, as_jax, as_numpy
from jaxscan.rig import System


class KnownNumbers(eqx.Module):
    """What is known of shared numbers from elsewhere: normal, about a mean.

    Attributes:
        mean: of the leaves of `System.shared`, in their order.
        root: rootᵀ root is the inverse of their covariance; a number of which nothing is known has a column of zeros.
    """

    mean: Float[Array | np.ndarray, "shared"]
    root: Float[Array | np.ndarray, "rows shared"]

    def residuals(self, system: System, poses: Float[Array, "1 0"], noise: Noise) -> Float[Array, "1 rows"]:
        """Root (numbers − mean), one block, in σ; they have no unknowns but the system's, and need no other σ."""
        del poses, noise
        numbers, _ = ravel_pytree(system.shared)
        return (jnp.asarray(self.root) @ (numbers - self.mean))[None]

    def start(self, system: System) -> Float[Array, "1 0"]:
        """One block without unknowns."""
        del system
        return jnp.zeros((1, 0))


def side_of(
    refined: Refined, sides: tuple[Observations, Observations], later: bool, free: Bool[np.ndarray, "all_shared"]
) -> tuple[Refined, Bool[np.ndarray, "shared"], KnownNumbers]:
    """One side as a solve of its own: where its rounds ended, what was free, and what the other side knows.

    Args:
        refined: of the joint solve, whose blocks stand in the order of the sides.
        sides: the photographs before and behind.
        later: which one.
        free: of the joint solve.
    """
    system = as_numpy(refined.system)
    n = len(ravel_pytree((system.rig, system.shape))[0])
    rig = as_numpy(as_float64(system).where(np.asarray(not later)).rig)
    mine = _blocks(sides, later)
    value, jacobian = as_numpy(refined.last)
    theirs = _blocks(sides, not later)
    columns = jacobian.shared.shape[1]
    N, g = np.zeros((n, n)), np.zeros(n)
    for J, r, at in zip(jacobian.blocks, value.blocks, theirs, strict=False):
        if len(at):
            shared = np.concatenate([J[at][..., :n], r[at][..., None]], axis=-1)
            Q = without_poses(J[at][..., columns:], shared).sum(axis=0)
            N, g = N + Q[:-1, :-1], g + Q[:-1, -1]
    numbers = np.asarray(ravel_pytree((rig, system.shape))[0])
    differ = np.pad(free[n:], (0, n - len(free[n:])))
    known, r = _known(N, g, free[:n] & ~differ, free[:n] & differ, numbers)

    # As many as are compiled for anyway, and never none.
    sizes = [bucket(max(len(at), 1)) if i == 0 else len(at) for i, at in enumerate(mine)]
    padded = [np.pad(at, (0, size - len(at))) for at, size in zip(mine, sizes, strict=True)]
    used = [np.arange(len(to)) < len(at) for to, at in zip(padded, mine, strict=True)]
    some = [i for i, at in enumerate(padded) if len(at) or i == 0]

    def of(arrays: tuple, i: int) -> np.ndarray:
        return arrays[i][padded[i]] * used[i].reshape(-1, *(1,) * (arrays[i].ndim - 1))

    def own(jacobian: np.ndarray) -> np.ndarray:
        return np.delete(jacobian, np.s_[n:columns], axis=-1)

    values = tuple(of(value.blocks, i) for i in some)
    columns_of = tuple(own(of(jacobian.blocks, i)) for i in some)
    J_known = np.asarray(known.root)[None]
    last = (
        Arrow(*as_jax((value.shared, (*values, r[None])))),
        Jacobian(*as_jax((jacobian.shared[:, :n], (*columns_of, J_known)))),
    )
    poses = tuple(system.poses[i][padded[i]] for i in some)
    one = replace(
        refined,
        system=System(as_jax(rig), as_jax((*poses, np.zeros((1, 0)))), as_jax(system.shape)),
        solved_with=refined.noise,
        groups=tuple(as_jax(_only(as_numpy(refined.groups[i]), padded[i], used[i])) for i in some),
        errors=tuple(tuple(each[padded[i]] for each in refined.errors[i]) for i in some),
        precision=arrow_precision(last[1]),
        last=as_numpy(last),
    )
    return one, free[:n], known


def _blocks(sides: tuple[Observations, Observations], later: bool) -> list[np.ndarray]:
    """Where the blocks of a side stand in each group of the joint solve."""
    (before, after), k = sides, int(later)
    counts = [(len(before.views), len(after.views)), (len(before.sequences), len(after.sequences))]
    groups = [count for i, count in enumerate(counts) if i == 0 or sum(count)]
    return [np.arange(count[k]) + (count[0] if later else 0) for count in groups]


def _only(blocks: Blocks, at: Int[np.ndarray, "some"], used: Bool[np.ndarray, "some"]) -> Blocks:
    """Some blocks; those that are padding have nothing that takes part."""
    some, own = jax.tree.map(lambda each: each[at], blocks), used[:, None, None]
    return eqx.tree_at(
        lambda b: (b.before, b.weights, b.corner_used, b.stripe_used),
        some,
        (None, some.weights * own, some.corner_used & own, some.stripe_used & own),
    )


def _known(
    N: Float[np.ndarray, "n n"],
    g: Float[np.ndarray, "n"],
    shared: Bool[np.ndarray, "n"],
    differ: Bool[np.ndarray, "n"],
    numbers: Float[np.ndarray, "n"],
) -> tuple[KnownNumbers, Float[np.ndarray, "n"]]:
    """What photographs know of the shared numbers, and its residual where these are."""
    S, D = np.flatnonzero(shared), np.flatnonzero(differ)
    back = N[np.ix_(S, D)] @ inverse_where_determined(N[np.ix_(D, D)])[0]
    M, pull = N[np.ix_(S, S)] - back @ N[np.ix_(D, S)], g[S] - back @ g[D]
    # Scaled by what was there before the elimination: what that leaves of nothing is rounding.
    e, size, V = determined_directions(M, UNDETERMINED, np.diagonal(N)[S])
    there = size > 0
    size = np.where(there, size, 1.0)
    back_to = np.where(e > 0, 1 / np.where(e > 0, e, 1.0), 0.0)
    along = V.T @ (e * pull)
    root, r, x = np.zeros((len(N), len(N))), np.zeros(len(N)), np.zeros(len(N))
    root[np.ix_(np.arange(len(S)), S)] = (there * np.sqrt(size))[:, None] * V.T * back_to
    r[: len(S)] = there / np.sqrt(size) * along
    x[S] = e * (V @ (there / size * along))
    return KnownNumbers(numbers - x, root), r
