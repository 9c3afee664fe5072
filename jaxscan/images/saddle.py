"""The exact place of a checkerboard's corner, by fitting a picture of it.

The model of a patch, with x counted from the corner in pixels, is

    I(x) = α + α' · x + (β + β' · x) S + η (1 − S²),      S = e₁ e₂ + cos(φ₁ − φ₂) s₁ s₂ ∂e₁ ∂e₂,
    e_i = erf(d_i / √2 s_i),                    d_i = n_i · x − κ_i (t_i · x)² / 2

n_i and t_i are the normal and the direction (angle φ_i) of the two edges, s_i their blur, lens and pixel together: a
pixel is a box, whose variance of 1/12 px² adds to the lens's. Each edge has a blur of its own, because astigmatism
and motion blur along one direction. S is the product of two edges under a Gaussian point spread, to first order in
the correlation of their two distances (the tetrachoric series, K. Pearson 1900): squares seen aslant do not cross at
right angles. κ_i is the bend that the lens gives an edge; it is read from the grid and held, because a bend that is
not known pulls the corner. Perspective needs no term: lines stay lines.

The ideal picture is the same after half a turn about the corner. Neither a point spread of another shape, if it is
symmetric, nor a response curve of the camera, nor ink that spreads, changes that, so none of them moves the corner. η
takes up the last two to first order, so that they are not taken for strangers; the slopes α', β' the gradient of the
light, which does break the symmetry.

Pixels are weighted equally within a parallelogram in the board's own directions, whose rim fades over one pixel. A
pixel at the detector's limit says only that there is at least so much light: its residual counts where the model is
darker. What the model cannot explain (a laser's stripe, a highlight, a finger) is weighted down by Tukey's biweight
and then left out, with its neighbours. The covariance of the thirteen parameters is s² (Jᵀ W J)⁻¹, with s² the mean
square of what is left, so that a patch that lost pixels, or that the model fits badly, has a larger one. Correlated
residuals increase the variance: `correlation` is the variance of the corner with sums over the 5 × 5 neighbours of each
pixel's share in it,

    τ = Σ_p (Σ_{q near p} ψ_q)² / (25 Σ_p ψ_p²),      ψ_p = (Jᵀ W J)⁻¹ J_p w_p r_p

over that without (the taper is M. Bartlett's, 1950, in two dimensions).
"""

from collections.abc import Callable
from functools import partial, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erf
from jaxtyping import Array, Bool, Float

from jaxscan.elimination import solve_blocks
from jaxscan.kept_programs import compiled
from jaxscan.precision import float32

Vectors = Float[np.ndarray, "corners 2"]
Scalars = Float[np.ndarray, "corners"]

# Half sides of the windows, px: each size is compiled once. The larger ones serve larger squares.
_HALF_SIDES = (8, 16)
# Corners that are fitted together: one size is compiled.
_BATCH = 64
_PARAMETERS = 13
_FIRST_BLUR_PX = 1.2
# A photograph sharpened below this aliases; a picture that is a little too soft fits it better than one as sharp.
_BLUR_RANGE_PX = (0.4, 8.0)
# No step turns or moves a corner further than the linearisation holds.
_LONGEST_STEP = (1.0, 1.0, 0.2, 0.2, 0.5, 0.5)
# Marquardt's damping in the first steps, where blur and direction are still guesses.
_DAMPED_STEPS = 3
_DAMPING = 1e-3
_TINY = 1e-6
_MOST_STEPS = (9, 4, 8)
# A phase is done when no corner's last step was longer, px.
_STEP_DONE_PX = (1e-2, 1e-2, 3e-4)
# One that still moves by more than this has not settled, px.
_SETTLED_PX = 0.1
# Tukey's biweight reaches zero, and a pixel is left out, at this multiple of the RMS of the residuals.
_LIMIT = 4.0
# A residual below this part of the contrast is the point spread's, not a stranger's.
_LEAST_RESIDUAL = 0.04
# Where less than this part of a patch is at the detector's limit that is a stripe or a highlight, not light paper.
_FEW = 0.3
# A window whose levels spread by less than this is flat.
_LEAST_SPREAD = 0.5


