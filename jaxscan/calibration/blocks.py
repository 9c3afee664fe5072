"""From observations, photograph by photograph, to padded arrays of one shape: what the solve compiles for."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from jaxscan.axis_details import is_detail
from jaxscan.buckets import bucket
from jaxscan.calibration.observations import BoardSequence, Observations, View
from jaxscan.calibration.residuals import Blocks
from jaxscan.precision import as_jax


def view_blocks(observations: Observations) -> Blocks:
    """The views, one block each, of one photograph that no axis moves."""
    views = [[view] for view in observations.views]
    return _pack(observations, views, {}, bucket(len(views)), 1)


def sequence_blocks(observations: Observations) -> Blocks:
    """The sequences along the axes, one block each."""
    sequences = observations.sequences
    photographs = bucket(max((len(sequence.views) for sequence in sequences), default=0))
    axes = {axis for sequence in sequences for axis in sequence.positions}
    q = {axis: np.zeros((len(sequences), photographs)) for axis in sorted(axes)}
    for b, sequence in enumerate(sequences):
        for axis, steps in sequence.positions.items():
            # Padding stands with the last, where the motion is as good as there.
            q[axis][b] = np.pad(steps, (0, photographs - len(steps)), mode="edge")
    return _pack(observations, [sequence.views for sequence in sequences], q, len(sequences), photographs)


def reference_positions(sequence: BoardSequence) -> dict[str, float]:
    """About which positions a sequence is fitted: their means, where its pose and the motion are least entangled.

    An axis with play stands there as if it had none.
    """
    return {axis: 0.0 if is_detail(axis) else float(np.mean(steps)) for axis, steps in sequence.positions.items()}


def _pack(
    observations: Observations,
    boards: Sequence[Sequence[View]],
    q: dict[str, Float[np.ndarray, "blocks photographs"]],
    n_blocks: int,
    photographs: int,
) -> Blocks:
    """Blocks for `boards` boards, each with `photographs` photographs of it."""
    points = observations.board.points()
    stripes = [
        [np.concatenate([s.pixels for s in view.stripes] or [np.zeros((0, 2))]) for view in views] for views in boards
    ]
    n_stripe = bucket(max((len(pixels) for each in stripes for pixels in each), default=0))
    shape, striped = (n_blocks, photographs, len(points)), (n_blocks, photographs, n_stripe)

    corners = np.full((*shape, 2), np.nan)
    weights = np.zeros(shape)
    stripe = np.full((*striped, 2), np.nan)
    columns = np.ones(striped, bool)
    light, at = np.zeros(striped, np.int32), np.zeros(striped)
    for b, views in enumerate(boards):
        for i, view in enumerate(views):
            corners[b, i] = view.corners
            weights[b, i] = view.used() if view.weights is None else np.where(view.used(), view.weights, 0.0)
            counts = [len(s.pixels) for s in view.stripes]
            n = sum(counts)
            stripe[b, i, :n] = stripes[b][i]
            columns[b, i, :n] = np.repeat([s.columns for s in view.stripes], counts)
            light[b, i, :n] = np.repeat([s.laser for s in view.stripes], counts)
            at[b, i, :n] = np.repeat([s.position for s in view.stripes], counts)
    reference = {axis: np.zeros(n_blocks) for axis in q}
    for b, sequence in enumerate(observations.sequences if q else ()):
        for axis, step in reference_positions(sequence).items():
            reference[axis][b] = step
    arrays = {
        "points": np.broadcast_to(points, (n_blocks, *points.shape)),
        "q": q,
        "reference": reference,
        "corners": corners,
        "weights": weights,
        "corner_used": weights > 0,
        "stripe": stripe,
        "stripe_weights": np.ones(striped),
        "stripe_used": np.isfinite(stripe).all(axis=-1),
        "stripe_columns": columns,
        "stripe_light": light,
        "stripe_at": at if observations.light_axes else None,
        "radius": np.full((n_blocks, len(points)), observations.radius_mm) if observations.radius_mm else None,
    }
    return Blocks(**as_jax(arrays))


def photographs_in_blocks(observations: Observations) -> Iterator[tuple[View, int, int, int]]:
    """Each photograph with the group, the block and the place in it where it stands."""
    for i, view in enumerate(observations.views):
        yield view, 0, i, 0
    for i, sequence in enumerate(observations.sequences):
        for k, view in enumerate(sequence.views):
            yield view, 1, i, k
