"""Spacetime analysis against the detectors of one frame: at a border of reflectance, at edges of depth, over step size.

A cut-out of 96 columns of the simulated rig of 2003, its true rig, photographs rendered in 16 bits with a noise of a
hundredth of the stripe's peak; the surface moves by 0.45 px a frame.

- `reflectance`: a plane whose albedo falls from 0.9 to 0.09 along a line parallel to the stripe. RMS distance from the
  plane of the points of those frames in which the line is within two standard deviations of the sheet. The sheet is
  1.5 px wide (σ) and the lens ideal, as in the row of the detectors of one frame (`stripes.reflectance_step`); beside
  it with the blur of the rig of 2003, where a good part of the bright side's light is smeared over the dark, and with
  speckle.
- `depth`: a box of 8 mm on the plane. Share of the points within 4 mm of its front and back edges that are further than
  0.3 mm from every true surface, and how many points there are.
- `steps`: the scan of the first row with every second, fourth … frame: RMS distance of points far from the border.
- `sigma`: a plain wall, Gaussian stripes averaged over each pixel and even noise, drawn in numbers; the wall turned, so
  that its lines cross the sheet at every part of a pixel, and carried sideways too. Error of the position over its
  predicted σ, RMS over the lines of sixteen frames, over widths, noises (in parts of the peak) and steps between
  frames. `sigma_off` is the worst distance from 1. A stripe of 1 px is shown beside it: interpolated between pixels it
  is off by up to 4 % of its peak, which the detector cannot tell from noise.
"""

import tempfile
from itertools import product
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import erf

from benchmarks.metric import Metric
from jaxscan.detectors import DEFAULT, DETECTORS, Detector
from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings, write_image
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import RangeImage, reconstruct
from jaxscan.reconstruction.frames import Frames
from jaxscan.reconstruction.spacetime import Geometry, half_window, spacetime_profiles
from jaxscan.reconstruction.triangulate import FramePoses
from jaxscan.rig import Camera, LightPlane, Linear, Rig
from jaxscan.simulation import Lighting, Scene, Sensor, distance, render
from jaxscan.simulation.rig_2003 import platform, simulated_rig
from jaxscan.simulation.shapes import box, floor

_COLUMNS, _ROWS = 96, 220
# The image's first column and row in that of the whole camera.
_CORNER = (262.0, 132.0)
_SHEET_MM, _BLUR_PX = 0.82, 0.6
_STEPS, _MM_PER_STEP = 250, 0.001
_BRIGHT, _DARK, _PEAK = 0.9, 0.09, 200.0
_AMBIENT = 20.0
_NEAR_MM, _OFF_MM = 4.0, 0.3


class _World(NamedTuple):
    rig: Rig
    R: Float[np.ndarray, "3 3"]
    origin: Float[np.ndarray, "3"]


def measure(quick: bool) -> list[Metric]:
    """All figures; in the long form all detectors, and the edges of depth."""
    world = _world()
    with tempfile.TemporaryDirectory() as folder:
        return [
            *sigma(),
            *reflectance(Path(folder), world, ("gravity", "likelihood") if quick else tuple(DETECTORS)),
            *([] if quick else depth(Path(folder), world)),
        ]


def _world() -> _World:
    whole = simulated_rig(0)
    with float64():
        camera = Camera.create(
            (_COLUMNS, _ROWS),
            np.stack(whole.camera.focal),
            np.stack(whole.camera.principal) - _CORNER,
            "radial1",
            np.stack(jax.tree.leaves(whole.camera.lens)),
        )
        return _World(as_numpy(Rig(camera, whole.lights, whole.motion)), *platform(whole))


def sigma() -> list[Metric]:
    """Whether the predicted σ is the actual one."""
    return [
        Metric("spacetime.sigma_off", _sigma_off((1.5, 3.0)), "", "lower", 0.1, floor=0.02),
        Metric("spacetime.sigma_off.width_1_px", _sigma_off((1.0,))),
    ]


def _sigma_off(widths: tuple[float, ...]) -> float:
    worst = 0.0
    for width, noise, speed in product(widths, (0.01, 0.05), (0.5, 1.0)):
        over = _error_over_sigma(width, noise, speed)
        off = float(np.sqrt(np.mean(over**2)))
        print(f"  sigma: {width} px wide, noise {noise}, {speed} px a frame: {off:.3f} ({over.size} positions)")
        worst = max(worst, abs(off - 1))
    return worst


