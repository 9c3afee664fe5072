"""Linear algebra of least-squares problems whose normal equations have the shape of an arrow.

The unknowns are a few *shared* ones s and many small *blocks* p_b; every residual depends on s and on at most one
block. With J_s, J_b the columns of the Jacobian, the normal equations are

    | U    W_1  W_2  … |   | δs  |     | g_s |         U = Σ J_sᵀ J_s     W_b = J_sᵀ J_b     V_b = J_bᵀ J_b
    | W_1ᵀ V_1         |   | δp_1|  = −| g_1 |         g = Jᵀ r
    | W_2ᵀ      V_2    |   | δp_2|     | g_2 |
    |  …            …  |   |  …  |     |  …  |

Eliminating the blocks leaves the Schur complement S = U − Σ W_b V_b⁻¹ W_bᵀ (D. C. Brown 1958; Triggs et al.,
"Bundle adjustment", 2000), so a step costs time in proportion to the number of blocks.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.elimination import solve_blocks


class Arrow(eqx.Module):
    """A vector of unknowns, or of residuals, in the shape of the problem.

    Attributes:
        shared: the shared unknowns, or the residuals that depend on these alone.
        blocks: for each group of like blocks, (blocks, size): their unknowns, or their residuals.
    """

    shared: Float[Array, "*stack shared"]
    blocks: tuple[Float[Array, "*stack _ _"], ...]


class Group(eqx.Module):
    """The normal equations of one group of blocks.

    Attributes:
        V: J_bᵀ J_b of each block.
        W: J_sᵀ J_b of each block.
        g: J_bᵀ r of each block.
    """

    V: Float[Array, "blocks size size"]
    W: Float[Array, "blocks shared size"]
    g: Float[Array, "blocks size"]


class NormalEquations(eqx.Module):
    """Jᵀ J and Jᵀ r, by blocks.

    Attributes:
        U: Jᵀ J of the shared unknowns.
        g: Jᵀ r of the shared unknowns.
        groups: the groups of blocks.
        total: ‖r‖².
    """

    U: Float[Array, "shared shared"]
    g: Float[Array, "shared"]
    groups: tuple[Group, ...]
    total: Float[Array, ""]

    @staticmethod
    def create(residual: Arrow, jacobian: "Jacobian") -> "NormalEquations":
        """The normal equations of a residual and the columns of its Jacobian."""
        Js, rs = jacobian.shared, residual.shared
        U, g, total = Js.T @ Js, Js.T @ rs, rs @ rs
        groups = []
        for J, r in zip(jacobian.blocks, residual.blocks, strict=True):
            n = Js.shape[1]
            # One product of the whole [J_s J_b r] with itself for each block is faster than its parts.
            columns = jnp.concatenate([J, r[..., None]], axis=-1)
            square = jnp.einsum("bmi,bmj->bij", columns, columns)
            whole = square.sum(0)
            U, g, total = U + whole[:n, :n], g + whole[:n, -1], total + whole[-1, -1]
            groups.append(Group(V=square[:, n:-1, n:-1], W=square[:, :n, n:-1], g=square[:, n:-1, -1]))
        return NormalEquations(U, g, tuple(groups), total)

    @staticmethod
    def unknown(y: Arrow) -> "NormalEquations":
        """Normal equations of the right shapes, with ‖r‖² infinite."""
        n, dtype = y.shared.size, y.shared.dtype
        groups = tuple(
            Group(jnp.zeros((b, d, d), dtype), jnp.zeros((b, n, d), dtype), jnp.zeros((b, d), dtype))
            for b, d in (block.shape for block in y.blocks)
        )
        return NormalEquations(jnp.zeros((n, n), dtype), jnp.zeros(n, dtype), groups, jnp.array(jnp.inf, dtype))

    def diagonal(self) -> Arrow:
        """The diagonal of JᵀJ."""
        return Arrow(jnp.diagonal(self.U), tuple(jnp.diagonal(g.V, axis1=-2, axis2=-1) for g in self.groups))

    def damped(self, damping: Float[Array, ""], D: Arrow) -> "NormalEquations":
        """JᵀJ + λ diag D in place of JᵀJ."""
        groups = tuple(
            Group(group.V + damping * d[..., None] * jnp.eye(d.shape[-1], dtype=d.dtype)[None], group.W, group.g)
            for group, d in zip(self.groups, D.blocks, strict=True)
        )
        return NormalEquations(self.U + damping * jnp.diag(D.shared), self.g, groups, self.total)

    def fall(self, step: Arrow, damping: Float[Array, ""], D: Arrow) -> Float[Array, ""]:
        """How much the linear model lets ‖r‖² fall along the step δ that was damped by λ diag D: −gᵀδ + λ δᵀDδ."""
        parts = [(self.g, step.shared, D.shared)]
        parts += [(group.g, s, d) for group, s, d in zip(self.groups, step.blocks, D.blocks, strict=True)]
        return sum((((damping * d * s - g) * s).sum() for g, s, d in parts), jnp.zeros_like(self.total))

    def step(self) -> Arrow:
        """The Gauss-Newton step −(JᵀJ)⁻¹ Jᵀr; NaN where JᵀJ is not positive definite."""
        eliminated = [_eliminate(group) for group in self.groups]
        S, g, scale = *self._reduced(eliminated), _scale(self.U)
        # One matrix, no batch, here and below: LAPACK's calls are not split then, and cannot wait for each other.
        factor = jnp.linalg.cholesky(scale[:, None] * S * scale[None])  # noqa: TID251
        step = -scale * jax.scipy.linalg.cho_solve((factor, True), scale * g)  # noqa: TID251
        return _with_blocks(step, eliminated)

    def determined_step(self) -> tuple[Arrow, Float[Array, ""]]:
        """The Gauss-Newton step along what the data determine, and gᵀ (JᵀJ)⁻¹ g, by how much ‖r‖² would fall.

        Residuals in units of their own σ make the latter the squared distance from the minimum in standard deviations.
        """
        eliminated = [_eliminate(group) for group in self.groups]
        S, g, scale = *self._reduced(eliminated), _scale(self.U)
        values, vectors = jnp.linalg.eigh(scale[:, None] * S * scale[None])  # noqa: TID251
        # Below this an eigenvalue is rounding: the direction is not determined, and no step along it is wanted.
        determined = values > 1e3 * jnp.finfo(values.dtype).eps
        along = vectors.T @ (scale * g)
        length = jnp.where(determined, along / jnp.where(determined, values, 1.0), 0.0)
        fall = along @ length + sum((group.g * e.own).sum() for group, e in zip(self.groups, eliminated, strict=True))
        return _with_blocks(-scale * (vectors @ length), eliminated), fall

    def schur_complement(self) -> Float[Array, "shared shared"]:
        """S = U − Σ W V⁻¹ Wᵀ."""
        return self._reduced([_eliminate(group) for group in self.groups])[0]

    def _reduced(self, eliminated: "list[_Eliminated]") -> tuple[Float[Array, "shared shared"], Float[Array, "shared"]]:
        """S, with 1 on the diagonal of a shared unknown that no residual depends on, and g_s − Σ W V⁻¹ g."""
        gaps = jnp.diag(jnp.where(jnp.diagonal(self.U) > 0, 0.0, 1.0).astype(self.U.dtype))
        S = self.U + gaps - sum(e.schur for e in eliminated)
        return S, self.g - sum(e.gradient for e in eliminated)


class _Eliminated(eqx.Module):
    """What a group leaves behind: V⁻¹ g, V⁻¹ Wᵀ, Σ W V⁻¹ Wᵀ and Σ W V⁻¹ g."""

    own: Float[Array, "blocks size"]
    coupling: Float[Array, "blocks size shared"]
    schur: Float[Array, "shared shared"]
    gradient: Float[Array, "shared"]


def _eliminate(group: Group) -> _Eliminated:
    right = jnp.concatenate([group.g[..., None], jnp.swapaxes(group.W, -1, -2)], axis=-1)
    solved = solve_blocks(group.V, right)
    own, coupling = solved[..., 0], solved[..., 1:]
    both = jnp.einsum("bsi,bij->sj", group.W, solved)
    return _Eliminated(own, coupling, both[:, 1:], both[:, 0])


def _with_blocks(step: Float[Array, "shared"], eliminated: list[_Eliminated]) -> Arrow:
    """A step of the shared unknowns and those of the blocks that follow from it."""
    return Arrow(step, tuple(-(e.own + e.coupling @ step) for e in eliminated))


def _scale(U: Float[Array, "n n"]) -> Float[Array, "n"]:
    """1 / √diagonal: what gives a normal matrix a unit diagonal."""
    diagonal = jnp.diagonal(U)
    return jax.lax.rsqrt(jnp.where(diagonal > 0, diagonal, 1.0))


class Jacobian(eqx.Module):
    """The Jacobian's columns: those of the shared unknowns, then for every block [J_s J_b].

    Attributes:
        shared: of the residuals that depend on shared unknowns alone.
        blocks: for each group (blocks, residuals, shared + size).
    """

    shared: Float[Array, "residuals shared"]
    blocks: tuple[Float[Array, "_ _ _"], ...]


def jacobian_columns(product: Callable[[Arrow], Arrow], like: Arrow) -> Jacobian:
    """All columns from n_shared + size Jacobian-vector products.

    A block's columns touch that block's residuals alone, so one product serves all blocks of all groups at once.

    Args:
        product: the Jacobian-vector product.
        like: the unknowns, for their shapes.
    """
    return _columns(jax.vmap(product, out_axes=-1)(_directions(like)), like)


class Sparsity(eqx.Module):
    """Which shared unknowns a block's residuals do not depend on: many local ones cost no more than a few.

    Shared unknowns of one class have one Jacobian-vector product together, for no residual depends on two of them
    (A. R. Curtis, M. J. D. Powell, J. K. Reid 1974). The residuals of shared unknowns alone may depend on any.

    Attributes:
        depends: for each group (blocks, residuals, shared), whether a residual may depend on an unknown.
        classes: of each shared unknown the number of its class.
    """

    depends: tuple[Bool[Array, "_ _ _"], ...]
    classes: tuple[int, ...] = eqx.field(static=True)

    def seeds(self) -> Float[np.ndarray, "classes shared"]:
        """A direction for each class."""
        return np.eye(max(self.classes) + 1)[:, list(self.classes)]


def linearise(residual: Callable[[Arrow], Arrow], y: Arrow, sparsity: Sparsity | None = None) -> tuple[Arrow, Jacobian]:
    """Residual and Jacobian at y."""
    return linearise_with(lambda y: (residual(y), None), y, sparsity)[:2]


def linearise_with(
    residual: Callable[[Arrow], tuple[Arrow, Any]], y: Arrow, sparsity: Sparsity | None = None
) -> tuple[Arrow, Jacobian, Any]:
    """Residual and Jacobian at y, and what else comes with the residual."""
    both = jax.vmap(lambda along: jax.jvp(residual, (y,), (along,), has_aux=True), out_axes=(None, -1, None))
    if sparsity is None:
        value, columns, more = both(_directions(y))
        return value, _columns(columns, y), more
    seeds = jnp.asarray(sparsity.seeds(), y.shared.dtype)
    few = _directions(Arrow(seeds[:, 0], y.blocks))
    value, columns, more = both(replace(few, shared=few.shared[:, : len(seeds)] @ seeds))
    own, at = _columns(columns, Arrow(seeds[:, 0], y.blocks)), np.array(sparsity.classes)
    blocks = tuple(
        jnp.concatenate([jnp.where(depends, J[..., at], 0.0), J[..., len(seeds) :]], axis=-1)
        for J, depends in zip(own.blocks, sparsity.depends, strict=True)
    )
    shared = jax.jacfwd(lambda shared: residual(Arrow(shared, y.blocks))[0].shared)(y.shared)
    return value, Jacobian(shared, blocks), more


def _directions(like: Arrow) -> Arrow:
    """One direction for each shared unknown, then one for each unknown of a block, of all blocks at once."""
    n = like.shared.size
    size = max((block.shape[1] for block in like.blocks), default=0)
    shared = jnp.eye(n, n + size, dtype=like.shared.dtype).T
    unit = jnp.eye(size, dtype=like.shared.dtype)
    blocks = tuple(
        jnp.concatenate(
            [
                jnp.zeros((n, *block.shape), block.dtype),
                jnp.broadcast_to(unit[:, None, : block.shape[1]], (size, *block.shape)),
            ]
        )
        for block in like.blocks
    )
    return Arrow(shared, blocks)


def _columns(products: Arrow, like: Arrow) -> Jacobian:
    """The products with all directions, without those that belong to larger blocks."""
    n = like.shared.size
    return Jacobian(
        shared=products.shared[..., :n],
        blocks=tuple(
            column[..., : n + block.shape[1]] for column, block in zip(products.blocks, like.blocks, strict=True)
        ),
    )
