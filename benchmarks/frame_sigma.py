"""Predicted σ of stripe positions over their actual scatter, in each frame of the simulated scan of a cup.

The scan is that of the simulated rig of 2003, with and without speckle, drawn once in 16 bits; from it come photographs
of 8 bits in colour, of 12 bits kept in 16, of a grey camera, and colour photographs whose laser is said to be grey. A
frame's ratio is 1 / RMS of error / σ, over points within 4 σ that are no closer than some columns to an edge of depth.
Of a perfect σ and the 180 to 330 points of a frame it is within 0.85 to 1.18 in 999 frames of 1000; the median of
|error / σ| would be in 968.
"""

from dataclasses import replace
from typing import Final, Literal

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from benchmarks.conditions import SCENES, SHORT
from benchmarks.metric import Metric
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.decode import NUMBERS_PER_LEVEL
from jaxscan.rig import Rig
from jaxscan.simulation import rig_2003
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.render import render
from jaxscan.simulation.scene import Scene
from jaxscan.simulation.shapes import cup

Color = Literal["red", "green", "blue", "grey"]

SPECKLES: Final = (0.0, 0.2)
LOW, HIGH = 0.85, 1.18
# Points whose true row jumps by more than this within this number of columns are at an edge of depth.
_JUMP_PX, _NEAR = 1.0, 4
_FEWEST: Final = 100
# What is further off, in σ, is counted among all points of a scan.
_FAR: Final = 4.0
# What the squares printed on the floor reflect, in parts of the floor, and the level of the lamp's reflection.
_INK, _HIGHLIGHT = 0.3, 900.0
_CAMERAS: Final[dict[str, Color]] = {"colour": "red", "twelve_bits": "red", "grey_camera": "grey", "grey_laser": "grey"}

# Where a column is looked at besides its middle, the nearest to it first, columns.
_PARTS_OF_COLUMN: Final = (-0.12, 0.12, -0.25, 0.25, -0.37, 0.37, -0.49, 0.49)

Photographs = np.ndarray


def measure(quick: bool) -> list[Metric]:
    """Every frame, or every sixth."""
    rig, every, metrics = rig_2003.simulated_rig(0), 6 if quick else 1, []
    scene = rig_2003.scan_scene(rig, cup(rig_2003.OBJECT_Y))
    for speckle in SPECKLES:
        photographs, truth = draw(rig, scene, replace(rig_2003.SCAN_LIGHTING, speckle=speckle), every)
        for camera, color in _CAMERAS.items():
            found = ratios(developed(photographs, camera), color, truth)
            print(f"  {camera}, speckle {speckle:g}: " + " ".join(f"{ratio:.2f}" for ratio in found), flush=True)
            name = f"frame_sigma.{camera}.speckle_{speckle:g}"
            inside = np.mean((found > LOW) & (found < HIGH))
            metrics += [
                Metric(f"{name}.least", found.min(), "", "higher", LOW, 0.1),
                Metric(f"{name}.most", found.max(), "", "lower", HIGH, 0.1),
                Metric(f"{name}.frames_within", float(inside), "", "higher", 1.0, floor=0.05),
            ]
    return metrics + whole(rig, every)


def whole(rig: Rig, every: int) -> list[Metric]:
    """Points within 1, 2 and 3 σ in all of a scan: speckle, a floor with printed squares, a burnt-out highlight.

    Nothing is left out: points at edges of depth and reflectance count, and so does what is no stripe. Where a surface
    ends within a column and its middle sees nothing, the truth is what the rest of the column sees.
    """
    scene, lighting = on_a_bench(rig)
    photographs, truth = draw(rig, scene, lighting, every)
    beside = [draw_truth(_sideways(rig, part), scene, lighting, every) for part in _PARTS_OF_COLUMN]
    for other in beside:
        truth = np.where(np.isfinite(truth), truth, other)
    stripe = detect_stripe(developed(photographs, "colour"), StripeSettings("red"))
    valid = np.asarray(stripe.valid)
    off = np.abs(np.asarray(stripe.position, np.float64) - truth)[valid] / np.asarray(stripe.sigma)[valid]
    shares = [float((off < n).mean()) for n in (1, 2, 3)]
    text = ", ".join(f"{100 * share:.1f}" for share in shares)
    print(f"  all of a scan, {valid.sum()} points: {text} % within 1, 2, 3 σ")
    return [
        Metric("frame_sigma.scan.within_1", shares[0], "", "higher", 0.62, floor=0.02),
        Metric("frame_sigma.scan.within_1_at_most", shares[0], "", "lower", 0.74, floor=0.02),
        Metric("frame_sigma.scan.within_2", shares[1], "", "higher", 0.93, floor=0.01),
        Metric("frame_sigma.scan.within_3", shares[2], "", "higher", 0.99, floor=0.005),
    ]


