"""Sessions and scans of a simulated rig as folders, with the truth beside them.

The truth is three kinds of files:

- `rig.json`: the true rig, in the format of any rig.
- `session.json`: `seed`; `boards`, T_cam_board of every view, and `stage`, that of the board on the stage at step 0, as
  rotation vector (radians) and translation (mm); `stage_steps`. With a turntable `turntable`, T_cam_board of the board
  on it with both at step 0; `turntable_steps`; `turntable_stage_step`, that of the stage. With a robot `hand`,
  T_base_hand of the last boards as it truly was, in place of the stage.
- `scan.npz`, or `scan-NAME.npz` for each of several lasers: motor steps (frames) by the name of each axis;
  `position` (frames, columns), the row in
  which an ideal camera sees the middle of the sheet; `points` (frames, columns, 3), that point in the object frame, mm;
  NaN where there is none.
"""

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.axes import STAGE
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.files.scan import SCAN_FILE, Scan, write_scan
from jaxscan.files.session import SESSION_FILE, Session, Views, write_session
from jaxscan.files.session_axes import StageImages, TurntableImages
from jaxscan.geometry import Pose
from jaxscan.images import StripeSettings
from jaxscan.npy import read_npz
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Rig
from jaxscan.simulation import rig_2003
from jaxscan.simulation.drawn_stage import DrawnStage
from jaxscan.simulation.hand import STILL, Hand
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.photographs import JPEG_QUALITY, Advance, Photographer, clear_for, make_folders
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.rig_2003 import BOARD, SCAN_FRAMES, STEPS_APART
from jaxscan.simulation.scene import Scene

TRUE_RIG: Final = "rig.json"
TRUE_SESSION: Final = "session.json"

# Second number of the seed: photographs of different kinds share no noise.
_BOARD_NOISE, _STAGE_NOISE, _SCAN_NOISE, _STRIPE_NOISE = range(4)
# Beyond those of any number of lasers.
_TURNTABLE_NOISE = 100
_DARK_NOISE = 200


@dataclass(frozen=True)
class SessionTruth:
    """What a simulated session shows.

    Attributes:
        rig: the true rig.
        seed: of the rig, the poses and the noise.
        boards: T_cam_board of every view, stacked; the mean over the exposure of the board where a hand shakes.
        stage: T_cam_board of the board on the stage at step 0; None without one.
        stage_steps: motor step count of every stage photograph.
        turntable: T_cam_board of the board on the turntable with stage and turntable at step 0; None without one.
        turntable_steps: motor step count of every turntable photograph.
        hand: T_base_hand of the last views, where a robot was, not where it said it was; None without one.
    """

    rig: Rig
    seed: int
    boards: Pose
    stage: Pose | None = None
    stage_steps: tuple[int, ...] = ()
    turntable: Pose | None = None
    turntable_steps: tuple[int, ...] = ()
    hand: Pose | None = None


@dataclass(frozen=True)
class ScanTruth:
    """What a simulated scan shows.

    Attributes:
        axes: motor steps of each axis at every frame.
        position: row in which an ideal camera sees the middle of the sheet, NaN for none, px.
        points: that point in the object frame, mm.
        which: of several scans, by laser or by side; empty for the only one.
    """

    axes: dict[str, Int[np.ndarray, "frames"]]
    position: Float[np.ndarray, "frames columns"]
    points: Float[np.ndarray, "frames columns 3"]
    which: str = ""


