"""Parts of known dimensions, drawn scans of them, and what is to be measured: for the suite `measure`.

A scan is where an ideal camera sees the sheet; to each drawing belongs a rig, drawn from the covariance of a
calibration or solved again, and noise of the stripe, part of it alike in neighbouring columns and frames, as speckle.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from benchmarks.stages import line_stage, session
from jaxscan.calibration import calibrate
from jaxscan.files.part_file import Dimension, Feature, Part
from jaxscan.files.region import Region
from jaxscan.files.rig_file import RigFile
from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.reconstruction import RangeImage
from jaxscan.reconstruction.point_sigma import ray_jacobian
from jaxscan.rig import Rig
from jaxscan.rig.projection import pixel_rays
from jaxscan.simulation import rig_2003
from jaxscan.simulation.drawn import drawn_scan
from jaxscan.simulation.scene import Body
from jaxscan.simulation.shapes import grey
from jaxscan.simulation.solids import Box, Cylinder, Solid, Sphere

# The stripe's σ as stated, and its true parts: independent, and correlated over this number of frames and columns.
SIGMA_PX, OWN_PX, SPECKLE_PX, GRAIN = 0.1, 0.08, 0.08, (1.0, 2.0)
_APART, _TRAVEL = 600, 60_000
_STRENGTH = 250.0
# Twice and more of what `scanned_image` keeps around a region, and of the largest error.
_BESIDE_MM = 6.0


@dataclass(frozen=True)
class Scene:
    """A part under the scanner.

    Attributes:
        position: where the stripe is seen without noise, px.
        steps: of the frames.
        part: what is to be measured.
        truth: of each dimension.
    """

    position: Float[np.ndarray, "frames columns"]
    steps: Float[np.ndarray, "frames"]
    part: Part
    truth: dict[str, float]


@cache
def calibrated() -> RigFile:
    """The rig, and the covariance of a calibration of it by 12 views and 31 places of the stage."""
    found = calibrate(session(0, line_stage(), False))
    assert found.covariance is not None
    return RigFile(rig_2003.simulated_rig(0), found.covariance)


def drawn_rig(random: np.random.Generator, true: RigFile | None = None) -> RigFile:
    """A rig as a calibration might have found it; by default one of the `calibrated` rig."""
    true = true or calibrated()
    assert true.covariance is not None
    sigma = true.covariance.of_leaves(true.rig)
    scale = np.sqrt(np.maximum(np.diag(sigma), 0.0))
    apart = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(sigma / apart[:, None] / apart)
    off = scale * (vectors @ (np.sqrt(np.maximum(values, 0.0)) * random.normal(size=len(values))))
    with float64():
        theta, unravel = ravel_pytree(as_float64(true.rig))
        return RigFile(as_numpy(unravel(theta + jnp.asarray(off))), true.covariance)


def solved_rig(seed: int) -> RigFile:
    """A rig that a session of its own gave."""
    found = calibrate(session(seed, line_stage(), False))
    return RigFile(found.rig, found.covariance)


def scan(scene: Scene, rig: RigFile, random: np.random.Generator, share: float = 1.0) -> RangeImage:
    """A scan with so much of the noise, reconstructed with a rig."""
    noise = OWN_PX * random.normal(size=scene.position.shape)
    alike = gaussian_filter(random.normal(size=scene.position.shape), GRAIN, mode="wrap")
    noise += SPECKLE_PX * alike / alike.std()
    return as_image(scene.position + share * noise, scene.steps, rig.rig)


def looked_at(scene: Scene) -> Scene:
    """Without what lies further from all regions than a scan's errors bring it: `scanned_image` leaves it aside."""
    image = as_image(scene.position, scene.steps, rig_2003.simulated_rig(0))
    near = np.zeros(image.valid.shape, bool)
    for feature in scene.part.features:
        if feature.region is not None:
            low, high = feature.region.wider(_BESIDE_MM).bounds()
            near |= ((image.points >= low) & (image.points <= high)).all(axis=2)
    return replace(scene, position=np.where(near, scene.position, np.nan))


