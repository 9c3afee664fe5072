"""How well the other photographs predict what each one shows: what models are compared by.

With N_i and g_i the normal equations and the gradient of each photograph, its own pose eliminated, and T the sum of all
N_i, what is shared stands without photograph i, to first order, at x_i = (T − N_i)⁻¹ g_i from where it stands with all.
There the photograph's squared residuals, in σ, are r² + 2 gᵀ x + xᵀ N x: nothing of the rig was fitted to them. With
the logarithms of the σ, and what bulges of its own are worth, that is −2 log of the density of what was seen.
"""

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.by_photograph import ByPhotograph
from jaxscan.calibration.determined import inverse_where_determined
from jaxscan.calibration.rounds import Refined
from jaxscan.rig.board_shape import BENDS

_POSE = 6


def leave_one_out(refined: Refined, each: ByPhotograph) -> Float[np.ndarray, "photographs"]:
    """−2 log of the density at which the others predict each photograph, up to a constant.

    A stripe point counts as much as its correlation with its neighbours leaves it.

    Args:
        refined: where the rounds ended.
        each: the normal equations of its photographs.
    """
    inverse, _ = inverse_where_determined(each.total() - each.N)
    x = np.einsum("pij,pj->pi", inverse, each.g)
    squares = each.square + 2 * (each.g * x).sum(axis=1) + np.einsum("pi,pij,pj->p", x, each.N, x)
    noise, tau = refined.noise, refined.stripe_correlation or 1.0
    scales = np.zeros(len(squares))
    for i, (group, b, k) in enumerate(each.at):
        blocks = refined.groups[group]
        corners = np.asarray(blocks.weights)[b, k][np.asarray(blocks.corner_used)[b, k]]
        stripe = np.asarray(blocks.stripe_weights)[b, k][np.asarray(blocks.stripe_used)[b, k]]
        scales[i] = 4 * np.log(float(noise.corner) / corners).sum()
        scales[i] += 2 / tau * np.log(float(noise.stripe) / stripe).sum()
        if noise.bend is not None and group == 0:
            scales[i] += _of_bends(np.asarray(refined.last[1].blocks[group])[b], x.shape[1], each, float(noise.bend))
    return squares + scales


def _of_bends(J: Float[np.ndarray, "rows columns"], unknowns: int, each: ByPhotograph, sigma: float) -> float:
    """Log |1 + σ² Q|, Q the information of a block's residuals on its bulges once its pose is eliminated."""
    shared = unknowns - sum(len(own) for own in each.own)
    V = J[:, shared:].T @ J[:, shared:]
    scale = 1 / np.sqrt(np.diagonal(V))
    V = scale[:, None] * V * scale
    told = np.linalg.slogdet(V)[1] - np.linalg.slogdet(V[:_POSE, :_POSE])[1] - 2 * np.log(scale[_POSE:]).sum()
    return float(told + 2 * BENDS * np.log(sigma))