class Saddles(NamedTuple):
    """Corners as their patches show them.

    Attributes:
        pixels: (u, v); NaN where the fit does not settle.
        variance: of u and v, px², for residuals of one grey level.
        residual: root mean square of the residuals, grey levels.
        contrast: of light and dark, grey levels, positive where the square between the two directions is light.
        blur: standard deviation of the two edges' blur, px.
        share: part of the window's weight that is on the photograph and was kept.
        told: part of the window's information on the corner that was kept, in the direction in which
            that is least.
        hidden: part of the window on the photograph that is burnt out where the model is darker by half the contrast.
        lopsided: part of the window on the photograph that is burnt out and whose mirror image about the corner is not.
        unrest: how far the last step still went, px.
        correlation: τ, by how much the correlation of the residuals increases their variance.
        by_bends: ∂(u, v) / ∂κ of the two edges, px².
    """

    pixels: Vectors
    variance: Vectors
    residual: Scalars
    contrast: Scalars
    blur: Vectors
    share: Scalars
    told: Scalars
    hidden: Scalars
    lopsided: Scalars
    unrest: Scalars
    correlation: Scalars
    by_bends: Float[np.ndarray, "corners 2 2"]


class _Patches(NamedTuple):
    """What is held in one fit; all with the corners in front."""

    levels: Float[Array, "*corners pixels"]
    inside: Bool[Array, "*corners pixels"]
    full: Bool[Array, "*corners pixels"]
    to_lattice: Float[Array, "*corners 2 2"]
    reach: Float[Array, "*corners 2"]
    clear: Float[Array, "*corners 2"]
    bends: Float[Array, "*corners 2"]
    scale: Float[Array, "*corners"]


class _State(NamedTuple):
    shape: Float[Array, "*corners 6"]
    light: Float[Array, "*corners 7"]
    moved: Float[Array, "*corners"]


def fit_saddles(
    image: np.ndarray,
    starts: Vectors,
    edges: tuple[Vectors, Vectors],
    bends: Vectors,
    reach: float,
    clear: Scalars,
    largest_px: float,
) -> Saddles:
    """Fit the patch about each corner.

    Args:
        image: grey or RGB, of 8 or 16 bits; the mean of the colours is fitted.
        starts: where each corner is, to within about a pixel.
        edges: along the board's x and y, from the corner to the next one, px.
        bends: κ of these edges, 1/px, positive towards the direction's clockwise normal.
        reach: half the side of the window in squares.
        clear: how far to either side of an edge there is no other mark than the squares, px.
        largest_px: half the side of the window at most.
    """
    lengths = np.stack([np.linalg.norm(edge, axis=1) for edge in edges], axis=1)
    reach_px = np.minimum(reach * lengths, largest_px)
    lattice = np.stack(edges, axis=-1) / lengths[:, None, :]
    need = np.abs(lattice * reach_px[:, None, :]).sum(axis=2).max(initial=0) + 1.5
    half = next((h for h in _HALF_SIDES if h >= need), _HALF_SIDES[-1])
    centres = np.rint(starts).astype(int)
    v, u = (offset.ravel() for offset in np.mgrid[-half : half + 1, -half : half + 1])
    levels, inside, full = _windows(image, centres, u, v)
    middle = np.where(inside, levels, 0).sum(1) / np.maximum(inside.sum(1), 1)
    # In units of its own contrast a window of 16 bits is as well conditioned as one of 8.
    spread = np.sqrt(np.where(inside, (levels - middle[:, None]) ** 2, 0).sum(1) / np.maximum(inside.sum(1), 1))
    spread = np.maximum(spread, _LEAST_SPREAD)
    angles = np.stack([np.arctan2(edge[:, 1], edge[:, 0]) for edge in edges], axis=1)
    shape = np.column_stack([starts - centres, angles, np.full((len(starts), 2), np.log(_FIRST_BLUR_PX))])
    # Across an edge a part of a square is shorter than along the other one, where they do not cross at right angles.
    sine = np.abs(np.linalg.det(lattice))[:, None]
    whole = {
        "levels": (levels - middle[:, None]) / spread[:, None],
        "inside": inside,
        "full": full,
        "to_lattice": np.linalg.inv(lattice) * sine[:, :, None],
        "reach": reach_px * sine,
        "clear": np.stack([clear, clear], axis=1),
        "bends": bends,
        "scale": reach_px.mean(axis=1),
    }
    # Few at a time: one size is compiled for boards of all sizes, a corner that takes many steps keeps few others, and
    # whoever else uses the processor waits no longer for a large board than for a small one. A GPU's own products of
    # matrices would round to ten bits.
    with float32(), jax.default_matmul_precision("highest"):
        pixels = jnp.asarray(u, jnp.float32), jnp.asarray(v, jnp.float32)
        parts = [
            _fit(
                _Patches(**{name: _batch(x, first) for name, x in whole.items()}),
                _batch(shape, first),
                *pixels,
                2 * half + 1,
            )
            for first in range(0, len(starts), _BATCH)
        ]
    (shape, light, moved), variance, residual, share, told, hidden, lopsided, correlation, by_bends = jax.tree.map(
        lambda *x: np.concatenate(x, dtype=np.float64)[: len(starts)], *parts
    )
    found = np.column_stack([shape, light, variance, residual, correlation])
    settled = np.isfinite(found).all(axis=1) & (moved < _SETTLED_PX)
    return Saddles(
        pixels=np.where(settled[:, None], centres + shape[:, :2], np.nan),
        variance=variance / spread[:, None] ** 2,
        residual=residual * spread,
        contrast=2 * light[:, 3] * spread,
        blur=np.exp(shape[:, 4:]),
        share=share,
        told=told,
        hidden=hidden,
        lopsided=lopsided,
        unrest=moved,
        correlation=correlation,
        by_bends=by_bends,
    )


