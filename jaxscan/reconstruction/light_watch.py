"""What is wrong with the light of a scan, from frame to frame: said in plain words, with what to do.

Each frame's surroundings are compared with those of the frame before. What is still, or of one reflectance, shows in
both the same; so the median change of a row's pixels is that of the light, and it is distinguished from what moves by
being the same in the left and the right half of the photograph. An exposure that changes takes the stripe along, a lamp
that is switched does not, and a lamp that flickers leaves bands of rows, for most cameras read row by row.
"""

import math

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.images import Stripe
from jaxscan.images.light import no_bell

# A note is worth it from these shares of the frames, and of a frame's pixels that are full.
_MANY_FRAMES, _MANY_FULL = 0.5, 0.2
# Levels jump from frame to frame by at least this factor; decided where surroundings have at least this grey level.
_JUMP, _LEAST_LEVEL = 1.3, 4.0
# With an exposure the stripe changes by at least this part of what its surroundings do, in logarithms.
_WITH_IT = 0.5
# Where there are no surroundings, at least this share of the steps between frames change the stripe by the factor.
_MANY_JUMPS = 0.25
# Bands are worth a note from this part of the level and this number of grey levels on.
_BANDS, _LEAST_BANDS = 0.02, 1.5
# The room's light counts where it differs by this part of the stripe's strength, and this number of grey levels, over
# the middle of its values: in grey photographs, and where colours tell it from the laser's.
_ROOM, _ROOM_OF_COLOUR, _LEAST_ROOM, _MIDDLE = 0.3, 0.5, 15.0, (0.1, 0.9)
# Grey levels of photographs of 16 bits for each one of 8.
_OF_16_BITS = 257.0
_LEAST_LINES, _LEAST_PAIRS, _LEAST_PIXELS, _LEAST_QUARTERS = 20, 3, 10, 3


