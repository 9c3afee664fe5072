"""Findings about what the photographs show and the model does not follow: lens, flat boards, straight stage, noise."""

from collections.abc import Sequence
from typing import cast

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.calibration.diagnostics import Diagnostics
from jaxscan.calibration.diagnostics.light_planes import light_plane_doubts
from jaxscan.calibration.diagnostics.missing_terms import MissingTerms
from jaxscan.calibration.diagnostics.stripe_shapes import StripeShape
from jaxscan.calibration.diagnostics.swept_offsets import curved_alike_mm, swept_offsets
from jaxscan.rig import MovingLight
from jaxscan.rig.camera import camera_parameters, lens_parameters
from jaxscan.rig.opencv_lens import LADDER
from jaxscan.view.report import Box, Level
from jaxscan.view.stage_findings import mixed_names, stage_findings

# A richer lens is worth a word when held-out corners are nearer by this share.
_LENS_GAIN = 0.025
# A stripe point's σ of more pixels than this is no line.
_ROUGH_PX = 1.0
# A mean residual above this number of standard errors, and this share of a corner's σ, comes from the lens.
_ERRORS, _SHARE = 5.0, 0.25
# A stripe is on a bent plate if its bend exceeds this multiple of what noise gives, and this multiple of its noise.
_BEND, _BEND_NOISE = 3.0, 4.0
# A stripe is beside the plane if its offset exceeds this multiple of its own noise and this multiple of the others'.
_OFFSET_NOISE, _OFFSET_OTHERS = 4.0, 3.0
# Stripes lie beside the plane as wholes, by this times as much as they are crooked: by noise alone 0.25 times. Of a few
# stripes the plane takes up most.
_WHOLES, _FEWEST_WHOLES = 1.0, 5
# A board of another shape than assumed moves the rig by this number of σ: the results are not to be trusted.
_MOVES_FAR = 4.0
# Of normal residuals 0.27 % lie beyond 3 σ.
_BEYOND_3 = 0.015
# Share of all corners that were rejected.
_REJECTED = 0.05
# Of a stripe's points those at the borders of the board's squares are: within a stripe's width of each there may be a
# tenth of all.
_STRIPE_REJECTED = 0.2
_NAMED = 5


def model_findings(calibration: Calibration, diagnostics: Diagnostics) -> list[Box]:
    """All of them, none for a model that follows what was seen."""
    lens = _lens(calibration, diagnostics)
    return [
        *lens,
        *_camera_model(calibration, diagnostics),
        *_board(calibration),
        *_off_grid(calibration),
        *_sheets(calibration, diagnostics, lens),
        *_curved_sweeps(calibration, diagnostics),
        *_bent(calibration, diagnostics),
        *_changed(calibration, diagnostics),
        *_lent(calibration),
        *_drift(calibration),
        *_moved(calibration, diagnostics),
        *stage_findings(calibration, diagnostics),
        *_tails(calibration, diagnostics),
    ]


