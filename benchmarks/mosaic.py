"""A stripe in photographs of a sensor with a mosaic of colour filters, whose colours were interpolated.

The photographs are those of `frame_sigma`, of lenses of several sharpness, with speckle. Of each pixel one colour is
kept, as of B. E. Bayer's pattern, and the others are interpolated: by means of neighbours (bilinear), along edges, by
variable gradients (both OpenCV's), or by means corrected by the other colours' second differences (H. Malvar, L. He,
R. Cutler 2004). Means are also sharpened by an unsharp mask; mixed by a colour matrix; encoded for a display; kept as
JPEG of quality 90 with colours at half resolution; and encoded, sharpened and kept so, as a webcam does. Errors are
over those of the same photographs in full colour and over those of the plain centre of gravity. σ over the error is as
in `cup_jpeg`.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float
from scipy.ndimage import correlate

from benchmarks.cup_jpeg import as_jpeg, errors, rms_of
from benchmarks.frame_sigma import HIGH, LOW, at_edges, developed, draw, ratio
from benchmarks.metric import Metric
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.simulation import rig_2003
from jaxscan.simulation.mosaic import Photograph, mosaic, through_mosaic
from jaxscan.simulation.shapes import cup

# Standard deviation of the lens's point spread, px: its stripes have 0.75, 1.0, 1.3 and 2.1 px.
_BLURS, _BLURS_QUICK = (0.6, 0.9, 1.2, 2.0), (0.9,)
_MATRIX: Final = np.array([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [-0.1, -0.5, 1.6]])
# Green where red or blue is; red where green is, in rows of red, and in columns of red; red where blue is.
_GREEN: Final = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]) / 8
_IN_ROWS: Final = (
    np.array([[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]]) / 8
)
_ACROSS: Final = (
    np.array([[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]) / 8
)


def measure(quick: bool) -> list[Metric]:
    """Every fourth photograph of each lens; in the short form every twelfth of one."""
    rig, metrics = rig_2003.simulated_rig(0), []
    scene = rig_2003.scan_scene(rig, cup(rig_2003.OBJECT_Y))
    for blur in _BLURS_QUICK if quick else _BLURS:
        lighting = replace(rig_2003.SCAN_LIGHTING, speckle=rig_2003.SPECKLE)
        sensor = replace(rig_2003.SENSOR, blur_px=blur)
        photographs, truth = draw(rig, scene, lighting, 12 if quick else 4, sensor)
        photographs, asked = developed(photographs, "colour"), ~at_edges(truth)
        full = rms_of(errors(detect_stripe(photographs, StripeSettings("red")), truth, asked)[0])
        print(f"  blur {blur:g} px, in full colour {full:.4f} px")
        print("    RMS px, over full colour, over gravity; σ over the error; taken for a mosaic")
        for how, interpolated in INTERPOLATED.items():
            seen = np.stack([interpolated(each) for each in photographs])
            own, by_gravity = (
                detect_stripe(seen, StripeSettings("red"), detector=name) for name in ("likelihood", "gravity")
            )
            off, sigma = errors(own, truth, asked)
            rms, other = rms_of(off), rms_of(errors(by_gravity, truth, asked)[0])
            honest, share = ratio(off / sigma), float(own.mosaic.mean())
            print(
                f"    {how:10} {rms:.4f} {rms / full:.2f} {rms / other:.2f}   {honest:.2f}   {share:.2f}",
                flush=True,
            )
            name = f"mosaic.blur_{blur:g}.{how}"
            metrics += [
                Metric(f"{name}.rms", rms, "px", "lower", None, 0.1),
                Metric(f"{name}.over_full_colour", rms / full, "", "lower", None, 0.1),
                Metric(f"{name}.over_gravity", rms / other, "", "lower", 1.0, 0.1),
                Metric(f"{name}.sigma_at_least", honest, "", "higher", LOW, 0.1),
                Metric(f"{name}.sigma_at_most", honest, "", "lower", HIGH, 0.1),
                Metric(f"{name}.taken", share, "", "higher", None, 0.1),
            ]
    return metrics


def _corrected(photograph: Photograph) -> Photograph:
    m = mosaic(photograph).astype(float)
    rows, columns = np.indices(m.shape) % 2
    red, blue = (rows == 0) & (columns == 0), (rows == 1) & (columns == 1)
    green, in_rows, in_columns, across = (
        correlate(m, kernel, mode="mirror") for kernel in (_GREEN, _IN_ROWS, _IN_ROWS.T, _ACROSS)
    )
    both = np.where(red | blue, green, m)
    r = np.where(red, m, np.where(blue, across, np.where(rows == 0, in_rows, in_columns)))
    b = np.where(blue, m, np.where(red, across, np.where(rows == 1, in_rows, in_columns)))
    return _levels(np.stack([r, both, b], axis=-1))


def sharpened(levels: Float[np.ndarray, "rows columns 3"], by: float) -> Float[np.ndarray, "rows columns 3"]:
    """By an unsharp mask of 1 px."""
    return levels + by * (levels - cv2.GaussianBlur(levels, (0, 0), 1.0))


def encoded(levels: Float[np.ndarray, "*of 3"]) -> Float[np.ndarray, "*of 3"]:
    """Levels of 0 to 255 as they are encoded for a display, IEC 61966-2-1."""
    light = levels / 255.0
    return 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def _sharpened(photograph: Photograph) -> Photograph:
    return _levels(sharpened(photograph.astype(np.float32), 1.0))


def _encoded(photograph: Photograph) -> Photograph:
    return _levels(encoded(photograph))


def _levels(light: Float[np.ndarray, "rows columns 3"]) -> Photograph:
    return np.rint(np.clip(light, 0, 255)).astype(np.uint8)


INTERPOLATED: Final[dict[str, Callable[[Photograph], Photograph]]] = {
    "bilinear": through_mosaic,
    "edges": lambda x: cv2.cvtColor(mosaic(x), cv2.COLOR_BayerBG2RGB_EA),
    "gradients": lambda x: cv2.cvtColor(mosaic(x), cv2.COLOR_BayerBG2RGB_VNG),
    "corrected": _corrected,
    "sharpened": lambda x: _sharpened(through_mosaic(x)),
    "matrix": lambda x: _levels(through_mosaic(x) @ _MATRIX.T),
    "encoded": lambda x: _encoded(through_mosaic(x)),
    "jpeg": lambda x: as_jpeg(through_mosaic(x)[None], 90, "420")[0],
    "webcam": lambda x: as_jpeg(_sharpened(_encoded(through_mosaic(x)))[None], 90, "420")[0],
}
