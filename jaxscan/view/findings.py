"""What a reader of a calibration must know, in plain words, each with the threshold at which it is said.

`stop` findings are reasons not to use the rig, `care` ones say what its σ do not cover. docs/report.md lists them all.
"""

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.calibration.diagnostics import Diagnostics, Suspect
from jaxscan.calibration.diagnostics.halves import Agreement
from jaxscan.calibration.diagnostics.suspects import LEAST_PX, REJECTED
from jaxscan.calibration.hand import Hand
from jaxscan.phrases import first_few, of_laser
from jaxscan.reconstruction.working_volume import WorkingVolume
from jaxscan.view.model_findings import model_findings
from jaxscan.view.report import Box
from jaxscan.view.stage_findings import mixed_names, mixed_up, off_their_places

# A point, or a focal length, known no better than this share of itself is a reason to stop.
_RELATIVE = 0.01
# Halves, or sessions, that differ by this multiple of their σ give a remark; by the second multiple, a reason to stop.
_FACTOR, _LARGE_FACTOR = 1.5, 4.0
# A session whose millimetres are longer by this share, and by this many σ, has another pitch.
_SCALE, _SCALE_SIGMA = 0.01, 5.0
# Photographs are named as worse than the others when their RMS exceeds this multiple of the median.
_WORSE = 1.5
_TILT_SPREAD_DEG, _IMAGE_SHARE, _REACH = 30.0, 0.5, 0.6
# Notes of what was seen that say more than how the board is read.
_WRONG = "columns =", "mm_per_step ="
_GRAVE_NOTES = *_WRONG, "second board", "color =", "bell-shaped"
_STRIPE_VIEWS, _DEPTH_RATIO, _STAGE_IMAGES = 4, 1.15, 5


def findings(calibration: Calibration, diagnostics: Diagnostics, volumes: tuple[WorkingVolume, ...]) -> tuple[Box, ...]:
    """Everything that is wrong or weak, the worst first; empty where nothing is."""
    # Where two sessions have different millimetres, their photographs do not fit together for that reason alone.
    # Nor do photographs on the stage that were mixed up.
    mixed = mixed_names(diagnostics)
    suspected = [suspect for suspect in diagnostics.suspects if suspect.name not in mixed]
    # A stripe that is looked for across its way makes photographs suspect too.
    boxes = [*_notes(calibration), *_scales(diagnostics), *mixed_up(diagnostics)]
    boxes += [*map(_suspect, suspected), *_sessions(diagnostics)]
    boxes += _hand(calibration.hand) if calibration.hand else []
    boxes += [*_halves(diagnostics), *model_findings(calibration, diagnostics)]
    # What the model misses widens σ, so that is fixed first.
    boxes += [*_imprecise(calibration, diagnostics.sigma_factor, volumes), *_worse(diagnostics)]
    boxes += thin(calibration, diagnostics)
    return tuple(sorted(boxes, key=lambda box: ("stop", "care", "good").index(box.level)))


def _hand(hand: Hand) -> list[Box]:
    """What is wrong with given poses; with a wrong scale the place of the hand is wrong by more than its σ."""
    grave = hand.scale_statement if hand.wrong_scale else ()
    return [Box("stop" if (what, fix) in grave else "care", f"{what}.", fix) for what, fix in hand.statements]


