"""A robot moves the head of a simulated scanner, or the object: a session and a scan at poses that it gives.

The poses that are written have the robot's error: normal, the same along all axes, another in each photograph.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxscan.files.pose_table import write_pose_table
from jaxscan.files.scan import SCAN_FILE, Scan, write_scan
from jaxscan.files.session import SESSION_FILE, Session, Views, write_session
from jaxscan.files.session_poses import PosedImages
from jaxscan.geometry import Pose
from jaxscan.images import StripeSettings
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import CARRIED_BY, HeadPoses, ObjectPoses, Rig, positions_of
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import ScanTruth, SessionTruth
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.photographs import JPEG_QUALITY, Advance, Photographer, clear_for
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.rig_2003 import BOARD
from jaxscan.simulation.scene import Scene

# Photographs of the board at given poses.
POSED_VIEWS: Final = 16
_TABLE: Final = "poses.csv"
# Where the camera sees the hand that it is on, and the base of a robot that moves the object, about: rad and mm.
_TO_CAMERA: Final = {
    "head": ((0.1, -0.05, 1.5), (10.0, 70.0, -90.0)),
    "object": ((2.2, 0.1, 0.2), (120.0, 330.0, 820.0)),
}
# Where the board is: in the base's frame, under the head; on the hand.
_BOARD: Final = {"head": ((0.0, 3.0, 0.1), (520.0, 40.0, 15.0)), "object": ((0.1, 0.2, 1.2), (-40.0, -30.0, 65.0))}
# How far these are from there, rad and mm.
_ASKEW, _ASIDE = 0.2, 20.0
# What is scanned is turned this way and that while it passes the sheet, rad.
_SWAY: Final = 0.12
# Photographs of different kinds share no noise.
_BOARD_NOISE, _SCAN_NOISE = 300, 400
_KINDS: Final = ("camera", "board", "object", "given", "scan")


@dataclass(frozen=True)
class Robot:
    """A robot.

    Attributes:
        moves: "head" or "object".
        sigma_mm: σ of a given position along each axis.
        sigma_deg: σ of a given rotation about each axis.
    """

    moves: str = "head"
    sigma_mm: float = 0.05
    sigma_deg: float = 0.02

    @property
    def kind(self) -> type[HeadPoses] | type[ObjectPoses]:
        """The kind of its motion."""
        return CARRIED_BY[self.moves]

    def given(self, true: Pose[np.ndarray], random: np.random.Generator) -> Pose[np.ndarray]:
        """The poses that it says, of those at which it stands."""
        count = len(true.rotation)
        turned = Rotation.from_rotvec(random.normal(0.0, np.radians(self.sigma_deg), (count, 3)))
        rotation = (Rotation.from_rotvec(true.rotation) * turned).as_rotvec()
        return Pose(rotation, true.translation + random.normal(0.0, self.sigma_mm, (count, 3)))


def with_robot(rig: Rig, robot: Robot, seed: int) -> Rig:
    """The camera and lights of a rig, and a robot in place of its stage."""
    K = _near(*_TO_CAMERA[robot.moves], _random(seed, "camera"))
    with float64():
        motion = robot.kind.create(K.rotation, K.matrix().T @ K.translation)
        return as_numpy(Rig(rig.camera, rig.lights, motion))


def simulate_robot_session(
    folder: Path,
    seed: int,
    rig: Rig,
    robot: Robot,
    *,
    views: int = rig_2003.BOARD_VIEWS,
    posed: int = POSED_VIEWS,
    lighting: Lighting = rig_2003.BOARD_LIGHTING,
    sensor: Sensor = rig_2003.SENSOR,
    ending: str = ".png",
    quality: int = JPEG_QUALITY,
    advance: Advance = lambda count: None,
) -> SessionTruth:
    """Write a calibration session: boards held by hand, and one that stays where it is while the robot moves.

    Args:
        folder: gets `session.toml`, `boards/`, `poses/` and `poses.csv`; is made if it is not there.
        seed: of the poses and the noise.
        rig: as `with_robot` gives it.
        robot: what gives the poses.
        views: how many boards are held by hand.
        posed: how many photographs at given poses.
        lighting: of all boards, with the stripe.
        sensor: of all photographs.
        ending: format of the photographs.
        quality: of JPEG.
        advance: called with 1 after every photograph.

    Raises:
        InputError: something cannot be written.
    """
    clear_for(SESSION_FILE, folder, "boards", "poses")
    shoot = Photographer(folder, rig, seed, lighting, sensor, ending, quality, advance).shoot
    at, paths = rig_2003.board_poses(rig, seed, views + posed), []
    for i in range(views + posed):
        name = f"boards/{i:02d}" if i < views else f"poses/{i - views:02d}"
        scene = rig_2003.board_scene(at.rotation[i], at.translation[i])
        paths.append(shoot(name, scene, (_BOARD_NOISE, i), laser=0))
    mounted = _near(*_BOARD[robot.moves], _random(seed, "board"))
    last = Pose(at.rotation[views:], at.translation[views:])
    true = robot.kind.carry(_motion(rig).to_camera().inverse() @ last @ mounted.inverse())
    given, table = robot.given(true, _random(seed, "given")), folder / _TABLE
    write_pose_table(table, [path.name for path in paths[views:]], given)
    write_session(
        Session(
            path=folder / SESSION_FILE,
            board=BOARD,
            views=Views(tuple(paths)),
            lasers=tuple(StripeSettings(name=light.name) for light in rig.lights),
            image_size=rig.camera.image_size,
            poses=PosedImages(tuple(paths[views:]), table, given, robot.moves),
        )
    )
    return SessionTruth(rig, seed, at, hand=true)


def simulate_robot_scan(
    folder: Path,
    rig: Rig,
    robot: Robot,
    scene: Scene,
    travel: Float[np.ndarray, "frames 3"],
    middle: Float[np.ndarray, "3"],
    seed: int = 0,
    *,
    name: str = "",
    lighting: Lighting = rig_2003.SCAN_LIGHTING,
    sensor: Sensor = rig_2003.SENSOR,
    ending: str = ".png",
    quality: int = JPEG_QUALITY,
    advance: Advance = lambda count: None,
) -> ScanTruth:
    """Write a scan in which the robot takes an object through the sheet, or the sheet over it, and turns it meanwhile.

    Args:
        folder: gets `scan.toml`, `frames/` and `poses.csv`; is made if it is not there.
        rig: as `with_robot` gives it.
        robot: what gives the poses.
        scene: as it stands before the first frame, camera frame.
        travel: how far it is then moved, camera frame, mm.
        middle: about which it is turned, where it stands first, camera frame, mm.
        seed: of the poses and the noise.
        name: of the object.
        lighting: what lights the scene.
        sensor: of all frames.
        ending: format of the photographs.
        quality: of JPEG.
        advance: called with 1 after every photograph.

    Raises:
        InputError: something cannot be written.
    """
    clear_for(SCAN_FILE, folder, "frames")
    shoot = Photographer(folder, rig, seed, lighting, sensor, ending, quality, advance).shoot
    first, true = _passing(rig, robot, travel, middle, seed)
    back = first.inverse()
    scene = replace(scene, bodies=tuple(body.moved(back.matrix(), back.translation) for body in scene.bodies))
    at, paths, profiles = positions_of(true), [], []
    for i in range(len(travel)):
        q: dict[str, Any] = {axis: n[i] for axis, n in at.items()}
        paths.append(shoot(f"frames/{i:03d}", scene, (_SCAN_NOISE, i), q=q, laser=0))
        profiles.append(true_profile(rig, scene, q, laser=0, lighting=lighting))
    given, table = robot.given(true, _random(seed, "scan")), folder / _TABLE
    write_pose_table(table, [path.name for path in paths], given)
    axes = {axis: tuple(n.tolist()) for axis, n in positions_of(given).items()}
    settings = StripeSettings(name=rig.lights[0].name)
    write_scan(Scan(folder / SCAN_FILE, settings, frames=tuple(paths), axes=axes, name=name, poses=table))
    rows, points = (np.stack([profile[k] for profile in profiles]) for k in (0, 1))
    return ScanTruth({axis: np.asarray(n) for axis, n in at.items()}, rows, points)


def _passing(
    rig: Rig, robot: Robot, travel: Float[np.ndarray, "frames 3"], middle: Float[np.ndarray, "3"], seed: int
) -> tuple[Pose[np.ndarray], Pose[np.ndarray]]:
    """T_camera_object before the first frame, and T_base_hand at each frame."""
    K = _motion(rig).to_camera()
    # What the object frame is: the base, with the object in it where the board was; or the hand, the object on it.
    place = _near(*_BOARD[robot.moves], _random(seed, "object"))
    first = Pose(place.inverse().rotation, middle - place.inverse().matrix() @ place.translation)
    phase = np.linspace(0.0, 2 * np.pi, len(travel))[:, None]
    sway = _SWAY * np.concatenate([np.sin(phase), 0.5 * np.sin(2 * phase), 0.7 * np.sin(phase)], axis=1)
    passing = Pose.about(sway, np.broadcast_to(middle, sway.shape), travel)
    return first, robot.kind.carry(K.inverse() @ passing @ first)


def _motion(rig: Rig) -> HeadPoses | ObjectPoses:
    assert isinstance(rig.motion, HeadPoses | ObjectPoses)
    return rig.motion


def _near(
    rotation: tuple[float, float, float], place: tuple[float, float, float], random: np.random.Generator
) -> Pose[np.ndarray]:
    askew = Rotation.from_rotvec(random.uniform(-_ASKEW, _ASKEW, 3))
    turned = (askew * Rotation.from_rotvec(rotation)).as_rotvec()
    return Pose(turned, np.array(place) + random.uniform(-_ASIDE, _ASIDE, 3))


def _random(seed: int, what: str) -> np.random.Generator:
    return np.random.default_rng([2003, seed, _BOARD_NOISE + _KINDS.index(what)])
