"""The simulated rig of 2003: the camera, the laser, the stage and the poses of a laboratory's scanner of that year.

Camera 640 × 480, f = (697.70833, 690.43328) px, c = (310.29604, 228.14934) px, k1 = −0.13396; light plane
ω = (0, −0.00494, 0.00303) 1/mm and stage 0.001 · unit(0.03, 0.92, −0.39) mm a step, both turned by 2° about a random
axis; a sheet of σ 0.25 mm; 11 poses of a board of 9 × 6 inner corners of 16 mm, 310 to 380 mm away and tilted by up to
0.6 rad about x and y, with the stripe across them; 31 photographs of that board on the stage, 2000 steps apart; a scan
of 37 frames from step 0, 2000 steps apart. With two lasers the second shines from below onto the line of the platform
where the first does. A turntable, on request, stands on the platform of the stage: 3200 steps a turn about an axis 2°
off the platform's normal; 16 photographs of the board lying on it, 200 steps apart, with the stage at step 18000.
"""

from collections.abc import Sequence
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num
from scipy.spatial.transform import Rotation

from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE
from jaxscan.geometry import Pose, matrix_to_vector, vector_to_matrix
from jaxscan.images import Board
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import BowedSheet, Camera, Light, LightPlane, Linear, Rig, Rotary, run_of, runs
from jaxscan.simulation.drawn_stage import DrawnStage
from jaxscan.simulation.hand import Hand
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.render import plane_of
from jaxscan.simulation.scene import Body, Scene
from jaxscan.simulation.shapes import board_plate, floor

IMAGE_SIZE: Final = (640, 480)
BOARD: Final = Board.checkerboard((9, 6), 16.0)
BOARD_VIEWS: Final = 11
STAGE_VIEWS: Final = 31
TURNTABLE_VIEWS: Final = 16
TURNS_APART: Final = 200
TURNTABLE_STAGE_STEP: Final = 18000
SCAN_FRAMES: Final = 37
STEPS_APART: Final = 2000
SCREW_STEPS: Final = 3200.0
SENSOR: Final = Sensor(blur_px=0.6, noise=2.0)
# The laser is bright enough for a response of 300 grey levels, (R − G) + (R − B), on the boards' black squares.
BOARD_LIGHTING: Final = Lighting(laser_power=2500.0)
# On objects 200 are enough, and what is burnt out is worth less.
SCAN_LIGHTING: Final = Lighting(laser_power=1000.0)
# Contrast of an ordinary laser's light in the pixels of a photograph.
SPECKLE: Final = 0.2

_FOCAL = (697.70833, 690.43328)
_PRINCIPAL = (310.29604, 228.14934)
_K1 = -0.13396
_OMEGA = np.array([0.0, -0.00494, 0.00303])
_TRAVEL = np.array([0.03, 0.92, -0.39])
_MM_PER_STEP = 0.001
_TURN = np.radians(2.0)
STEPS_PER_TURN: Final = 3200
# Where the middle of what stands on the platform comes under the sheet.
_UNDER_SHEET = 37000
# Where in its turn a screw stands at step 0.
_SCREW_PHASE = 1.0
# Motor steps of the turntable from frame to frame of a scan that turns.
TURN_APART: Final = 20
# How far the turntable's axis, and the middle of the board on it, may stand from where they should, mm.
_OFF_AXIS = 3.0
# Makes the second sheet about as steep as the first, (0, 0.00494, 0.00268) 1/mm.
_BEYOND_PLATFORM = 0.6

_NEAREST, _FARTHEST, _TILT, _ROLL = 310.0, 380.0, 0.6, 0.15
# How far the middle of a board may stand from the stripe and from the middle of the image, mm.
_ASIDE, _OFF_STRIPE = 30.0, 25.0
_STAGE_DISTANCE, _STAGE_TILT = 345.0, 0.25
# The pattern with one square around it stays this far within the image, px.
_BORDER_PX = 6.0
# The platform, from (x, y) to (x, y) of its own frame, and the middle of what stands on it, mm.
_FLOOR = ((-85.0, -15.0), (85.0, 95.0))
OBJECT_Y: Final = 37.0
# The depth at which the sheet meets the platform of the stage, mm.
_PLATFORM_DEPTH = 350.0


