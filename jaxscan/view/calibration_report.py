"""The report of a calibration: is it good, what limits it, what photograph would help most; then the figures."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxscan.calibration import Calibration
from jaxscan.calibration.diagnostics import PARTS, Diagnostics, diagnose
from jaxscan.reconstruction.next_photographs import NextPhotographs, next_photographs
from jaxscan.reconstruction.working_volume import WorkingVolume, working_volumes
from jaxscan.rig import Covariance
from jaxscan.view import calibration_sections as sections
from jaxscan.view.advice import advise
from jaxscan.view.findings import findings
from jaxscan.view.report import Box, Report, Section

# The calls of `advance` that `calibration_report` makes.
REPORT_PARTS = PARTS + 3
_GRAVEST = {
    "stop": "Do not use this calibration yet",
    "care": "Usable, with care",
    "good": "A good calibration",
}


def calibration_report(calibration: Calibration, advance: Callable[[int], object] = lambda by: None) -> Report:
    """All that is known of how far a calibration can be trusted.

    Args:
        calibration: what `calibrate` returned.
        advance: called with 1 after each of `REPORT_PARTS` parts of the work.
    """
    diagnostics = diagnose(calibration, advance)
    volumes = working_volumes(calibration)
    advance(1)
    planned = next_photographs(calibration, volumes)
    advance(1)
    report = compose(calibration, diagnostics, volumes, planned)
    advance(1)
    return report


def compose(
    calibration: Calibration,
    diagnostics: Diagnostics,
    volumes: tuple[WorkingVolume, ...],
    planned: NextPhotographs,
) -> Report:
    """Words, tables and figures from the numbers."""
    found = findings(calibration, diagnostics, volumes)
    level = found[0].level if found else "good"
    factor = diagnostics.sigma_factor
    verdict = Box(level, f"{_GRAVEST[level]}. {_precision(calibration, volumes, factor)}", _count(found))
    advice = advise(planned, volumes, calibration.observations)
    first = advice.words[0]
    return Report(
        kind="calibration-report",
        title="Calibration report",
        verdict=verdict,
        sections=(
            Section("Is it good?", boxes=found or (Box("good", "Nothing was found that the σ do not cover."),)),
            Section("What limits it?", paragraphs=_limits(calibration, diagnostics, volumes)),
            Section(
                "What photograph would help most?",
                paragraphs=(f"{first[0].upper()}{first[1:]}.",),
                items=advice.words[1:],
                figures=advice.figures,
            ),
            sections.rig(calibration, diagnostics),
            *(sections.volume(volume) for volume in volumes),
            sections.photographs(calibration, diagnostics),
            sections.residuals(calibration, diagnostics),
            *([sections.stripes(diagnostics)] if diagnostics.stripes else []),
            *([sections.stage(calibration, diagnostics)] if diagnostics.stages else []),
            *([sections.turntable(calibration, diagnostics)] if diagnostics.turntables else []),
            sections.apart(diagnostics),
            *([sections.lens(diagnostics.ladder)] if diagnostics.ladder else []),
            sections.coverage(calibration, diagnostics),
            sections.left_out(calibration),
        ),
        numbers={
            "boards": board_poses(calibration),
            "diagnostics": diagnostics,
            "working_volumes": volumes,
            "next_photographs": planned,
        },
    )


@dataclass(frozen=True)
class BoardPose:
    """Where a board stood.

    Attributes:
        name: of the view's photograph, or of the first one of a sequence.
        staged: whether it stood on stage or turntable; its pose is then that at motor step 0.
        rotation: vector of T_cam_board, radians.
        translation_mm: of T_cam_board.
        covariance: of the rig's parameters and this pose together.
    """

    name: str
    staged: bool
    rotation: Float[np.ndarray, "3"]
    translation_mm: Float[np.ndarray, "3"]
    covariance: Covariance


def board_poses(calibration: Calibration) -> tuple[BoardPose, ...]:
    """Every board with its pose and the covariance of it: the views, then the sequences on stage and turntable."""
    names = [fit.name for fit in calibration.fits]
    staged = [stage.views[0].name for stage in calibration.observations.stages]
    poses = []
    for on_stage, called, pose, covariances in (
        (False, names, calibration.system.boards, calibration.board_covariances),
        (True, staged, calibration.system.stages, calibration.stage_covariances),
    ):
        rotations, translations = np.asarray(pose.rotation), np.asarray(pose.translation)
        poses += [
            BoardPose(name, on_stage, rotations[i], translations[i], covariance)
            for i, (name, covariance) in enumerate(zip(called, covariances, strict=True))
        ]
    return tuple(poses)


def _precision(calibration: Calibration, volumes: tuple[WorkingVolume, ...], factor: float) -> str:
    """How well a point, or else the camera, is known."""
    if volumes:
        worst = max(volumes, key=lambda v: v.median_mm)
        near, far = worst.depths_mm.min(), worst.depths_mm.max()
        text = (
            f"A point of the working volume, {near:.0f} to {far:.0f} mm away, is known to {_mm(worst.median_mm)} in "
            f"the median and {_mm(worst.worst_mm)} at worst (σ along its ray)"
        )
        return f"{text}, by the two halves rather {_mm(factor * worst.median_mm)}." if factor > 1.5 else f"{text}."
    focal = float(calibration.rig.camera.focal[0])
    sigma = calibration.covariance.sigma("camera.focal.0") or 0.0
    text = f"The focal length is {focal:.1f} ± {sigma:.2g} px, corners fit to {calibration.corner_rms_px:.3f} px RMS"
    return f"{text}; by the two halves rather ± {factor * sigma:.2g} px." if factor > 1.5 else f"{text}."


def _count(found: tuple[Box, ...]) -> str:
    stop, care = (sum(box.level == level for box in found) for level in ("stop", "care"))
    if not found:
        return "Nothing was found that its σ do not cover."
    parts = [
        f"{n} {'reason' if n == 1 else 'reasons'} {what}" for n, what in ((stop, "against it"), (care, "for care")) if n
    ]
    return f"{' and '.join(parts)} below."


def _limits(calibration: Calibration, diagnostics: Diagnostics, volumes: tuple[WorkingVolume, ...]) -> tuple[str, ...]:
    words = []
    for volume in volumes:
        name = f'laser "{volume.laser}": ' if volume.laser else ""
        rig = 100 * volume.rig_share
        known = volume.if_known_mm
        part, other = sorted(known, key=lambda key: known[key])
        words.append(
            f"{name}{rig:.0f} % of a point's variance is the rig's, {100 - rig:.0f} % the pixel's own. Of the rig, "
            f"the {part} limits: if it were known exactly, the median σ would fall from {_mm(volume.median_mm)} to "
            f"{_mm(known[part])}; if the {other} were, to {_mm(known[other])}."
        )
        if volume.travelled_mm is not None:
            words.append(
                f"At the far end of the stage's travel σ is {_mm(volume.travelled_mm)} in the median: the stage adds "
                f"{_mm(np.sqrt(max(volume.travelled_mm**2 - volume.median_mm**2, 0.0)))}."
            )
    tau = calibration.stripe_correlation
    if tau is not None and tau > 3:
        words.append(
            f"Errors along a stripe are tied to each other: {tau:.0f} neighbouring points are worth one. A bent "
            "plate, a burnt-out stripe or speckle does that."
        )
    worst = diagnostics.photographs[0]
    median = float(np.nanmedian([p.corner_rms_px for p in diagnostics.photographs]))
    words.append(
        f"Corners: {calibration.corner_rms_px:.3f} px RMS distance over all photographs; the worst is {worst.name} "
        f"with {worst.corner_rms_px:.3f} px, the median {median:.3f} px."
    )
    return tuple(words)


def _mm(value: float) -> str:
    return f"{value:.2g} mm" if value < 0.1 else f"{value:.2f} mm"
