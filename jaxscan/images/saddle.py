"""The exact place of a checkerboard's corner, by fitting a picture of it.

OpenCV's `cornerSubPix` interpolates gradients and errs by 0.02 to 0.05 px on sharp photographs, however little noise
there is. Here a model of the corner is fitted to the grey levels by Gauss-Newton steps:

    I(x) = (α + α' · x) + (β + β' · x) tanh(d₁ / s) tanh(d₂ / s),     d_i = n_i · x − κ_i (t_i · x)² / 2

with x counted from the corner, n_i and t_i the normal and the direction of the two edges, s their blur. Apart from the
two slopes, of the light and of its contrast, the model is symmetric about the corner, as a blurred corner is, so that a
profile of another shape does not move it. κ_i is the bend that the lens gives the edge: it is read from the grid and
held, because a bend that is not known pulls the corner with it.
"""

import numpy as np
from jaxtyping import Float

Vectors = Float[np.ndarray, "corners 2"]
Scalars = Float[np.ndarray, "corners"]

_MOST_STEPS = 15
_STEP_DONE_PX = 2e-4
_FIRST_BLUR_PX = 1.2
_BLUR_RANGE_PX = (0.3, 8.0)
# No step turns or moves a corner further than the linearisation holds.
_LONGEST_STEP = np.array([1.0, 1.0, 0.2, 0.2, 0.5])
# Marquardt's damping in the first steps, where blur and direction are still guesses.
_DAMPED_STEPS = 3
_DAMPING = 1e-3
_TINY = 1e-9
# A window whose levels spread by less than this is flat.
_LEAST_CONTRAST = 0.5
# Where there is a corner, β is about the spread of the levels in its window.
_LEAST_SHARE = 0.3


def fit_saddles(
    grey: Float[np.ndarray, "rows columns"],
    starts: Vectors,
    directions: tuple[Vectors, Vectors],
    bends: tuple[Scalars, Scalars],
    radii: Scalars,
) -> Vectors:
    """The corners' pixels (u, v), each fitted to the disc about its start; NaN where the fit does not settle.

    Args:
        grey: the photograph's levels.
        starts: where each corner is, to within about a pixel.
        directions: of the edges that cross there, along the board's x and y.
        bends: κ of these edges, 1/px, positive towards the direction's clockwise normal.
        radii: of the discs, px; they should hold no other edge.
    """
    centres = np.rint(starts)
    half = int(np.ceil(radii.max()))
    v, u = (offset.ravel()[None] for offset in np.mgrid[-half : half + 1, -half : half + 1])
    levels, inside = _windows(grey, centres.astype(int), u, v)
    # In units of its own contrast a window of 16 bits is as well conditioned as one of 8.
    levels -= levels.mean(axis=1, keepdims=True)
    levels /= np.maximum(levels.std(axis=1, keepdims=True), _LEAST_CONTRAST)
    nonlinear = np.column_stack([starts - centres, *(np.arctan2(t[:, 1], t[:, 0]) for t in directions)])
    nonlinear = np.column_stack([nonlinear, np.full(len(starts), np.log(_FIRST_BLUR_PX))])
    light = np.zeros((len(starts), 6))
    moved = np.full(len(starts), np.inf)
    for step in range(_MOST_STEPS):
        x, y = u - nonlinear[:, :1], v - nonlinear[:, 1:2]
        # The disc's rim fades over a pixel, so that the sum does not jump as the disc moves.
        weights = inside * (radii[:, None] + 0.5 - np.hypot(x, y)).clip(0, 1)
        saddle, slopes = _saddle(x, y, nonlinear[:, 2:], bends)
        basis = _light_basis(x / radii[:, None], y / radii[:, None], saddle)
        if step == 0:
            light = _least_squares(basis, levels, weights, 0.0)
        contrast = np.einsum("npk,nk->np", basis[..., :3], light[:, 3:])
        jacobian = np.concatenate([slopes * contrast[..., None], basis], axis=-1)
        residuals = levels - np.einsum("npk,nk->np", basis, light)
        change = _least_squares(jacobian, residuals, weights, _DAMPING if step < _DAMPED_STEPS else 0.0)
        nonlinear += change[:, :5].clip(-_LONGEST_STEP, _LONGEST_STEP)
        nonlinear[:, 4] = nonlinear[:, 4].clip(*np.log(_BLUR_RANGE_PX))
        light += change[:, 5:]
        moved = np.abs(change[:, :2]).max(axis=1)
        if (moved < _STEP_DONE_PX).all():
            break
    settled = np.isfinite(nonlinear).all(axis=1) & (moved < 100 * _STEP_DONE_PX)
    settled &= np.abs(light[:, 3]) > _LEAST_SHARE
    return np.where(settled[:, None], centres + nonlinear[:, :2], np.nan)