def _error_over_sigma(width: float, noise: float, speed: float) -> Float[np.ndarray, "positions"]:
    """Errors of drawn passages: the wall turns 1° about the stripe's normal line and moves in its own plane.

    A point that is τ too far along its ray r is off the wall, of normal n, by τ n · r, and its stripe would be off by
    τ / (r · ∂X/∂v) pixels.
    """
    lines, rows, focal, depth, steps_apart = 1024, 96, 600.0, 300.0, 100
    omega, normal = np.array([0.0, -0.005, 1 / depth]), np.array([-0.02, 0.0, 1.0])
    per_step = np.array([0.2, 1.0, 0.004]) * speed * depth / focal / steps_apart
    with float64():
        camera = Camera.create((lines, rows), [focal, focal], [lines / 2, rows / 2])
        rig = as_numpy(Rig(camera, (LightPlane.create(omega),), Linear.create(per_step)))

    def on_sheet(v: Float[np.ndarray, "frames lines"]) -> Float[np.ndarray, "frames lines 3"]:
        ray = _rays(v, lines, rows, focal)
        return ray / (ray @ omega)[..., None]

    # The wall as the camera sees it does not change: it moves in its own plane.
    ray = _rays(np.broadcast_to(np.arange(rows + 1)[:, None] - 0.5, (rows + 1, lines)), lines, rows, focal)
    off = (ray * (depth / (ray @ normal))[..., None]) @ omega - 1
    # From the sheet in standard deviations, at the edges of pixels; across each of them it goes evenly.
    x = off / (width * np.abs(np.diff(off, axis=0)).mean())
    light = np.sqrt(np.pi / 2) * np.diff(erf(x / np.sqrt(2)), axis=0) / np.diff(x, axis=0)
    half = half_window(width / speed)
    random = np.random.default_rng(0)
    frames = 10000 + 20000 * (light + noise * random.standard_normal((2 * half + 16, rows, lines)))
    settings, counts = StripeSettings("grey"), steps_apart * np.arange(len(frames))
    batch = Frames(np.rint(frames).astype(np.uint16), None, counts[:, None])
    geometry = Geometry.create(rig, settings, STAGE, steps_apart, {})

    def frames_at(positions: Int[np.ndarray, "frames 1"]) -> FramePoses:
        return FramePoses.create(rig.motion, {STAGE: positions[:, 0]}, len(positions))

    found = list(spacetime_profiles(geometry, width / speed, settings, [batch], DEFAULT, "strongest", frames_at))
    points, position, predicted = (
        np.concatenate([getattr(one, name) for one in found])[half : half + 16].astype(np.float64)
        for name in ("points", "position", "sigma")
    )
    X = on_sheet(position)
    ray = X / np.linalg.norm(X, axis=-1, keepdims=True)
    too_far = (points @ normal - depth) / (ray @ normal)
    over = too_far / ((on_sheet(position + 0.5) - on_sheet(position - 0.5)) * ray).sum(-1) / predicted
    return over[np.isfinite(over)]


def _rays(v: Float[np.ndarray, "some lines"], lines: int, rows: int, focal: float) -> Float[np.ndarray, "some lines 3"]:
    u = np.broadcast_to(np.arange(lines), v.shape)
    return np.stack([(u - lines / 2) / focal, (v - rows / 2) / focal, np.ones(v.shape)], axis=-1)


def reflectance(folder: Path, world: _World, names: tuple[Detector, ...]) -> list[Metric]:
    """The border between bright and dark."""
    frames, border = 160, 20.0
    bodies = floor((-30.0, -15.0), (30.0, border), _BRIGHT), floor((-30.0, border), (30.0, 95.0), _DARK)
    scene = Scene(tuple(body.moved(world.R, world.origin) for body in bodies))
    metrics = []
    for kind, blur, speckle in (("ideal", 0.0, 0.0), ("blur", _BLUR_PX, 0.0), ("speckle", 0.0, 0.47)):
        scan = _shoot(folder / kind, world, scene, frames, blur, speckle)
        y = _STEPS * _MM_PER_STEP * np.arange(frames)
        near, far = np.abs(y - border) < 2 * _SHEET_MM, (y > 2.5) & (y < border - 4 * _SHEET_MM)
        errors: dict[str, tuple[float, float]] = {}
        for name in names:
            image = reconstruct(world.rig, scan, detector=name)
            errors[name] = _rms(world, image, near), _rms(world, image, far)
        for name in ("gravity", "likelihood"):
            image = reconstruct(world.rig, scan, detector=name, spacetime=True)
            errors[f"spacetime_{name}"] = _rms(world, image, near), _rms(world, image, far)
        print(f"  {kind}: RMS distance from the plane about the border (and away from it), mm")
        for name, (at_border, away) in errors.items():
            print(f"    {name:22} {at_border:7.3f} ({away:.4f})")
        stem, gravity = f"spacetime.reflectance.{kind}", errors["gravity"][0]
        metrics.append(Metric(f"{stem}.gravity", gravity, "mm"))
        value = errors["spacetime_likelihood"][0]
        metrics.append(Metric(f"{stem}.spacetime", value, "mm"))
        goal = ("lower", 0.2) if kind == "ideal" else ("shown", None)
        metrics.append(Metric(f"{stem}.over_gravity", value / gravity, "", *goal))
        if kind == "ideal":
            metrics += steps(world, scan, far)
    return metrics


