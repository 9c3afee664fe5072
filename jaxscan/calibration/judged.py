"""A solve that ended, as a calibration that knows what it does not follow: shapes, changes, drifts, and wider σ."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Array, Bool

from jaxscan.calibration.assemble import assemble
from jaxscan.calibration.bundle import Factor
from jaxscan.calibration.by_photograph import ByPhotograph
from jaxscan.calibration.diagnostics.board_flatness import board_flatness
from jaxscan.calibration.diagnostics.changes import find_change
from jaxscan.calibration.diagnostics.light_planes import light_plane_doubts
from jaxscan.calibration.diagnostics.sheet_curves import sheet_curves
from jaxscan.calibration.diagnostics.stage_shapes import rows_of_shapes, stage_shapes
from jaxscan.calibration.diagnostics.stripe_shapes import stripe_shapes
from jaxscan.calibration.leave_one_out import leave_one_out
from jaxscan.calibration.observations import Observations, Unused
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined
from jaxscan.calibration.stage_paths import courses
from jaxscan.calibration.widening import widened
from jaxscan.calibration.with_hand import with_hand


def judged(
    refined: Refined,
    free: Bool[Array, "shared"],
    observations: Observations,
    held: set[str],
    unused: Unused,
    factors: tuple[Factor, ...],
    aliases: Sequence[str] = (),
    *,
    plain: bool,
) -> Calibration:
    """The calibration, with what its residuals show beyond noise, and its given poses; inside a `float64` block.

    Args:
        refined: where the rounds ended.
        free: which shared parameters were refined.
        observations: those that took part.
        held: names of the rig's parameters that were held.
        unused: what did not take part, in words.
        factors: what else was known.
        aliases: of screws whose period the photographs do not determine, sentences without their full stops.
        plain: whether every observation took part with the same weight; then σ are not widened.
    """
    result = assemble(refined, free, observations, held, unused, factors)
    by_axis = courses(result)
    stages = stage_shapes(refined, result, by_axis)
    paths = rows_of_shapes(refined, result, by_axis, stages) if stages else None
    curves = sheet_curves(refined, paths)
    flatness = board_flatness(refined, result, curves, paths)
    each = ByPhotograph.create(refined, observations, np.ones(2))
    change = find_change(refined, result, each, [stage.axis for stage in stages])
    formal = result.covariance
    named = bool(stages or curves or flatness.statements)
    off_grid = drift = None
    if not plain:
        wider, off_grid, drift = widened(refined, result, each, drifts=change is None and not named)
        result = result if wider is refined else assemble(wider, free, observations, held, unused, factors)
    # What a term is named for is said once.
    off_grid = None if off_grid is None else replace(off_grid, said=named)
    left = () if off_grid is None else off_grid.statements
    result = replace(
        result,
        plain=plain,
        warnings=(
            *aliases,
            *_sentences((*(each for found in (*stages, flatness) for each in found.statements), *left)),
            *light_plane_doubts(stripe_shapes(result), curves),
            *_sentences(each.statement for each in (change, drift) if each is not None),
        ),
        flatness=flatness,
        sheet_curves=curves,
        change=change,
        undetermined_periods=tuple(aliases),
        stage_shapes=stages,
        off_grid=off_grid,
        drift=drift,
        formal_covariance=formal,
        held_out=leave_one_out(refined, each),
    )
    return with_hand(result)


def _sentences(statements: Iterable[tuple[str, str]]) -> Iterator[str]:
    """What is the case and what to do, without the last full stop, as warnings are."""
    return (f"{what}. {fix}".removesuffix(".") for what, fix in statements)
