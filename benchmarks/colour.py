"""Colour and albedo of points against what was drawn: balls and printed boxes of colours that no test has.

A point's true colour is that of the light of the room on the surface which its pixel's ray meets, without noise and
blur. The share that is of the wrong surface: of the points whose colour is nearer to that of another surface of the
scene in the same light than to that of their own. Pixels within 1.5 px of an edge of shape or print are mixed by the
lens in every photograph; they are left out of both, and are a figure by themselves.

The lamp and the object are as bright as in a lit room (a white surface has 150 to 220 of 255 levels), noise is 2
levels. Albedo is of a
second scan whose stripe is not burnt out, of a fan that spreads.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation

from benchmarks.metric import Metric
from jaxscan.files.scan import read_scan
from jaxscan.images.sampled import levels_at
from jaxscan.reconstruction import RangeImage, reconstruct
from jaxscan.reconstruction.scan_colours import neighbour_colours
from jaxscan.rig import Rig
from jaxscan.rig.projection import pixel_rays
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_scan
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.plate import Checks, Circles, Plate
from jaxscan.simulation.render import carried, render, sight_of, trace
from jaxscan.simulation.scene import Body, Scene
from jaxscan.simulation.solids import Box, Sphere
from jaxscan.surface.albedo import albedo

# Of the room, and of a stripe that is not burnt out.
ROOM: Final = replace(rig_2003.SCAN_LIGHTING, ambient=150.0, directional=70.0)
_WEAK: Final = replace(rig_2003.SCAN_LIGHTING, ambient=20.0, directional=10.0, laser_power=700.0, laser_fan_mm=350.0)
_GOALS: Final = {"rms": 3.0, "of_wrong_surface": 0.1, "albedo": 5.0}
# Nearer to an edge pixels are mixed, px.
EDGE_PX: Final = 1.5


def measure(quick: bool) -> list[Metric]:
    """A linear scan and a turn; one seed, or three."""
    found: dict[str, list[float]] = {}
    for seed in range(100, 101 if quick else 103):
        for turning in (False, True):
            for name, value in _measured(seed, turning, quick).items():
                found.setdefault(name, []).append(value)
    metrics = []
    for name, values in found.items():
        target = _GOALS.get(name.split(".")[-1])
        value = float(np.sqrt(np.mean(np.square(values))))
        better = "shown" if target is None else "lower"
        metrics.append(Metric(f"colour.{name}", value, "%", better, target, slack=0.2, floor=0.05))
    return metrics


def _measured(seed: int, turning: bool, quick: bool) -> dict[str, float]:
    rig = rig_2003.with_turntable(rig_2003.simulated_rig(seed), seed) if turning else rig_2003.simulated_rig(seed)
    scene = rig_2003.scan_scene(rig, coloured_things(seed))
    apart = (32 if quick else 16) if turning else (2000 if quick else 1000)
    axes = rig_2003.turning_axes(apart) if turning else {"stage": tuple(range(0, 72001, apart))}
    kind, found = "turning" if turning else "linear", {}
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        simulate_scan(here / "a", rig, scene, seed, axes=axes, lighting=ROOM, laser_off=True)
        scan = read_scan(here / "a")
        image = reconstruct(rig, scan)
        truth = Truth(rig, scene, image, ROOM)
        found |= truth.errors(f"{kind}.laser_off", image)
        alone = replace(scan, backgrounds=())
        image = reconstruct(rig, alone)
        truth = Truth(rig, scene, image, ROOM)
        image = replace(image, colours=neighbour_colours(rig, alone, image))
        found |= truth.errors(f"{kind}.other_steps", image)
        simulate_scan(here / "b", rig, scene, seed, axes=axes, lighting=_WEAK)
        image = reconstruct(rig, read_scan(here / "b"))
        found[f"{kind}.albedo"] = Truth(rig, scene, image, _WEAK).albedo_error(albedo(image))
    return found


def coloured_things(seed: int) -> tuple[Body, ...]:
    """Five balls and a printed box on the platform, of colours that are no brighter in red than a laser can bear."""
    random = np.random.default_rng([20, seed])

    def colour() -> Float[np.ndarray, "3"]:
        red = random.uniform(0.25, 0.75)
        return np.array([red, *random.uniform(max(red - 0.05, 0.3), 0.9, 2)])

    places = [(-42.0, 14.0), (-8.0, 10.0), (30.0, 16.0), (-36.0, 52.0), (40.0, 50.0)]
    balls = []
    for x, y in places:
        radius = random.uniform(9.0, 15.0)
        balls.append(Body(Sphere(np.array([x, y, radius]), radius), colour()))
    half = np.array([16.0, 14.0, random.uniform(8.0, 14.0)])
    middle = np.array([2.0, 50.0, half[2]])
    pattern = Checks(np.array([2.0, 2.0]), 8.0) if seed % 2 else Circles(np.array([3.0, 3.0]), 8.0, 3.0)
    paint, top = colour(), np.array([middle[0] - 8.0, middle[1] - 8.0, 2 * half[2] + 0.05])
    print_ = Plate(top, np.eye(3)[0], np.eye(3)[1], np.full(2, -6.0), np.full(2, 20.0), pattern, 0.4)
    return (*balls, Body(Box(middle, np.eye(3), half), colour()), Body(print_, paint))


class Truth:
    """What the rays of a scan's pixels meet.

    Args:
        rig: the true one.
        scene: as it stands with all axes at 0.
        image: of its scan.
        lighting: of the scan.
    """

    def __init__(self, rig: Rig, scene: Scene, image: RangeImage, lighting: Lighting) -> None:
        u, v = np.meshgrid(*(np.arange(n) for n in rig.camera.image_size))
        grid = pixel_rays(rig.camera, np.stack([u, v], axis=-1)).astype(np.float32)
        self.valid = image.valid
        self.level = np.full((*image.valid.shape, 3), np.nan)
        self.albedo = np.full((*image.valid.shape, 3), np.nan)
        self.inner = np.zeros(image.valid.shape, bool)
        palette = []
        line = np.arange(image.valid.shape[1])
        for i in range(len(image.valid)):
            q = {axis: int(steps[i]) for axis, steps in image.positions.items()}
            here = carried(rig, scene, q).cast(np.float32)
            depth, key = trace(here, sight_of(rig.camera, grid))
            edge = edges(np.asarray(here.smooth(key)), np.asarray(depth))
            near = np.asarray(binary_dilation(edge, np.ones((3, 3)), iterations=round(EDGE_PX)), bool)
            pixels = np.stack([line, image.pixels[i]], axis=-1)
            at = np.rint(np.nan_to_num(pixels)).astype(int)
            still = render(rig, scene, q=q, lighting=lighting, sensor=Sensor(blur_px=0.0, noise=0.0, bits=16))
            self.level[i] = levels_at(still, pixels)
            self.albedo[i] = np.moveaxis(np.asarray(here.albedo(key)), 0, -1)[at[:, 1], at[:, 0]]
            self.inner[i] = image.valid[i] & ~near[at[:, 1], at[:, 0]] & (np.asarray(key)[at[:, 1], at[:, 0]] >= 0)
            palette.append(np.unique(np.round(self.albedo[i][self.inner[i]], 4), axis=0))
        self.palette = np.unique(np.concatenate(palette), axis=0)

    def errors(self, name: str, image: RangeImage) -> dict[str, float]:
        """RMS error over RMS level, of the wrong surface, without a colour, and the error beside edges, %."""
        assert image.colours is not None
        coloured = image.colours.any(axis=-1)
        some, mixed = self.inner & coloured, self.valid & ~self.inner & coloured
        return {
            f"{name}.rms": 100 * relative(image.colours[some], self.level[some]),
            f"{name}.of_wrong_surface": 100 * float(self.wrong(image, some).mean()),
            f"{name}.without": 100 * float((self.valid & ~coloured).sum() / self.valid.sum()),
            f"{name}.beside_edges": 100 * relative(image.colours[mixed], self.level[mixed]),
        }

    def wrong(self, image: RangeImage, some: Bool[np.ndarray, "frames columns"]) -> Bool[np.ndarray, "some"]:
        """Whether the colours of some points are nearer to that of another surface than to their own's."""
        assert image.colours is not None
        found, true = image.colours[some].astype(float), self.level[some]
        shade = (true / self.albedo[some]).mean(axis=-1)
        off = np.linalg.norm(found[:, None] - shade[:, None, None] * self.palette, axis=-1)
        own = np.linalg.norm(self.albedo[some][:, None] - self.palette, axis=-1).argmin(axis=1)
        return off.argmin(axis=1) != own

    def albedo_error(self, found: Float[np.ndarray, "frames columns"]) -> float:
        """RMS of the ratio to the red albedo, its median taken out, %."""
        some = self.inner & np.isfinite(found)
        ratio = found[some] / self.albedo[some][:, 0]
        return 100 * float(np.sqrt(np.mean((ratio / np.median(ratio) - 1) ** 2)))


def relative(found: np.ndarray, true: Float[np.ndarray, "points 3"]) -> float:
    return float(np.sqrt(np.mean((found - true) ** 2) / np.mean(true**2)))


def edges(key: np.ndarray, depth: np.ndarray) -> Bool[np.ndarray, "rows columns"]:
    """Pixels beside which another surface is seen, or one far behind."""
    edge = np.zeros(key.shape, bool)
    z = np.where(np.isfinite(depth), depth, 1e6)
    for axis in (0, 1):
        step = np.diff(key, axis=axis) != 0
        step |= np.abs(np.diff(z, axis=axis)) > 0.01 * np.minimum(*(np.delete(z, end, axis) for end in (0, -1)))
        for end in (0, -1):
            inside = [slice(None)] * 2
            inside[axis] = slice(1, None) if end == 0 else slice(None, -1)
            edge[tuple(inside)] |= step
    return edge