def simulated_rig(seed: int, lasers: int = 1, bow_mm: float = 0.0) -> Rig:
    """The true rig: leaves NumPy float64.

    Args:
        seed: of the directions of sheet and travel.
        lasers: 1, or 2: "upper", the one, and "lower", from the other side onto the same line of the platform.
        bow_mm: how far the sheets are off their planes, towards the camera, at ± 100 mm across the fan on the platform.
    """
    random = np.random.default_rng([2003, seed])
    omega, travel = _turned(_OMEGA, random), _turned(_TRAVEL / np.linalg.norm(_TRAVEL), random)
    with float64():
        camera = Camera.create(IMAGE_SIZE, np.asarray(_FOCAL), np.asarray(_PRINCIPAL), "radial1", np.asarray([_K1]))
        rig = as_numpy(Rig(camera, (_sheet(omega, bow_mm),), Linear.create(_MM_PER_STEP * travel)))
        if lasers == 1:
            return rig
        R, origin = platform(rig)
        beta = R[:, 2] / (R[:, 2] @ origin)
        # The planes through the line where ω and β meet are a ω + (1 - a) β.
        lower = beta + _BEYOND_PLATFORM * (beta - omega)
        sheets = (_sheet(omega, bow_mm, "upper"), _sheet(lower, bow_mm, "lower"))
        return as_numpy(Rig(camera, sheets, rig.motion))


def with_stage(
    rig: Rig,
    *,
    guide_mm: float = 0.0,
    screw_mm: float = 0.0,
    screw_steps: float = SCREW_STEPS,
    play_mm: float = 0.0,
) -> Rig:
    """The rig with a stage that is no line, in the place of its own.

    Args:
        rig: with a line.
        guide_mm: how far the middle of the guide is off the line through the ends of the photographs' travel; its
            carriage turns as it follows the guide.
        screw_mm: by how much the screw is ahead of its steps, and behind them, at most.
        screw_steps: of one turn of the screw.
        play_mm: by how much farther on what it carries stands when it comes back.
    """
    if not guide_mm and not screw_mm and not play_mm:
        return rig
    step = stage_travel(rig, np.ones(1))[0]
    over = float(np.linalg.norm(step)) * STEPS_APART * (STAGE_VIEWS - 1)
    R, origin = platform(rig)
    stage = DrawnStage.create(
        step,
        sag_mm=guide_mm,
        over_mm=over,
        towards=R[:, 2],
        origin=origin,
        wave_mm=screw_mm,
        period=screw_steps,
        phase=_SCREW_PHASE,
        play_mm=play_mm,
    )
    return rig.with_axis(stage)


def stage_steps(rig: Rig, count: int, apart: int) -> tuple[int, ...]:
    """Motor steps of photographs on the stage: one after the other; there and back where it has play, which tells it.

    Args:
        rig: with a stage.
        count: of the photographs.
        apart: from one place to the next.
    """
    steps = [apart * i for i in range(count)]
    return tuple(steps[::2] + steps[1::2][::-1] if _plays(rig) else steps)


