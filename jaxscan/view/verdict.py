"""The verdict on a calibration: one sentence, what limits it, what to photograph next, and what was found wrong.

One function makes it of whatever parts were computed: of those that take a fraction of a second after every
calibration, of all of them for the report.
"""

from dataclasses import dataclass

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.calibration.diagnostics import Diagnostics, diagnose
from jaxscan.phrases import laser_prefix
from jaxscan.reconstruction.working_volume import WorkingVolume, working_volumes
from jaxscan.view.advice import Advice, advise_unplanned, poses_limit
from jaxscan.view.findings import camera_is_held, findings, thin
from jaxscan.view.report import Box, Level

_GRAVEST = {
    "stop": "Do not use this calibration yet",
    "care": "Usable, with care",
    "good": "A good calibration",
}


@dataclass(frozen=True)
class Verdict:
    """How far a calibration can be trusted.

    Attributes:
        level: good; care, where its σ do not cover everything; stop, where it should not be used.
        statement: the verdict in a sentence or two.
        limits: what limits it.
        next: what to photograph next.
        warnings: everything that was found, the worst first, each with its level, what is the case and what to do.
        thorough: whether halves of the photographs, other lenses and the next poses were computed, as for the report.
    """

    level: Level
    statement: str
    limits: str
    next: str
    warnings: tuple[Box, ...]
    thorough: bool

    @property
    def count(self) -> str:
        """How many warnings there are, in words."""
        return _count(self.warnings)


def verdict(calibration: Calibration) -> Verdict:
    """Judge a calibration by what can be computed in a fraction of a second; the report shows more.

    Args:
        calibration: what `calibrate` returned.
    """
    volumes = working_volumes(calibration)
    advice = advise_unplanned(volumes, calibration.hand)
    return judge(calibration, diagnose(calibration, thorough=False), volumes, advice)


def judge(
    calibration: Calibration, diagnostics: Diagnostics, volumes: tuple[WorkingVolume, ...], advice: Advice
) -> Verdict:
    """The verdict by the parts that were computed.

    Args:
        calibration: what `calibrate` returned.
        diagnostics: thorough or not.
        volumes: its working volumes.
        advice: what to photograph next, where nothing else has to be corrected first.
    """
    found = findings(calibration, diagnostics, volumes)
    level: Level = found[0].level if found else "good"
    return Verdict(
        level=level,
        statement=f"{_GRAVEST[level]}. {_precision(calibration, volumes, diagnostics.sigma_factor)}"
        f"{_parted(calibration)}",
        limits=limits(calibration, diagnostics, volumes)[0],
        next=_next(calibration, found, diagnostics, advice),
        warnings=found,
        thorough=diagnostics.thorough,
    )


def _next(calibration: Calibration, found: tuple[Box, ...], diagnostics: Diagnostics, advice: Advice) -> str:
    """What is wrong comes first, then what the photographs do not cover, then what helps most."""
    if found and found[0].level == "stop":
        return f"First correct what is wrong. {found[0].advice or 'The first warning says what to do.'}"
    first = advice.words[0]
    if not (lacking := thin(calibration, diagnostics)):
        return f"{first[0].upper()}{first[1:]}."
    # Beyond the photographs no pose can be planned, for what the lens does there is not known.
    covered = f" For the part of the image where it has been, {first}." if diagnostics.thorough else ""
    return f"{lacking[0].advice}{covered}"


def _parted(calibration: Calibration) -> str:
    """What a session in two parts has found, and which part this is; nothing of a session solved whole."""
    parted = calibration.parted
    if parted is None:
        return ""
    where = f"from {parted.after} on" if parted.later else f"up to {parted.before}"
    this = f" This is the rig {where}." if parted.rig_differs else ""
    return f"{this} {parted.sentence[0].upper()}{parted.sentence[1:]}."


def _precision(calibration: Calibration, volumes: tuple[WorkingVolume, ...], factor: float) -> str:
    """How well a point, or else the camera, is known."""
    if volumes:
        worst = max(volumes, key=lambda v: v.median_mm)
        near, far = worst.depths_mm.min(), worst.depths_mm.max()
        text = (
            f"A point of the working volume, {near:.0f} to {far:.0f} mm away, is known to {_mm(worst.median_mm)} in "
            f"the median and {_mm(worst.worst_mm)} at worst (σ along its ray)"
        )
        text = f"{text}, by the two halves rather {_mm(factor * worst.median_mm)}." if factor > 1.5 else f"{text}."
        if (hand := calibration.hand) is not None:
            text += f" The given poses move every profile of a scan by {_mm(hand.profile_mm)} of its own."
        return text
    focal = float(calibration.rig.camera.focal[0])
    sigma = calibration.covariance.sigma("camera.focal.0")
    fit = f"corners fit to {calibration.corner_rms_px:.3f} px RMS"
    if not sigma:
        return f"The focal length is held at {focal:.1f} px, {fit}."
    text = f"The focal length is {focal:.1f} ± {sigma:.2g} px, {fit}"
    return f"{text}; by the two halves rather ± {factor * sigma:.2g} px." if factor > 1.5 else f"{text}."


def _count(found: tuple[Box, ...]) -> str:
    stop, care = (sum(box.level == level for box in found) for level in ("stop", "care"))
    if not found:
        return "Nothing was found that its σ do not cover."
    parts = [
        f"{n} {'reason' if n == 1 else 'reasons'} {what}" for n, what in ((stop, "against it"), (care, "for care")) if n
    ]
    return f"{' and '.join(parts)} below."


def limits(calibration: Calibration, diagnostics: Diagnostics, volumes: tuple[WorkingVolume, ...]) -> tuple[str, ...]:
    """What limits a point, or else the camera, what most of all first."""
    words = []
    hand = calibration.hand
    if hand is not None and poses_limit(volumes, hand):
        words.append(
            f"The given poses: they move every profile of a scan by {_mm(hand.profile_mm)}, more than a point is off "
            "within its profile. Let the arm stand still for each photograph, and mount camera and board firmly; "
            "beyond that, only a more exact arm helps."
        )
    for volume in volumes:
        rig = 100 * volume.rig_share
        known = volume.if_known_mm
        part, other = sorted(known, key=lambda key: known[key])
        whose = (
            f"{laser_prefix(volume.laser)}{rig:.0f} % of a point's variance is the rig's, {100 - rig:.0f} % the "
            "pixel's own."
        )
        if _mm(known[part]) == _mm(volume.median_mm):
            words.append(f"{whose} The rig does not limit it.")
        else:
            words.append(
                f"{whose} Of the rig, the {part} limits: if it were known exactly, the median σ would fall from "
                f"{_mm(volume.median_mm)} to {_mm(known[part])}"
                + (
                    ", and the camera is held."
                    if camera_is_held(calibration)
                    else f"; if the {other} were, to {_mm(known[other])}."
                )
            )
        if volume.travelled_mm is not None:
            moved = " and ".join(calibration.rig.axes())
            words.append(
                f"At the far end of the travel of the {moved} σ is {_mm(volume.travelled_mm)} in the median: this adds "
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