class LightWatch:
    """Looks on while frames are measured, and keeps a few numbers of each."""

    def __init__(self) -> None:
        self._correlation: list[float] = []
        self._odd: list[bool] = []
        self._black: list[float] = []
        self._mosaic: list[bool] = []
        self._full: list[float] = []
        # By how much levels and stripe rise from the frame before, in logarithms; NaN where it cannot be determined.
        self._level_rise: list[float] = []
        self._strength_rise: list[float] = []
        # Of the changes of rows, the median product of the two halves of the photograph; and the mean level.
        self._bands: list[float] = []
        self._level: list[float] = []
        # By how much the surroundings differ within a frame, and how strong the stripe is there, grey levels.
        self._differ: list[float] = []
        self._strength: list[float] = []
        self._before: tuple[np.ndarray, np.ndarray] | None = None

    def see(self, stripe: Stripe) -> None:
        """Take account of the next frames, in their order."""
        # How bright a full stripe is, is not seen.
        known = stripe.valid & ~stripe.burnt
        level, strength = stripe.surroundings, np.where(known, stripe.strength, np.nan)
        self._full += stripe.full.tolist()
        darkest, brightest = np.quantile(level.reshape(len(level), -1), _MIDDLE, axis=1)
        self._differ += (brightest - darkest).tolist()
        bits = np.where(stripe.light[:, 3] > np.iinfo(np.uint8).max, _OF_16_BITS, 1.0)
        self._strength += (_median(strength, known) / bits).tolist()
        self._level += level.mean(axis=(1, 2)).tolist()
        shown = stripe.valid.any(axis=1)
        self._correlation += stripe.correlation[shown].tolist()
        self._odd += stripe.odd[shown].tolist()
        self._black += stripe.black()[shown].tolist()
        self._mosaic += stripe.mosaic[shown].tolist()
        if self._before is not None:
            level, strength = (
                np.concatenate([old, new]) for old, new in zip(self._before, (level, strength), strict=True)
            )
        if len(level) > 1:
            self._compare(level, strength)
        self._before = level[-1:], strength[-1:]

    def _compare(
        self, level: Float[np.ndarray, "frames rows columns"], strength: Float[np.ndarray, "frames lines"]
    ) -> None:
        """Each frame with the one before it."""
        with np.errstate(invalid="ignore", divide="ignore"):
            rise = np.log(strength[1:] / strength[:-1])
        both = np.isfinite(strength[1:]) & np.isfinite(strength[:-1])
        enough = both.sum(axis=1) >= _LEAST_LINES
        self._strength_rise += np.where(enough, _median(rise, both), np.nan).tolist()
        levels = _rises(level)
        self._level_rise += levels.tolist()
        by = np.nan_to_num(levels)
        still = np.abs(by) <= math.log(_JUMP)
        # What rises everywhere alike is another exposure, or another lamp.
        change = (level[1:] - level[:-1] * np.exp(by)[:, None, None])[still]
        half = level.shape[2] // 2
        left, right = (np.median(part, axis=2) for part in (change[..., :half], change[..., half:]))
        # The median of the lit rows: where an edge has moved over all columns a row changes too, but few rows do.
        lit = np.median(level[:-1][still], axis=2) > _LEAST_LEVEL
        self._bands += np.nan_to_num(_median(left * right, lit)).tolist()

    def notes(self, exposures_known: bool, background: bool, grey: bool) -> list[str]:
        """What is wrong, and what to do.

        Args:
            exposures_known: whether the scan says how long each frame was exposed.
            background: whether a photograph with the laser off is subtracted.
            grey: whether the laser's colour is grey, so that no colour tells it from the room's light.
        """
        return [
            *self._smoothed(),
            *self._profile(),
            *self._colours(),
            *self._overexposed(),
            *([] if exposures_known else self._jumps(background)),
            *self._flicker(background),
            *([] if background else self._lit_room(grey)),
        ]

    def _smoothed(self) -> list[str]:
        alike = [by for by in self._correlation if by]
        if not alike or len(alike) < _MANY_FRAMES * len(self._correlation):
            return []
        return [
            f"the noise of neighbouring pixels is alike (correlation {np.median(alike):.2f} in {len(alike)} of "
            f"{len(self._correlation)} frames), as in photographs that were denoised or enlarged, or of a surface with "
            "a fine texture: σ was widened for it, and is not to be trusted to better than a factor of three where a "
            "filter keeps edges: switch noise reduction off, and save photographs as the sensor sees them"
        ]

    def _profile(self) -> list[str]:
        said = no_bell(self._odd, self._black, "frames")
        return [] if said is None else [f"the stripe's {said}"]

    def _colours(self) -> list[str]:
        count = sum(self._mosaic)
        if not count or count < _MANY_FRAMES * len(self._mosaic):
            return []
        return [
            f"the camera has a mosaic of colour filters (seen in {count} of {len(self._mosaic)} frames): the stripe "
            "was measured in the pixels that saw the laser's colour, every second one of a line, and neighbouring "
            "lines are not independent of each other: a monochrome camera shows the stripe better"
        ]

    def _lit_room(self, grey: bool) -> list[str]:
        differ, strength = np.array(self._differ), np.array(self._strength)
        known = np.isfinite(strength)
        share = _ROOM if grey else _ROOM_OF_COLOUR
        lit = known & (differ > _LEAST_ROOM) & (differ > share * np.nan_to_num(strength))
        if lit.sum() <= _MANY_FRAMES * known.sum():
            return []
        lost = (
            "along silhouettes and edges of shadows points are less exact than σ says or are lost, and lit borders may "
            "be taken for the stripe: switch other light off, put a filter of the laser's colour before the lens"
            if grey
            else "on dark paint points are lost, and paint of the laser's colour may be taken for the stripe: switch "
            "other light off"
        )
        return [
            f"the light of the room differs by {np.median(differ[lit]):.0f} grey levels within these "
            f"{'grey ' * grey}photographs, and the stripe stands {np.median(strength[lit]):.0f} levels high: {lost}, "
            'or photograph each frame with the laser off too (scanner scan --dark, background = "dark/*.png" in '
            "scan.toml; one such photograph is enough where nothing but the light moves)"
        ]

    def _overexposed(self) -> list[str]:
        full = np.array(self._full)
        many = np.flatnonzero(full > _MANY_FULL)
        if not len(many):
            return []
        worst = int(np.argmax(full))
        return [
            f"{len(many)} of {len(full)} frames are overexposed: more than {_MANY_FULL:.0%} of their pixels are full "
            f"(frame {worst}: {full[worst]:.0%}), and there the laser does not show: expose shorter, close the lens, "
            "or shade other light"
        ]

    def _jumps(self, background: bool) -> list[str]:
        level, strength = np.array(self._level_rise), np.array(self._strength_rise)
        least = math.log(_JUMP)
        jumps = np.abs(np.nan_to_num(level)) > least
        exposed = jumps & (np.sign(level) * strength > _WITH_IT * np.abs(level))
        # In the dark only the stripe shows it: the object changes it too, but not in frame after frame.
        dark = np.isnan(level) & (np.abs(np.nan_to_num(strength)) > least)
        if dark.sum() > max(_MANY_JUMPS * len(level), _LEAST_PAIRS):
            jumps, exposed, level = jumps | dark, exposed | dark, np.where(np.isnan(level), strength, level)
        if not jumps.any():
            return []
        sizes = np.where(jumps, np.abs(level), 0.0)
        first = int(np.argmax(sizes))
        times, most = int(jumps.sum()), math.exp(sizes[first])
        said = (
            f"between neighbouring frames {times} time{'s' if times > 1 else ''}, by up to a factor of {most:.1f} "
            f"(frames {first} and {first + 1})"
        )
        if exposed.any():
            return [
                f"the exposure changes {said}: fix it; of steps that are photographed with several exposures list "
                "exposures_s in scan.toml, and the same step for each of them"
            ]
        return [
            f"the light beside the stripe changes {said}: a lamp was switched, or the exposure is not fixed: leave "
            "lamps as they are, fix the exposure, or list exposures_s in scan.toml"
            + (", and take a background for each frame" if background else "")
        ]

    def _flicker(self, background: bool) -> list[str]:
        if len(self._bands) < _LEAST_PAIRS:
            return []
        # The difference of two frames has the variance of both.
        amplitude = math.sqrt(max(float(np.median(self._bands)), 0.0))
        level = float(np.median(self._level))
        if amplitude < max(_BANDS * level, _LEAST_BANDS):
            return []
        return [
            f"bands of light move over the photographs, {amplitude:.1f} grey levels (RMS) from one frame to the next: "
            "a lamp flickers"
            + (", and subtracting the background does not take it away" if background else "")
            + ": expose for a multiple of half the mains' period (1/100 or 1/120 s), or switch the lamp off. An object "
            "with printed lines along the rows, which move from frame to frame, looks the same"
        ]