def on_a_bench(rig: Rig) -> tuple[Scene, Lighting]:
    """A scene with printed squares and a burnt-out highlight, and its light."""
    scene = SCENES["bench"](rig, replace(SHORT, floor_ink=_INK))
    scene = eqx.tree_at(lambda s: s.bodies, scene, tuple(replace(body, glossy=True) for body in scene.bodies))
    return scene, replace(
        rig_2003.SCAN_LIGHTING, speckle=0.2, highlight=_HIGHLIGHT, direction=rig_2003.mirrored_lamp(rig)
    )


def draw(
    rig: Rig, scene: Scene, lighting: Lighting, every: int, seen_by: Sensor = rig_2003.SENSOR
) -> tuple[Photographs, Float[np.ndarray, "frames columns"]]:
    """The photographs, 16 bits in colour, and the true row of the stripe in each column."""
    sensor = replace(seen_by, bits=16)
    images = [
        render(rig, scene, q={"stage": steps}, laser=0, lighting=lighting, sensor=sensor, seed=(2003, 0, 2, i))
        for i, steps in _stops(every)
    ]
    return np.stack(images), draw_truth(rig, scene, lighting, every)


def draw_truth(rig: Rig, scene: Scene, lighting: Lighting, every: int) -> Float[np.ndarray, "frames columns"]:
    """The true row of the stripe in the middle of each column."""
    return np.stack(
        [true_profile(rig, scene, {"stage": steps}, laser=0, lighting=lighting)[0] for _, steps in _stops(every)]
    )


def _stops(every: int) -> list[tuple[int, int]]:
    """Number and place of each photograph, motor steps."""
    return [(i, i * rig_2003.STEPS_APART) for i in range(0, rig_2003.SCAN_FRAMES, every)]


def _sideways(rig: Rig, part: float) -> Rig:
    """The rig whose columns are this part of a column further on."""
    return eqx.tree_at(lambda r: r.camera.principal[0], rig, rig.camera.principal[0] - part)


def developed(photographs: Photographs, camera: str) -> Photographs:
    """The photographs as a camera keeps them."""
    if camera == "twelve_bits":
        return photographs >> 4
    eight = np.rint(photographs / NUMBERS_PER_LEVEL).astype(np.uint8)
    return eight[..., 0] if camera == "grey_camera" else eight


def ratios(
    photographs: Photographs, color: Color, truth: Float[np.ndarray, "frames columns"]
) -> Float[np.ndarray, "frames"]:
    """σ over the actual scatter, in each frame that has enough points."""
    stripe = detect_stripe(photographs, StripeSettings(color))
    known = np.asarray(stripe.valid) & ~at_edges(truth)
    return frame_ratios(np.where(known, (np.asarray(stripe.position, np.float64) - truth) / stripe.sigma, np.nan))


def frame_ratios(off: Float[np.ndarray, "frames columns"]) -> Float[np.ndarray, "some_frames"]:
    """σ over the actual scatter in each frame that has enough points, from error / σ; NaN where there is none."""
    return np.asarray([ratio(each) for each in off if np.isfinite(each).sum() >= _FEWEST])


def ratio(off: Float[np.ndarray, "*points"]) -> float:
    """1 / RMS of error / σ, over what is not further off than 4."""
    with np.errstate(invalid="ignore"):
        return float(1 / np.sqrt(np.mean(off[np.abs(off) < _FAR] ** 2)))


def at_edges(truth: Float[np.ndarray, "frames columns"]) -> Bool[np.ndarray, "frames columns"]:
    """Which points are at an edge of depth, or have no truth."""
    jump = ~(np.abs(np.diff(truth, axis=1)) <= _JUMP_PX)
    jump = np.pad(jump, ((0, 0), (1, 1)), constant_values=True)
    at = ~np.isfinite(truth)
    for shift in range(-_NEAR, _NEAR + 1):
        at |= np.roll(jump, shift, axis=1)[:, :-1] | np.roll(jump, shift, axis=1)[:, 1:]
    return at
