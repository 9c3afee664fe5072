"""What is no stripe, and weak light: strays and how much of the stripe is kept, in drawn photographs and a drawn scan.

A stray is a point further than 3 px from the stripe, or where there is none; the share further than 1 mm off is that of
points taken to space by the simulated rig of 2003. Kept is the part of the columns with a stripe that have a point
within 3 px of it; columns in which something as bright lies on the stripe are not asked for.
"""

import tempfile
from pathlib import Path
from typing import Final, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from benchmarks.cluttered import COLUMNS, KINDS, ROWS, Drawn, course, photograph, reflectances
from benchmarks.metric import Metric
from jaxscan.files.axes import STAGE
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings, detect_stripe, write_image
from jaxscan.reconstruction import Kernel, reconstruct
from jaxscan.reconstruction.triangulate import FramePoses, triangulate
from jaxscan.rig import Fixed, Rig
from jaxscan.simulation import rig_2003, true_profile
from jaxscan.simulation.shapes import box, cup

Color = Literal["red", "green", "blue", "grey"]

_STRAY_PX, _STRAY_MM = 3.0, 1.0
_WIDTHS = (0.8, 1.5, 3.0)
_LASERS: Final[dict[Color, Float[np.ndarray, "3"]]] = {
    "red": np.array([1.0, 0.06, 0.04]),
    "green": np.array([0.05, 1.0, 0.06]),
    "blue": np.array([0.03, 0.08, 1.0]),
    "grey": np.ones(3),
}
_SCAN = ("highlight", "ghost", "lamp")
# Peaks in grey levels, read noise, σ in px.
_WEAK = (30, 57, 114, 200), (2, 5, 10, 15, 20), (0.8, 1.5, 2.5, 4.0)
_WEAK_QUICK = (57, 114), (5, 15), (0.8, 1.5, 4.0)

Marks = Bool[np.ndarray, "frames columns"]


class Counts(NamedTuple):
    """Points, and columns with a stripe."""

    points: int
    stray_px: int
    stray_mm: int
    columns: int
    kept: int

    @staticmethod
    def of(found: Marks, near: Marks, close: Marks, asked: Marks) -> "Counts":
        """Which lines have a point, near the stripe in the image, near it in space; which have a stripe to be found."""
        strays = found & ~near, found & ~close
        return Counts(*(int(each.sum()) for each in (found, *strays, asked, asked & near)))

    def shares(self) -> tuple[float, float, float]:
        """Strays in pixels and in mm of all points, and the part of the stripe that is kept."""
        return (
            self.stray_px / max(self.points, 1),
            self.stray_mm / max(self.points, 1),
            self.kept / max(self.columns, 1),
        )


def measure(quick: bool) -> list[Metric]:
    """All figures; in the short form fewer seeds, colours and cells."""
    return frames(quick) + scan(quick) + weak(quick)


def frames(quick: bool) -> list[Metric]:
    """Each kind of clutter alone, all together, and none, in photographs of their own."""
    rig, seeds = rig_2003.simulated_rig(0), 4 if quick else 16
    kernel, metrics = Kernel.create(rig), []
    print("  points further than 3 px off, than 1 mm off; stripe kept, %")
    colors: tuple[Color, ...] = ("red", "grey") if quick else tuple(_LASERS)
    for color in colors:
        for name in ("none", *KINDS, "all"):
            kinds = [] if name == "none" else list(KINDS) if name == "all" else [name]
            drawn = [_drawn(seed, kinds, s, color) for seed in range(seeds) for s in _WIDTHS]
            images = np.stack([one.image for one in drawn])
            position = detect_stripe(images[..., 0] if color == "grey" else images, StripeSettings(color)).position
            px, mm, kept = _counted(kernel, position, drawn).shares()
            print(f"    {color:6} {name:15} {100 * px:8.3f} {100 * mm:8.3f} {100 * kept:8.2f}", flush=True)
            goal = color != "grey"
            stem = f"clutter.{color}.{name}"
            metrics.append(Metric(f"{stem}.stray_mm", mm, "", "lower" if goal else "shown", 1e-3, floor=1e-3))
            metrics.append(Metric(f"{stem}.kept", kept, "", "higher" if goal else "shown", 0.98, floor=0.003))
    return metrics


def _drawn(seed: int, kinds: list[str], s: float, color: Color) -> Drawn:
    random = np.random.default_rng([seed, int(10 * s), len(color)])
    centre, height = course(random)
    return photograph(centre, height, s, kinds, random, _LASERS[color])


def _counted(kernel: Kernel, position: Float[np.ndarray, "frames columns"], drawn: list[Drawn]) -> Counts:
    centre = np.stack([one.centre for one in drawn])
    asked = np.isfinite(centre) & ~np.stack([one.hidden for one in drawn])
    found = np.isfinite(position)
    with np.errstate(invalid="ignore"):
        near = np.abs(position - centre) <= _STRAY_PX
        close = np.linalg.norm(_points(kernel, position) - _points(kernel, centre), axis=-1) <= _STRAY_MM
    return Counts.of(found, near, close, asked)