def as_image(rows: Float[np.ndarray, "frames columns"], steps: Float[np.ndarray, "frames"], rig: Rig) -> RangeImage:
    """The range image that a rig makes of stripes."""
    valid = np.isfinite(rows)
    frame, column = np.nonzero(valid)
    pixels = np.stack([column, rows[valid]], axis=1)
    rays = pixel_rays(rig.camera, pixels)
    seen = rays / np.asarray(rig.lights[0].inverse_depth(rays))[:, None]
    moved = np.asarray(rig.pose({"stage": steps}).translation)[frame]
    sigma = SIGMA_PX * np.abs(ray_jacobian(rig_2003.simulated_rig(0), "", pixels, {"stage": steps[frame]}, True)[1])

    def grid(values: np.ndarray) -> np.ndarray:
        full = np.full((*valid.shape, *values.shape[1:]), np.nan, np.float32)
        full[valid] = values
        return full

    return RangeImage(
        points=grid(seen - moved),
        pixels=rows.astype(np.float32),
        strength=grid(np.full(len(rays), _STRENGTH)),
        sigma=grid(sigma),
        sigma_pixel=grid(sigma),
        valid=valid,
        positions={"stage": steps.astype(np.int64)},
        motion=rig.motion,
        sheets=(rig.light(),),
    )


def _frame() -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    return rig_2003.platform(rig_2003.simulated_rig(0))


def at(x: float, y: float, z: float) -> tuple[float, float, float]:
    """A point of the platform in the object frame, mm."""
    R, origin = _frame()
    a, b, c = R @ np.array([x, y, z]) + origin
    return float(a), float(b), float(c)


def _across() -> tuple[float, float, float]:
    """The platform's y, object frame."""
    x, y, z = _frame()[0][:, 1]
    return float(x), float(y), float(z)


def _around(x: float, y: float, z: float, radius: float) -> Region:
    return Region(at(x, y, z), None, radius)


def _body(solid: Solid) -> Body:
    return Body(solid, grey(0.6))