def stage_runs(rig: Rig, steps: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """The entry that positions of the stage have beside these steps where it has play, else none."""
    return {run_of(STAGE): tuple(runs(np.asarray(steps)).tolist())} if _plays(rig) else {}


def _plays(rig: Rig) -> bool:
    stage = rig.axes().get(STAGE)
    return isinstance(stage, DrawnStage) and bool(stage.play[0])


def _sheet(omega: Float[np.ndarray, "3"], bow_mm: float, name: str = "") -> Light:
    if bow_mm:
        return BowedSheet.curved(omega, bow_mm, 100.0, _PLATFORM_DEPTH, name)
    return LightPlane.create(omega, name)


def board_poses(rig: Rig, seed: int, views: int = BOARD_VIEWS) -> Pose:
    """T_cam_board of the board poses, stacked: the whole pattern is in view and the stripe crosses it."""
    random = np.random.default_rng([2003, seed, 1])
    rotations, translations = [], []
    while len(rotations) < views:
        rotation = np.array([*random.uniform(-_TILT, _TILT, 2), random.uniform(-_ROLL, _ROLL)])
        aside = np.array([random.uniform(-_ASIDE, _ASIDE), random.uniform(-_OFF_STRIPE, _OFF_STRIPE), 0.0])
        middle = _sheet_point(rig, random.uniform(_NEAREST, _FARTHEST)) + aside
        R, translation = _about_middle(rotation, middle)
        if in_view(rig.camera, R, translation[None]):
            rotations.append(rotation)
            translations.append(translation)
    return Pose(np.stack(rotations), np.stack(translations))


def stage_pose(rig: Rig, seed: int) -> Pose:
    """T_cam_board at step 0 of the board that is fixed on the stage: in view over its whole travel."""
    random = np.random.default_rng([2003, seed, 2])
    travel = stage_travel(rig, np.arange(STAGE_VIEWS) * STEPS_APART)
    while True:
        rotation = random.uniform(-_STAGE_TILT, _STAGE_TILT, 3) * [1, 1, 0.3]
        middle = np.array([random.uniform(-5, 5), random.uniform(-3, 3), _STAGE_DISTANCE]) - travel[-1] / 2
        R, translation = _about_middle(rotation, middle)
        if in_view(rig.camera, R, translation + travel[[0, -1]]):
            return Pose(rotation, translation)


def with_turntable(rig: Rig, seed: int) -> Rig:
    """The rig with a turntable where the scanned object stands."""
    random = np.random.default_rng([2003, seed, 3])
    R, origin = platform(rig)
    aside = random.uniform(-_OFF_AXIS, _OFF_AXIS, 2)
    axis = _turned(R[:, 2], random)
    with float64():
        through = origin + R @ np.array([aside[0], OBJECT_Y + aside[1], 0.0])
        turntable = Rotary.create(2 * np.pi / STEPS_PER_TURN * axis, through)
        return as_numpy(rig.with_axis(turntable).normal())


def turntable_pose(rig: Rig, seed: int) -> Pose:
    """The pose, in the object frame and at the turntable's step 0, of the board that lies on it: in view all around."""
    random = np.random.default_rng([2003, seed, 4])
    R, origin = platform(rig)
    # The board's z points away from the camera, into the platform.
    lying = R @ np.diag([1.0, -1.0, -1.0])
    moved = stage_travel(rig, np.array([TURNTABLE_STAGE_STEP]))
    while True:
        askew = vector_to_matrix(random.uniform(-_STAGE_TILT, _STAGE_TILT, 3) * [0.2, 0.2, 1])
        aside = np.array([*random.uniform(-_OFF_AXIS, _OFF_AXIS, 2), 0.0])
        rotation = matrix_to_vector(lying @ askew)
        _, translation = _about_middle(rotation, origin + R @ (np.array([0.0, OBJECT_Y, 0.0]) + aside))
        pose = Pose(rotation, translation)
        if all(
            in_view(rig.camera, at.matrix(), at.translation + moved)
            for at in turned_boards(rig, pose, TURNS_APART * np.arange(TURNTABLE_VIEWS))
        ):
            return pose


def turned_boards(rig: Rig, pose: Pose, steps: Num[np.ndarray, "images"]) -> list[Pose]:
    """A pose in the object frame as the turntable turns.

    Raises:
        InputError: the rig has no turntable.
    """
    if "turntable" not in rig.axes():
        raise InputError("the rig has no turntable: make one with with_turntable")
    return [as_numpy(rig.pose({"turntable": np.float64(n)})) @ pose for n in steps]


def stage_travel(rig: Rig, steps: Num[np.ndarray, "images"]) -> Float[np.ndarray, "images 3"]:
    """How far the stage has moved its load (mm, camera frame)."""
    return as_numpy(rig.pose({"stage": steps.astype(np.float64)})).translation


def platform(rig: Rig, depth: float = _PLATFORM_DEPTH) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """The frame of the stage's platform: rotation and origin of T_cam_platform.

    z points up, out of the platform; y against the travel, so that what stands at y comes under the sheet after about
    y millimetres; the origin lies on the sheet at step 0.
    """
    travel = stage_travel(rig, np.ones(1))[0]
    y = -travel / np.linalg.norm(travel)
    x = np.array([1.0, 0.0, 0.0])
    x = x - (x @ y) * y
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)], axis=1), _sheet_point(rig, depth)


def mirrored_lamp(rig: Rig) -> tuple[float, float, float]:
    """Towards a lamp that the camera would see in a mirror on the platform, where the sheet meets it.

    So its highlight lies under the stripe on whatever is flat and parallel to the platform.
    """
    R, origin = platform(rig)
    sight = -origin / np.linalg.norm(origin)
    x, y, z = 2 * (R[:, 2] @ sight) * R[:, 2] - sight
    return float(x), float(y), float(z)


