"""A stripe on a surface of many colours in the light of a room: error of its place over gravity's, σ, what is kept.

Eight drawn frames in colour, without a photograph with the laser off. The surface has patches of paint, whose edges the
stripe crosses at all angles; on each it is as bright as the paint reflects the laser's light, with a speckle of
contrast 0.2. The room's light is white or that of a warm lamp. A row has a laser that is dim beside the room's light,
another one a lens that shows the other two colours 0.3 px further on. Columns near a step of depth are not asked.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float, UInt
from scipy.ndimage import gaussian_filter, shift
from scipy.spatial import KDTree

from benchmarks.cameras import on_sensor, rounded
from benchmarks.cup_jpeg import Against
from benchmarks.frame_sigma import Color
from benchmarks.metric import Metric
from benchmarks.stray_light import drawn_laser
from benchmarks.video import beside_no_step
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripe_settings import CHANNELS

_FRAMES, _WIDTH, _SPECKLE, _BLUR_PX, _READ = 8, 1.3, 0.2, 0.65, 1.5
# What paints reflect of red, green and blue.
_PAINTS: Final = np.array(
    [(0.74, 0.73, 0.70), (0.36, 0.40, 0.50), (0.62, 0.42, 0.30), (0.20, 0.20, 0.20), (0.45, 0.60, 0.40)]
)
# Pixels to a patch, about; levels of the room's light on white.
_PATCH_PX: Final = 24
_WHITE, _WARM = np.array([100.0, 100.0, 100.0]), np.array([120.0, 100.0, 78.0])
# A point that is further off than this is none of the stripe, px.
_STRAY_PX: Final = 3.0


class Row(NamedTuple):
    """What is photographed: the laser's colour and height on white, and the room's light.

    How far the other channels are apart from the laser's own, px, and what they have of its light.
    """

    color: Color
    height: float
    room: Float[np.ndarray, "rgb"]
    apart_px: float = 0.0
    leak: tuple[float, float, float] = (1.0, 0.06, 0.03)


ROWS: Final = {
    "red": Row("red", 150.0, _WARM),
    "green": Row("green", 150.0, _WARM),
    "blue": Row("blue", 150.0, _WARM),
    "white_room": Row("red", 150.0, _WHITE),
    "dim": Row("red", 60.0, _WARM),
    "no_room": Row("red", 150.0, 0.03 * _WARM),
    "colours_apart": Row("red", 150.0, _WARM, 0.3, (1.0, 0.3, 0.1)),
}
_QUICK: Final = ("red",)


def measure(quick: bool) -> list[Metric]:
    """All rows, or the first."""
    metrics = []
    print("  RMS px, over gravity; σ over the error; beyond half a pixel, % (of gravity); kept, strays, %")
    asked = beside_no_step(_FRAMES)
    for name in _QUICK if quick else ROWS:
        row = ROWS[name]
        photographs, truth = painted(row)
        found = Against.create(photographs, truth, asked, StripeSettings(row.color))
        stripe = detect_stripe(photographs, StripeSettings(row.color))
        off = np.abs(np.where(stripe.valid, stripe.position, np.nan) - truth)
        with np.errstate(invalid="ignore"):
            kept, strays = 100 * np.mean(off[asked] < _STRAY_PX), 100 * np.mean(off[asked] >= _STRAY_PX)
        print(
            f"    {name:14} {found.rms:.3f} {found.rms / found.other:.2f}   {found.sigma:.2f}   {found.far:.1f} "
            f"({found.far_other:.1f})   {kept:.1f} {strays:.2f}",
            flush=True,
        )
        metrics += found.metrics(f"painted.{name}", None)
        metrics += [
            Metric(f"painted.{name}.beyond_half_a_pixel", found.far, "%", "lower", None, 0.1, floor=1.0),
            Metric(f"painted.{name}.kept", float(kept), "%", "higher", None, 0.01),
            Metric(f"painted.{name}.strays", float(strays), "%", "lower", None, 0.1, floor=0.2),
        ]
    return metrics


def painted(row: Row) -> tuple[UInt[np.ndarray, "frames rows columns 3"], Float[np.ndarray, "frames columns"]]:
    """The photographs, and where the stripe is."""
    random = np.random.default_rng(1)
    laser, truth = drawn_laser(_WIDTH, row.height, _SPECKLE, random)
    rows, columns = laser.shape[1:]
    centres = random.uniform((0, 0), (rows, columns), (rows * columns // _PATCH_PX**2, 2))
    at = np.indices((rows, columns)).reshape(2, -1).T
    paint = _PAINTS[random.integers(len(_PAINTS), size=len(centres))]
    reflected = paint[KDTree(centres).query(at)[1]].reshape(rows, columns, 3)
    own, *others = CHANNELS[row.color]
    leak = np.empty(3)
    leak[[own, *others]] = row.leak
    light = row.room * gaussian_filter(reflected, (_BLUR_PX, _BLUR_PX, 0))
    light = light + (laser * reflected[..., own])[..., None] * leak
    for each in others:
        light[..., each] = shift(light[..., each], (0, row.apart_px, 0), order=3, mode="nearest")
    return rounded(on_sensor(light, random, read=_READ)), truth
