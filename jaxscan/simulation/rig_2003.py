"""The simulated rig of 2003: the camera, the laser, the stage and the poses of a laboratory's scanner of that year.

Camera 640 × 480, f = (697.70833, 690.43328) px, c = (310.29604, 228.14934) px, k1 = −0.13396; light plane
ω = (0, −0.00494, 0.00303) 1/mm and stage 0.001 · unit(0.03, 0.92, −0.39) mm a step, both turned by 2° about a random
axis; a sheet of σ 0.25 mm; 11 poses of a board of 9 × 6 inner corners of 16 mm, 310 to 380 mm away and tilted by up to
0.6 rad about x and y, with the stripe across them; 31 photographs of that board on the stage, 2000 steps apart; a scan
of 37 frames from step 0, 2000 steps apart. With two lasers the second shines from below onto the line of the platform
where the first does. A turntable, on request, stands on the platform of the stage: 3200 steps a turn about an axis 2°
off the platform's normal; 32 photographs of the board leaning on it by 0.7 rad, 100 steps apart, with the stage where
the board is in the middle of the image.
"""

from collections.abc import Sequence
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Num
from scipy.spatial.transform import Rotation

from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE
from jaxscan.geometry import Pose, matrix_to_vector, vector_to_matrix
from jaxscan.images import Board
from jaxscan.kept_programs import compiled
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
TURNTABLE_VIEWS: Final = 32
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
_UNDER_SHEET: Final = 37000
# How high above the platform objects are about the turntable's axis, mm.
_TOP: Final = 26.0
# Where in its turn a screw stands at step 0.
_SCREW_PHASE = 1.0
# Motor steps of the turntable from frame to frame of a scan that turns.
TURN_APART: Final = 20
# How far the turntable's axis, and the middle of the board on it, may stand from where they should, mm.
_OFF_AXIS = 3.0
# The board on the turntable leans, rad, so that the camera sees it tilted another way at every angle: that determines
# the focal length, which a board that lies flat hardly does.
_LEAN = 0.7
# Where the stage may stand meanwhile, and at how many angles that is asked.
_STAGE_STEPS_TRIED = (10_000, 60_000, 2000)
_TURNS_TRIED = 16
# Makes the second sheet about as steep as the first, (0, 0.00494, 0.00268) 1/mm.
_BEYOND_PLATFORM = 0.6

_NEAREST, _FARTHEST, _TILT, _ROLL = 310.0, 380.0, 0.6, 0.15
# How far the middle of a board may stand from the stripe and from the middle of the image, mm.
_ASIDE, _OFF_STRIPE = 30.0, 25.0
_STAGE_DISTANCE, _STAGE_TILT = 345.0, 0.25
_TRIED_AT_ONCE = 64
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
    """The rig with a stage that is no line, instead of its own.

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
    """Motor steps of photographs on the stage: one after the other; there and back where it has play, to determine it.

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
    widest = np.array([_STAGE_TILT, _STAGE_TILT, _STAGE_TILT, 5.0, 3.0])
    while True:
        # Many at once: of a stage that is no line hardly any pose is in view all the way.
        tries = random.uniform(-widest, widest, (_TRIED_AT_ONCE, len(widest)))
        rotations = tries[:, :3] * [1, 1, 0.3]
        middles = np.insert(tries[:, 3:], 2, _STAGE_DISTANCE, axis=1) - travel[-1] / 2
        R, translations = _about_middle(rotations, middles)
        seen = np.flatnonzero(in_view(rig.camera, R, translations[:, None] + travel[[0, -1]]))
        if len(seen):
            return Pose(rotations[seen[0]], translations[seen[0]])


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
    """The pose (object frame, turntable at step 0) of the board that leans on the turntable, in view all around."""
    random = np.random.default_rng([2003, seed, 4])
    moved = stage_travel(rig, np.array([turntable_stage_step(rig)]))
    while True:
        askew = random.uniform(-_STAGE_TILT, _STAGE_TILT, 3) * [0.2, 0.2, 1]
        pose = _leaning(rig, askew, random.uniform(-_OFF_AXIS, _OFF_AXIS, 2))
        if all(
            in_view(rig.camera, at.matrix(), at.translation + moved)
            for at in turned_boards(rig, pose, turns_of(TURNTABLE_VIEWS))
        ):
            return pose


def turntable_stage_step(rig: Rig) -> int:
    """Where the stage stands meanwhile: the board is as far within the image, all around, as can be."""
    boards = turned_boards(rig, _leaning(rig, np.zeros(3), np.zeros(2)), turns_of(_TURNS_TRIED))
    at_start = np.concatenate([_outline() @ at.matrix().T + at.translation for at in boards])
    steps = np.arange(*_STAGE_STEPS_TRIED)
    corners = at_start + stage_travel(rig, steps)[:, None]
    pixels = _pixels(rig.camera, corners)
    inside = np.minimum(pixels, np.asarray(rig.camera.image_size) - 1 - pixels).min(axis=(1, 2))
    return int(steps[inside.argmax()])


def _leaning(rig: Rig, askew: Float[np.ndarray, "3"], aside: Float[np.ndarray, "2"]) -> Pose:
    """The board leaning on the turntable, turned by so much (rad) and so far (mm) from where it should be."""
    R, origin = platform(rig)
    # The board's z points away from the camera, into the platform; the edge of its outer squares stands on it.
    leaning = R @ np.diag([1.0, -1.0, -1.0]) @ vector_to_matrix(np.array([_LEAN, 0.0, 0.0]))
    height = np.sin(_LEAN) * (np.ptp(BOARD.points()[:, 1]) / 2 + BOARD.pitch_mm)
    rotation = matrix_to_vector(leaning @ vector_to_matrix(askew))
    middle = origin + R @ np.array([aside[0], OBJECT_Y + aside[1], height])
    return Pose(rotation, _about_middle(rotation, middle)[1])


