"""How far a calibration can be trusted, as numbers: nothing here is in words or drawn, that is `jaxscan.view`'s."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxscan.calibration.coverage import Coverage, measure_coverage
from jaxscan.calibration.diagnostics.halves import Agreement, halves, sessions, solve_apart
from jaxscan.calibration.diagnostics.ladder import Ladder, climb
from jaxscan.calibration.diagnostics.missing_terms import MissingTerms, missing_terms
from jaxscan.calibration.diagnostics.residual_statistics import (
    ByRadius,
    CornerResiduals,
    Normality,
    OverImage,
    PhotographStatistics,
    by_radius,
    corner_normality,
    corner_residuals,
    over_image,
    photographs,
    stripe_normality,
)
from jaxscan.calibration.diagnostics.stage_errors import (
    StageErrors,
    TurntableErrors,
    stage_errors,
    turntable_errors,
)
from jaxscan.calibration.diagnostics.stripe_shapes import StripeShape, stripe_shapes
from jaxscan.calibration.diagnostics.suspects import Suspect, suspects
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.stage_order import StageOrder, stage_orders

# The calls of `advance` that `diagnose` makes.
PARTS = 4


@dataclass(frozen=True)
class Diagnostics:
    """All of it.

    Attributes:
        photographs: each photograph, the worst first.
        suspects: those that do not fit the others.
        corners: every corner's residual.
        corner_normality: of these.
        stripe_normality: of the stripe points; None without a laser.
        by_radius: corner residuals by distance from the principal point.
        over_image: mean corner residuals over the image.
        stripes: each stripe's distance from the light plane.
        stages: errors of the stage, sequence by sequence.
        turntables: errors of the turntable, sequence by sequence.
        stage_orders: sequences on the stage whose photographs were mixed up.
        missing_terms: what a richer lens would change, to first order; None where there is none or the camera was held.
        coverage: what the photographs cover.
        thorough: whether parts of the photographs and other lenses were solved too; otherwise what follows is empty.
        too_few_for_halves: whether there are too few photographs for two rigs.
        halves: two halves of the photographs solved apart; None where there are too few.
        sessions: each further session against the first; empty for a single one.
        ladder: the lenses tried; None where the camera was held, or its lens is none of the ladder.
    """

    photographs: tuple[PhotographStatistics, ...]
    suspects: tuple[Suspect, ...]
    corners: CornerResiduals
    corner_normality: Normality
    stripe_normality: Normality | None
    by_radius: ByRadius
    over_image: OverImage
    stripes: tuple[StripeShape, ...]
    stages: tuple[StageErrors, ...]
    turntables: tuple[TurntableErrors, ...]
    stage_orders: tuple[StageOrder, ...]
    missing_terms: MissingTerms | None
    coverage: Coverage
    thorough: bool
    too_few_for_halves: bool
    halves: Agreement | None
    sessions: tuple[Agreement, ...]
    ladder: Ladder | None

    @property
    def sigma_factor(self) -> float:
        """The factor by which predicted σ should be multiplied, from the two halves; 1 where they agree."""
        return self.halves.sigma_factor if self.halves is not None and self.halves.disagree else 1.0


def diagnose(
    calibration: Calibration, advance: Callable[[int], object] = lambda by: None, *, thorough: bool = True
) -> Diagnostics:
    """Look for whatever a small RMS hides.

    Args:
        calibration: what `calibrate` returned.
        advance: called with 1 after each of `PARTS` parts of the work.
        thorough: whether parts of the problem are solved again, some dozens of times: photographs that do not fit
            mirrored and turned, halves and sessions apart, other lenses. The rest takes a fraction of a second.
    """
    residuals = corner_residuals(calibration)
    principal = np.stack(calibration.rig.camera.principal).astype(np.float64)
    coverage = measure_coverage(calibration.observations, calibration.rig, calibration.photograph_poses())
    suspected = suspects(calibration, explain=thorough)
    advance(1)
    parts = halves(calibration.observations)
    agreement = solve_apart(calibration, *parts) if parts and thorough else None
    advance(1)
    each = sessions(calibration.observations)
    apart = [solve_apart(calibration, each[0], other) for other in each[1:]] if thorough else []
    advance(1)
    # A part of a session may have no views, and says nothing of the camera then.
    viewed = bool(calibration.observations.views)
    found = viewed and any(name.startswith("camera") for name in calibration.covariance.names)
    ladder = climb(calibration) if found and thorough else None
    advance(1)
    return Diagnostics(
        photographs=photographs(calibration),
        suspects=suspected,
        corners=residuals,
        corner_normality=corner_normality(residuals),
        stripe_normality=stripe_normality((*calibration.fits, *calibration.moved_fits)),
        by_radius=by_radius(residuals, principal),
        over_image=over_image(residuals, calibration.observations.image_size),
        stripes=stripe_shapes(calibration),
        stages=stage_errors(calibration),
        turntables=turntable_errors(calibration),
        stage_orders=stage_orders(calibration.observations, calibration.rig),
        missing_terms=missing_terms(calibration) if viewed else None,
        coverage=coverage,
        thorough=thorough,
        too_few_for_halves=parts is None,
        halves=agreement,
        sessions=tuple(a for a in apart if a is not None),
        ladder=ladder,
    )