def _suspect(suspect: Suspect) -> Box:
    where = "Photograph of the board on an axis," if suspect.staged else "Photograph"
    if suspect.stripe_alone:
        return Box(
            "care",
            f"{where} {suspect.name}: {100 * (suspect.stripe_rejected or 0.0):.0f} % of its stripe points were "
            "rejected. Its corners fit, and so does the rest of its stripe.",
            "A part of the stripe lies on something else than the board, on borders of squares, or is a reflection: "
            "look at it, and take it again if it is.",
        )
    if suspect.another_stripe:
        return Box(
            "stop",
            f"{where} {suspect.name}: its corners fit, and {100 * (suspect.stripe_rejected or 0.0):.0f} % of its "
            "stripe points were rejected: its stripe is not where the sheet of light meets this board.",
            "It is the stripe of another photograph (two that were exchanged are both named), or a reflection, or the "
            "laser was moved: look at it, and correct the list of photographs or leave it out.",
        )
    what = (
        f"{where} {suspect.name} does not fit the others: its corners are off by {suspect.corner_median_px:.2f} px in "
        f"the median, where {suspect.usual_corner_median_px:.2f} px is usual"
    )
    if suspect.stripe_median_px is not None:
        what += f", its stripe by {suspect.stripe_median_px:.2f} px"
    what += f"; {100 * suspect.corners_rejected:.0f} % of its corners"
    if suspect.stripe_rejected is not None:
        what += f" and {100 * suspect.stripe_rejected:.0f} % of its stripe points"
    what += " were rejected"
    if suspect.explanation:
        return Box(
            "stop",
            f"{what}. It fits when it is {suspect.explanation}.",
            f"Save {suspect.name} as the camera took it, or leave it out.",
        )
    # One that still takes part is a bad photograph; one that was rejected is perhaps none of this rig.
    rejected = max(suspect.corners_rejected, suspect.stripe_rejected or 0.0) > REJECTED
    if rejected and suspect.staged:
        return Box(
            "stop",
            f"{what}.",
            "Its step count in session.toml may be wrong, the board may have come loose, or the photograph is "
            "mirrored, turned, or of another camera, zoom or focus: look at it, and correct its step count or leave it "
            "out.",
        )
    return Box(
        "stop" if rejected else "care",
        f"{what}.",
        "It may be of another camera, zoom or focus, show another board or a reflection of the stripe, or be blurred: "
        "look at it, and leave it out or take it again."
        if rejected
        else "It is blurred, shows another board, the board was bent or moved, or the camera was focused again: leave "
        "it out or take it again, with autofocus off.",
    )


def _scales(diagnostics: Diagnostics) -> list[Box]:
    boxes = []
    for each in filter(_rescaled, diagnostics.sessions):
        scale, sigma = each.scale or 0.0, each.scale_sigma or 0.0
        boxes.append(
            Box(
                "stop",
                f"Millimetres of the session {each.parts[1]} are {100 * abs(scale):.2f} ± {100 * sigma:.1g} % "
                f"{'longer' if scale > 0 else 'shorter'} than those of {each.parts[0]}: the squares of one of the "
                "boards are not of the size that square_mm states.",
                "Measure ten squares of each board with a ruler and correct square_mm in that session.toml. "
                "Everything else that does not fit may come from this alone.",
            )
        )
    return boxes


def _sessions(diagnostics: Diagnostics) -> list[Box]:
    return [
        Box(
            "stop" if each.sigma_factor > _LARGE_FACTOR else "care",
            f"The sessions {each.parts[0]} and {each.parts[1]} disagree by {each.sigma_factor:.1f} times what their σ "
            "predict.",
            "Something moved or was refocused between them: calibrate them apart.",
        )
        for each in diagnostics.sessions
        if not _rescaled(each) and each.disagree and each.sigma_factor > _FACTOR
    ]


def _rescaled(each: Agreement) -> bool:
    """Whether the difference of two sessions is that of their millimetres."""
    if each.scale is None or each.scale_sigma is None:
        return False
    return abs(each.scale) > max(_SCALE, _SCALE_SIGMA * each.scale_sigma)


def _imprecise(calibration: Calibration, factor: float, volumes: tuple[WorkingVolume, ...]) -> list[Box]:
    boxes = []
    for volume in volumes:
        depth = float(np.median(volume.depths_mm))
        share = factor * volume.median_mm / depth
        if share > _RELATIVE:
            boxes.append(
                Box(
                    "stop",
                    f"A point {depth:.0f} mm away is known to {factor * volume.median_mm:.1f} mm, {100 * share:.1f} % "
                    "of its distance.",
                    "The photographs do not determine the rig well enough to measure with: see what limits it.",
                )
            )
    focal = float(calibration.rig.camera.focal[0])
    sigma = factor * (calibration.covariance.sigma("camera.focal.0") or 0.0)
    if not volumes and sigma > _RELATIVE * focal:
        boxes.append(
            Box("stop", f"The focal length is known to {100 * sigma / focal:.1f} % of itself.", "See what limits it.")
        )
    return boxes


def _notes(calibration: Calibration) -> list[Box]:
    notes = [note for note in calibration.notes if any(grave in note for grave in _GRAVE_NOTES)]
    # With a wrong scale everything is wrong, and with a stripe that is looked for across its way what the laser shows.
    return [
        Box("stop" if any(each in note for each in _WRONG) else "care", note[0].upper() + note[1:] + ".")
        for note in notes
    ]