def _batch(x: np.ndarray, first: int) -> Array:
    """Some corners as the fit takes them, the last one repeated."""
    some = np.minimum(np.arange(first, first + _BATCH), len(x) - 1)
    return jnp.asarray(x[some], bool if x.dtype == bool else jnp.float32)


def _windows(
    image: np.ndarray, centres: np.ndarray, u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Levels about each corner, which of them lie on the photograph, and which are at the detector's limit."""
    at_u, at_v = centres[:, :1] + u, centres[:, 1:] + v
    rows, columns = image.shape[:2]
    inside = (at_u >= 0) & (at_v >= 0) & (at_u < columns) & (at_v < rows)
    levels = image[at_v.clip(0, rows - 1), at_u.clip(0, columns - 1)]
    full = np.asarray(levels >= np.iinfo(image.dtype).max)
    if image.ndim == 3:
        return levels.mean(axis=-1, dtype=np.float32), inside, np.asarray(full.any(axis=-1))
    return levels.astype(np.float32), inside, full


@compiled(static_argnames="side")
def _fit(patches: _Patches, shape: Array, u: Array, v: Array, side: int) -> tuple[_State, *tuple[Array, ...]]:
    """All corners at once, in three phases: least squares, robust, and least squares on the pixels that are kept."""
    n = len(shape)

    def beside(mask: Array) -> Array:
        return _over_neighbours(jnp.logical_or, mask.reshape(n, side, side), 1).reshape(n, -1)

    evaluate = jax.vmap(partial(_evaluate, u=u, v=v))
    most, step_done = jnp.asarray(_MOST_STEPS), jnp.asarray(_STEP_DONE_PX)

    def again(carried: tuple[Array, Array, _State, Array]) -> tuple[Array, Array, _State, Array]:
        phase, k, state, trusted = carried
        residuals, jacobian, window, _ = evaluate(patches, state.shape, state.light)
        limit = _limit(residuals, window * trusted, state.light)
        trusted = jax.lax.cond(
            (phase == 2) & (k == 0), lambda: trusted & ~beside((jnp.abs(residuals) > limit) & trusted), lambda: trusted
        )
        biweight = jnp.clip(1 - (residuals / limit) ** 2, 0) ** 2
        weights = window * trusted * jnp.where(phase == 1, biweight, 1.0)
        damping = jnp.where((phase == 0) & (k < _DAMPED_STEPS), _DAMPING, 0.0)
        state = _step(state.shape, state.light, residuals, jacobian, weights, damping)
        done = (k + 1 >= most[phase]) | ((k > 0) & (state.moved < step_done[phase]).all())
        return jnp.where(done, phase + 1, phase), jnp.where(done, 0, k + 1), state, trusted

    few = ((patches.full & patches.inside).sum(1) < _FEW * patches.inside.sum(1))[:, None]
    trusted = patches.inside & ~(few & beside(patches.full & patches.inside))
    # Without contrast the shape has no derivatives, so that the first step finds the light alone.
    start = _State(shape, jnp.zeros((n, _PARAMETERS - 6)), jnp.full(n, jnp.inf))
    _, _, state, trusted = jax.lax.while_loop(
        lambda carried: carried[0] < 3, again, (jnp.asarray(0), jnp.asarray(0), start, trusted)
    )
    residuals, jacobian, window, whole = evaluate(patches, state.shape, state.light)
    weights = window * trusted
    total = weights.sum(1)
    normal = (jacobian * weights[:, None]) @ jacobian.mT
    inverse = solve_blocks(normal, jnp.broadcast_to(jnp.eye(_PARAMETERS), normal.shape))
    variance = jnp.einsum("nii->ni", inverse)[:, :2]
    # How far a residual of one level at each pixel would move the corner.
    pull = inverse[:, :2] @ (jacobian * weights[:, None])

    def by_bends(patch: _Patches, shape: Array, light: Array) -> Array:
        return jax.jacfwd(lambda bends: _evaluate(patch._replace(bends=bends), shape, light, u, v)[0])(patch.bends)

    moved_by_bends = pull @ jax.vmap(by_bends)(patches, state.shape, state.light)
    freedom = total - _PARAMETERS
    residual = jnp.sqrt((weights * residuals**2).sum(1) / jnp.where(freedom > 1, freedom, jnp.nan))
    # What each pixel's residual contributes to the corner's error.
    square = (pull * residuals[:, None]).reshape(n, 2, side, side)
    sums = _over_neighbours(jnp.add, square, 2)
    correlation = (sums**2).sum((1, 2, 3)) / (25 * (square**2).sum((1, 2, 3)))
    known = jnp.where(variance > 0, variance, jnp.nan)
    seen = window * patches.inside
    told = _least_part(jacobian[:, :2], weights, seen)
    # By more than half the contrast: light paper that is burnt out itself may be so right up to its edges.
    burnt = patches.full & (residuals > jnp.abs(state.light[:, 3:4]))
    hidden = (seen * burnt).sum(1) / seen.sum(1)
    # What the model's light, which rises towards the stripe, takes for itself as bright enough is among these.
    full = patches.full & patches.inside
    mirrored = full.reshape(n, side, side)[:, ::-1, ::-1].reshape(n, -1)
    on_photograph = whole * patches.inside
    lopsided = (on_photograph * (full & ~mirrored)).sum(1) / on_photograph.sum(1)
    return state, known, residual, total / window.sum(1), told, hidden, lopsided, correlation, moved_by_bends


def _least_part(slopes: Array, kept: Array, whole: Array) -> Array:
    """The least part, over all directions, of the information on the corner that some weights keep of others.

    That is the lesser root λ of det(K − λ W) = 0, with K and W the sums of the squares of the model's slopes.
    """
    K, W = ((slopes * weights[:, None]) @ slopes.mT for weights in (kept, whole))
    det_K, det_W = (A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] ** 2 for A in (K, W))
    both = K[:, 0, 0] * W[:, 1, 1] + K[:, 1, 1] * W[:, 0, 0] - 2 * K[:, 0, 1] * W[:, 0, 1]
    return 2 * det_K / (both + jnp.sqrt(jnp.maximum(both**2 - 4 * det_K * det_W, 0.0)))