def steps(world: _World, scan: Scan, far: Bool[np.ndarray, "frames"]) -> list[Metric]:
    """Coarser steps."""
    metrics = []
    for every in (1, 2, 4, 6, 8):
        some = range(0, len(scan.frames), every)
        coarser = Scan(
            scan.path,
            scan.laser,
            tuple(scan.frames[i] for i in some),
            axes={STAGE: tuple(scan.axes[STAGE][i] for i in some)},
        )
        try:
            image = reconstruct(world.rig, coarser, spacetime=True)
        except InputError as error:
            print(f"    every {every}: {error}")
            continue
        each = _rms(world, image, far[::every])
        metrics.append(Metric(f"spacetime.steps.{0.45 * every:.2f}_px_a_frame", each, "mm"))
    return metrics


def depth(folder: Path, world: _World) -> list[Metric]:
    """Edges of depth."""
    frames, middle, size = 140, 17.0, (80.0, 12.0, 8.0)
    bodies = box(middle, size, _BRIGHT), floor((-40.0, -25.0), (40.0, 95.0), _BRIGHT)
    scene = Scene(tuple(body.moved(world.R, world.origin) for body in bodies))
    metrics = []
    for kind, blur in (("ideal", 0.0), ("blur", _BLUR_PX)):
        scan = _shoot(folder / f"depth-{kind}", world, scene, frames, blur, 0.0)
        print(f"  depth, {kind}: points near the edges, share of them further than {_OFF_MM} mm from every surface")
        for name in ("gravity", "likelihood", "spacetime"):
            image = (
                reconstruct(world.rig, scan, spacetime=True)
                if name == "spacetime"
                else reconstruct(world.rig, scan, detector=name)
            )
            points = image.points[image.valid].astype(np.float64)
            y = ((points - world.origin) @ world.R)[:, 1]
            points = points[np.abs(np.abs(y - middle) - size[1] / 2) < _NEAR_MM]
            off = float((distance(scene, points) > _OFF_MM).mean())
            print(f"    {name:12} {len(points):6d}  {off:.4f}")
            metrics.append(Metric(f"spacetime.depth.{kind}.{name}", off))
            metrics.append(Metric(f"spacetime.depth.{kind}.{name}.points", len(points)))
    return metrics


def _shoot(folder: Path, world: _World, scene: Scene, frames: int, blur: float, speckle: float) -> Scan:
    folder.mkdir()
    lighting = Lighting(
        ambient=_AMBIENT,
        directional=0.0,
        laser_power=_PEAK / _BRIGHT,
        sheet_sigma_mm=_SHEET_MM,
        speckle=speckle,
        speckle_length_px=(1.1, 1.1),
    )
    sensor = Sensor(blur_px=blur, noise=_PEAK / 100, bits=16)
    paths, counts = [], tuple(_STEPS * i for i in range(frames))
    for i, n in enumerate(counts):
        paths.append(folder / f"{i:03d}.png")
        write_image(
            paths[-1], render(world.rig, scene, q={"stage": n}, laser=0, lighting=lighting, sensor=sensor, seed=i)
        )
    return Scan(folder / "scan.toml", StripeSettings("red"), tuple(paths), axes={STAGE: counts})


def _rms(world: _World, image: RangeImage, frames: Bool[np.ndarray, "frames"]) -> float:
    z = (image.points[frames].astype(np.float64) - world.origin) @ world.R[:, 2]
    return float(np.sqrt(np.nanmean(z**2)))
