"""The map of a board into one photograph, from its corners alone, and how it bends the board's lines.

A board point s is seen at

    u = R (c + w g(|w|²)) + P(s),    g(ρ) = (1 + k₁ ρ + k₂ ρ²) / (1 + k₃ ρ + k₄ ρ²),    w = (h₁ · s, h₂ · s) / (h₃ · s)

counted from the image's middle: a homography, a radial lens about a centre c near the middle, in units of half the
image's diagonal R, and a polynomial P over the board for what these leave (a board that is not flat, a lens that is not
centred). A polynomial alone follows a wide-angle lens badly, and worst at the outermost corners, where a line's bend is
to be known as well as anywhere. A quotient serves lenses whose own polynomial is of the rays or of the pixels.

c and k are held near 0 by as much as is known of lenses: a small board does not determine them, and does not need them.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.robust import NORMAL_MAD

Grid = Float[np.ndarray, "grid_rows grid_columns 2"]
Points = Float[np.ndarray, "points 2"]
Scalars = Float[np.ndarray, "points"]
# Of the homography eight, c and k.
_Parameters = Float[np.ndarray, "14"]

# Lenses to start from: none, and barrels. The homography that fits best decides which one.
_STARTS = ((0.0, 0.0), (-0.25, 0.06), (-0.5, 0.25))
# Standard deviations of c and k among cameras, and of a corner at least (px).
_USUAL = np.array([0.05, 0.05, 0.5, 0.5, 0.5, 0.5])
_LEAST_SIGMA_PX = 0.05
_MOST_STEPS = 12
# Done when no corner is moved further, in its σ.
_STEP_DONE = 0.2
_FIRST_DAMPING, _MOST_DAMPING = 1e-4, 1e4
_POLYNOMIAL_DEGREE = 4
# Corners are ignored if their error exceeds this multiple of the usual error, and this (px).
_LIMIT = 4.0
_LEAST_LIMIT_PX = 0.2
_ROUNDS = 8
# The last round explains hardly more than the one before: this part of it is left.
_SETTLED = 0.9
# Fewer corners say nothing of the map; fewer than the second number nothing of bends, which are then 0.
FEWEST = 6
_FEWEST_FOR_BENDS = 12
# Of the step for differences, in halves of the board.
_STEP = 1e-3


class BoardMap(NamedTuple):
    """What the corners of one photograph say of it.

    Attributes:
        parameters: homography and lens, to start the next fit from.
        pixels: where homography and lens put every corner, seen or not.
        bends: κ of the board's lines along x and y at every corner, 1/px, positive towards the clockwise normal.
    """

    parameters: _Parameters
    pixels: Grid
    bends: Grid


def map_board(grid: Grid, image_size: tuple[int, int], start: _Parameters | None = None) -> BoardMap | None:
    """Fit the map to the corners that are seen; None where they are too few.

    Args:
        grid: corners, px; NaN where one is not seen.
        image_size: columns and rows, px.
        start: of an earlier fit to nearly the same corners.
    """
    rows, columns = grid.shape[:2]
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    at = np.stack([x.ravel(), y.ravel()], axis=1)
    half_diagonal, middle = np.hypot(*image_size) / 2, (np.array(image_size) - 1) / 2
    seen = np.isfinite(grid[..., 0]).ravel()
    pixels = np.where(seen[:, None], grid.reshape(-1, 2) - middle, 0.0)
    if seen.sum() < FEWEST:
        return None
    parameters = _start(at[seen], pixels[seen] / half_diagonal) if start is None else start
    if parameters is None:
        return None
    kept, rest = seen, np.zeros((terms(0), 2))
    left = pixels - half_diagonal * _lens(parameters, at)[0]
    for _ in range(_ROUNDS):
        # What a lens does not explain, a bent board, must not make it a strange one: it is let go by degrees.
        sigma = max(float(np.median(np.linalg.norm(left[kept], axis=1))), _LEAST_SIGMA_PX)
        parameters = _refined(parameters, at[kept], pixels[kept], half_diagonal, sigma)
        left = pixels - half_diagonal * _lens(parameters, at)[0]
        rest = _polynomial_fit(at, left, kept)
        off = np.linalg.norm(left - _polynomial(rest, at), axis=1)
        usual = NORMAL_MAD * float(np.median(off[kept]))
        fit = seen & (off <= max(_LIMIT * usual, _LEAST_LIMIT_PX))
        explained = sigma <= _LEAST_SIGMA_PX or np.median(np.linalg.norm(left[fit], axis=1)) > _SETTLED * sigma
        if fit.sum() < FEWEST or (explained and (fit == kept).all()):
            break
        kept = fit

    bends = np.zeros(grid.shape)
    if kept.sum() >= _FEWEST_FOR_BENDS:
        about = np.concatenate([at + step for step in _STEP * np.array([[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]])])
        near = half_diagonal * _lens(parameters, about)[0] + _polynomial(rest, about)
        here, left, right, above, below = near.reshape(5, -1, 2)
        bends = np.stack([_bend(left, here, right), _bend(above, here, below)], axis=-1).reshape(grid.shape)
    predicted = half_diagonal * _lens(parameters, at)[0] + middle
    return BoardMap(parameters, predicted.reshape(grid.shape), bends)


def _bend(before: Points, here: Points, after: Points) -> Scalars:
    """The curvature of the line through three points close together, at the second."""
    along, second = (after - before) / 2, after - 2 * here + before
    return (along[:, 0] * second[:, 1] - along[:, 1] * second[:, 0]) / np.linalg.norm(along, axis=1) ** 3


def _start(at: Points, seen: Points) -> _Parameters | None:
    """The homography behind the lens that brings it nearest to the corners."""
    radius, best, nearest = np.linalg.norm(seen, axis=1, keepdims=True), None, np.inf
    table = np.linspace(0, 2, 513)
    for k1, k2 in _STARTS:
        straight = np.interp(radius, table * (1 + k1 * table**2 + k2 * table**4), table)
        H = cv2.findHomography(at, seen * straight / np.maximum(radius, 1e-9), 0)[0]
        if H is None or abs(H[2, 2]) < 1e-9:
            continue
        parameters = np.array([*(H / H[2, 2]).ravel()[:8], 0.0, 0.0, k1, k2, 0.0, 0.0])
        distance = float(np.median(np.linalg.norm(_lens(parameters, at)[0] - seen, axis=1)))
        if distance < nearest:
            best, nearest = parameters, distance
    return best


def _refined(parameters: _Parameters, at: Points, pixels: Points, half_diagonal: float, sigma: float) -> _Parameters:
    """Levenberg and Marquardt's minimum of the corners' distances and of c and k in units of what is usual."""
    scale = half_diagonal / sigma
    prior = np.concatenate([np.zeros(8), 1 / _USUAL**2])
    damping = _FIRST_DAMPING

    def residuals(parameters: _Parameters) -> tuple[np.ndarray, np.ndarray, float]:
        seen, w = _lens(parameters, at)
        left = (pixels / sigma - scale * seen).ravel()
        return left, w, float(left @ left + prior @ parameters**2)

    left, w, cost = residuals(parameters)
    for _ in range(_MOST_STEPS):
        J = scale * _derivatives(parameters, at, w).reshape(-1, 14)
        normal, gradient = J.T @ J + np.diag(prior), J.T @ left - prior * parameters
        while damping < _MOST_DAMPING:
            step = np.linalg.solve(normal + np.diag(damping * normal.diagonal() + 1e-9), gradient)
            new_left, new_w, new_cost = residuals(parameters + step)
            if new_cost <= cost:
                break
            damping *= 10
        else:
            break
        parameters, left, w, cost, damping = parameters + step, new_left, new_w, new_cost, damping / 10
        if np.abs(J @ step).max() < _STEP_DONE:
            break
    return parameters


def _lens(parameters: _Parameters, at: Points) -> tuple[Points, np.ndarray]:
    """Where board points are seen, in units of R, and what the derivatives take up: h · s for each point."""
    H = np.append(parameters[:8], 1.0).reshape(3, 3)
    ray = at @ H[:, :2].T + H[:, 2]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        w = ray[:, :2] / ray[:, 2:]
        return parameters[8:10] + w * _scale(parameters, (w**2).sum(axis=1, keepdims=True))[0], ray


def _scale(parameters: _Parameters, square: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The scale g at |w|², its derivative, and its denominator."""
    k1, k2, k3, k4 = parameters[10:]
    above, below = 1 + k1 * square + k2 * square**2, 1 + k3 * square + k4 * square**2
    g = above / below
    return g, (k1 + 2 * k2 * square - g * (k3 + 2 * k4 * square)) / below, below