def simulate_session(
    folder: Path,
    seed: int = 0,
    *,
    rig: Rig | None = None,
    views: int | None = None,
    stage_views: int | None = None,
    turntable_views: int | None = None,
    steps_apart: int = STEPS_APART,
    lighting: Lighting = rig_2003.BOARD_LIGHTING,
    sensor: Sensor = rig_2003.SENSOR,
    hand: Hand = STILL,
    bend_mm: float = 0.0,
    separate_stripes: bool = False,
    ending: str = ".png",
    quality: int = JPEG_QUALITY,
    advance: Advance = lambda count: None,
) -> SessionTruth:
    """Write a calibration session of the simulated rig of 2003: boards with the stripe, and a board on the stage.

    Of a rig with a turntable also a board that leans on that.

    Args:
        folder: gets `session.toml`, `boards/`, `stage/` and `turntable/`; is made if it is not there.
        seed: of the rig, the poses and the noise.
        rig: another rig than that of the seed; with several lasers the stripes are photographed separately.
        views: how many poses, the first of them the same whatever their number; 11 if None.
        stage_views: how many photographs of the board on the stage; 31 if None.
        turntable_views: how many photographs of the board on the turntable, if the rig has one; 32 if None.
        steps_apart: motor steps from one photograph on the stage to the next.
        lighting: of the boards with a stripe; the stage photographs have the same without the laser. Boards are matt.
        sensor: of all photographs.
        hand: how still it holds the boards of the views; those on stage and turntable do not shake.
        bend_mm: of the board, as `shapes.board_plate` has it.
        separate_stripes: photograph every pose once without the laser and once with it, into `stripes/`.
        ending: format of the photographs.
        quality: of JPEG, whose colour has half the resolution (4:2:0).
        advance: called with 1 after every photograph.

    Raises:
        InputError: something cannot be written.
    """
    rig = rig_2003.simulated_rig(seed) if rig is None else rig
    separate = separate_stripes or len(rig.lights) != 1
    views = rig_2003.BOARD_VIEWS if views is None else views
    boards, stage = rig_2003.board_poses(rig, seed, views), rig_2003.stage_pose(rig, seed)
    steps = rig_2003.stage_steps(rig, rig_2003.STAGE_VIEWS if stage_views is None else stage_views, steps_apart)
    come = {STAGE: steps, **rig_2003.stage_runs(rig, steps)}
    inner = [*(["stripes"] if separate else []), *(["turntable"] if "turntable" in rig.axes() else [])]
    clear_for(SESSION_FILE, folder, "boards", "stage", *inner)
    shoot = Photographer(folder, rig, seed, lighting, sensor, ending, quality, advance).shoot
    board_images: list[Path] = []
    stripe_images: dict[str, list[Path | None]] = {laser.name: [] for laser in rig.lights}
    for i in range(views):
        pose = Pose(np.asarray(boards.rotation[i]), np.asarray(boards.translation[i]))
        exposures = rig_2003.held(rig, hand, pose, (seed, i), 1 + (len(rig.lights) if separate else 0), bend_mm)
        board_images.append(shoot(f"boards/{i:02d}", exposures[0], (_BOARD_NOISE, i), laser=None if separate else 0))
        for n, laser in enumerate(rig.lights if separate else ()):
            name = f"stripes/{laser.name or 'stripe'}-{i:02d}"
            stripe_images[laser.name].append(shoot(name, exposures[1 + n], (_STRIPE_NOISE + n, i), laser=n))
    scene = rig_2003.board_scene(np.asarray(stage.rotation), np.asarray(stage.translation), bend_mm)
    stage_images = [
        shoot(f"stage/{i:02d}", scene, (_STAGE_NOISE, i), q={name: each[i] for name, each in come.items()})
        for i in range(len(steps))
    ]
    leaning = rig_2003.turntable_pose(rig, seed) if "turntable" in rig.axes() else None
    turns = tuple(rig_2003.turns_of(turntable_views or rig_2003.TURNTABLE_VIEWS).tolist()) if leaning else ()
    on_stage, turned = rig_2003.turntable_stage_step(rig) if leaning else 0, []
    for i, pose in enumerate(rig_2003.turned_boards(rig, leaning, np.array(turns)) if leaning else ()):
        scene = rig_2003.board_scene(np.asarray(pose.rotation), np.asarray(pose.translation), bend_mm)
        turned.append(shoot(f"turntable/{i:02d}", scene, (_TURNTABLE_NOISE, i), q={STAGE: on_stage}))
    stripes = {name: tuple(paths) for name, paths in stripe_images.items()} if separate and rig.lights else None
    write_session(
        Session(
            path=folder / SESSION_FILE,
            board=BOARD,
            views=Views(tuple(board_images), stripes),
            stage=StageImages(tuple(stage_images), steps),
            turntable=TurntableImages(tuple(turned), turns, on_stage) if turned else None,
            lasers=tuple(StripeSettings(name=laser.name) for laser in rig.lights),
            image_size=rig.camera.image_size,
        )
    )
    return SessionTruth(rig, seed, boards, stage, steps, leaning, turns)


def simulate_scan(
    folder: Path,
    rig: Rig,
    scene: Scene,
    seed: int = 0,
    *,
    laser: int = 0,
    name: str = "",
    frames: int = SCAN_FRAMES,
    steps_apart: int = STEPS_APART,
    axes: Mapping[str, Sequence[int]] | None = None,
    lighting: Lighting = rig_2003.SCAN_LIGHTING,
    sensor: Sensor = rig_2003.SENSOR,
    ending: str = ".png",
    quality: int = JPEG_QUALITY,
    advance: Advance = lambda count: None,
    laser_off: bool = False,
) -> ScanTruth:
    """Write a scan: `scan.toml` and `frames/`, and `dark/` where each step is photographed without the laser too.

    Args:
        folder: is made if it is not there.
        rig: the true rig.
        scene: as it stands with all axes at 0.
        seed: of the noise.
        laser: which of the rig's lasers is on (an index).
        name: of the object.
        frames: how many, the first at the stage's step 0.
        steps_apart: motor steps of the stage from one to the next.
        axes: motor steps of each axis at each frame, in place of these two.
        lighting: what lights the scene.
        sensor: of all frames.
        ending: format of the photographs.
        quality: of JPEG, whose colour has half the resolution (4:2:0).
        advance: called with 1 after every photograph of the laser.
        laser_off: photograph each step with the laser off too: the scan's `background`.

    Raises:
        InputError: something cannot be written.
    """
    clear_for(SCAN_FILE, folder, "frames", *(["dark"] if laser_off else []))
    photographer = Photographer(folder, rig, seed, lighting, sensor, ending, quality, advance)
    # Those without the laser do not count.
    in_the_dark = replace(photographer, advance=lambda count: None)
    given = {STAGE: range(0, steps_apart * frames, steps_apart)} if axes is None else axes
    positions = {axis: tuple(int(n) for n in steps) for axis, steps in given.items()}
    come = positions | rig_2003.stage_runs(rig, positions.get(STAGE, ()))
    paths, dark, profiles = [], [], []
    for i, place in enumerate(zip(*come.values(), strict=True)):
        q = dict(zip(come, place, strict=True))
        noise = (_SCAN_NOISE, i, *([laser] if laser else []))
        paths.append(photographer.shoot(f"frames/{i:03d}", scene, noise, q=q, laser=laser))
        if laser_off:
            dark.append(in_the_dark.shoot(f"dark/{i:03d}", scene, (_DARK_NOISE, i), q=q))
        profiles.append(true_profile(rig, scene, q, laser=laser, lighting=lighting))
    settings = StripeSettings(name=rig.lights[laser].name)
    write_scan(
        Scan(folder / SCAN_FILE, settings, frames=tuple(paths), axes=positions, backgrounds=tuple(dark), name=name)
    )
    rows, points = (np.stack([profile[k] for profile in profiles]) for k in (0, 1))
    return ScanTruth({axis: np.asarray(steps) for axis, steps in positions.items()}, rows, points, settings.name)