def _over_neighbours(combine: Callable[[Array, Array], Array], x: Array, reach: int) -> Array:
    """`combine` over the pixels up to `reach` rows and columns away; what is outside counts as 0.

    One axis after the other, by whole rows: XLA's own windows are an order of magnitude slower on a CPU.
    """
    for axis in (-2, -1):
        size = x.shape[axis]
        padded = jnp.pad(x, [(0, 0)] * (x.ndim - 2) + [(reach, reach) if a == axis else (0, 0) for a in (-2, -1)])
        x = reduce(combine, [jax.lax.slice_in_dim(padded, k, k + size, axis=axis) for k in range(2 * reach + 1)])
    return x


def _limit(residuals: Array, weights: Array, light: Array) -> Array:
    """Beyond which a pixel is a stranger's; found from the residuals within it, in a few rounds from above."""
    least = 2 * _LEAST_RESIDUAL * jnp.abs(light[:, 3:4])

    def rms(weights: Array) -> Array:
        return jnp.sqrt((weights * residuals**2).sum(1, keepdims=True) / (weights.sum(1, keepdims=True) + _TINY))

    limit = _LIMIT * jnp.maximum(rms(weights), least)
    for _ in range(4):
        limit = _LIMIT * jnp.maximum(rms(weights * (jnp.abs(residuals) < limit)), least)
    return limit