def _derivatives(parameters: _Parameters, at: Points, ray: np.ndarray) -> Float[np.ndarray, "points 2 14"]:
    """Derivatives of `_lens` by its parameters."""
    w = ray[:, :2] / ray[:, 2:]
    square = (w**2).sum(axis=1)
    g, by_square, below = _scale(parameters, square)
    by_w = g[:, None, None] * np.eye(2) + 2 * (by_square[:, None] * w)[:, :, None] * w[:, None, :]
    along = np.column_stack([at, np.ones(len(at))]) / ray[:, 2:]
    J = np.empty((len(at), 2, 14))
    J[:, :, :3], J[:, :, 3:6] = by_w[:, :, :1] * along[:, None], by_w[:, :, 1:] * along[:, None]
    J[:, :, 6:8] = -(by_w @ w[:, :, None]) * along[:, None, :2]
    J[:, :, 8:10] = np.eye(2)
    for k, by_k in enumerate((square, square**2, -g * square, -g * square**2)):
        J[:, :, 10 + k] = w * (by_k / below)[:, None]
    return J


def _polynomial_fit(at: Points, values: Points, kept: Bool[np.ndarray, "points"]) -> Float[np.ndarray, "terms 2"]:
    degree = largest_degree(int(kept.sum()), _POLYNOMIAL_DEGREE)
    return np.linalg.lstsq(polynomials(at[kept], degree), values[kept], rcond=None)[0]


def _polynomial(coefficients: Float[np.ndarray, "terms 2"], at: Points) -> Points:
    degree = next(n for n in range(_POLYNOMIAL_DEGREE + 1) if terms(n) == len(coefficients))
    return polynomials(at, degree) @ coefficients


def largest_degree(points: int, most: int) -> int:
    """The largest degree of a polynomial over the board with two corners for each of its terms."""
    return max((n for n in range(1, most + 1) if points >= 2 * terms(n)), default=0)


def terms(degree: int) -> int:
    """How many products of powers of x and y there are up to a degree."""
    return (degree + 1) * (degree + 2) // 2


def polynomials(at: Points, degree: int) -> Float[np.ndarray, "points terms"]:
    """All products of powers of x and y up to a degree."""
    x, y = (np.vander(each, degree + 1, increasing=True) for each in at.T)
    return np.concatenate([x[:, : degree + 1 - j] * y[:, j : j + 1] for j in range(degree + 1)], axis=1)