def _points(kernel: Kernel, position: Float[np.ndarray, "frames columns"]) -> Float[np.ndarray, "frames columns 3"]:
    u = np.broadcast_to(np.arange(COLUMNS, dtype=np.float32), position.shape)
    still = FramePoses.create(Fixed(), {}, len(position))
    return np.asarray(triangulate(kernel, still, *(jnp.asarray(x, np.float32) for x in (u, position))))


def scan(quick: bool) -> list[Metric]:
    """A whole scan of a block and a cup, with what else is bright standing still."""
    rig, counts = rig_2003.simulated_rig(0), []
    for seed in range(1 if quick else 4):
        with tempfile.TemporaryDirectory() as name:
            counts.append(_scanned(rig, Path(name), seed, 10 if quick else 37))
    px, mm, kept = Counts(*np.sum(counts, axis=0)).shares()
    print(f"    a scan with {', '.join(_SCAN)}: {100 * px:.3f} {100 * mm:.3f} {100 * kept:.2f}", flush=True)
    return [
        Metric("clutter.scan.stray_mm", mm, "", "lower", 1e-3, floor=1e-3),
        Metric("clutter.scan.kept", kept, "", "higher", 0.98, floor=0.003),
    ]


def _scanned(rig: Rig, folder: Path, seed: int, frames: int) -> Counts:
    y = rig_2003.OBJECT_Y
    block = box(y, (40.0, 40.0, 25.0)).moved(np.eye(3), np.array([-45.0, 0.0, 0.0]))
    bodies = (block, *(body.moved(np.eye(3), np.array([30.0, 0.0, 0.0])) for body in cup(y)))
    scene, apart = rig_2003.scan_scene(rig, bodies), 74000 // frames
    random = np.random.default_rng([seed, 1])
    height, steps, paths, drawn, true = reflectances(random), [], [], [], []
    for i in range(frames):
        profile = true_profile(rig, scene, {"stage": apart * i})
        # What stands still has its own generator, begun again for each photograph; the ghost goes with the stripe.
        own = np.random.default_rng([seed, 2, i])
        one = photograph(profile.position, height, 1.2, _SCAN, own, still=np.random.default_rng([seed, 3]))
        drawn.append(one)
        true.append(profile.points)
        paths.append(folder / f"{i:03d}.png")
        write_image(paths[-1], one.image)
        steps.append(apart * i)
    photographs = Scan(folder / "scan.toml", StripeSettings("red"), tuple(paths), axes={STAGE: tuple(steps)})
    # As its boards were held.
    image = reconstruct(RigFile(rig, None, {"stripe_depths_mm": [310.0, 380.0]}), photographs)
    centre, asked = np.stack([one.centre for one in drawn]), ~np.stack([one.hidden for one in drawn])
    with np.errstate(invalid="ignore"):
        near = np.abs(image.pixels - centre) <= _STRAY_PX
        close = np.linalg.norm(image.points - np.stack(true), axis=-1) <= _STRAY_MM
    asked &= np.isfinite(centre)
    return Counts.of(image.valid, near, close, asked)


def weak(quick: bool) -> list[Metric]:
    """Straight stripes of even height in noise: columns kept and strays, over peak, noise and width."""
    peaks, noises, widths = (
        ((57, 114), (5, 15), (0.8, 1.5, 4.0))
        if quick
        else ((30, 57, 114, 200), (2, 5, 10, 15, 20), (0.8, 1.5, 2.5, 4.0))
    )
    metrics = []
    print("  weak light, red (grey): peak, noise, σ px; columns kept and strays, %")
    for peak in peaks:
        for noise in noises:
            for s in widths:
                cells = [_weak(peak, noise, s, "red"), _weak(peak, noise, s, "grey")]
                text = "  ".join(f"{100 * kept:7.2f} {100 * stray:7.3f}" for kept, stray in cells)
                print(f"    {peak:4} {noise:4} {s:4}   {text}", flush=True)
                if (peak, noise) == (114, 15):
                    kept, stray = np.array(cells)[:, 0].min(), np.array(cells)[:, 1].max()
                    metrics.append(Metric(f"clutter.weak.{s}.kept", kept, "", "higher", 0.95, floor=0.01))
                    metrics.append(Metric(f"clutter.weak.{s}.stray", stray, "", "lower", 2e-3, floor=1e-3))
    return metrics


def _weak(peak: float, noise: float, s: float, color: Color) -> tuple[float, float]:
    random = np.random.default_rng([int(peak), int(noise), int(10 * s)])
    v = np.arange(ROWS)[:, None]
    centre = ROWS / 2 + 60 * np.sin(np.arange(COLUMNS) / 110)
    images = []
    for _ in range(2):
        light = 60 + (peak * np.exp(-0.5 * ((v - centre) / s) ** 2))[..., None] * _LASERS[color]
        images.append(np.rint(light + noise * random.standard_normal(light.shape)).clip(0, 255).astype(np.uint8))
    shown = np.stack(images)
    position = detect_stripe(shown[..., 0] if color == "grey" else shown, StripeSettings(color)).position
    found = np.isfinite(position)
    with np.errstate(invalid="ignore"):
        near = np.abs(position - centre) <= _STRAY_PX
    return float((found & near).mean()), float((found & ~near).sum() / max(found.sum(), 1))
