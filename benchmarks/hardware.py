"""The scanner on bad days: serial lines with faults, and programs that are killed."""

import contextlib
import io
import tempfile
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.killed_scans import kill_and_resume, prepare
from benchmarks.metric import Metric
from benchmarks.serial_sessions import Outcome, session, struck

_SESSIONS, _QUICK_SESSIONS = 1000, 200
_KILLS, _QUICK_KILLS = 50, 5
# A session on a perfect line sends fewer bytes than this to the controller.
_BYTES = 400


def measure(quick: bool) -> list[Metric]:
    """Sessions with random faults and scans killed; in full also one fault at a time, everywhere, and the points."""
    metrics = [*_sessions(_QUICK_SESSIONS if quick else _SESSIONS), *_killed(_QUICK_KILLS if quick else _KILLS)]
    return metrics if quick else [*metrics, *_one_byte(), *_points()]


def _sessions(count: int) -> list[Metric]:
    with ProcessPoolExecutor(2) as pool:
        outcomes = list(pool.map(session, range(count), chunksize=20))
    whole = [outcome for outcome in outcomes if not outcome.pulled]
    carried = [outcome for outcome in whole if outcome.moving or outcome.laser]
    return [
        Metric("hardware.sessions", len(outcomes)),
        *_faults("hardware.sessions", outcomes),
        Metric("hardware.sessions.positions_believed", sum(outcome.places for outcome in outcomes)),
        Metric("hardware.sessions.well_ended", sum(not outcome.error for outcome in whole) / len(whole), "", "higher"),
        Metric("hardware.sessions.left_on_and_said", len(carried)),
        Metric("hardware.sessions.longest_wall", max(outcome.wall_s for outcome in outcomes), "s"),
    ]


def _one_byte() -> list[Metric]:
    with ProcessPoolExecutor(2) as pool:
        work = [pool.submit(struck, "bistep", i, byte) for byte in b"=g!" for i in range(_BYTES)]
        outcomes = [done.result() for done in work]
    return [Metric("hardware.one_byte.sessions", len(outcomes)), *_faults("hardware.one_byte", outcomes)]


def _killed(count: int) -> list[Metric]:
    quiet = contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO())
    with tempfile.TemporaryDirectory() as name, quiet[0], quiet[1], warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = prepare(Path(name))
        outcomes = [kill_and_resume(folder, seed) for seed in range(count)]
    caught = sum(outcome.running for outcome in outcomes)
    return [
        Metric("hardware.kills", len(outcomes)),
        Metric("hardware.kills.while_running", caught),
        Metric("hardware.kills.frames_reported", sum(outcome.reported for outcome in outcomes)),
        Metric("hardware.kills.frames_lost_or_torn", sum(not outcome.whole for outcome in outcomes), "", "lower", 0),
        Metric("hardware.kills.other_after_resume", sum(not outcome.same for outcome in outcomes), "", "lower", 0),
    ]


def _points() -> list[Metric]:
    """The simulated scanner of 2003, with play in its screw and a switched laser: a guided session, a scan, points."""
    from hardware.guide import guided_session
    from hardware.scan import Devices, take
    from hardware.scan_plan import Plan, ScanFolder
    from hardware.simulated.camera import SimulatedCamera, SimulatedWorld
    from hardware.simulated.laser import SimulatedLaser
    from hardware.simulated.operator import SimulatedOperator
    from hardware.simulated.stage import SimulatedStage
    from hardware.stages import Travel
    from jaxscan import calibrate, observe, read_scan, read_session, reconstruct
    from jaxscan.files.axes import STAGE
    from jaxscan.simulation import distance, rig_2003
    from jaxscan.simulation.shapes import cup

    world = SimulatedWorld(0, cup(rig_2003.OBJECT_Y))
    stage, laser = SimulatedStage(Travel(last=80000, backlash=900), play=900), SimulatedLaser()
    devices = Devices(SimulatedCamera(world, {STAGE: stage}, laser), {STAGE: stage}, laser)
    steps = tuple(rig_2003.STEPS_APART * i for i in range(rig_2003.SCAN_FRAMES))
    with tempfile.TemporaryDirectory() as name:
        session, scan = Path(name) / "session", Path(name) / "scan"
        operator = SimulatedOperator(world, rig_2003.BOARD_VIEWS)
        on_stage = steps[: rig_2003.STAGE_VIEWS]
        guided_session(session, devices, rig_2003.BOARD, operator, stage_steps=on_stage)
        world.put_object()
        take(ScanFolder.create(scan, Plan({STAGE: steps})), devices)
        camera = read_session(session).camera
        observations = observe(read_session(session))
        calibration = calibrate(observations, lens=camera.lens, principal_point=camera.principal_point)
        image = reconstruct(calibration.rig_file(), read_scan(scan))
    off = distance(world.scene, np.asarray(image.points[image.valid], np.float64))
    return [
        Metric("hardware.points.count", len(off)),
        Metric("hardware.points.rms", float(np.sqrt((off**2).mean())), "mm", "lower", 0.16),
    ]


def _faults(name: str, outcomes: list[Outcome]) -> list[Metric]:
    for outcome in outcomes:
        if outcome.fault:
            print(f"  {outcome.url}: {outcome.fault}")
    wrong = sum(len(outcome.wrong) for outcome in outcomes)
    return [
        Metric(f"{name}.wrong_positions_believed", wrong, "", "lower", 0),
        Metric(f"{name}.faults", sum(bool(outcome.fault) for outcome in outcomes), "", "lower", 0),
    ]