def listed(words: list[str]) -> str:
    """The first few, and how many more."""
    more = len(words) - _NAMED
    return ", ".join(words[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def _lens(calibration: Calibration, diagnostics: Diagnostics) -> list[Box]:
    tried, names, missing = diagnostics.ladder, list(LADDER), diagnostics.missing_terms
    lacking = _missing_terms(missing)
    # On the ladder's rungs stays held what was held.
    if tried is None or (lacking and missing is not None and missing.freed):
        return lacking
    by_name = {rung.lens: rung for rung in tried.rungs}
    chosen, supported = by_name[tried.chosen], by_name[tried.supported]
    richer = names.index(tried.supported) > names.index(tried.chosen)
    if richer and supported.held_out_px > (1 - _LENS_GAIN) * chosen.held_out_px:
        return []
    if richer:
        return [
            Box(
                "care",
                f'The lens "{tried.chosen}" is too simple: "{tried.supported}" predicts views that it has not seen to '
                f"{supported.held_out_px:.3f} px instead of {chosen.held_out_px:.3f} px.",
                f'Set lens = "{tried.supported}" under [camera] in session.toml.',
            )
        ]
    if names.index(tried.supported) < names.index(tried.chosen):
        terms = chosen.terms - supported.terms
        gone = [name for name in _held_terms(calibration) if name not in camera_parameters(tried.supported)]
        unheld = f" and take {', '.join(gone)} out of hold" if gone else ""
        return [
            Box(
                "care",
                f'The lens "{tried.chosen}" is richer than the photographs support: beyond "{tried.supported}" its '
                f"{terms} further term{'s' if terms > 1 else ''} only fit{'s' if terms == 1 else ''} noise. Views "
                f"that it has not seen it predicts to {chosen.held_out_px:.3f} px, the simpler one to "
                f"{supported.held_out_px:.3f} px, which is no clear difference.",
                f'Set lens = "{tried.supported}" under [camera] in session.toml{unheld}, or hold the board '
                "into the corners of the image, where the terms differ.",
            )
        ]
    return []


def _missing_terms(missing: MissingTerms | None) -> list[Box]:
    """What the residuals alone say of the lens and of its held terms."""
    if missing is None or not missing.clear:
        return []
    moves = f", and move {missing.parameter} by {missing.shift_in_sigma:.1f} of its σ" if missing.parameter else ""
    alike = "A bent board looks similar: --report shows which it is, with views that a lens has not seen."
    if missing.freed:
        what, it = ", ".join(missing.freed), "it" if len(missing.freed) == 1 else "them"
        they = "it" if it == "it" else "they"
        return [
            Box(
                "care",
                f"The lens is not followed with {what} held: free, {they} would explain {100 * missing.gain:.0f} % "
                f"of the corners' squared errors{moves}.",
                f"Free {what}: take {it} out of --hold and of hold under [camera] in session.toml, and name {it} with "
                f"--free where the file of --camera has 0. {alike}",
            )
        ]
    return [
        Box(
            "care",
            f'The lens is not followed: one of the kind "{missing.lens}" would explain {100 * missing.gain:.0f} % of '
            f"the corners' squared errors{moves}.",
            f'Set lens = "{missing.lens}" under [camera] in session.toml. {alike}',
        )
    ]


def _held_terms(calibration: Calibration) -> list[str]:
    """The terms of the lens that were not sought."""
    sought = {*calibration.covariance.names, *calibration.rig.given()}
    return [n for n in lens_parameters(calibration.rig.camera.lens.kind) if n not in sought]


def _camera_model(calibration: Calibration, diagnostics: Diagnostics) -> list[Box]:
    held = _held_terms(calibration)
    other = "try a richer lens" if calibration.rig.camera.lens.kind in LADDER else "try another lens"
    richer = f"free {', '.join(held)}, held here, or {other}" if held else other
    by = diagnostics.by_radius
    out = np.abs(by.radial_px) / by.radial_error_px
    worst = int(np.argmax(np.where(np.abs(by.radial_px) > _SHARE * calibration.corner_sigma_px, out, 0.0)))
    boxes = []
    if out[worst] > _ERRORS and abs(by.radial_px[worst]) > _SHARE * calibration.corner_sigma_px:
        boxes.append(
            Box(
                "care",
                f"Corners {by.radius_px[worst]:.0f} px from the principal point are off by {by.radial_px[worst]:+.3f} "
                f"px outwards in the mean ({out[worst]:.0f} standard errors): the lens is not followed there.",
                f"{richer[0].upper()}{richer[1:]}; if that does not help, see whether the boards are flat.",
            )
        )
    if not boxes and diagnostics.over_image.left_out(calibration.corner_sigma_px):
        share = diagnostics.over_image.share_off(calibration.corner_sigma_px)
        splined = (
            ' Where no formula helps, lens = "splined" follows what is left.'
            if calibration.rig.camera.lens.kind in LADDER
            else ""
        )
        boxes.append(
            Box(
                "care",
                f"In {100 * share:.0f} % of the image the corners are off in the same direction in every photograph.",
                f"The model of the camera misses something: {richer}, and see whether the boards are flat.{splined}",
            )
        )
    return boxes


def _board(calibration: Calibration) -> list[Box]:
    """Boards of another shape than they were taken to have."""
    found = calibration.flatness
    if found is None:
        return []
    level: Level = "stop" if found.session or found.shift_in_sigma > _MOVES_FAR else "care"
    return [Box(level, f"{what}.", fix) for what, fix in found.statements]


def _off_grid(calibration: Calibration) -> list[Box]:
    """Points of the board that are not where they should be."""
    found = calibration.off_grid
    return [] if found is None else [Box("care", f"{what}.", fix) for what, fix in found.statements]


def _sheets(calibration: Calibration, diagnostics: Diagnostics, lens: list[Box]) -> list[Box]:
    """Light planes that do not fit their stripes, be it by board or lens, and stripes that are hardly lines."""
    advice = (
        "The line is thicker than half a square, a reflection or another light was taken for it, or the plates are "
        "bent: focus the laser, see by jaxscan inspect --png what was found, check [laser] color and columns."
    )
    curved = [curve.in_words for curve in calibration.sheet_curves]
    of_lens = (
        "The line lens is not square to its beam, or the mirror before it is bent. In session.toml it is "
        'sheet = "bowed" under [laser]; see whether the two halves then agree better.'
    )
    # What has to be corrected first, because it bends the stripes too.
    first = _board(calibration) or lens or _moved(calibration, diagnostics)
    boxes = [
        Box("care", f"{doubt}.", lens[0].advice if lens else of_lens)
        if doubt in curved
        else Box("stop", f"{doubt}.", first[0].advice if first else advice)
        for doubt in light_plane_doubts(diagnostics.stripes, calibration.sheet_curves)
    ]
    sigma = calibration.stripe_sigma_px
    if sigma is not None and sigma > _ROUGH_PX:
        boxes.append(
            Box(
                "care",
                f"Stripe points scatter by {sigma:.1f} px about the light plane, where a tenth of a pixel is usual.",
                "See by jaxscan inspect --png whether the line is what was found: check [laser] color and columns, "
                "make the line thinner and brighter, and the room darker.",
            )
        )
    return boxes


def _bent(calibration: Calibration, diagnostics: Diagnostics) -> list[Box]:
    """Stripes that are not straight, where the sheet is not named as the reason."""
    boxes, curved = [], _curved(calibration, diagnostics)
    whole = _wholes(calibration, diagnostics)
    bent = [s for s in _crooked(diagnostics.stripes) if s.laser not in curved and s.laser not in whole]
    if bent:
        names = listed([f"{s.label} ({s.bend_mm:.2f} mm from peak to valley)" for s in bent])
        several = any(s.position is not None for s in bent)
        part = ", or the stripe is in part a reflection where others on the same board are straight" if several else ""
        boxes.append(
            Box(
                "care",
                f"{_not_straight(bent, diagnostics)}: {names}. A sheet of light meets a flat board in a straight "
                f"line, so the plates are bent there{part}.",
                "Glue the pattern to something stiff and hold the plate without bending it. Leave out the first of "
                "these photographs and see whether the two halves then agree better.",
            )
        )
    size = np.array([abs(s.offset_mm) for s in diagnostics.stripes])
    beside = [
        s
        for s in sorted(diagnostics.stripes, key=lambda s: -abs(s.offset_mm))
        # Of a swept light the cause of all has a finding of its own.
        if not (s.position is not None and s.laser in whole)
        and abs(s.offset_mm)
        > max(_OFFSET_NOISE * s.noise_mm, _OFFSET_OTHERS * float(np.median(size)), curved.get(s.laser, 0.0))
    ]
    if beside:
        names = listed([f"{s.label} ({s.offset_mm:+.2f} mm)" for s in beside])
        swept = all(s.position is not None for s in beside)
        boxes.append(
            Box(
                "care",
                f"The whole stripe lies beside the {'sheet of light' if swept else 'light plane'} on {names}.",
                "Look at the photograph: the light did not stand where its step says, or the stripe is a reflection "
                "or lies on something else than the board. If all stripes of a board are named, the board moved."
                if swept
                else "The board moved between corners and stripe, is bent as a whole, or its squares are of another "
                "size.",
            )
        )
    return boxes


def _changed(calibration: Calibration, diagnostics: Diagnostics) -> list[Box]:
    """What is another before and behind one of the photographs."""
    change = calibration.change
    if change is None or {change.before, change.after} & mixed_names(diagnostics):
        return []
    what, fix = change.statement
    return [Box("stop", f"{what}.", fix)]


def _lent(calibration: Calibration) -> list[Box]:
    """What the photographs of one part of a session do not show."""
    parted = calibration.parted
    return [] if parted is None else [Box("care", f"{each[0].upper()}{each[1:]}.", "") for each in parted.lent]


def _drift(calibration: Calibration) -> list[Box]:
    """What goes on slowly from photograph to photograph."""
    if calibration.drift is None:
        return []
    what, fix = calibration.drift.statement
    return [Box("care", f"{what}.", fix)]


def _curved(calibration: Calibration, diagnostics: Diagnostics) -> dict[str, float]:
    """How far the stripes of each laser may lie beside it whose sheet is curved and was taken as flat."""
    return {curve.laser: abs(curve.curve_mm) for curve in calibration.sheet_curves} | _sags(calibration, diagnostics)


def _sags(calibration: Calibration, diagnostics: Diagnostics) -> dict[str, float]:
    """How far the stripes of each swept laser sag in the median that are curved alike on all boards, mm."""
    if _board(calibration):
        return {}
    swept = {laser: own for laser, own in _by_laser(diagnostics).items() if own[0].position is not None}
    return {laser: sag for laser, own in swept.items() if _mostly_bent(own) and (sag := curved_alike_mm(own))}


def _by_laser(diagnostics: Diagnostics) -> dict[str, list[StripeShape]]:
    """The stripes of each laser."""
    lasers = dict.fromkeys(stripe.laser for stripe in diagnostics.stripes)
    return {laser: [stripe for stripe in diagnostics.stripes if stripe.laser == laser] for laser in lasers}


def _crooked(stripes: Sequence[StripeShape]) -> list[StripeShape]:
    """Those that are not straight."""
    usual = float(np.median([s.noise_mm for s in stripes] or [0.0]))
    return [s for s in stripes if s.bend_mm > max(_BEND * s.bend_of_noise_mm, _BEND_NOISE * max(s.noise_mm, usual))]


def _mostly_bent(own: Sequence[StripeShape]) -> bool:
    return 2 * len(_crooked(own)) >= len(own)


def _not_straight(some: Sequence[StripeShape], diagnostics: Diagnostics) -> str:
    """How many boards that is, or how many stripes where a board has several."""
    boards = len({s.name for s in diagnostics.stripes})
    if all(s.position is None for s in diagnostics.stripes):
        return f"The stripe is not straight on {len({s.name for s in some})} of {boards} boards"
    are = "is" if len(some) == 1 else "are"
    return f"{len(some)} of {len(diagnostics.stripes)} stripes on {boards} boards {are} not straight"


def _wholes(calibration: Calibration, diagnostics: Diagnostics) -> dict[str, list[StripeShape]]:
    """The stripes of each laser whose stripes are straight and lie beside it as wholes, the farthest first.

    By medians: one stripe that is off says nothing of the others. Of a swept light some may be off by a common cause.
    """
    curved, found = _curved(calibration, diagnostics), {}
    for laser, own in _by_laser(diagnostics).items():
        least = max(_WHOLES * _usual(own)[1], curved.get(laser, 0.0))
        far = _usual(own)[0] >= least
        if not far and own[0].position is not None and _rms([s.beside_mm for s in own]) >= least:
            far = swept_offsets(own).by is not None
        if len(own) >= _FEWEST_WHOLES and far and not _mostly_bent(own):
            found[laser] = sorted(own, key=lambda s: -s.beside_mm)
    return found


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _usual(own: Sequence[StripeShape]) -> tuple[float, float]:
    """How far stripes lie beside the sheet as wholes, and how far they are crooked, in the median, mm."""
    return float(np.median([s.beside_mm for s in own])), float(np.median([s.crooked_mm for s in own]))


def _curved_sweeps(calibration: Calibration, diagnostics: Diagnostics) -> list[Box]:
    """Stripes of a swept light that are curved alike on all boards."""
    boxes = []
    for laser, sag in _sags(calibration, diagnostics).items():
        own = _by_laser(diagnostics)[laser]
        length = float(np.median([s.length_mm for s in own]))
        boxes.append(
            Box(
                "care",
                f"The stripes{_which(laser)} are curved alike on all boards, by {sag:.2g} mm over {length:.0f} mm in "
                "the median: the sheet of light may be curved, and was taken as flat.",
                "There is no curved sheet that is swept: turn the line lens until it is square to its beam, take "
                "another laser, or use the middle of its fan only. If all boards are one plate, or bent alike, it "
                "looks the same: lay a straight edge across it.",
            )
        )
    return boxes


def _moved(calibration: Calibration, diagnostics: Diagnostics) -> list[Box]:
    """Stripes that are straight and lie beside the sheet as wholes: boards that moved, or a drive that is uneven."""
    return [
        _off_the_plane(laser, own) if own[0].position is None else _off_the_sweep(calibration, laser, own)
        for laser, own in _wholes(calibration, diagnostics).items()
    ]


def _which(laser: str) -> str:
    return f' of laser "{laser}"' if laser else ""


def _off_the_plane(laser: str, own: Sequence[StripeShape]) -> Box:
    """Boards that were not where their corners say when the stripe was photographed."""
    beside, crooked = _usual(own)
    names = listed([f"{s.name} ({s.beside_mm:.2g} mm)" for s in own])
    return Box(
        "care",
        f"The stripes{_which(laser)} are straight and fit no plane: each as a whole lies beside the light plane, by "
        f"{beside:.2g} mm in the median, {beside / crooked:.1f} times as far as they are crooked. The farthest are "
        f"{names}. The boards were not where their corners say when the stripe was photographed.",
        "Where corners and stripe have photographs of their own, the board moved between them: put it on a "
        "stand and switch the laser without touching anything, or photograph both at once. Otherwise see "
        "whether the plates are flat and whether the sheet of light is.",
    )


def _off_the_sweep(calibration: Calibration, laser: str, own: Sequence[StripeShape]) -> Box:
    """A swept light that was not where its steps say, or boards that were not where their corners say."""
    found = swept_offsets(own)
    beside, crooked = _rms([s.beside_mm for s in own]), _rms([s.crooked_mm for s in own])
    light = next(light for light in calibration.rig.lights if light.name == laser)
    axis, (least, low), (most, high) = calibration.observations.light_axes[laser], found.least, found.most
    amount, unit = cast(MovingLight, light).amount(high - low)
    apart = f"{high - low:.2g} steps, or {amount:.2g} {unit} of the light, apart"
    what = (
        f"The stripes{_which(laser)} are straight, and each as a whole lies beside the sheet of light, by "
        f"{beside:.2g} mm RMS, {beside / crooked:.1f} times as far as they are crooked"
    )
    if found.by == "steps":
        return Box(
            "care",
            f'{what}. At one step it is alike on all boards ({100 * found.share:.0f} % of the squares): axis "{axis}" '
            f"does not turn the light evenly. It stood {low:+.2g} steps off at step {least} and {high:+.2g} at step "
            f"{most}, {apart}.",
            "A motor with microsteps: photograph and scan at full steps only. A mirror that a voltage drives is not "
            "quite proportional to it: where its true angles are known, give these as steps, in thousandths of a "
            "degree. There is no table of a drive's true angles yet. What an even turn can follow is not counted "
            "here: the drive may be further off.",
        )
    if found.by == "boards":
        return Box(
            "care",
            f"{what}. On one board it is alike at all steps ({100 * found.share:.0f} % of the squares), and differs "
            f"from board to board: {low:+.2g} steps on {least} and {high:+.2g} on {most}, {apart}. The drive has play "
            "or did not start from the same place, or the boards moved after their corners were photographed.",
            f'Move axis "{axis}" to every position in the same direction and from the same stop, in the scans too, and '
            "put the board on a stand that nothing touches from its first photograph to its last.",
        )
    names = listed([f"{s.label} ({s.beside_mm:.2g} mm)" for s in own])
    return Box(
        "care",
        f"{what}, neither alike at one step nor on one board. The farthest are {names}.",
        "See whether stripe_steps has the position of each photograph, whether the light stood still while it was "
        "taken, and whether the plates are flat and the sheet of light is.",
    )


def _tails(calibration: Calibration, diagnostics: Diagnostics) -> list[Box]:
    boxes = []
    for what, normality in (("corners", diagnostics.corner_normality), ("stripe points", diagnostics.stripe_normality)):
        if normality is not None and normality.beyond_3 > _BEYOND_3:
            boxes.append(
                Box(
                    "care",
                    f"Errors of the {what} are not normal: {100 * normality.beyond_3:.1f} % lie beyond 3 σ, where 0.3 "
                    "% should.",
                    "A mixture of good and bad photographs looks like this: the report has the worst of them.",
                )
            )
    known = mixed_names(diagnostics) | {suspect.name for suspect in diagnostics.suspects}
    fits = [fit for fit in (*calibration.fits, *calibration.moved_fits) if fit.name not in known]
    for what, most, kept, seen in (
        (
            "corners",
            _REJECTED,
            sum(int(f.corner_kept.sum()) for f in fits),
            sum(int(np.isfinite(f.corner_errors[:, 0]).sum()) for f in fits),
        ),
        (
            "stripe points",
            _STRIPE_REJECTED,
            sum(int(f.stripe_kept.sum()) for f in fits),
            sum(f.stripe_kept.size for f in fits),
        ),
    ):
        if seen and 1 - kept / seen > most:
            boxes.append(
                Box(
                    "care",
                    f"{100 * (1 - kept / seen):.0f} % of all {what} were rejected as outliers.",
                    "The report lists the photographs that they are from.",
                )
            )
    return boxes