def _windows(
    grey: Float[np.ndarray, "rows columns"], centres: np.ndarray, u: np.ndarray, v: np.ndarray
) -> tuple[Float[np.ndarray, "corners pixels"], np.ndarray]:
    """Grey levels about each corner, and which of them lie on the photograph."""
    at_u, at_v = centres[:, :1] + u, centres[:, 1:] + v
    rows, columns = grey.shape
    inside = (at_u >= 0) & (at_v >= 0) & (at_u < columns) & (at_v < rows)
    return grey[at_v.clip(0, rows - 1), at_u.clip(0, columns - 1)].astype(np.float64), inside


def _saddle(
    x: np.ndarray, y: np.ndarray, shape: Float[np.ndarray, "corners 3"], bends: tuple[Scalars, Scalars]
) -> tuple[Float[np.ndarray, "corners pixels"], Float[np.ndarray, "corners pixels 5"]]:
    """tanh(d₁ / s) tanh(d₂ / s), and its derivatives by the corner's u, v, the two angles and log s."""
    blur = np.exp(shape[:, 2:])
    edges = []
    for angle, bend in ((shape[:, :1], bends[0]), (shape[:, 1:2], bends[1])):
        cos, sin = np.cos(angle), np.sin(angle)
        along, across = cos * x + sin * y, cos * y - sin * x
        d = across - bend[:, None] / 2 * along**2
        # The bend is small: its share in the derivatives is left to the next step.
        edges.append((np.tanh(d / blur), d, along, cos, sin))
    (e1, d1, along1, cos1, sin1), (e2, d2, along2, cos2, sin2) = edges
    g1, g2 = (1 - e1**2) * e2 / blur, (1 - e2**2) * e1 / blur
    slopes = [g1 * sin1 + g2 * sin2, -(g1 * cos1 + g2 * cos2), -g1 * along1, -g2 * along2, -(g1 * d1 + g2 * d2)]
    return e1 * e2, np.stack(slopes, axis=-1)


def _light_basis(x: np.ndarray, y: np.ndarray, saddle: np.ndarray) -> Float[np.ndarray, "corners pixels 6"]:
    """What α, α', β, β' multiply; the first three are also what the contrast is made of."""
    one = np.ones_like(x)
    return np.stack([one, x, y, saddle, x * saddle, y * saddle], axis=-1)


def _least_squares(
    jacobian: Float[np.ndarray, "corners pixels parameters"],
    residuals: Float[np.ndarray, "corners pixels"],
    weights: Float[np.ndarray, "corners pixels"],
    damping: float,
) -> Float[np.ndarray, "corners parameters"]:
    weighted = (jacobian * weights[..., None]).transpose(0, 2, 1)
    normal = weighted @ jacobian
    scale = np.einsum("nii->ni", normal)
    # A flat window has no saddle: a little on the diagonal keeps its equations solvable, and it does not settle.
    extra = damping * scale + _TINY * (1 + scale.max(axis=1, keepdims=True))
    normal = normal + extra[:, :, None] * np.eye(normal.shape[-1])
    return np.linalg.solve(normal, weighted @ residuals[..., None])[..., 0]
