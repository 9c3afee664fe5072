"""Findings about what the photographs show and the model does not follow: lens, flat boards, straight stage, noise."""

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.calibration.diagnostics import Diagnostics
from jaxscan.calibration.diagnostics.missing_terms import MissingTerms
from jaxscan.rig.camera import camera_parameters, lens_parameters
from jaxscan.rig.opencv_lens import LADDER
from jaxscan.view.report import Box, Level
from jaxscan.view.stage_findings import mixed_names, stage_findings
from jaxscan.view.stripe_findings import stripe_findings

# A richer lens is worth a word when held-out corners are nearer by this share.
_LENS_GAIN = 0.025
# A mean residual above this number of standard errors, and this share of a corner's σ, comes from the lens.
_ERRORS, _SHARE = 5.0, 0.25
# A board of another shape than assumed moves the rig by this number of σ: the results are not to be trusted.
_MOVES_FAR = 4.0
# Of normal residuals 0.27 % lie beyond 3 σ.
_BEYOND_3 = 0.015
# Share of all corners that were rejected.
_REJECTED = 0.05
# Of a stripe's points those at the borders of the board's squares are: within a stripe's width of each there may be a
# tenth of all.
_STRIPE_REJECTED = 0.2


def model_findings(calibration: Calibration, diagnostics: Diagnostics) -> list[Box]:
    """All of them, none for a model that follows what was seen."""
    lens, board = _lens(calibration, diagnostics), _board(calibration)
    stripes, moved = stripe_findings(calibration, diagnostics, lens, board)
    return [
        *lens,
        *_camera_model(calibration, diagnostics),
        *board,
        *_off_grid(calibration),
        *stripes,
        *_changed(calibration, diagnostics),
        *_lent(calibration),
        *_drift(calibration),
        *moved,
        *stage_findings(calibration, diagnostics),
        *_tails(calibration, diagnostics),
    ]


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
                f"{terms} further term{'s' if terms > 1 else ''} only fit{'s' if terms == 1 else ''} noise. It "
                f"predicts views that it has not seen to {chosen.held_out_px:.3f} px, the simpler one to "
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
                f"The lens model does not fit with {what} held: free, {they} would explain {100 * missing.gain:.0f} % "
                f"of the corners' squared errors{moves}.",
                f"Free {what}: take {it} out of --hold and of hold under [camera] in session.toml, and name {it} with "
                f"--free where the file of --camera has 0. {alike}",
            )
        ]
    return [
        Box(
            "care",
            f'The lens model does not fit: one of the kind "{missing.lens}" would explain {100 * missing.gain:.0f} % '
            "of "
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
                f"px outwards in the mean ({out[worst]:.0f} standard errors): the lens model does not fit there.",
                f"{richer[0].upper()}{richer[1:]}; if that does not help, see whether the boards are flat.",
            )
        )
    if not boxes and diagnostics.over_image.left_out(calibration.corner_sigma_px):
        share = diagnostics.over_image.share_off(calibration.corner_sigma_px)
        splined = (
            'Where no formula helps, lens = "splined" describes the rest.'
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
