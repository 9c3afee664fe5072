"""The photographs and the truth of a simulated world: a rig with a stage, with a robot, or with a light that sweeps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from jaxscan.rig import Rig
    from jaxscan.simulation import Body, Scene, Sensor
    from jaxscan.simulation.folders import ScanTruth, SessionTruth
    from jaxscan.simulation.hand import Hand
    from jaxscan.simulation.robot import Robot

# What is added to the seed from side to side: their noise has nothing in common.
_SIDES_APART: Final = 1_000_000


@dataclass(frozen=True)
class _World:
    """What worlds of all kinds have.

    Attributes:
        out: the folder to make.
        seed: of rig, poses and noise.
        rig: with a stage.
        name: of what is scanned.
        boards: how the photographs of boards are taken: arguments of what writes a session.
        frames: how those of a scan are: arguments of what writes a scan.
    """

    out: Path
    seed: int
    rig: "Rig"
    name: str
    boards: Mapping[str, Any]
    frames: Mapping[str, Any]


def simulate_into(
    out: Path,
    seed: int,
    bodies: "tuple[Body, ...]",
    name: str,
    *,
    lasers: int = 1,
    sides: int = 1,
    apart: int | None = None,
    sensor: "Sensor | None" = None,
    light: Mapping[str, Any],
    hand: "Hand | None" = None,
    bow_mm: float = 0.0,
    bend_mm: float = 0.0,
    stage: Mapping[str, float] | None = None,
    turntable: bool = False,
    separate_stripes: bool = False,
    robot: "Robot | None" = None,
    swept: bool = False,
    ending: str = ".png",
    quality: int | None = None,
) -> "tuple[Scene, SessionTruth, tuple[ScanTruth, ...]]":
    """Write the session, a scan of some bodies by each laser and from each side, and their truth into a folder.

    A scan goes over the same travel, however many motor steps its frames are apart; by default as the rig of 2003. On a
    turntable a scan of one side goes once all around. There is a progress bar. The scene is that of the first side.
    `light` changes the lighting of the rig of 2003; with a highlight the bodies are glossy, and the lamp stands where
    they mirror it. `stage` has the arguments of `rig_2003.with_stage`. A robot takes the place of the stage, and so
    does a light that is swept.
    """
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.cli.progress import step
    from jaxscan.files.axes import STAGE
    from jaxscan.simulation import rig_2003
    from jaxscan.simulation.hand import STILL
    from jaxscan.simulation.photographs import JPEG_QUALITY

    step("building the scene")
    rig = rig_2003.with_stage(rig_2003.simulated_rig(seed, lasers, bow_mm), **(stage or {}))
    rig = rig_2003.with_turntable(rig, seed) if turntable else rig
    if light.get("highlight"):
        bodies = tuple(replace(body, glossy=True) for body in bodies)
        light = {**light, "direction": rig_2003.mirrored_lamp(rig)}
    turned = [
        rig_2003.turned_on(rig, bodies, rig_2003.STEPS_PER_TURN * k / sides)
        if turntable
        else rig_2003.turned(bodies, 360 * k / sides)
        for k in range(sides)
    ]
    scenes = [rig_2003.scan_scene(rig, each) for each in turned]
    if turntable and sides == 1:
        apart = apart or rig_2003.TURN_APART
        axes = [rig_2003.turning_axes(apart, rig_2003.step_over_axis(rig, i)) for i in range(lasers)]
    else:
        apart = apart or rig_2003.STEPS_APART
        axes = [{STAGE: tuple(range(0, (rig_2003.SCAN_FRAMES - 1) * rig_2003.STEPS_APART + 1, apart))}] * lasers
    common: dict[str, Any] = {
        "sensor": sensor or rig_2003.SENSOR,
        "ending": ending,
        "quality": quality or JPEG_QUALITY,
    }
    boards = {**common, "lighting": replace(rig_2003.BOARD_LIGHTING, **light)}
    frames = {**common, "lighting": replace(rig_2003.SCAN_LIGHTING, **light)}
    world = _World(out, seed, rig, name, boards, frames)
    if robot is not None:
        return _with_robot(world, robot, scenes[0], axes[0][STAGE])
    if swept:
        return _with_sweep(world, scenes[0], len(axes[0][STAGE]))
    held = {"hand": hand or STILL, "bend_mm": bend_mm, "separate_stripes": separate_stripes}
    return _with_stage(replace(world, boards={**boards, **held}), scenes, axes)


def _with_stage(
    world: _World, scenes: "Sequence[Scene]", axes: Sequence[Mapping[str, Sequence[int]]]
) -> "tuple[Scene, SessionTruth, tuple[ScanTruth, ...]]":
    """A world whose object a stage moves, or a turntable: a scan by each laser, along its axes, of each side."""
    from jaxscan.atomic import replacing_folders
    from jaxscan.cli.progress import progress
    from jaxscan.files.axes import STAGE
    from jaxscan.simulation import folders, rig_2003

    rig, sides = world.rig, len(scenes)
    photographs = rig_2003.BOARD_VIEWS * photographs_of_a_pose(len(rig.lights), world.boards["separate_stripes"])
    photographs += rig_2003.STAGE_VIEWS + ("turntable" in rig.axes()) * rig_2003.TURNTABLE_VIEWS
    photographs += len(rig.lights) * sides * len(axes[0][STAGE])
    with replacing_folders(world.out) as folder, progress("rendering", photographs) as advance:
        session = folders.simulate_session(folder / "session", world.seed, rig=rig, advance=advance, **world.boards)
        scans = []
        for (i, laser), k in product(enumerate(rig.lights), range(sides)):
            side = f"{360 * k / sides:03.0f}" if sides > 1 else ""
            which = "-".join(part for part in (laser.name, side) if part)
            truth = folders.simulate_scan(
                folder / folders.scan_name(which),
                rig,
                scenes[k],
                world.seed + _SIDES_APART * k,
                laser=i,
                axes=axes[i],
                name=" ".join(part for part in (world.name, side) if part),
                advance=advance,
                **world.frames,
            )
            scans.append(replace(truth, which=which))
        folders.write_truth(folder / "truth", session, *scans)
    return scenes[0], session, tuple(scans)


def _with_robot(
    world: _World, robot: "Robot", scene: "Scene", steps: Sequence[int]
) -> "tuple[Scene, SessionTruth, tuple[ScanTruth, ...]]":
    """A world with a robot in place of the stage, which takes the object over the way of these steps of the stage."""
    import numpy as np

    from jaxscan.atomic import replacing_folders
    from jaxscan.cli.progress import progress
    from jaxscan.simulation import folders, rig_2003
    from jaxscan.simulation.robot import POSED_VIEWS, simulate_robot_scan, simulate_robot_session, with_robot

    travel, moved = rig_2003.stage_travel(world.rig, np.array(steps)), with_robot(world.rig, robot, world.seed)
    photographs = rig_2003.BOARD_VIEWS + POSED_VIEWS + len(steps)
    with replacing_folders(world.out) as folder, progress("rendering", photographs) as advance:
        session = simulate_robot_session(folder / "session", world.seed, moved, robot, advance=advance, **world.boards)
        scan = simulate_robot_scan(
            folder / folders.scan_name(""),
            moved,
            robot,
            scene,
            travel,
            rig_2003.middle_of_object(world.rig),
            world.seed,
            name=world.name,
            advance=advance,
            **world.frames,
        )
        folders.write_truth(folder / "truth", session, scan)
    return scene, session, (scan,)


def _with_sweep(world: _World, scene: "Scene", frames: int) -> "tuple[Scene, SessionTruth, tuple[ScanTruth, ...]]":
    """A world with a light that sweeps over the object in place of the stage."""
    from jaxscan.atomic import replacing_folders
    from jaxscan.cli.progress import progress
    from jaxscan.files.session_sweeps import AXIS
    from jaxscan.simulation import folders, rig_2003, swept

    scene, moved = swept.in_the_middle(world.rig, scene), swept.with_sweep(world.rig, world.seed)
    photographs = rig_2003.BOARD_VIEWS * photographs_of_a_pose(1, separate_stripes=False, swept=True) + frames
    with replacing_folders(world.out) as folder, progress("rendering", photographs) as advance:
        session = swept.simulate_swept_session(
            folder / "session",
            world.seed,
            moved,
            views=rig_2003.BOARD_VIEWS,
            stripes=swept.STRIPES,
            advance=advance,
            **world.boards,
        )
        scan = folders.simulate_scan(
            folder / folders.scan_name(""),
            moved,
            scene,
            world.seed,
            axes={AXIS: swept.sweep_of(frames).tolist()},
            name=world.name,
            advance=advance,
            **world.frames,
        )
        folders.write_truth(folder / "truth", session, scan)
    return scene, session, (scan,)


def photographs_of_a_pose(lasers: int, separate_stripes: bool, *, swept: bool = False) -> int:
    """How many photographs are taken of a board in one pose."""
    if swept:
        from jaxscan.simulation.swept import STRIPES

        return 1 + STRIPES
    return 1 + lasers if separate_stripes or lasers > 1 else 1
