"""`calibrate_by_evidence`: the model that the photographs ask for, from the simplest on.

What the residuals of a solve show of a term that was not sought (a board that bends, a sheet that is curved, a lens
that is not followed, a stage that is no line) is found without another solve, and so rarely by chance alone that a
session which needs no term pays for none. A term that is found is solved for, and replaces the simpler model where
the other photographs predict each one better with it than without: −2 log of the density has to fall by more than two
of its standard errors, from photograph to photograph. Both are solved on the same observations, those that the richer
model keeps. A photograph of which it keeps too few corners for a pose is not compared.

Where the corners' start shows that they are so far off the axis that only a fisheye sees them, it begins with one:
what is solved with another lens there says nothing (docs/decisions/0047).
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.calibrate import calibrate
from jaxscan.calibration.diagnostics.ladder import climb
from jaxscan.calibration.diagnostics.missing_terms import missing_terms
from jaxscan.calibration.first_camera import beyond_the_ladder
from jaxscan.calibration.model import Choice, Model, Trial
from jaxscan.calibration.observations import InlierMask, Observations
from jaxscan.calibration.refusals import FEWEST_VIEWS, with_enough_corners
from jaxscan.calibration.result import Calibration
from jaxscan.errors import InputError, ObservabilityError, SolveError
from jaxscan.rig import BowedSheet, LightPlane
from jaxscan.rig.board_shape import rounded_mm
from jaxscan.rig.camera import camera_parameters
from jaxscan.rig.fisheye import Fisheye
from jaxscan.rig.opencv_lens import LADDER, is_off_centre
from jaxscan.rig.projection import off_axis, pixel_rays

# Limit, standard errors: a richer model must predict the photographs better by this.
_STANDARD_ERRORS = 2.0
# No session asks for more models one after the other.
_MOST = 6
# Radians from the axis beyond which a lens may be a fisheye.
_WIDE = 0.6
# What may be fixed, as `Model` has it.
PARTS: Final = ("lens", "board_shape", "lights", "motion")


def calibrate_by_evidence(
    observations: Observations,
    model: Model,
    *,
    fixed: Collection[str] = (),
    advance: Callable[[str], object] = lambda doing: None,
    **asked: Any,
) -> Calibration:
    """Calibrate with the model that the photographs support; its `choice` says which, and why.

    Args:
        observations: corners and stripes.
        model: where to start: no part of it is left out.
        fixed: parts of it, from `PARTS`, that are not changed.
        advance: called as each solve begins, with what it is, in words.
        asked: other arguments of `calibrate`, except `keep` and `plain`, with which no choice is possible.

    Raises:
        InputError: as `calibrate`.
        ObservabilityError: as `calibrate`, for the model to begin with, or for a fisheye where it begins with that.
        SolveError: likewise.
    """
    lights = model.lights or (LightPlane.kind,) * len(observations.lasers)
    kinds = {sequence.axis: sequence.kind for sequence in observations.sequences}
    motion = {axis: kind for axis, kind in model.motion.items() if kinds.get(axis) != kind}
    model = replace(model, lights=lights, motion=motion)

    def solved(each: Model, **more: Any) -> Calibration:
        return calibrate(observations, **each.asked(), advance=advance, **asked, **more)

    began = None if "lens" in fixed else _fisheye(observations, model, asked.get("hold", ()))
    trials = [] if began is None else [began]
    model = model if began is None else began.model
    found = solved(model)
    for _ in range(_MOST):
        best = None
        for proposals in _proposals(found, model, fixed):
            tried = [_tried(each, why, model, found, observations, solved) for each, why in proposals]
            best = _best(tried)
            trials += [each.trial(model, each is best) for each in tried]
            if best is not None:
                break
        if best is None or best.result is None:
            break
        model, found = best.model, best.result
    return replace(found, choice=Choice(model, tuple(trials)))


def _fisheye(observations: Observations, model: Model, hold: Collection[str]) -> Trial | None:
    """The model with a fisheye where no lens of the ladder sees all corners; None where one does, or more is asked."""
    usable, _ = with_enough_corners(observations)
    if model.lens not in LADDER or model.tilted or len(usable.views) < FEWEST_VIEWS:
        return None
    # Terms that are held are of the lens that was asked for.
    if set(hold) - set(camera_parameters(Fisheye.kind)) or (angle := beyond_the_ladder(usable)) is None:
        return None
    why = f"corners are {angle:.0f}° off the camera's axis, where only a fisheye sees them"
    wide = replace(model, lens=Fisheye.kind)
    return Trial(wide, wide.beyond(model), why, np.nan, np.nan, taken=True)


def _proposals(found: Calibration, model: Model, fixed: Collection[str]) -> Iterator[list[tuple[Model, str]]]:
    """Models that may take the place of that which was solved with, and what asks for each, the simpler ones first.

    Those that come first are held against one another: a lens that is not followed and a board that bends look alike,
    and either looks like a sheet that is curved and a stage that is no line. These come when neither is taken.
    """
    parts = {name: (part, why) for name, part, why in _parts(found, model) if name not in fixed}
    single = {name: (replace(model, **part), why) for name, (part, why) in parts.items()}
    everything = {name: value for part, _ in parts.values() for name, value in part.items()}
    together = (
        [(replace(model, **everything), " and ".join(why for _, why in parts.values()))] if len(parts) > 1 else []
    )
    lenses = [] if "lens" in fixed else list(_lenses(found, model))
    if "board_shape" in single:
        yield [*lenses, single.pop("board_shape"), *together]
    elif lenses:
        yield lenses
    yield [*single.values(), *together]


def _parts(found: Calibration, model: Model) -> Iterator[tuple[str, dict[str, Any], str]]:
    """What residuals ask of board, sheets and axes: which part of the model, what it would be, and why."""
    flatness = found.flatness
    if flatness is not None and flatness.bent and not flatness.session:
        why = f"the board is bent by {rounded_mm(flatness.bent_mm)}"
        yield "board_shape", {"board_shape": flatness.asks}, why
    if found.sheet_curves:
        curved = {curve.laser: curve for curve in found.sheet_curves}
        names = [light.name for light in found.rig.lights]
        kinds = [BowedSheet.kind if n in curved else kind for n, kind in zip(names, model.lights, strict=True)]
        most = max(curved.values(), key=lambda curve: abs(curve.curve_mm))
        why = f"the sheet is curved by {rounded_mm(abs(most.curve_mm))} over {most.width_mm:g} mm"
        yield "lights", {"lights": tuple(kinds)}, why
    if found.stage_shapes:
        motion = {**model.motion, **{shape.axis: shape.kind for shape in found.stage_shapes}}
        yield "motion", {"motion": motion}, _of_stages(found)


def _of_stages(found: Calibration) -> str:
    return " and ".join(what[0].lower() + what[1:] for shape in found.stage_shapes for what, _ in shape.statements)


def _lenses(found: Calibration, model: Model) -> Iterator[tuple[Model, str]]:
    """The lens of the ladder that views not seen support, and others that may do as well or better."""
    missing = missing_terms(found)
    if missing is None or not missing.clear or missing.freed:
        return
    ladder = climb(found)
    order = list(LADDER)
    if ladder is None or order.index(ladder.supported) <= order.index(model.lens):
        return
    why = f"a richer lens would explain {100 * missing.gain:.0f} % of the corners' squared errors"
    yield replace(model, lens=ladder.supported), why
    # What is off centre may be a lens that is, or a sensor.
    if is_off_centre(ladder.supported) and not model.tilted and model.lens != "none":
        yield replace(model, tilted=True), why
    if _half_field(found) > _WIDE:
        yield replace(model, lens=Fisheye.kind, tilted=False), why


def _half_field(found: Calibration) -> float:
    """The angle between the axis and the ray of the farthest corner that was seen, radians."""
    camera = found.rig.camera
    seen = np.concatenate([view.corners[view.used()] for view in found.observations.photographs()])
    return float(np.nanmax(off_axis(pixel_rays(camera, seen))))


@dataclass(frozen=True)
class _Tried:
    """A model beside a simpler one.

    Attributes:
        model: it.
        why: what asked for it.
        falls: by how much −2 log of the density falls with it, for each of `Observations.photographs`; NaN where one of
            both models does without the photograph, or where it has no result.
        result: its calibration, where there is one.
        refused: why there is none, in words.
    """

    model: Model
    why: str
    falls: Float[np.ndarray, "photographs"]
    result: Calibration | None
    refused: str = ""

    @property
    def clear(self) -> bool:
        """Whether photographs that were left out are predicted better."""
        return _falls(self.falls)

    def trial(self, simpler: Model, taken: bool) -> Trial:
        """The model with the reason for it, and how much better it predicts."""
        known = self.falls[np.isfinite(self.falls)]
        count = len(known)
        gain = float(known.mean()) if count else np.nan
        error = float(known.std(ddof=1)) / count**0.5 if count else np.nan
        return Trial(self.model, self.model.beyond(simpler), self.why, gain, error, taken, self.refused)


def _tried(
    model: Model,
    why: str,
    simpler: Model,
    found: Calibration,
    observations: Observations,
    solved: Callable[..., Calibration],
) -> _Tried:
    """A model, held against a simpler one, with which was found what is found, on what it keeps itself."""
    try:
        rich = solved(model)
        same = _same(rich.kept, found.kept)
        poor = found if same else solved(simpler, keep=rich.kept)
    except (InputError, ObservabilityError, SolveError) as error:
        return _Tried(model, why, np.full(len(observations.photographs()), np.nan), None, str(error))
    compared = observations if same else observations.only(rich.kept)
    return _Tried(model, why, _held_out(poor, compared) - _held_out(rich, observations), rich)


def _held_out(found: Calibration, given: Observations) -> Float[np.ndarray, "photographs"]:
    """What the others predict of each photograph that was given; NaN where a solve does without it."""
    _, enough = with_enough_corners(given)
    held_out = np.full(len(enough), np.nan)
    held_out[np.flatnonzero(enough)[found.observations.in_order()]] = found.held_out
    return held_out


def _same(a: Sequence[InlierMask], b: Sequence[InlierMask]) -> bool:
    return all(
        np.array_equal(one.corners, other.corners)
        and all(np.array_equal(x, y) for x, y in zip(one.stripes, other.stripes, strict=True))
        for one, other in zip(a, b, strict=True)
    )


def _best(tried: Sequence[_Tried]) -> _Tried | None:
    """The first that is clear, or one that is clearly better still; None where none is."""
    best = None
    for each in tried:
        if each.clear and (best is None or _falls(each.falls - best.falls)):
            best = each
    return best


def _falls(by: Float[np.ndarray, "photographs"]) -> bool:
    """Whether something falls by more than chance from photograph to photograph explains."""
    by = by[np.isfinite(by)]
    return len(by) > 1 and float(by.mean()) > _STANDARD_ERRORS * float(by.std(ddof=1)) / len(by) ** 0.5
