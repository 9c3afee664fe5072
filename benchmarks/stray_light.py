"""Light beside a stripe that is none of its own: error of the stripe's place over gravity's, σ over the error.

Eight drawn frames of a red stripe on textured ground, as in `cameras`. In runs of forty columns a second reflection
lies beside it, broader and weaker, with a speckle of its own; these columns are asked. Or the light of the room ends
at an edge that winds about the stripe and crosses it again and again, in photographs that are grey; all are asked. Or
it has a step that goes along with the stripe: on its dark side in a third of the columns, which are asked, as beside an
object; on its bright side in all.
"""

from itertools import product
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, UInt
from scipy.special import ndtr

from benchmarks.cameras import on_sensor, rounded
from benchmarks.cup_jpeg import Against
from benchmarks.metric import Metric
from benchmarks.video import COLOURS, beside_no_step, moving_light, texture
from jaxscan.images import StripeSettings

_FRAMES: Final = 8
# Height of the stripe; light of the scene and how it varies; the sensor's noise.
_HEIGHT, _GROUND, _VARIES, _READ = 170.0, 12.0, 3.6, 0.5
# The reflection: of the stripe's height, how far beside it, px, and over its width; the columns of a run.
_SHARES, _APART_PX, _BROADER, _RUN = (0.0, 0.03, 0.07, 0.15, 0.3), (4, 6, 8), 1.5, 40
_WIDTHS, _SPECKLES = (1.2, 2.0), (0.2, 0.0)
# The room's light beyond its edge, levels; how far the edge winds about the stripe, px, and the columns of a radian.
_ROOM, _WINDS_PX, _OVER = (5.0, 15.0, 40.0), 10.0, 60.0
# The step: of the stripe's height, and how far beside it, px; negative where the stripe is on the bright side.
_STEPS, _BESIDE_PX = (0.1, 0.2, 0.4), (1.5, 3.0, 4.5, 6.0, -2.0, -3.0)
_STRIPE, _BLUR_PX = 120.0, 0.65
# Heights of burnt-out stripes, beside a step of 48 levels in a third of the columns.
_BURNT: Final = (400.0, 1500.0)
_QUICK_SHARES, _QUICK_APART_PX = (0.0, 0.15), (5,)


def measure(quick: bool) -> list[Metric]:
    """Reflections and the room's light; in the short form one reflection, with speckle."""
    shares, apart = (_QUICK_SHARES, _QUICK_APART_PX) if quick else (_SHARES, _APART_PX)
    metrics = []
    print("  reflection: RMS px, over gravity, σ over the error, beyond half a pixel % (of gravity)")
    for speckle, width, share in product(_SPECKLES[: 1 if quick else None], _WIDTHS, shares):
        for beside in apart if share else apart[:1]:
            name = f"reflection.speckle_{speckle:g}.width_{width:g}.share_{share:g}.apart_{beside}"
            metrics += _against(name, *with_reflection(width, speckle, share, beside), StripeSettings("red"))
    if not quick:
        for speckle, levels in product(_SPECKLES, _ROOM):
            metrics += _against(
                f"room.speckle_{speckle:g}.levels_{levels:g}", *in_a_room(speckle, levels), StripeSettings("grey")
            )
        for speckle, share, apart in product(_SPECKLES, _STEPS, _BESIDE_PX):
            name = f"step.speckle_{speckle:g}.share_{share:g}.apart_{apart:g}"
            metrics += _against(name, *beside_a_step(speckle, share, apart), StripeSettings("grey"))
        for height, apart in product(_BURNT, (3.0, 5.0, -3.0, -5.0)):
            name = f"step.burnt_{height:g}.apart_{apart:g}"
            metrics += _against(name, *beside_a_step(0.2, 0.4, apart, height), StripeSettings("grey"))
    return metrics


def _against(
    name: str,
    photographs: UInt[np.ndarray, "frames rows columns *rgb"],
    truth: Float[np.ndarray, "frames columns"],
    asked: Bool[np.ndarray, "frames columns"],
    settings: StripeSettings,
) -> list[Metric]:
    found = Against.create(photographs, truth, asked, settings)
    print(
        f"    {name:62s} {found.rms:.3f} {found.rms / found.other:.2f}   {found.sigma:.2f}   {found.far:.1f} "
        f"({found.far_other:.1f})",
        flush=True,
    )
    far = Metric(f"stray_light.{name}.beyond_half_a_pixel", found.far, "%", "lower", None, 0.1, floor=1.0)
    return [*found.metrics(f"stray_light.{name}", None), far]


Drawn = tuple[
    UInt[np.ndarray, "frames rows columns *rgb"],
    Float[np.ndarray, "frames columns"],
    Bool[np.ndarray, "frames columns"],
]


def with_reflection(width: float, speckle: float, share: float, apart: int) -> Drawn:
    """Photographs of a stripe with a weaker one beside it, where it is, and which columns have both."""
    random = np.random.default_rng(1)
    laser, truth = drawn_laser(width, _HEIGHT, speckle, random)
    there = np.broadcast_to(np.arange(truth.shape[1]) // _RUN % 3 == 1, truth.shape)
    if share:
        reflected, _ = drawn_laser(_BROADER * width, share * _HEIGHT, speckle, random)
        laser = laser + np.where(there[:, None], np.roll(reflected, apart, axis=1), 0.0)
    light = texture(_GROUND, _VARIES)[..., None] + laser[..., None] * COLOURS
    return rounded(on_sensor(light, random, read=_READ)), truth, there & beside_no_step(_FRAMES)


def in_a_room(speckle: float, levels: float) -> Drawn:
    """Grey photographs with an edge of the room's light that winds about the stripe; where that is; all columns."""
    random = np.random.default_rng(1)
    laser, truth = drawn_laser(_WIDTHS[0], _HEIGHT, speckle, random)
    edge = truth + _WINDS_PX * np.sin(np.arange(truth.shape[1]) / _OVER + np.arange(_FRAMES)[:, None])
    beyond = np.clip(np.arange(laser.shape[1])[:, None] - edge[:, None] + 0.5, 0, 1)
    light = texture(_GROUND, _VARIES) + laser + levels * beyond
    return rounded(on_sensor(light, random, read=_READ)), truth, beside_no_step(_FRAMES)


def beside_a_step(speckle: float, share: float, apart: float, height: float = _STRIPE) -> Drawn:
    """Grey photographs with a step of the room's light that goes along with the stripe; where that is; who is asked.

    The stripe may be higher than what `share` is of, so that it is burnt out.
    """
    random = np.random.default_rng(1)
    laser, truth = drawn_laser(_WIDTHS[0], height, speckle, random)
    there = np.broadcast_to(np.arange(truth.shape[1]) // _RUN % 3 == 1, truth.shape)
    there = there | (apart < 0) & (height == _STRIPE)
    far = np.arange(laser.shape[1])[:, None] - truth[:, None] - apart
    beyond = np.where(there[:, None], ndtr(far / _BLUR_PX), 0.0)
    light = texture(_GROUND, _VARIES) + laser + share * _STRIPE * beyond
    return rounded(on_sensor(light, random, read=_READ)), truth, there & beside_no_step(_FRAMES)


def drawn_laser(
    width: float, height: float, speckle: float, random: np.random.Generator
) -> tuple[Float[np.ndarray, "frames rows columns"], Float[np.ndarray, "frames columns"]]:
    """The laser's light in all frames, and where its stripe is."""
    light, centre = zip(*moving_light(width, height, speckle, random, _FRAMES), strict=True)
    return np.stack(light), np.stack(centre)