def scan_name(which: str) -> str:
    """What a scan is called: `scan`, or `scan-WHICH` for one of several."""
    return f"scan-{which}" if which else "scan"


def write_truth(folder: Path, session: SessionTruth, *scans: ScanTruth) -> None:
    """Write the files of the truth, those of each scan by its name.

    Raises:
        InputError: something cannot be written.
    """
    make_folders(folder)
    values: dict[str, Any] = {
        "seed": session.seed,
        "boards": [_pose_values(session.boards, i) for i in range(len(session.boards.rotation))],
    }
    if session.stage is not None:
        values["stage"] = _pose_values(session.stage, ...)
        values["stage_steps"] = list(session.stage_steps)
    if session.hand is not None:
        values["hand"] = [_pose_values(session.hand, i) for i in range(len(session.hand.rotation))]
    if session.turntable is not None:
        values["turntable"] = _pose_values(session.turntable, ...)
        values["turntable_steps"] = list(session.turntable_steps)
        values["turntable_stage_step"] = rig_2003.turntable_stage_step(session.rig)
    with replacing(folder / TRUE_SESSION, "w") as file:
        json.dump(values, file, indent=2)
    for scan in scans:
        with replacing(folder / f"{scan_name(scan.which)}.npz") as file:
            arrays: dict[str, Any] = {"position": scan.position, "points": scan.points, **scan.axes}
            np.savez(file, **arrays)
    write_rig(folder / TRUE_RIG, RigFile(with_kinds_of_files(session.rig)))


def with_kinds_of_files(rig: Rig) -> Rig:
    """A rig whose drawn stage, if it has one, is of the kind of motion that a rig file can have."""
    stages = [part for part in rig.motion.parts() if isinstance(part, DrawnStage)]
    with float64():
        return as_numpy(rig.with_axis(stages[0].nearest_kind())) if stages else rig


def read_scan_truth(folder: Path, which: str = "") -> ScanTruth:
    """Read what `write_truth` wrote of a scan.

    Raises:
        InputError: there is no such file.
    """
    path = folder / f"{scan_name(which)}.npz"
    if not path.is_file():
        raise InputError(f"{path}: there is no such file: name the folder truth of a simulation")
    return read_truth_file(path, which)


def truth_file(path: Path) -> Path | None:
    """The file with the truth of a scan: the path itself, or the only one in a folder truth; None if it is neither.

    Raises:
        InputError: a folder has the truth of several scans.
    """
    if path.is_dir():
        found = sorted(path.glob(f"{scan_name('')}*.npz")) if (path / TRUE_RIG).is_file() else []
        if len(found) > 1:
            names = ", ".join(each.name for each in found)
            raise InputError(f"{path}: has the truth of {len(found)} scans: name one of its files: {names}")
        return found[0] if found else None
    if path.suffix.lower() != ".npz" or not zipfile.is_zipfile(path):
        return None
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
    return path if names >= {"position.npy", "points.npy"} and "strength.npy" not in names else None


def read_truth_file(path: Path, which: str = "") -> ScanTruth:
    """Read one file that `write_truth` wrote of a scan.

    Raises:
        InputError: it holds something else.
    """
    arrays = read_npz(path, lambda name: True)
    position, points = arrays.pop("position", np.zeros(0)), arrays.pop("points", np.zeros(0))
    if position.ndim != 2 or points.shape != (*position.shape, 3):
        raise InputError(
            f'{path}: "position" and "points" have the shapes {position.shape} and {points.shape}, not (frames, '
            "columns) and as many points: simulate again"
        )
    return ScanTruth(arrays, position, points, which)


def _pose_values(pose: Pose, i: Any) -> dict[str, list[float]]:
    vectors = np.asarray(pose.rotation), np.asarray(pose.translation)
    return {key: vector[i].tolist() for key, vector in zip(("rotation", "translation"), vectors, strict=True)}
