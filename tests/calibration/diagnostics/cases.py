"""Sessions in which something is wrong, made from the synthetic rig of 2003 by changing what was seen."""

from dataclasses import replace

import numpy as np

from jaxscan.calibration import Observations, View
from tests.calibration import synthetic


def of_another_camera(session: Observations, index: int, monkeypatch, focal: float = 1.3) -> Observations:
    """One view taken with another focal length."""
    with monkeypatch.context() as patch:
        patch.setattr(synthetic, "FOCAL", tuple(focal * f for f in synthetic.FOCAL))
        other = synthetic.observations(seed=0, n_stage=5)
    return with_view(session, index, other.views[index])


def mirrored(session: Observations, index: int, left_to_right: bool) -> Observations:
    """One photograph mirrored; its corners then read in the order that the finder would give them."""
    view = session.views[index]
    columns, rows = session.board.counts
    corners = flipped(view.corners, left_to_right).reshape(rows, columns, 2)[::-1].reshape(-1, 2)
    stripe = view.stripes[0]
    pixels = flipped(stripe.pixels, left_to_right)
    return with_view(session, index, replace(view, corners=corners, stripes=(replace(stripe, pixels=pixels),)))


def flipped(pixels: np.ndarray, left_to_right: bool) -> np.ndarray:
    columns, rows = synthetic.IMAGE_SIZE
    return pixels * [-1, 1] + [columns - 1, 0] if left_to_right else pixels * [1, -1] + [0, rows - 1]


def with_view(session: Observations, index: int, view: View) -> Observations:
    views = list(session.views)
    views[index] = view
    return replace(session, views=tuple(views))


def bent_stripe(session: Observations, index: int, height_px: float) -> Observations:
    """One stripe bowed by `height_px` pixels in its middle."""
    view = session.views[index]
    stripe = view.stripes[0]
    seen = np.isfinite(stripe.pixels).all(axis=1)
    t = np.linspace(-1, 1, int(seen.sum()))
    pixels = stripe.pixels.copy()
    pixels[seen, 1] += height_px * (1 / 3 - t**2)
    return with_view(session, index, replace(view, stripes=(replace(stripe, pixels=pixels),)))