def scan_scene(rig: Rig, bodies: Sequence[Body]) -> Scene:
    """Objects on the platform, as they stand at step 0: bodies of the platform's frame with the floor under them."""
    R, origin = platform(rig)
    return Scene(tuple(body.moved(R, origin) for body in (*bodies, floor(*_FLOOR))))


def turning_axes(apart: int) -> dict[str, tuple[int, ...]]:
    """A full turn of the turntable in frames so many of its motor steps apart, its axis under the sheet."""
    turns = tuple(range(0, STEPS_PER_TURN, apart))
    return {"stage": (_UNDER_SHEET,) * len(turns), "turntable": turns}


def turned(bodies: Sequence[Body], degrees: float) -> tuple[Body, ...]:
    """What stands on the platform, turned about the upright through its middle, anticlockwise as seen from above."""
    middle = np.array([0.0, OBJECT_Y, 0.0])
    R = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    return tuple(body.moved(R, middle - R @ middle) for body in bodies)


def turned_on(rig: Rig, bodies: Sequence[Body], steps: float) -> tuple[Body, ...]:
    """What stands on the turntable, after so many of its motor steps, in the platform's frame."""
    R, origin = platform(rig)
    T = turned_boards(rig, Pose.identity(), np.array([steps]))[0]
    turn = T.matrix()
    return tuple(body.moved(R.T @ turn @ R, R.T @ (turn @ origin + T.translation - origin)) for body in bodies)


def board_scene(rotation: Float[np.ndarray, "3"], translation: Float[np.ndarray, "3"]) -> Scene:
    """The board alone, in the pose T_cam_board, fixed on the stage where there is one."""
    return Scene((board_plate(BOARD).moved(vector_to_matrix(rotation), translation),))


def held(rig: Rig, hand: Hand, pose: Pose, seed: tuple[int, int], exposures: int) -> list[list[Scene]]:
    """The board alone, held in the pose T_cam_board: at even times of each of several exposures.

    Args:
        rig: the true one.
        hand: how still it is.
        pose: the mean one over the first exposure.
        seed: of the session, and which view it is.
        exposures: how many, right after each other.
    """
    px_per_mm = max(float(f) for f in rig.camera.focal) / float(pose.apply(BOARD.points())[:, 2].min())
    moments = hand.held(pose, BOARD.points(), (2003, seed[0], 5, seed[1]), exposures, px_per_mm)
    return [[board_scene(np.asarray(at.rotation), np.asarray(at.translation)) for at in each] for each in moments]


def _sheet_point(rig: Rig, depth: float) -> Float[np.ndarray, "3"]:
    """The point of the first laser's sheet at a depth that is nearest to the optical axis (mm)."""
    omega = plane_of(rig.lights[0])
    aside = omega[:2] * (1 - omega[2] * depth) / (omega[:2] @ omega[:2])
    return np.array([*aside, depth])


def _turned(vector: Float[np.ndarray, "3"], random: np.random.Generator) -> Float[np.ndarray, "3"]:
    """The vector turned by 2° about a random axis at right angles to it."""
    aside = np.cross(vector, random.standard_normal(3))
    aside *= np.linalg.norm(vector) / np.linalg.norm(aside)
    return np.cos(_TURN) * vector + np.sin(_TURN) * aside


def _about_middle(
    rotation: Float[np.ndarray, "3"], middle: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Rotation matrix and translation of T_cam_board with the middle of the board at a place."""
    R = vector_to_matrix(rotation)
    return R, middle - R @ BOARD.points().mean(axis=0)


def in_view(camera: Camera, R: Float[np.ndarray, "3 3"], translations: Float[np.ndarray, "places 3"]) -> bool:
    """Whether the pattern, with the squares around its points, is within the image at each place."""
    points = BOARD.points()
    low, high = points.min(axis=0) - BOARD.pitch_mm, points.max(axis=0) + BOARD.pitch_mm
    outline = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])
    corners = (outline @ R.T)[None] + translations[:, None]
    with float64():
        pixels = np.asarray(_project(camera, jnp.asarray(corners.reshape(-1, 3))))
    inside = (pixels > -0.5 + _BORDER_PX) & (pixels < np.asarray(camera.image_size) - 0.5 - _BORDER_PX)
    return bool(inside.all())


@jax.jit
def _project(camera: Camera, points: Float[Array, "points 3"]) -> Float[Array, "points 2"]:
    return jax.vmap(camera.project)(points)
