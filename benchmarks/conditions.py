"""Simulated sessions and scans for the comparison: the rig of 2003, and the same with one thing changed.

Two scenes stand on the platform: a cup; and `bench`, a block with steps of 1.48, 3.68, 8.94 and 14.00 mm beside a ball
of radius 22 mm, of which heights, radius and the floor's flatness are read.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import equinox as eqx
import numpy as np
import trimesh
from jaxtyping import Bool, Float

from benchmarks.gauge import HEIGHTS, faces
from jaxscan.files.scan import Scan, read_scan
from jaxscan.files.session import Session, read_session
from jaxscan.geometry import Pose
from jaxscan.images import read_image, write_image
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, Rig
from jaxscan.simulation import rig_2003
from jaxscan.simulation.accuracy import near_its_true_point
from jaxscan.simulation.folders import ScanTruth, simulate_scan, simulate_session
from jaxscan.simulation.light import Sensor
from jaxscan.simulation.photographs import JPEG_QUALITY
from jaxscan.simulation.plate import Checks, Plate
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.scene import Body, Scene
from jaxscan.simulation.shapes import cup, grey, sphere, stair

RADIUS: Final = 22.0
_BLOCK_X, _BLOCK_WIDTH, _BALL_X = -40.0, 84.0, 40.0
_CHECK_MM = 7.0
_SPOT_SIGMA_PX, _SPOT_HALF = 1.5, 5


@dataclass(frozen=True)
class Condition:
    """How photographs are taken.

    Attributes:
        views: board poses.
        stage_views: photographs of the board on the stage.
        frames: of a scan.
        steps_apart: motor steps from one frame to the next, and from one of the stage's photographs to the next.
        sensor: of all photographs.
        lighting: changes to the lighting of boards and objects, which is without speckle.
        k1: of the lens; None for that of 2003.
        floor_ink: brightness of every second square of the floor; 1 is a plain floor.
        spots: red spots in each photograph where no stripe is, as of glints and lamps.
        ending: file format.
        quality: of JPEG, whose colour has half the resolution.
    """

    views: int = rig_2003.BOARD_VIEWS
    stage_views: int = rig_2003.STAGE_VIEWS
    frames: int = rig_2003.SCAN_FRAMES
    steps_apart: int = rig_2003.STEPS_APART
    sensor: Sensor = rig_2003.SENSOR
    lighting: Mapping[str, Any] = field(default_factory=dict)
    k1: float | None = None
    floor_ink: float = 1.0
    spots: int = 0
    ending: str = ".png"
    quality: int = JPEG_QUALITY


# A third of the photographs: what is compared here is one condition with another.
SHORT: Final = Condition(stage_views=11, frames=13, steps_apart=3 * rig_2003.STEPS_APART)


@dataclass(frozen=True)
class Photographed:
    """A session and scans, and what is true of them.

    Attributes:
        rig: the true one.
        session: photographs of boards.
        lit: for each view, the columns in which an ideal camera sees the sheet on the board.
        scans: by the name of their scene.
        scenes: what stood there at motor step 0.
        truths: what is true of each scan.
    """

    rig: Rig
    session: Session
    lit: Bool[np.ndarray, "views columns"]
    scans: Mapping[str, Scan]
    scenes: Mapping[str, Scene]
    truths: Mapping[str, ScanTruth]


def photograph(folder: Path, condition: Condition, seed: int, scenes: tuple[str, ...]) -> Photographed:
    """Render a session and a scan of each of some scenes (`cup`, `bench`)."""
    rig = rig_2003.simulated_rig(seed)
    if condition.k1 is not None:
        with float64():
            camera = Camera.create(
                rig.camera.image_size,
                np.array([float(x) for x in rig.camera.focal]),
                np.array([float(x) for x in rig.camera.principal]),
                "radial1",
                np.array([condition.k1]),
            )
            rig = as_numpy(replace(rig, camera=camera))
    common: dict[str, Any] = {
        "sensor": condition.sensor,
        "ending": condition.ending,
        "quality": condition.quality,
    }
    truth = simulate_session(
        folder / "session",
        seed,
        rig=rig,
        views=condition.views,
        stage_views=condition.stage_views,
        steps_apart=condition.steps_apart,
        lighting=replace(rig_2003.BOARD_LIGHTING, **condition.lighting),
        **common,
    )
    worlds = {name: SCENES[name](rig, condition) for name in scenes}
    truths = {
        name: simulate_scan(
            folder / name,
            rig,
            world,
            seed,
            frames=condition.frames,
            steps_apart=condition.steps_apart,
            lighting=replace(rig_2003.SCAN_LIGHTING, **condition.lighting),
            **common,
        )
        for name, world in worlds.items()
    }
    if condition.spots:
        random = np.random.default_rng([seed, condition.spots])
        for path in sorted(folder.rglob(f"*{condition.ending}")):
            write_image(path, _spotted(read_image(path), condition.spots, random))
    return Photographed(
        rig,
        read_session(folder / "session"),
        _lit(rig, truth.boards),
        {name: read_scan(folder / name) for name in scenes},
        worlds,
        truths,
    )


def _cup(rig: Rig, condition: Condition) -> Scene:
    return _floored(rig, rig_2003.scan_scene(rig, cup(rig_2003.OBJECT_Y)), condition)


def _bench(rig: Rig, condition: Condition) -> Scene:
    y = rig_2003.OBJECT_Y
    block = tuple(b.moved(np.eye(3), np.array([_BLOCK_X, 0, 0])) for b in stair(y, HEIGHTS, width=_BLOCK_WIDTH))
    ball = sphere(y, RADIUS).moved(np.eye(3), np.array([_BALL_X, 0, 0]))
    return _floored(rig, rig_2003.scan_scene(rig, (*block, ball)), condition)


SCENES: Final[dict[str, Callable[[Rig, Condition], Scene]]] = {"cup": _cup, "bench": _bench}


def _floored(rig: Rig, scene: Scene, condition: Condition) -> Scene:
    """The scene, its floor with squares printed on it where the condition says so."""
    if condition.floor_ink == 1.0:
        return scene
    plain = scene.bodies[-1].shape
    assert isinstance(plain, Plate)
    size = np.asarray(plain.high) - np.asarray(plain.low)
    R, origin = rig_2003.platform(rig)
    corner = np.array([*(np.asarray(plain.low) + _CHECK_MM), 0.0])
    checked = Plate(
        corner,
        np.array([1.0, 0.0, 0.0]),
        np.array([0.0, 1.0, 0.0]),
        np.full(2, -_CHECK_MM),
        size - _CHECK_MM,
        Checks(np.ceil(size / _CHECK_MM), _CHECK_MM),
        condition.floor_ink,
    )
    printed = Body(checked, grey(0.5)).moved(R, origin)
    return eqx.tree_at(lambda s: s.bodies, scene, (*scene.bodies[:-1], printed))


def _lit(rig: Rig, boards: Pose) -> Bool[np.ndarray, "views columns"]:
    scenes = (
        rig_2003.board_scene(np.asarray(r), np.asarray(t))
        for r, t in zip(boards.rotation, boards.translation, strict=True)
    )
    return np.stack([np.isfinite(true_profile(rig, scene).position) for scene in scenes])


def _spotted(image: np.ndarray, count: int, random: np.random.Generator) -> np.ndarray:
    """The photograph with small bright red spots in random places."""
    image = image.astype(float)
    rows, columns = image.shape[:2]
    offset = np.arange(-_SPOT_HALF, _SPOT_HALF + 1)
    spot = 400 * np.exp(-0.5 * (offset[:, None] ** 2 + offset**2) / _SPOT_SIGMA_PX**2)
    for _ in range(count):
        v, u = (int(random.integers(_SPOT_HALF, n - _SPOT_HALF)) for n in (rows, columns))
        image[v - _SPOT_HALF : v + _SPOT_HALF + 1, u - _SPOT_HALF : u + _SPOT_HALF + 1, 0] += spot
    return image.clip(0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Reading:
    """What is read of a bench, mm.

    Attributes:
        heights: the mean height of each face over the plane of the floor, less the true one.
        radius: of the ball of least squares, less the true one.
        flatness: RMS distance of the floor's points from their own plane.
    """

    heights: Float[np.ndarray, "faces"]
    radius: float
    flatness: float


def read_bench(
    cloud: Float[np.ndarray, "frames columns 3"], true_points: Float[np.ndarray, "frames columns 3"], rig: Rig
) -> Reading:
    """Read heights, radius and flatness of a cloud.

    Args:
        cloud: object frame, NaN for none.
        true_points: of the same frames and columns: they say what each point is of.
        rig: the true one.
    """
    near = near_its_true_point(cloud, true_points)
    *on_steps, on_floor = faces(true_points, rig, HEIGHTS, rig_2003.OBJECT_Y, _BLOCK_X, _BLOCK_WIDTH)
    R, origin = rig_2003.platform(rig)
    middle = origin + R @ np.array([_BALL_X, rig_2003.OBJECT_Y, RADIUS])
    with np.errstate(invalid="ignore"):
        on_ball = near & (np.abs(np.linalg.norm(true_points - middle, axis=-1) - RADIUS) < 1e-3)
    of_floor = cloud[near & on_floor]
    if min(len(of_floor), on_ball.sum(), *((near & on).sum() for on in on_steps)) < 10:
        return Reading(np.full(len(HEIGHTS), np.nan), np.nan, np.nan)
    centre = of_floor.mean(axis=0)
    normal = np.linalg.svd(of_floor - centre, full_matrices=False)[2][2]
    normal *= -np.sign(normal @ centre)
    heights = np.array([((cloud[near & on] - centre) @ normal).mean() for on in on_steps])
    return Reading(
        heights - HEIGHTS,
        float(trimesh.nsphere.fit_nsphere(cloud[on_ball])[1]) - RADIUS,
        float(np.sqrt((((of_floor - centre) @ normal) ** 2).mean())),
    )