def turns_of(views: int) -> Int[np.ndarray, "views"]:
    """Motor steps of the turntable at photographs of the board all around: evenly, the first at 0."""
    return STEPS_PER_TURN // views * np.arange(views)


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


def middle_of_object(rig: Rig) -> Float[np.ndarray, "3"]:
    """The point of the platform on which the middle of an object stands at step 0, camera frame, mm."""
    R, origin = platform(rig)
    return origin + R @ np.array([0.0, OBJECT_Y, 0.0])


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


def turning_axes(apart: int, stage_step: int = _UNDER_SHEET) -> dict[str, tuple[int, ...]]:
    """A full turn of the turntable in frames `apart` motor steps apart, the stage at one place meanwhile."""
    turns = tuple(range(0, STEPS_PER_TURN, apart))
    return {"stage": (stage_step,) * len(turns), "turntable": turns}


def step_over_axis(rig: Rig, laser: int = 0) -> int:
    """The stage's step at which a sheet meets the turntable's axis at the top of what stands on it.

    The axis is not in the sheet: at other heights a disc about it is never lit in a turn.

    Args:
        rig: with a turntable.
        laser: which of its lasers (an index).
    """
    R, origin = platform(rig)
    turntable = rig.axis("turntable")
    assert isinstance(turntable, Rotary)
    axis, centre = np.asarray(turntable.direction()), np.asarray(turntable.centre)
    top = centre + axis * (_TOP - (centre - origin) @ R[:, 2]) / (axis @ R[:, 2])
    with float64():
        steps = np.arange(0.0, 2.0 * _UNDER_SHEET, 100.0)
        level = np.asarray(rig.lights[laser].level(jnp.asarray(top + stage_travel(rig, steps))))
    return int(steps[np.abs(level).argmin()])


def turned(bodies: Sequence[Body], degrees: float) -> tuple[Body, ...]:
    """What stands on the platform, turned about the upright through its middle, anticlockwise as seen from above."""
    middle = np.array([0.0, OBJECT_Y, 0.0])
    R = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    return tuple(body.moved(R, middle - R @ middle) for body in bodies)


def turned_on(rig: Rig, bodies: Sequence[Body], steps: float) -> tuple[Body, ...]:
    """What is on the turntable, after `steps` motor steps, in the platform's frame."""
    R, origin = platform(rig)
    T = turned_boards(rig, Pose.identity(), np.array([steps]))[0]
    turn = T.matrix()
    return tuple(body.moved(R.T @ turn @ R, R.T @ (turn @ origin + T.translation - origin)) for body in bodies)


def board_scene(rotation: Float[np.ndarray, "3"], translation: Float[np.ndarray, "3"], bend_mm: float = 0.0) -> Scene:
    """The board alone, in the pose T_cam_board, fixed on the stage where there is one; bent, where it is."""
    return Scene((board_plate(BOARD, bend_mm=bend_mm).moved(vector_to_matrix(rotation), translation),))


def held(
    rig: Rig, hand: Hand, pose: Pose, seed: tuple[int, int], exposures: int, bend_mm: float = 0.0
) -> list[list[Scene]]:
    """The board alone, held in the pose T_cam_board: at even times of each of several exposures.

    Args:
        rig: the true one.
        hand: how still it is.
        pose: the mean one over the first exposure.
        seed: of the session, and which view it is.
        exposures: how many, right after each other.
        bend_mm: of the board.
    """
    px_per_mm = max(float(f) for f in rig.camera.focal) / float(pose.apply(BOARD.points())[:, 2].min())
    moments = hand.held(pose, BOARD.points(), (2003, seed[0], 5, seed[1]), exposures, px_per_mm)
    return [
        [board_scene(np.asarray(at.rotation), np.asarray(at.translation), bend_mm) for at in each] for each in moments
    ]


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
    rotation: Float[np.ndarray, "*stack 3"], middle: Float[np.ndarray, "*stack 3"]
) -> tuple[Float[np.ndarray, "*stack 3 3"], Float[np.ndarray, "*stack 3"]]:
    """Rotation matrix and translation of T_cam_board with the middle of the board at a place."""
    R = vector_to_matrix(rotation)
    return R, middle - R @ BOARD.points().mean(axis=0)


def in_view(
    camera: Camera, R: Float[np.ndarray, "*stack 3 3"], translations: Float[np.ndarray, "*stack places 3"]
) -> Bool[np.ndarray, "*stack"]:
    """Whether the pattern, with the squares around its points, is within the image at each of a pose's places."""
    corners = (_outline() @ R.swapaxes(-1, -2))[..., None, :, :] + translations[..., None, :]
    pixels = _pixels(camera, corners)
    inside = (pixels > -0.5 + _BORDER_PX) & (pixels < np.asarray(camera.image_size) - 0.5 - _BORDER_PX)
    return np.asarray(inside.all(axis=(-3, -2, -1)))


def _outline() -> Float[np.ndarray, "4 3"]:
    """The corners of the pattern with the squares around its points, in the board's frame, mm."""
    points = BOARD.points()
    low, high = points.min(axis=0) - BOARD.pitch_mm, points.max(axis=0) + BOARD.pitch_mm
    return np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])


def _pixels(camera: Camera, points: Float[np.ndarray, "*of 3"]) -> Float[np.ndarray, "*of 2"]:
    with float64():
        seen = np.asarray(_project(camera, jnp.asarray(points.reshape(-1, 3))))
    return seen.reshape(*points.shape[:-1], 2)


@compiled()
def _project(camera: Camera, points: Float[Array, "points 3"]) -> Float[Array, "points 2"]:
    return jax.vmap(camera.project)(points)