def _rises(level: Float[np.ndarray, "frames rows columns"]) -> Float[np.ndarray, "pairs"]:
    """How much levels rise everywhere from frame to frame, in logarithms: by the quarter that changes least.

    0 where quarters of the photograph disagree, for then something moves; NaN where fewer than three are lit.
    """
    before, after = level[:-1], level[1:]
    lit = (before > _LEAST_LEVEL) | (after > _LEAST_LEVEL)
    rise = np.log((after + 1) / (before + 1))
    quarters = [
        [
            np.reshape(part, (len(part), -1))
            for rows in np.array_split(each, 2, axis=1)
            for part in np.array_split(rows, 2, 2)
        ]
        for each in (rise, lit)
    ]
    found = np.stack([_median(*of) for of in zip(*quarters, strict=True)], axis=1)
    lit_enough = np.stack([on.sum(axis=1) >= _LEAST_PIXELS for on in quarters[1]], axis=1)
    least = np.take_along_axis(found, np.where(lit_enough, np.abs(found), np.inf).argmin(axis=1)[:, None], axis=1)[:, 0]
    signs = np.sign(found)
    agree = [(lit_enough <= (signs == sign)).all(axis=1) for sign in (-1, 0, 1)]
    return np.where(lit_enough.sum(axis=1) < _LEAST_QUARTERS, np.nan, np.where(np.any(agree, axis=0), least, 0.0))


def _median(values: Float[np.ndarray, "pairs some"], of: Bool[np.ndarray, "pairs some"]) -> Float[np.ndarray, "pairs"]:
    """The median of some of the values of each row; NaN where there are none."""
    ranked, count = np.sort(np.where(of, values, np.inf), axis=1), of.sum(axis=1)
    at = np.stack([np.maximum(count - 1, 0) // 2, np.minimum(count // 2, values.shape[1] - 1)], axis=1)
    middle = np.take_along_axis(ranked, at, axis=1)
    return np.where(count > 0, middle.mean(axis=1), np.nan)
