"""From observations, photograph by photograph, to padded arrays of one shape: what the solve compiles for."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxscan.calibration.observations import Observations, StageSequence, View
from jaxscan.calibration.residuals import Blocks

# So many boards are solved in milliseconds and compiled for in seconds.
_LEAST = 12


def bucket(count: int) -> int:
    """The next size of a coarse series: a few more views or stripe points do not compile anew. Wastes at most 1/4.

    Few are solved for as many as a usual session has, none as none.
    """
    if count <= _LEAST:
        return _LEAST if count else 0
    unit = 1 << (count.bit_length() - 3)
    return -(-count // unit) * unit


def view_blocks(observations: Observations) -> Blocks:
    """The views, one block each."""
    boards = [([view], np.zeros(1), None) for view in observations.views]
    return _pack(observations, boards, bucket(len(boards)), 1)


def stage_blocks(observations: Observations) -> Blocks:
    """The sequences on stage and turntable, one block each, with step counts relative to each one's reference."""
    boards = [
        (
            stage.views,
            stage.steps - reference_step(stage),
            None if stage.turns is None else stage.turns - reference_turn(stage),
        )
        for stage in observations.stages
    ]
    return _pack(observations, boards, len(boards), bucket(max((len(views) for views, _, _ in boards), default=0)))


def reference_step(stage: StageSequence) -> float:
    """The step count about which a sequence is fitted: its mean, where t₀ and per_step are least entangled.

    The board of a turned one is placed at the stage's step 0, in the frame of the turntable's axis.
    """
    return float(np.mean(stage.steps)) if stage.turns is None else 0.0


def reference_turn(stage: StageSequence) -> float:
    """The turntable's step count about which a sequence is fitted: the mean; 0 on the stage."""
    return 0.0 if stage.turns is None else float(np.mean(stage.turns))


_Counts = Float[np.ndarray, "_"]


def _pack(
    observations: Observations,
    boards: Sequence[tuple[Sequence[View], _Counts, _Counts | None]],
    n_blocks: int,
    images: int,
) -> Blocks:
    """Blocks for so many boards, each for so many photographs of it.

    With each board go the step counts of the stage and, if it was turned, of the turntable.
    """
    points = observations.board.points()
    each = len(points)
    extent = np.ptp(points[:, :2], axis=0)
    relative = (points[:, :2] - points[:, :2].min(axis=0)) / np.where(extent > 0, extent, 1.0)
    n_corners = each * images
    stripes = [[s for view in views for s in view.stripes] for views, _, _ in boards]
    n_stripe = bucket(max((sum(len(s.pixels) for s in seen) for seen in stripes), default=0))

    corners = np.full((n_blocks, n_corners, 2), np.nan)
    weights = np.zeros((n_blocks, n_corners))
    steps = np.zeros((n_blocks, n_corners))
    turns = np.zeros((n_blocks, n_corners)) if any(turned is not None for _, _, turned in boards) else None
    stripe = np.full((n_blocks, n_stripe, 2), np.nan)
    columns = np.ones((n_blocks, n_stripe), bool)
    laser = np.zeros((n_blocks, n_stripe), np.int32)
    for b, (views, counts, turned) in enumerate(boards):
        for i, (view, count) in enumerate(zip(views, counts, strict=True)):
            here = slice(i * each, (i + 1) * each)
            corners[b, here] = view.corners
            weights[b, here] = view.used() if view.weights is None else np.where(view.used(), view.weights, 0.0)
            steps[b, here] = count
        if turns is not None and turned is not None:
            turns[b, : each * len(views)] = np.repeat(turned, each)
        at = 0
        for seen in stripes[b]:
            here = slice(at, at + len(seen.pixels))
            stripe[b, here], columns[b, here], laser[b, here] = seen.pixels, seen.columns, seen.laser
            at = here.stop
    return Blocks(
        points=jnp.asarray(np.broadcast_to(np.tile(points, (images, 1)), (n_blocks, n_corners, 3))),
        relative=jnp.asarray(np.broadcast_to(np.tile(relative, (images, 1)), (n_blocks, n_corners, 2))),
        corners=jnp.asarray(corners),
        weights=jnp.asarray(weights),
        corner_used=jnp.asarray(weights > 0),
        steps=jnp.asarray(steps),
        stripe=jnp.asarray(stripe),
        stripe_weights=jnp.ones(stripe.shape[:2]),
        stripe_used=jnp.asarray(np.isfinite(stripe).all(axis=-1)),
        stripe_columns=jnp.asarray(columns),
        stripe_laser=jnp.asarray(laser),
        turns=None if turns is None else jnp.asarray(turns),
        radius=jnp.full((n_blocks, n_corners), observations.radius_mm) if observations.radius_mm else None,
    )