def _halves(diagnostics: Diagnostics) -> list[Box]:
    each = diagnostics.halves
    if diagnostics.too_few_for_halves:
        return [
            Box(
                "care",
                "There are too few photographs to solve two halves apart, so only the residuals support the σ.",
                "Take at least six views of the board, four of them with the stripe, and four photographs on each "
                "axis.",
            )
        ]
    if each is None and diagnostics.thorough:
        return [
            Box(
                "care",
                "A half of the photographs gives no rig by itself, so only the residuals support the σ.",
                "Take more views of the board, tilted in different directions, with the stripe at different distances.",
            )
        ]
    if each is None or not each.disagree:
        return []
    worst = int(np.argmax(np.abs(each.differences_in_sigma)))
    return [
        Box(
            "stop" if each.sigma_factor > _LARGE_FACTOR else "care",
            f"Two halves of the photographs disagree by {each.sigma_factor:.1f} times what their σ predict (most in "
            f"{each.names[worst]}, {abs(each.differences_in_sigma[worst]):.1f} σ): read every σ as "
            f"{each.sigma_factor:.1f} times as large.",
            "Errors that do not average out are the cause: a board that is not flat or not held still, a camera that "
            "focused or zoomed between photographs (switch autofocus off), a lens that the model does not follow, or "
            "one bad photograph.",
        )
    ]


def _worse(diagnostics: Diagnostics) -> list[Box]:
    """Photographs whose corners, and whose stripe if they have one, fit worse than those of most."""
    suspected = {suspect.name for suspect in diagnostics.suspects} | off_their_places(diagnostics)
    each = [p for p in diagnostics.photographs if np.isfinite(p.corner_rms_px) and p.name not in suspected]
    if not each:
        return []
    corner = float(np.median([p.corner_rms_px for p in each]))
    stripe = float(np.median([p.stripe_rms_px for p in each if p.stripe_rms_px is not None] or [0.0]))
    worse = [
        p
        for p in each
        if p.corner_rms_px > max(_WORSE * corner, LEAST_PX)
        and (p.stripe_rms_px is None or p.stripe_rms_px > _WORSE * stripe)
    ]
    if not worse:
        return []
    names = first_few([f"{p.name} ({p.corner_rms_px:.2f} px)" for p in worse])
    return [
        Box(
            "care",
            f"Corners fit worse than elsewhere (median {corner:.2f} px), and the stripe too where there is one, on "
            f"{names}.",
            "Those photographs are blurred, or the plate was bent or moved: they count less in the solve already; "
            "better, leave them out or take them again.",
        )
    ]


def camera_is_held(calibration: Calibration) -> bool:
    """Whether the camera was given, and no photograph can make it better."""
    return calibration.covariance.sigma("camera.focal.0") is None


def thin(calibration: Calibration, diagnostics: Diagnostics) -> list[Box]:
    """Photographs that leave much to the model."""
    cover, boxes = diagnostics.coverage, []
    # A part of a session without views has its camera from the other part, and says so.
    viewed = len(cover.tilts_deg) > 0 and not camera_is_held(calibration)
    if viewed and cover.tilt_spread_deg < _TILT_SPREAD_DEG:
        boxes.append(
            Box(
                "care",
                f"All boards are nearly parallel: their normals lie within {cover.tilt_spread_deg:.0f}° of each "
                "other. Then lengths rest on small differences of perspective: points are three to four times as "
                "far off as with tilted boards, by noise, which σ covers, and by a board that is not quite flat.",
                "Tilt the board by 30° or more, in different directions from view to view.",
            )
        )
    if viewed and cover.image_share < _IMAGE_SHARE and cover.reach < _REACH:
        boxes.append(
            Box(
                "care",
                f"Corners cover {100 * cover.image_share:.0f} % of the image and reach {100 * cover.reach:.0f} % of "
                "the way to its corners: beyond, the lens is a guess.",
                "Hold the board into the corners of the image too.",
            )
        )
    for stripe in cover.stripes:
        near, far = stripe.depths_mm
        if stripe.views < _STRIPE_VIEWS or far < _DEPTH_RATIO * near:
            boxes.append(
                Box(
                    "care",
                    f"The light plane{of_laser(stripe.laser)} rests on {stripe.views} boards with stripes between "
                    f"{near:.0f} and {far:.0f} mm.",
                    "Hold the board at the nearest and at the farthest place that will be scanned, with the stripe "
                    "across it.",
                )
            )
    for axis, along in cover.axes.items():
        if along.way is None or along.unit != "mm" or along.photographs >= _STAGE_IMAGES:
            continue
        boxes.append(
            Box(
                "care",
                f"The {axis} rests on {along.photographs} photographs: its straightness cannot be seen.",
                f"Photograph the board at {_STAGE_IMAGES} or more places along the travel.",
            )
        )
    return boxes