def _evaluate(patch: _Patches, shape: Array, light: Array, u: Array, v: Array) -> tuple[Array, Array, Array, Array]:
    """Residuals, derivatives of the model by shape and light, and the window, for each pixel.

    The window comes twice: without the pixels at the detector's limit that the model has brighter, and whole.
    """
    x, y = u - shape[0], v - shape[1]
    saddle, slopes = _saddle(x, y, shape[2:], patch.bends)
    # Written out, here and below: XLA makes one pass of it, but not of small matrix products.
    a, b, bulge = x / patch.scale, y / patch.scale, 1 - saddle**2
    contrast = light[3] + light[4] * a + light[5] * b
    model = light[0] + light[1] * a + light[2] * b + contrast * saddle + light[6] * bulge
    by_saddle = contrast - 2 * light[6] * saddle
    basis = [jnp.ones_like(x), a, b, saddle, a * saddle, b * saddle, bulge]
    jacobian = jnp.stack([*(slope * by_saddle for slope in slopes), *basis])
    (to_i, to_j), reach, clear = patch.to_lattice, patch.reach, patch.clear
    i, j = jnp.abs(to_i[0] * x + to_i[1] * y), jnp.abs(to_j[0] * x + to_j[1] * y)
    window = jnp.clip(reach[0] - i + 0.5, 0, 1) * jnp.clip(reach[1] - j + 0.5, 0, 1)
    window = window * jnp.maximum(jnp.clip(clear[0] - i + 0.5, 0, 1), jnp.clip(clear[1] - j + 0.5, 0, 1))
    # At the detector's limit a model that is brighter is right.
    satisfied = patch.full & (model > patch.levels)
    return patch.levels - model, jacobian, window * ~satisfied, window


def _saddle(x: Array, y: Array, shape: Array, bends: Array) -> tuple[Array, list[Array]]:
    """S, and its derivatives by the corner's u, v, the two angles and log s₁, log s₂.

    Small shares are left out of the derivatives: the bend's, and that of the second term of S by angles and blurs.
    """
    edges = []
    for angle, log_blur, bend in zip(shape[:2], shape[2:], bends, strict=True):
        cos, sin, blur = jnp.cos(angle), jnp.sin(angle), jnp.exp(log_blur)
        along = cos * x + sin * y
        d = cos * y - sin * x - bend / 2 * along**2
        z = d / blur
        edges.append((erf(z / np.sqrt(2)), np.sqrt(2 / np.pi) / blur * jnp.exp(-(z**2) / 2), d, along, cos, sin, blur))
    (e1, g1, d1, along1, cos1, sin1, s1), (e2, g2, d2, along2, cos2, sin2, s2) = edges
    crossing = (cos1 * cos2 + sin1 * sin2) * s1 * s2 * g1 * g2
    by_d1, by_d2 = g1 * e2 - crossing * d1 / s1**2, g2 * e1 - crossing * d2 / s2**2
    slopes = [
        by_d1 * sin1 + by_d2 * sin2,
        -(by_d1 * cos1 + by_d2 * cos2),
        -by_d1 * along1,
        -by_d2 * along2,
        -g1 * d1 * e2,
        -g2 * d2 * e1,
    ]
    return e1 * e2 + crossing, slopes


def _step(shape: Array, light: Array, residuals: Array, jacobian: Array, weights: Array, damping: Array) -> _State:
    """One step of Gauss and Newton for each corner, held short.

    A blur that stands at the end of its range and would leave it is held (D. Bertsekas 1982): a step that is cut off
    afterwards would carry the corner along with a change of the blur that is not made.
    """
    sharpest, widest = np.log(_BLUR_RANGE_PX)
    weighted = jacobian * weights[:, None]
    downhill = (weighted[:, 4:6] @ residuals[..., None])[..., 0]
    held = ((shape[:, 4:] <= sharpest) & (downhill < 0)) | ((shape[:, 4:] >= widest) & (downhill > 0))
    jacobian = jacobian.at[:, 4:6].multiply(jnp.where(held, 0.0, 1.0)[..., None])
    change = _least_squares(jacobian, residuals, weights, damping)
    longest = jnp.asarray(_LONGEST_STEP)[None]
    shape = shape + jnp.clip(change[:, :6], -longest, longest)
    shape = shape.at[:, 4:].set(jnp.clip(shape[:, 4:], sharpest, widest))
    return _State(shape, light + change[:, 6:], jnp.abs(change[:, :2]).max(1))


def _least_squares(jacobian: Array, residuals: Array, weights: Array, damping: Array) -> Array:
    weighted = jacobian * weights[:, None]
    normal = weighted @ jacobian.mT
    scale = jnp.einsum("nii->ni", normal)
    # A flat window has no saddle: a little on the diagonal keeps its equations solvable, and it does not settle.
    extra = damping * scale + _TINY * (1 + scale.max(1, keepdims=True))
    damped = normal + extra[:, None] * jnp.eye(_PARAMETERS)[None]
    return solve_blocks(damped, weighted @ residuals[..., None])[..., 0]