def _leaning(degrees: float) -> Float[np.ndarray, "3 3"]:
    """Axes of a box that leans to the right."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _dimension(name: str, kind: str, *of: str) -> Dimension:
    return Dimension(name, kind, of)


def _scene(solids: list[Solid], features: list[Feature], dimensions: list[Dimension], truth: dict[str, float]) -> Scene:
    rig = rig_2003.simulated_rig(0)
    steps = np.arange(0, _TRAVEL, _APART)
    scene = rig_2003.scan_scene(rig, [_body(solid) for solid in solids])
    position = drawn_scan(rig, scene, {"stage": steps}, 0.0).position
    part = Part(Path("part.toml"), "drawn", tuple(features), tuple(dimensions))
    return Scene(position, steps.astype(float), part, truth)


@cache
def blocks_and_balls() -> Scene:
    """Balls of 5 and 12 mm, a cylinder of 9 mm, and two boxes of 10 and 14 mm side by side."""
    y = 30.0
    balls = {"ball-12": (-55.0, 12.0), "ball-5": (-27.0, 5.0)}
    solids: list[Solid] = [Sphere(np.array([x, y, r]), r) for x, r in balls.values()]
    solids += [Box(np.array([-5.0, y, 5.0]), np.eye(3), np.array([9.0, 16.0, 5.0]))]
    solids += [Box(np.array([13.0, y, 7.0]), np.eye(3), np.array([9.0, 16.0, 7.0]))]
    solids += [Cylinder(np.array([50.0, y - 16, 9.0]), np.array([0.0, 1.0, 0.0]), 9.0, 32.0)]
    features = [Feature(name, "ball", _around(x, y, r, 1.3 * r)) for name, (x, r) in balls.items()]
    features += [
        Feature("low", "plane", _around(-5.0, y, 10.0, 8.0)),
        Feature("high", "plane", _around(13.0, y, 14.0, 8.0)),
        Feature("cylinder", "cylinder", _around(50.0, y, 9.0, 13.0)),
        Feature("cut", "section", _around(-55.0, y, 14.0, 12.0), point=at(0.0, y, 0.0), normal=_across()),
        Feature("cut-top", "section", _around(-5.0, y, 10.0, 8.0), point=at(0.0, y, 0.0), normal=_across()),
        Feature("circle", "circle", of=("cut",)),
        Feature("line", "line", of=("cut-top",)),
    ]
    dimensions = [
        _dimension("ball radius 12", "radius", "ball-12"),
        _dimension("ball radius 5", "radius", "ball-5"),
        _dimension("cylinder radius", "radius", "cylinder"),
        _dimension("circle radius", "radius", "circle"),
        _dimension("step", "step", "low", "high"),
        _dimension("plane distance", "distance", "low", "high"),
        _dimension("flush", "flush", "low", "high"),
        _dimension("ball distance", "distance", "ball-12", "ball-5"),
        _dimension("ball over plane", "distance", "ball-12", "low"),
        _dimension("cylinder to ball", "distance", "cylinder", "ball-5"),
        _dimension("line to plane", "distance", "line", "high"),
        _dimension("flatness", "flatness", "low"),
        _dimension("roundness", "roundness", "ball-12"),
        _dimension("straightness", "straightness", "line"),
    ]
    truth = {
        "ball radius 12": 12.0,
        "ball radius 5": 5.0,
        "cylinder radius": 9.0,
        "circle radius": 12.0,
        "step": 4.0,
        "plane distance": 4.0,
        "flush": 4.0,
        "ball distance": float(np.hypot(28.0, 7.0)),
        "ball over plane": 2.0,
        "cylinder to ball": float(np.hypot(77.0, 4.0)),
        "line to plane": 4.0,
        "flatness": 0.0,
        "roundness": 0.0,
        "straightness": 0.0,
    }
    return _scene(solids, features, dimensions, truth)


@cache
def roof() -> Scene:
    """A ball of 25 mm, and a roof of two planes at right angles."""
    y, x, half = 30.0, 20.0, 12.0
    solids: list[Solid] = [Sphere(np.array([-45.0, y, 25.0]), 25.0)]
    solids += [Box(np.array([x, y, 0.0]), _leaning(45.0), np.array([half, 18.0, half]))]
    s = np.sqrt(0.5)
    features = [Feature("ball-25", "ball", _around(-45.0, y, 25.0, 29.0))]
    for name, way in (("left", -1.0), ("right", 1.0)):
        features.append(Feature(name, "plane", _around(x + way * half * s, y, half * s, 7.0)))
    features.append(Feature("ridge", "edge", of=("left", "right")))
    dimensions = [
        _dimension("ball radius 25", "radius", "ball-25"),
        _dimension("roof angle", "angle", "left", "right"),
        _dimension("ridge over ball", "distance", "ridge", "ball-25"),
    ]
    ridge = np.array([x, half / s])
    truth = {
        "ball radius 25": 25.0,
        "roof angle": 90.0,
        "ridge over ball": float(np.hypot(ridge[0] + 45.0, ridge[1] - 25.0)),
    }
    return _scene(solids, features, dimensions, truth)


def implicit(level: Callable[[np.ndarray], np.ndarray], steps: Float[np.ndarray, "frames"]) -> Float[np.ndarray, "f c"]:
    """Where the stripe is seen on a surface level(X) = 0 of the platform's frame that nothing hides, px.

    The sheet stands still before the camera: each pixel sees one point of it, whatever moves. Along each column the
    sign of the level changes where the surface is; three secant steps put it to 1e-9 px.
    """
    rig = rig_2003.simulated_rig(0)
    R, origin = _frame()
    width, height = rig.camera.image_size
    u, v = np.meshgrid(np.arange(0.0, width), np.arange(0.0, height))
    found = np.full((len(steps), width), np.nan)

    def sheet(pixels: np.ndarray) -> np.ndarray:
        rays = pixel_rays(rig.camera, pixels)
        return rays / np.asarray(rig.lights[0].inverse_depth(rays))[:, None]

    fixed = sheet(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(height, width, 3)
    travel = np.asarray(rig.pose({"stage": steps}).translation)

    def levels(X: np.ndarray, f: int) -> np.ndarray:
        return level((X - travel[f] - origin) @ R)

    for f in range(len(steps)):
        g = levels(fixed.reshape(-1, 3), f).reshape(height, width)
        row, column = np.nonzero((g[:-1] > 0) != (g[1:] > 0))
        a, b = row.astype(float), row + 1.0
        ga, gb = g[row, column], g[row + 1, column]
        at, gt = a, ga
        for _ in range(4):
            at = a - ga * (b - a) / (gb - ga)
            gt = levels(sheet(np.stack([column, at], axis=1)), f)
            a, ga, b, gb = np.where(abs(ga) < abs(gb), a, b), np.where(abs(ga) < abs(gb), ga, gb), at, gt
            done = np.abs(gb - ga) < 1e-14
            gb = np.where(done, ga + 1.0, gb)
            b = np.where(done, a, b)
        found[f, column] = np.where(np.abs(gt) < 1e-7, at, np.nan)
    return found


@cache
def cone() -> Scene:
    """A cone with its tip 25 mm up and an opening of 100°, and a dome: what a ball of 40 mm has 8 mm above a plane."""
    y, tip, half = 30.0, 25.0, np.radians(50.0)

    def level(x: np.ndarray) -> np.ndarray:
        rho = np.hypot(x[:, 0] + 30.0, x[:, 1] - y)
        of_cone = rho * np.cos(half) - (tip - x[:, 2]) * np.sin(half)
        of_dome = np.linalg.norm(x - np.array([40.0, y, 8.0 - 40.0]), axis=1) - 40.0
        return np.minimum(np.minimum(of_cone, of_dome), x[:, 2])

    steps = np.arange(0, _TRAVEL, _APART).astype(float)
    features = [
        Feature("cone", "cone", _around(-30.0, y, 12.0, 13.0)),
        Feature("dome", "surface", _around(40.0, y, 0.0, 26.0)),
        Feature("base", "plane", _around(9.0, y, 0.0, 7.0)),
    ]
    dimensions = [_dimension("cone angle", "cone_angle", "cone"), _dimension("volume", "volume", "dome", "base")]
    truth = {"cone angle": 100.0, "volume": float(np.pi * 8.0**2 * (3 * 40.0 - 8.0) / 3)}
    part = Part(Path("part.toml"), "cone", tuple(features), tuple(dimensions))
    return Scene(implicit(level, steps), steps, part, truth)


@cache
def in_one_place() -> Scene:
    """Two patches each of a cylinder, a ball and a plane: their axes, centres and faces are the same, 0 apart."""
    y = 36.0
    solids: list[Solid] = [
        Cylinder(np.array([-40.0, 8.0, 9.0]), np.array([0.0, 1.0, 0.0]), 9.0, 56.0),
        Box(np.array([0.0, y, 3.0]), np.eye(3), np.array([15.0, 25.0, 3.0])),
        Sphere(np.array([45.0, y, 12.0]), 12.0),
    ]
    features = [
        Feature("near", "cylinder", _around(-40.0, 20.0, 15.0, 12.0)),
        Feature("far", "cylinder", _around(-40.0, 52.0, 15.0, 12.0)),
        Feature("left", "ball", _around(38.0, y, 20.0, 10.0)),
        Feature("right", "ball", _around(52.0, y, 20.0, 10.0)),
        Feature("this", "plane", _around(-8.0, y, 6.0, 7.0)),
        Feature("that", "plane", _around(8.0, y, 6.0, 7.0)),
    ]
    dimensions = [
        _dimension("axes apart", "distance", "near", "far"),
        _dimension("axes' angle", "angle", "near", "far"),
        _dimension("centres apart", "distance", "left", "right"),
        _dimension("faces apart", "distance", "this", "that"),
        _dimension("faces' angle", "angle", "this", "that"),
    ]
    return _scene(solids, features, dimensions, dict.fromkeys((each.name for each in dimensions), 0.0))


SCENES = (blocks_and_balls, roof, cone, in_one_place)
