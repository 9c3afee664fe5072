"""The report of a calibration: is it good, what limits it, what photograph would help most; then the figures."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxscan.calibration import Calibration
from jaxscan.calibration.diagnostics import PARTS, Diagnostics, diagnose
from jaxscan.reconstruction.next_best_views import NextBestViews, next_best_views
from jaxscan.reconstruction.working_volume import WorkingVolume, working_volumes
from jaxscan.rig import Covariance
from jaxscan.rig.speckle_limit import Optics
from jaxscan.view import calibration_sections as sections
from jaxscan.view import motion_sections
from jaxscan.view.advice import advise
from jaxscan.view.report import Box, Report, Section
from jaxscan.view.verdict import Verdict, judge, limits

# The calls of `advance` that `calibration_report` makes.
REPORT_PARTS = PARTS + 3


def calibration_report(
    calibration: Calibration,
    advance: Callable[[int], object] = lambda by: None,
    optics: Optics | None = None,
) -> tuple[Report, Verdict]:
    """All that is known of how far a calibration can be trusted, and the verdict that it begins with.

    Args:
        calibration: what `calibrate` returned.
        advance: called with 1 after each of `REPORT_PARTS` parts of the work.
        optics: lens, laser and pixel, where the limit of speckle is wanted.
    """
    diagnostics = diagnose(calibration, advance)
    volumes = working_volumes(calibration)
    advance(1)
    planned = next_best_views(calibration, volumes)
    advance(1)
    composed = compose(calibration, diagnostics, volumes, planned, optics)
    advance(1)
    return composed


def compose(
    calibration: Calibration,
    diagnostics: Diagnostics,
    volumes: tuple[WorkingVolume, ...],
    planned: NextBestViews,
    optics: Optics | None = None,
) -> tuple[Report, Verdict]:
    """Words, tables and figures from the numbers, and the verdict."""
    advice = advise(planned, volumes, calibration.observations, calibration.hand)
    judged = judge(calibration, diagnostics, volumes, advice)
    first, correct_first = advice.words[0], (judged.next,) if judged.level == "stop" else ()
    report = Report(
        kind="calibration-report",
        title="Calibration report",
        verdict=Box(judged.level, judged.statement, judged.count),
        sections=(
            Section(
                "Is it good?", boxes=judged.warnings or (Box("good", "Nothing was found that the σ do not cover."),)
            ),
            Section("What limits it?", paragraphs=limits(calibration, diagnostics, volumes)),
            Section(
                "What photograph would help most?",
                paragraphs=(*correct_first, f"{first[0].upper()}{first[1:]}."),
                items=advice.words[1:],
                figures=advice.figures,
            ),
            sections.rig(calibration, diagnostics),
            *(sections.volume(volume) for volume in volumes),
            sections.photographs(calibration, diagnostics),
            sections.residuals(calibration, diagnostics),
            *([light] if (light := sections.light(calibration, volumes, optics)) else []),
            *([sections.stripes(diagnostics)] if diagnostics.stripes else []),
            *([motion_sections.stage(calibration, diagnostics)] if diagnostics.stages else []),
            *([motion_sections.turntable(calibration, diagnostics)] if diagnostics.turntables else []),
            *([motion_sections.hand(calibration.hand)] if calibration.hand else []),
            sections.apart(diagnostics),
            *([sections.lens(diagnostics.ladder)] if diagnostics.ladder else []),
            sections.coverage(calibration, diagnostics),
            sections.left_out(calibration),
        ),
        numbers={
            "boards": board_poses(calibration),
            "board_shape": calibration.shape_facts(),
            "board_flatness": calibration.flatness,
            "sheet_curves": calibration.sheet_curves,
            "board_points": calibration.off_grid,
            "drift": calibration.drift,
            "sigma_over_noise_alone": calibration.widened_by(),
            "model": calibration.choice.as_data() if calibration.choice is not None else None,
            "change": calibration.change,
            "parted": calibration.parted,
            "stage_shapes": calibration.stage_shapes,
            "given_poses": calibration.hand,
            "diagnostics": diagnostics,
            "working_volumes": volumes,
            "next_best_views": planned,
        },
    )
    return report, judged


@dataclass(frozen=True)
class BoardPose:
    """Where a board stood.

    Attributes:
        name: of the view's photograph, or of the first one of a sequence.
        staged: whether it stood on stage or turntable; its pose is then that at motor step 0.
        rotation: vector of T_cam_board, radians.
        translation_mm: of T_cam_board.
        bulges_mm: along columns and rows, of this board in addition to the common shape; None where it has none.
        covariance: of the rig's parameters and this pose together.
    """

    name: str
    staged: bool
    rotation: Float[np.ndarray, "3"]
    translation_mm: Float[np.ndarray, "3"]
    bulges_mm: Float[np.ndarray, "2"] | None
    covariance: Covariance


def board_poses(calibration: Calibration) -> tuple[BoardPose, ...]:
    """Every board: the views, then the sequences on stage and turntable."""
    names = [fit.name for fit in calibration.fits]
    staged = [sequence.views[0].name for sequence in calibration.observations.sequences]
    poses = []
    for on_stage, called, pose, covariances in (
        (False, names, calibration.system.boards, calibration.board_covariances),
        (True, staged, calibration.system.moved, calibration.moved_covariances),
    ):
        rotations, translations = np.asarray(pose.rotation), np.asarray(pose.translation)
        # Without photographs on an axis they form no group.
        bends = calibration.system.bends(int(on_stage)) if called else None
        own = [None] * len(called) if bends is None else np.asarray(bends)
        poses += [
            BoardPose(name, on_stage, rotations[i], translations[i], own[i], covariance)
            for i, (name, covariance) in enumerate(zip(called, covariances, strict=True))
        ]
    return tuple(poses)
