"""Findings about stripes on boards: sheets of light that do not fit, stripes that are not straight or lie beside them.

A stripe that is not straight is on a bent plate, or its sheet is curved. One that is straight and lies beside the sheet
as a whole is on a board that moved, or its light did not stand where its step says.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.calibration.diagnostics import Diagnostics
from jaxscan.calibration.diagnostics.light_planes import light_plane_doubts
from jaxscan.calibration.diagnostics.stripe_shapes import StripeShape
from jaxscan.calibration.diagnostics.swept_offsets import SweptOffsets, curved_alike_mm, swept_offsets
from jaxscan.phrases import first_few, of_laser
from jaxscan.rig import MovingLight
from jaxscan.view.report import Box

# A stripe point's σ of more pixels than this is no line.
_ROUGH_PX = 1.0
# A stripe is on a bent plate if its bend exceeds this multiple of what noise gives, and this multiple of its noise.
_BEND, _BEND_NOISE = 3.0, 4.0
# A stripe is beside the plane if its offset exceeds this multiple of its own noise and this multiple of the others'.
_OFFSET_NOISE, _OFFSET_OTHERS = 4.0, 3.0
# Stripes lie beside the plane as wholes, by this times as much as they are crooked: by noise alone 0.25 times. Of a few
# stripes the plane takes up most.
_WHOLES, _FEWEST_WHOLES = 1.0, 5


@dataclass(frozen=True)
class _StripesBeside:
    """The stripes of one laser that are straight and lie beside its sheet as wholes.

    Attributes:
        stripes: all stripes of the laser, the farthest first.
        offsets: what they have in common where the light is swept; None for a light that stands still.
    """

    stripes: list[StripeShape]
    offsets: SweptOffsets | None


def stripe_findings(
    calibration: Calibration, diagnostics: Diagnostics, lens: list[Box], board: list[Box]
) -> tuple[list[Box], list[Box]]:
    """What is wrong with sheets of light and stripes, none where they fit.

    Args:
        calibration: what was found.
        diagnostics: of it.
        lens: the findings about the lens, which bends stripes too.
        board: the findings about the shape of boards, which bends stripes too.

    Returns:
        Sheets that do not fit their stripes, and stripes that are not straight; apart from these, stripes that are
        straight and lie beside the sheet as wholes.
    """
    sags = {} if board else _sags(diagnostics)
    curved = {curve.laser: abs(curve.curve_mm) for curve in calibration.sheet_curves} | sags
    beside = _stripes_beside(diagnostics, curved)
    moved = [
        _off_the_plane(laser, each.stripes)
        if each.offsets is None
        else _off_the_sweep(calibration, laser, each.stripes, each.offsets)
        for laser, each in beside.items()
    ]
    # What has to be corrected first, because it bends the stripes too.
    first = board or lens or moved
    return [
        *_sheets(calibration, diagnostics, lens, first),
        *_curved_sweeps(diagnostics, sags),
        *_not_straight(diagnostics, curved, beside),
        *_single_beside(diagnostics, curved, beside),
    ], moved


def _sheets(calibration: Calibration, diagnostics: Diagnostics, lens: list[Box], first: list[Box]) -> list[Box]:
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


def _not_straight(
    diagnostics: Diagnostics, curved: Mapping[str, float], beside: Mapping[str, _StripesBeside]
) -> list[Box]:
    """Stripes that are not straight, where the sheet is not named as the reason."""
    bent = [s for s in _crooked(diagnostics.stripes) if s.laser not in curved and s.laser not in beside]
    if not bent:
        return []
    names = first_few([f"{s.label} ({s.bend_mm:.2f} mm from peak to valley)" for s in bent])
    several = any(s.position is not None for s in bent)
    part = ", or the stripe is in part a reflection where others on the same board are straight" if several else ""
    return [
        Box(
            "care",
            f"{_how_many_bent(bent, diagnostics)}: {names}. A sheet of light meets a flat board in a straight line, "
            f"so the plates are bent there{part}.",
            "Glue the pattern to something stiff and hold the plate without bending it. Leave out the first of these "
            "photographs and see whether the two halves then agree better.",
        )
    ]


def _single_beside(
    diagnostics: Diagnostics, curved: Mapping[str, float], beside: Mapping[str, _StripesBeside]
) -> list[Box]:
    """Single stripes that lie beside the sheet, farther than the others."""
    size = np.array([abs(s.offset_mm) for s in diagnostics.stripes])
    far = [
        s
        for s in sorted(diagnostics.stripes, key=lambda s: -abs(s.offset_mm))
        # Of a swept light the cause of all has a finding of its own.
        if not (s.position is not None and s.laser in beside)
        and abs(s.offset_mm)
        > max(_OFFSET_NOISE * s.noise_mm, _OFFSET_OTHERS * float(np.median(size)), curved.get(s.laser, 0.0))
    ]
    if not far:
        return []
    names = first_few([f"{s.label} ({s.offset_mm:+.2f} mm)" for s in far])
    swept = all(s.position is not None for s in far)
    return [
        Box(
            "care",
            f"The whole stripe is off the {'sheet of light' if swept else 'light plane'} on {names}.",
            "Look at the photograph: the light was not where its step says, or the stripe is a reflection or lies on "
            "something else than the board. If all stripes of a board are named, the board moved."
            if swept
            else "The board moved between corners and stripe, is bent as a whole, or its squares are of another size.",
        )
    ]


def _sags(diagnostics: Diagnostics) -> dict[str, float]:
    """How far the stripes of each swept laser sag in the median that are curved alike on all boards, mm."""
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


def _how_many_bent(some: Sequence[StripeShape], diagnostics: Diagnostics) -> str:
    """How many boards that is, or how many stripes where a board has several."""
    boards = len({s.name for s in diagnostics.stripes})
    if all(s.position is None for s in diagnostics.stripes):
        return f"The stripe is not straight on {len({s.name for s in some})} of {boards} boards"
    are = "is" if len(some) == 1 else "are"
    return f"{len(some)} of {len(diagnostics.stripes)} stripes on {boards} boards {are} not straight"


def _stripes_beside(diagnostics: Diagnostics, curved: Mapping[str, float]) -> dict[str, _StripesBeside]:
    """By laser, the stripes that are straight and lie beside the sheet as wholes; no laser whose stripes do not.

    By medians: one stripe that is off says nothing of the others. Of a swept light some may be off by a common cause.
    """
    found = {}
    for laser, all_own in _by_laser(diagnostics).items():
        if len(all_own) < _FEWEST_WHOLES or _mostly_bent(all_own):
            continue
        own = sorted(all_own, key=lambda s: -s.beside_mm)
        beside, crooked = _usual(own)
        least = max(_WHOLES * crooked, curved.get(laser, 0.0))
        far, offsets = beside >= least, None
        if own[0].position is not None and (far or _rms([s.beside_mm for s in own]) >= least):
            offsets = swept_offsets(own)
            far = far or offsets.by is not None
        if far:
            found[laser] = _StripesBeside(own, offsets)
    return found


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _usual(own: Sequence[StripeShape]) -> tuple[float, float]:
    """How far stripes lie beside the sheet as wholes, and how far they are crooked, in the median, mm."""
    return float(np.median([s.beside_mm for s in own])), float(np.median([s.crooked_mm for s in own]))


def _curved_sweeps(diagnostics: Diagnostics, sags: Mapping[str, float]) -> list[Box]:
    """Stripes of a swept light that are curved alike on all boards."""
    boxes = []
    for laser, sag in sags.items():
        own = _by_laser(diagnostics)[laser]
        length = float(np.median([s.length_mm for s in own]))
        boxes.append(
            Box(
                "care",
                f"The stripes{of_laser(laser)} are curved alike on all boards, by {sag:.2g} mm over {length:.0f} mm in "
                "the median: the sheet of light may be curved, and was taken as flat.",
                "A swept sheet cannot be modelled as curved: turn the line lens until it is square to its beam, take "
                "another laser, or use the middle of its fan only. If all boards are one plate, or bent alike, it "
                "looks the same: lay a straight edge across it.",
            )
        )
    return boxes


def _off_the_plane(laser: str, own: Sequence[StripeShape]) -> Box:
    """Boards that were not where their corners say when the stripe was photographed."""
    beside, crooked = _usual(own)
    names = first_few([f"{s.name} ({s.beside_mm:.2g} mm)" for s in own])
    return Box(
        "care",
        f"The stripes{of_laser(laser)} are straight and fit no plane: each as a whole is off the light plane, by "
        f"{beside:.2g} mm in the median, {beside / crooked:.1f} times as far as they are crooked. The farthest are "
        f"{names}. The boards were not where their corners say when the stripe was photographed.",
        "Where corners and stripe have photographs of their own, the board moved between them: put it on a "
        "stand and switch the laser without touching anything, or photograph both at once. Otherwise see "
        "whether the plates are flat and whether the sheet of light is.",
    )


def _off_the_sweep(calibration: Calibration, laser: str, own: Sequence[StripeShape], found: SweptOffsets) -> Box:
    """A swept light that was not where its steps say, or boards that were not where their corners say."""
    beside, crooked = _rms([s.beside_mm for s in own]), _rms([s.crooked_mm for s in own])
    light = next(light for light in calibration.rig.lights if light.name == laser)
    axis, (least, low), (most, high) = calibration.observations.light_axes[laser], found.least, found.most
    amount, unit = cast(MovingLight, light).amount(high - low)
    apart = f"{high - low:.2g} steps, or {amount:.2g} {unit} of the light, apart"
    what = (
        f"The stripes{of_laser(laser)} are straight, and each as a whole is off the sheet of light, by "
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
            "degree. A table of a drive's true angles cannot be given yet. The part that an even turn can explain is "
            "not "
            "counted here: the drive may be further off.",
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
    names = first_few([f"{s.label} ({s.beside_mm:.2g} mm)" for s in own])
    return Box(
        "care",
        f"{what}, neither alike at one step nor on one board. The farthest are {names}.",
        "See whether stripe_steps has the position of each photograph, whether the light stood still while it was "
        "taken, and whether the plates are flat and the sheet of light is.",
    )
