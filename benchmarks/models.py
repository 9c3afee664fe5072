"""The model that is chosen for sessions of ten kinds, and what choosing costs those that need no term.

Ten sessions of each kind, of the simulated rig of 2003, drawn with normal noise: nothing wrong; two lenses with
more terms; a tilted sensor; boards bent by 0.3 mm, or differently in each photograph; a bowed sheet; a bowed
guide; a screw's period. An answer is right if it is the kind that was drawn, and nothing else.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import jax
import numpy as np
from jaxtyping import Float

from benchmarks.board_shape import warped
from benchmarks.drawn import Noise, exact_views, project, redrawn
from benchmarks.drawn_bent import bent_session
from benchmarks.metric import Metric, ratio
from jaxscan.calibration import BoardSequence, Calibration, Observations, View, calibrate
from jaxscan.calibration.choose import calibrate_by_evidence
from jaxscan.calibration.model import Model
from jaxscan.images import Board
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, Rig
from jaxscan.simulation import rig_2003

_SEEDS, _FEW = 10, 2
_PLAIN: Final = Model(lights=("plane",))
_RIGHT: Final[dict[str, Callable[[Model], bool]]] = {
    "nothing": lambda m: m == _PLAIN,
    "radial2": lambda m: m == replace(_PLAIN, lens="radial2"),
    "brown": lambda m: m == replace(_PLAIN, lens="brown"),
    "tilted": lambda m: m == replace(_PLAIN, tilted=True),
    "bent": lambda m: m == replace(_PLAIN, board_shape="warp"),
    "bends": lambda m: m == replace(_PLAIN, board_shape="bend"),
    "bowed": lambda m: m == replace(_PLAIN, lights=("bowed",)),
    "guide": lambda m: m == replace(_PLAIN, motion={"stage": "guide"}),
    "brown_on_guide": lambda m: m == replace(_PLAIN, lens="brown", motion={"stage": "guide"}),
    "screw": lambda m: m == replace(_PLAIN, motion={"stage": "screw"}),
}


def measure(quick: bool) -> list[Metric]:
    """Ten sessions of each kind, or two."""
    seeds = range(_FEW if quick else _SEEDS)
    metrics, right = [], 0
    for kind, judge in _RIGHT.items():
        own = 0
        for seed in seeds:
            found = chosen(session(kind, seed))
            assert found.choice is not None
            own += judge(found.choice.model)
            if not judge(found.choice.model):
                print(f"  {kind} {seed}: {found.choice.sentence}; {found.choice.trials}", flush=True)
        right += own
        metrics.append(Metric(f"models.{kind}.right", own / len(seeds), "", "higher", 0.9, slack=0.1))
        print(f"  {kind}: {own} of {len(seeds)}", flush=True)
        jax.clear_caches()
    share = right / len(_RIGHT) / len(seeds)
    return [*metrics, Metric("models.right", share, "", "higher", 0.95, slack=0.03), _cost(seeds)]


def chosen(observations: Observations) -> Calibration:
    """Calibrated with the model that is chosen, from the plainest."""
    return calibrate_by_evidence(observations, Model())


def _cost(seeds: range) -> Metric:
    """The time of choosing for sessions where nothing is wrong, over that of a calibration, compiled both."""
    own, plain = [], []
    for seed in seeds:
        observations = session("nothing", seed)
        for solve, times in ((calibrate, plain), (chosen, own), (calibrate, plain), (chosen, own)):
            begin = time.perf_counter()
            solve(observations)
            times.append(time.perf_counter() - begin)
    return ratio("models.nothing.time_over_plain", float(np.median(own) / np.median(plain)), 1.3)


def session(kind: str, seed: int) -> Observations:
    """A session of a kind, with noise."""
    random = np.random.default_rng([2018, seed])
    if kind in ("bent", "bends"):
        heights = warped(seed, 0.5, 0.1) if kind == "bends" else warped(seed, 0.3, 0.0)
        board = Board.checkerboard((9, 6), 24.0)
        _, exact = bent_session(seed, heights, board=board, stage_views=11, columns_apart=4)
        return redrawn(exact, Noise(), random)
    rig = rig_2003.simulated_rig(seed, bow_mm=0.3 if kind == "bowed" else 0.0)
    lenses = {
        "radial2": [[-0.15, 0.6]],
        "brown": [[-0.15, 0.2, -0.5], [2e-3, -1.5e-3]],
    }
    lens = kind.removesuffix("_on_guide")
    if lens in lenses:
        rig = _with_lens(rig, lens, lenses[lens])
    if kind == "tilted":
        about = random.uniform(0, 2 * np.pi)
        tilt = np.radians(10.0) * np.array([np.cos(about), np.sin(about)])
        rig = replace(rig, camera=replace(rig.camera, tilt=tuple(tilt)))
    if kind.endswith("guide"):
        rig = rig_2003.with_stage(rig, guide_mm=0.1)
    if kind == "screw":
        rig = rig_2003.with_stage(rig, screw_mm=0.05, screw_steps=9000.0)
    return redrawn(_exact(rig, seed), Noise(), random)


def _with_lens(rig: Rig, lens: str, numbers: list[list[float]]) -> Rig:
    camera = rig.camera
    with float64():
        own = Camera.create(camera.image_size, np.stack(camera.focal), np.stack(camera.principal), lens, *numbers)
    return replace(rig, camera=as_numpy(own))


def _exact(rig: Rig, seed: int) -> Observations:
    """What is seen of boards on the rig, without noise; corners that are out of the image are not seen."""
    poses, stage = rig_2003.board_poses(rig, seed), rig_2003.stage_pose(rig, seed)
    points, size = rig_2003.BOARD.points(), np.array(rig.camera.image_size)
    steps = rig_2003.STEPS_APART * np.arange(rig_2003.STAGE_VIEWS, dtype=float)

    def seen(name: str, X: Float[np.ndarray, "corners 3"]) -> View:
        pixels = project(rig.camera, X)
        inside = np.all((pixels >= 0) & (pixels <= size - 1), axis=1)
        return View(name, np.where(inside[:, None], pixels, np.nan))

    moved = as_numpy(rig.pose({"stage": steps}))
    first = stage.apply(points)
    places = enumerate(zip(moved.matrix(), moved.translation, strict=True))
    along = tuple(seen(f"stage-{i}", first @ R.T + t) for i, (R, t) in places)
    return Observations(
        rig.camera.image_size,
        rig_2003.BOARD,
        exact_views(rig, poses),
        (BoardSequence({"stage": steps}, along),),
        lasers=("",),
    )
