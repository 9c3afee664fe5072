"""A light that sweeps over boards and object, which stand still: a session and a scan of the simulated rig of 2003.

In place of the stage the laser turns, about an axis near its own place and a little askew.
"""

from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Int

from jaxscan.files.session import SESSION_FILE, Session, Views, write_session
from jaxscan.files.session_sweeps import AXIS
from jaxscan.images import StripeSettings
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Rig, SweptSheet
from jaxscan.rig.light import laser_place
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import SessionTruth
from jaxscan.simulation.light import Lighting, Sensor
from jaxscan.simulation.photographs import JPEG_QUALITY, Advance, Photographer, clear_for
from jaxscan.simulation.render import plane_of
from jaxscan.simulation.rig_2003 import BOARD
from jaxscan.simulation.scene import Scene

# The light turns by this for a motor step, degrees; in the middle it stands at `MIDDLE` steps.
DEGREES_PER_STEP: Final = 0.01
MIDDLE: Final = 1000
# From the first frame of a scan to its last, motor steps.
SWEEP: Final = 1200
# Stripes on each board.
STRIPES: Final = 7
# How far the axis is askew, radians, and off the laser's place, mm, at most.
_ASKEW, _ASIDE = 0.03, 6.0
_NOISE: Final = 500


def with_sweep(rig: Rig, seed: int) -> Rig:
    """The camera of a rig and its first light, which an axis turns; the stage is left out."""
    random = np.random.default_rng([2003, seed, _NOISE])
    omega, place = plane_of(rig.lights[0]), laser_place(rig.lights[0])
    along = np.array([1.0, 0.0, 0.0]) if abs(omega[1]) > abs(omega[0]) else np.array([0.0, 1.0, 0.0])
    axis = along + random.uniform(-_ASKEW, _ASKEW, 3)
    turn = np.radians(DEGREES_PER_STEP) * axis / np.linalg.norm(axis)
    with float64():
        light = SweptSheet.about(
            omega, turn, place + random.uniform(-_ASIDE, _ASIDE, 3), float(MIDDLE), rig.lights[0].name
        )
        return as_numpy(Rig(rig.camera, (light,)))


def sweep_of(frames: int) -> Int[np.ndarray, "frames"]:
    """Motor steps of the frames of a whole sweep."""
    return MIDDLE + np.round(np.linspace(-SWEEP / 2, SWEEP / 2, frames)).astype(np.int64)


def in_the_middle(rig: Rig, scene: Scene) -> Scene:
    """The scene of a rig with a stage, carried to where the sheet crosses its middle."""
    middle = (rig_2003.SCAN_FRAMES - 1) * rig_2003.STEPS_APART / 2
    return scene.carried(as_numpy(rig.pose({"stage": np.float64(middle)})))


def simulate_swept_session(
    folder: Path,
    seed: int,
    rig: Rig,
    *,
    views: int = rig_2003.BOARD_VIEWS,
    stripes: int = STRIPES,
    lighting: Lighting = rig_2003.BOARD_LIGHTING,
    sensor: Sensor = rig_2003.SENSOR,
    ending: str = ".png",
    quality: int = JPEG_QUALITY,
    advance: Advance = lambda count: None,
) -> SessionTruth:
    """Write a calibration session: of each board a photograph without the light, and some with it, over the sweep.

    Args:
        folder: gets `session.toml`, `boards/` and `stripes/`; is made if it is not there.
        seed: of the poses and the noise.
        rig: as `with_sweep` gives it.
        views: how many poses.
        stripes: how many photographs of each with the light on.
        lighting: of all boards.
        sensor: of all photographs.
        ending: format of the photographs.
        quality: of JPEG.
        advance: called with 1 after every photograph.

    Raises:
        InputError: something cannot be written.
    """
    clear_for(SESSION_FILE, folder, "boards", "stripes")
    shoot = Photographer(folder, rig, seed, lighting, sensor, ending, quality, advance).shoot
    at, steps = rig_2003.board_poses(rig, seed, views), sweep_of(stripes).tolist()
    paths, sweeps = [], []
    for i in range(views):
        scene = rig_2003.board_scene(at.rotation[i], at.translation[i])
        paths.append(shoot(f"boards/{i:02d}", scene, (_NOISE + 1, i)))
        lit = [
            (step, shoot(f"stripes/{i:02d}-{k:02d}", scene, (_NOISE + 2, i, k), q={AXIS: step}, laser=0))
            for k, step in enumerate(steps)
        ]
        sweeps.append(tuple(lit))
    name = rig.lights[0].name
    write_session(
        Session(
            path=folder / SESSION_FILE,
            board=BOARD,
            views=Views(tuple(paths), {}, sweeps={name: tuple(sweeps)}),
            lasers=(StripeSettings(name=name),),
            sheets=(SweptSheet.kind,),
            light_axes={name: AXIS},
            image_size=rig.camera.image_size,
        )
    )
    return SessionTruth(rig, seed, at)
