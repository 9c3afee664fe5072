"""Is the path of a stage what it was taken for? Told from the own places of its photographs, without another solve.

A bow is a parabola of the steps, along the travel or across it, or a turn of the carriage in proportion to them; a
screw's wave is a sine along the travel. Each is held against the scatter of the photographs about it, by R. A. Fisher's
F, so that a stage which merely wobbles is not named; the wave as often as periods were asked. A board that is bent, or
was pushed once, looks similar: so a bow is estimated together with the terms of a board's shape, by the last step of
the solve, and none is reported where one step between two photographs explains more. Play is a shift along the
travel by the direction of approach; there must be photographs of both.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy.special import gammaincc

from jaxscan.calibration.diagnostics.board_flatness import beside_shape
from jaxscan.calibration.flatness import BY_CHANCE
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined
from jaxscan.calibration.stage_paths import Course, Fit, Periods, find_period, fitted
from jaxscan.calibration.stage_shape import StageShape
from jaxscan.rig.guide import Guide, Screw, ScrewOnGuide
from jaxscan.rig.line import Line
from jaxscan.rig.linear import Linear
from jaxscan.rig.play import kind_with_play

# What is smaller than this share of the distance, or of the scatter of the photographs, is not worth a word.
_WORTH, _OF_SCATTER = 1e-5, 0.3
# Photographs that must stand on either side of a step.
_BEFORE = 2
# Play is reported where the load moves along the travel: what goes across it by this share of that, and by more than
# chance, was pushed.
_PUSHED, _PUSHED_BY_CHANCE = 0.5, 1e-2
# One explains more than another where χ² is smaller by this.
_CLEARLY = 9.0
_NAMES = {
    (False, False): Linear.kind,
    (True, False): Guide.kind,
    (False, True): Screw.kind,
    (True, True): ScrewOnGuide.kind,
}


def stage_shapes(refined: Refined, calibration: Calibration, by_axis: Mapping[str, Course]) -> tuple[StageShape, ...]:
    """For each axis that does not move its load as was assumed, how it does.

    Args:
        refined: where the rounds ended.
        calibration: the same, assembled.
        by_axis: its `courses`.
    """
    found = []
    for axis, course in by_axis.items():
        part = calibration.rig.axis(axis)
        if isinstance(part, Line) and (shape := _shape(refined, calibration, part, course)) is not None:
            found.append(shape)
    return tuple(found)


def _shape(refined: Refined, calibration: Calibration, part: Line, course: Course) -> StageShape | None:
    bowed, waved, played = ("bow" in part.shape(), "wave" in part.shape(), "play" in part.shape())
    known = [course.line()]
    if bowed:
        known.append(course.bow())
    if isinstance(part, Screw | ScrewOnGuide):
        known.append(_known_wave(course, part))
    # Photographs of one pass show no play.
    told = [course.play()] if played or course.there_and_back else []
    beside = np.concatenate([*known, *told], axis=1)
    wave = None if waved else _wave(course, beside, bowed)
    along = beside if wave is None else np.concatenate([beside, course.wave(wave.period)], axis=1)
    bow = None if bowed else _bow(refined, calibration, course, along, None if wave is None else wave.period)
    known += [course.bow()] if not bowed else []
    known += [course.wave(wave.period)] if wave is not None else []
    play = None if played or not told else _play(course, np.concatenate(known, axis=1))
    if bow is None and wave is None and play is None:
        return None
    said = dict(bow or {})
    if wave is not None:
        said["wave_mm"], said["wave_sigma_mm"] = _length(wave.fit.values, wave.fit.covariance)
    if play is not None:
        said["play_mm"], said["play_sigma_mm"] = float(play.values[0]), float(play.covariance[0, 0] ** 0.5)
        said["play_steps"] = said["play_mm"] / course.mm_per_step
    kind = _NAMES[bowed or bow is not None, waved or wave is not None]
    return StageShape(
        axis=course.axis,
        taken=calibration.rig.axis(course.axis).kind,
        kind=kind_with_play(kind) if played or play is not None else kind,
        p=max(said.pop("p", 0.0), *(found.p for found in (wave, play) if found is not None), 0.0),
        travel_mm=2 * course.half * course.mm_per_step,
        period_steps=None if wave is None else wave.period,
        aliases=() if wave is None else wave.others,
        **said,
    )


def _known_wave(course: Course, part: Screw | ScrewOnGuide) -> Float[np.ndarray, "images 4"]:
    """What the solve had free of the wave: cosine, sine and period."""
    wave = course.wave(float(part.period[0]))
    return np.concatenate([wave, course.along[:, None] * wave], axis=1)


def _wave(course: Course, beside: Float[np.ndarray, "images others"], bowed: bool) -> Periods | None:
    """The wave along the travel, where there is one and it matters."""
    beside = beside if bowed else np.concatenate([beside, course.bow()], axis=1)
    found = find_period(course, beside)
    if found is None or found.p > BY_CHANCE:
        return None
    scatter = found.fit.scatter * float(np.sqrt((course.sigma[:, 0] ** 2).mean()))
    if np.linalg.norm(found.fit.values) < max(_WORTH * course.distance, _OF_SCATTER * scatter):
        return None
    return None if _steps_more(course, [0], beside, found.fit.fall, found.fit.scatter) else found


def _play(course: Course, beside: Float[np.ndarray, "images others"]) -> Fit | None:
    """The play, where there is any and it matters.

    Not where a drift from the first photograph to the last, or a step in time elsewhere, as of a board that was pushed,
    explains as much; nor where the board goes across the travel too, or by as much as lies between two photographs, as
    when they were counted wrong.
    """

    def of(columns: Float[np.ndarray, "images columns"]) -> Fit | None:
        return fitted(course.moved[:, 0], course.sigma[:, 0], beside, columns)

    fit = of(course.play())
    if fit is None or fit.p > BY_CHANCE:
        return None
    large, scatter = abs(float(fit.values[0])), fit.scatter * float(np.sqrt((course.sigma[:, 0] ** 2).mean()))
    apart = np.abs(np.diff(course.steps))[np.diff(course.sequence) == 0]
    most = _PUSHED * float(np.median(apart[apart > 0])) * course.mm_per_step
    if large > most or large < max(_WORTH * course.distance, _OF_SCATTER * scatter):
        return None
    for k in (1, 2):
        across = fitted(course.moved[:, k], course.sigma[:, k], course.line(), course.play())
        if across is not None and abs(float(across.values[0])) > _PUSHED * large and across.p < _PUSHED_BY_CHANCE:
            return None
    drift, margin = of(course.in_time()), _CLEARLY * fit.scatter**2
    if drift is not None and drift.left < fit.left + margin:
        return None
    for k in range(_BEFORE, len(course.steps) - _BEFORE + 1):
        step = of((np.arange(len(course.steps)) >= k).astype(float)[:, None])
        if step is not None and step.left < fit.left - margin:
            return None
    return fit


def _bow(
    refined: Refined,
    calibration: Calibration,
    course: Course,
    along: Float[np.ndarray, "images others"],
    period: float | None,
) -> dict[str, float] | None:
    """Bow and turn, by the names of `StageShape`, where there are any and they matter."""
    line, offsets = course.line(), course.line()[:, : course.sequence.max() + 1]
    tests: list[tuple[Fit | None, float]] = []
    for k in range(3):
        fit = fitted(course.moved[:, k], course.sigma[:, k], along if k == 0 else line, course.bow())
        tests.append((fit, float(np.sqrt((course.sigma[:, k] ** 2).mean()))))
    for k in range(3):
        fit = fitted(course.turned[:, k], course.turned_sigma[:, k], offsets, course.along[:, None])
        # A turn matters by what it does at the board's edge.
        tests.append((fit, course.reach * float(np.sqrt((course.turned_sigma[:, k] ** 2).mean()))))
    lengths = [1.0] * 3 + [course.reach] * 3
    p = 1.0
    for k, ((fit, sigma), length) in enumerate(zip(tests, lengths, strict=True)):
        if fit is None:
            continue
        large = length * abs(float(fit.values[0]))
        worth = large > max(_WORTH * course.distance, _OF_SCATTER * fit.scatter * sigma)
        if worth and not (k < 3 and _steps_more(course, [k], along if k == 0 else line, fit.fall, fit.scatter)):
            p = min(p, fit.p)
    p = min(1.0, 6 * p)
    if p > BY_CHANCE:
        return None
    # Beside the shape of the board, in units of the scatter of the photographs.
    rows = stage_rows(refined, calibration, [(course, period, False)])
    values, covariance = (part[..., :6] for part in beside_shape(refined, calibration, rows))
    covariance = covariance[:6]
    usual = float(np.median([max(fit.scatter, 1.0) for fit, _ in tests if fit is not None]))
    chi2 = float(values @ np.linalg.pinv(covariance, hermitian=True) @ values) / usual**2
    p = max(p, float(gammaincc(len(values) / 2, chi2 / 2)))
    if p > BY_CHANCE:
        return None
    bow, bow_sigma = _length(values[:3], covariance[:3, :3])
    turn, turn_sigma = _length(2e3 * values[3:], 4e6 * covariance[3:, 3:])
    return {
        "p": p,
        "bow_mm": bow,
        "bow_sigma_mm": usual * bow_sigma,
        "turn_mrad": turn,
        "turn_sigma_mrad": usual * turn_sigma,
    }


def _length(vector: Float[np.ndarray, "n"], covariance: Float[np.ndarray, "n n"]) -> tuple[float, float]:
    """The length of a vector, and its σ."""
    length = float(np.linalg.norm(vector))
    way = vector / length
    return length, float(np.sqrt(way @ covariance @ way))


def _steps_more(
    course: Course, ways: Sequence[int], beside: Float[np.ndarray, "images others"], fall: float, scatter: float
) -> bool:
    """Whether a step between two photographs, as of a board that was pushed, explains more than something else did.

    Args:
        course: of the axis.
        ways: directions.
        beside: what is fitted together with them.
        fall: by how much χ² fell, in units of the scatter then.
        scatter: that.
    """
    order = np.argsort(course.steps, kind="stable")
    for k in range(_BEFORE, len(order) - _BEFORE + 1):
        step = np.zeros(len(order))
        step[order[k:]] = 1.0
        for way in ways:
            fit = fitted(course.moved[:, way], course.sigma[:, way], beside, step[:, None])
            if fit is not None and fit.fall * fit.scatter**2 > fall * scatter**2:
                return True
    return False


def stage_rows(
    refined: Refined, calibration: Calibration, shapes: Sequence[tuple[Course, float | None, bool]]
) -> list[Float[np.ndarray, "blocks residuals columns"]]:
    """The derivatives of each group's residuals by the bow and turn of some axes, their waves and play.

    The board's place at its positions of reference moves all its photographs alike; so each one's rows by that, times
    what the path does there, are those by the path.

    Args:
        refined: where the rounds ended.
        calibration: the same, assembled.
        shapes: of each axis its course, the period of its wave where it has one, and whether it has play.
    """
    shared = refined.last[1].shared.shape[1]
    widths = [6 + 2 * (period is not None) + played for _, period, played in shapes]
    found = []
    for i, (group, J) in enumerate(zip(refined.groups, refined.last[1].blocks, strict=False)):
        # Behind corners and stripe stands what is known of the boards' bends.
        J = np.asarray(J)[:, : group.corners[0].size + group.stripe_used[0].size, shared : shared + 6]
        columns = [np.zeros((*J.shape[:2], 0))]
        corners, stripes = 2 * group.corners.shape[2], group.stripe_used.shape[2]
        for (course, period, played), width in zip(shapes, widths, strict=True) if i else ():
            path = np.zeros((*J.shape[:2], width))
            for b, sequence in enumerate(calibration.observations.sequences):
                if sequence.axis != course.axis:
                    continue
                n = np.asarray(group.q[course.axis])[b]
                of_row = np.concatenate([np.repeat(n, corners), np.repeat(n, stripes)])
                s, rows = (of_row - course.middle) / course.half, J[b, : len(of_row)]
                path[b, : len(of_row), :3] = rows[:, 3:] * (s**2)[:, None]
                path[b, : len(of_row), 3:6] = rows[:, :3] * s[:, None]
                ahead = rows[:, 3:] @ course.direction
                if period is not None:
                    w = 2 * np.pi * of_row / period
                    path[b, : len(of_row), 6:8] = ahead[:, None] * np.stack([np.cos(w), np.sin(w)], axis=1)
                if played:
                    way = np.pad(np.sign(sequence.runs), (0, len(n) - len(sequence.views)))
                    each = np.concatenate([np.repeat(way, corners), np.repeat(way, stripes)])
                    path[b, : len(of_row), -1] = -ahead * each / 2
            columns.append(path)
        if not i:
            columns += [np.zeros((*J.shape[:2], width)) for width in widths]
        found.append(np.concatenate(columns, axis=2))
    return found


def rows_of_shapes(
    refined: Refined, calibration: Calibration, by_axis: Mapping[str, Course], shapes: Sequence[StageShape]
) -> list[Float[np.ndarray, "blocks residuals columns"]]:
    """`stage_rows` of those that were named."""
    found = [(by_axis[shape.axis], shape.period_steps, bool(shape.play_mm)) for shape in shapes]
    return stage_rows(refined, calibration, found)
