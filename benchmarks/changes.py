"""Things that moved between two photographs: how many are named, with the right photograph, and how often none moved.

Sessions of the simulated rig of 2003 are drawn with normal noise. Behind a photograph by chance the lens is refocused,
the lens is pushed in its mount, the laser is turned about a line 200 mm aside of the camera, the camera is turned and
with it all that it sees of laser and stage, or the board is pushed on the stage. Clean sessions have boards, numbers of
views and noise of many kinds.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import jax
import numpy as np

from benchmarks.board_shape import warped
from benchmarks.drawn import Noise, exact_session, exact_views, project, redrawn
from benchmarks.drawn_bent import bent_session, clean_session
from benchmarks.metric import Metric
from jaxscan.calibration import Calibration, Observations, View, calibrate
from jaxscan.geometry import vector_to_matrix
from jaxscan.precision import as_numpy
from jaxscan.rig import LightPlane, Linear, Rig
from jaxscan.simulation import rig_2003
from jaxscan.simulation.render import plane_of

_UNTIL_CLEARED: Final = 20
_SEEDS, _SEEDS_QUICK, _CLEAN, _CLEAN_QUICK = 20, 3, 100, 10
# What is seen, px; the share of the focal length; the laser's degrees; the board's mm.
_PX, _FOCUS, _DEGREES, _PUSH = 0.5, 3e-3, 0.05, 0.1
_ASIDE = np.array([0.0, -200.0, 0.0])
# Of what is named by these kinds of change a push of the camera is one as well as the other: both turn its rays.
_RIGHT: Final = {
    "refocus": ("focus",),
    "lens_pushed": ("image",),
    "laser_turned": ("light",),
    "camera_turned": ("light", "image"),
    "board_pushed": ("place",),
}


def measure(quick: bool) -> list[Metric]:
    """Each change with many seeds and in four sizes, clean sessions, and faults that are no changes."""
    seeds = range(_SEEDS_QUICK if quick else _SEEDS)
    metrics = []
    for name in _RIGHT:
        for times in (1.0,) if quick else (1.0, 0.5, 0.25, 2.0):
            found = [_named(seed, name, times) for seed in seeds]
            stem = f"changes.{name}" + ("" if times == 1 else f".times_{times:g}")
            goal = ("higher", 0.95) if times == 1 else ("shown", None)
            metrics.append(Metric(f"{stem}.named", float(np.mean([near for near, _ in found])), "", *goal))
            metrics.append(Metric(f"{stem}.of_its_kind", float(np.mean([kind for _, kind in found]))))
            print("  " + ", ".join(f"{m.name} {m.value:.2f}" for m in metrics[-2:]), flush=True)
    count = _CLEAN_QUICK if quick else _CLEAN
    called = 0
    for seed in range(count):
        called += calibrate(clean_session(seed)).change is not None
        # Every size of board is compiled again, and the number of memory maps of a process is limited.
        if seed % _UNTIL_CLEARED == 0:
            jax.clear_caches()
    metrics.append(Metric(f"changes.false_of_{count}_clean", called, "", "lower", 1.0))
    for name, session in _FAULTS.items():
        wrong = sum(calibrate(session(seed)).change is not None for seed in seeds)
        metrics.append(Metric(f"changes.false.{name}", wrong / len(seeds)))
        print(f"  {metrics[-1].name} {metrics[-1].value:.2f}", flush=True)
    return metrics


def _named(seed: int, name: str, times: float) -> tuple[bool, bool]:
    """Whether a change is named within one photograph of where it is, and of its kind."""
    session, behind = changed_session(seed, name, times)
    found: Calibration = calibrate(session)
    names = [view.name for view in session.photographs()]
    if found.change is None:
        return False, False
    near = abs(names.index(found.change.after) - behind) <= 1
    return near, near and found.change.kind in _RIGHT[name]


def changed_session(seed: int, name: str, times: float = 1.0) -> tuple[Observations, int]:
    """A session in which something changes after some of the photographs.

    Args:
        seed: of the rig, the place and the noise.
        name: one of `refocus`, `lens_pushed`, `laser_turned`, `camera_turned`, `board_pushed`.
        times: how many times as much as usual.
    """
    random = np.random.default_rng([seed, 55])
    rig, exact = exact_session(seed)
    n, (sequence,) = len(exact.views), exact.sequences
    behind = int(random.integers(3, n - 2))
    later, pushed = rig, 0.0
    if name == "board_pushed":
        behind = n + int(random.integers(3, len(sequence.views) - 3))
        pushed = _PUSH * times
    else:
        later = changed_rig(rig, name, times)
    poses = rig_2003.board_poses(rig, seed)
    views = exact_views(later, type(poses)(poses.rotation[behind:], poses.translation[behind:]))
    views = tuple(replace(view, name=f"view-{i + behind}") for i, view in enumerate(views))
    first = rig_2003.stage_pose(rig, seed).apply(rig_2003.BOARD.points())
    across = np.array([pushed, 0.0, 0.0])
    along = tuple(
        View(view.name, project(later.camera, first + moved + (across if n + i >= behind else 0.0)))
        for i, (view, moved) in enumerate(
            zip(sequence.views, rig_2003.stage_travel(later, sequence.steps), strict=True)
        )
    )
    exact = replace(exact, views=exact.views[:behind] + views, sequences=(replace(sequence, views=along),))
    return redrawn(exact, Noise(), random), behind


def changed_rig(rig: Rig, name: str, times: float = 1.0) -> Rig:
    """The rig behind a change, as `changed_session` names it; itself where the board was pushed."""
    return as_numpy(_CHANGES[name](rig, times)) if name in _CHANGES else rig


def refocused(rig: Rig, by: float) -> Rig:
    """The rig with focal lengths that are longer by a share."""
    fu, fv = (np.asarray(f) * (1 + by) for f in rig.camera.focal)
    return replace(rig, camera=replace(rig.camera, focal=(np.asarray(fu), np.asarray(fv))))


def _lens_pushed(rig: Rig, times: float) -> Rig:
    u, v = rig.camera.principal
    return replace(rig, camera=replace(rig.camera, principal=(u, np.asarray(v + _PX * times))))


def _laser_turned(rig: Rig, times: float) -> Rig:
    omega = plane_of(rig.lights[0])
    normal, away = omega / np.linalg.norm(omega), 1 / np.linalg.norm(omega)
    at = _ASIDE - normal * (normal @ _ASIDE - away)
    turned = np.asarray(vector_to_matrix(np.array([np.radians(_DEGREES * times), 0.0, 0.0]))) @ normal
    return replace(rig, lights=(LightPlane.create(turned / (turned @ at), rig.lights[0].name),))


def _camera_turned(rig: Rig, times: float) -> Rig:
    R = np.asarray(vector_to_matrix(np.array([_PX * times / float(rig.camera.focal[1]), 0.0, 0.0])))
    light, motion = rig.lights[0], rig.motion
    assert isinstance(motion, Linear)
    x, y, z = (np.asarray(each) for each in R @ np.array([float(x) for x in motion.per_step]))
    turned = LightPlane.create(R @ plane_of(light), light.name)
    return replace(rig, lights=(turned,), motion=replace(motion, per_step=(x, y, z)))


_CHANGES: Final[dict[str, Callable[[Rig, float], Rig]]] = {
    "refocus": lambda rig, times: refocused(rig, _FOCUS * times),
    "lens_pushed": _lens_pushed,
    "laser_turned": _laser_turned,
    "camera_turned": _camera_turned,
}


def _bent(seed: int) -> Observations:
    _, exact = bent_session(seed, warped(seed, 0.5, 0.1))
    return redrawn(exact, Noise(), np.random.default_rng([seed, 3]))


def _two_boards(seed: int) -> Observations:
    """One photograph in three with stripes of another place, as of a board that moved between corners and stripe."""
    random = np.random.default_rng([seed, 4])
    session = redrawn(exact_session(seed)[1], Noise(), random)
    moved = [
        replace(
            view,
            stripes=tuple(replace(s, pixels=s.pixels + random.normal(size=(1, 2)) * [0.0, 0.5]) for s in view.stripes),
        )
        if random.random() < 1 / 3
        else view
        for view in session.views
    ]
    return replace(session, views=tuple(moved))


def _other_lens(seed: int) -> Observations:
    """With tangential terms that the solve does not seek, and the board from near to far."""
    random = np.random.default_rng([seed, 5])
    session = redrawn(exact_session(seed)[1], Noise(), random)

    def bent(pixels: np.ndarray) -> np.ndarray:
        x, y = ((pixels - np.array([310.0, 228.0])) / 700.0).T
        by = 700.0 * np.stack([2e-3 * 2 * x * y, 2e-3 * (x**2 + 3 * y**2)], axis=1)
        return pixels + by

    photographs = [
        replace(
            view,
            corners=bent(view.corners),
            stripes=tuple(replace(s, pixels=s.pixels + (bent(s.pixels) - s.pixels) * [0.0, 1.0]) for s in view.stripes),
        )
        for view in session.photographs()
    ]
    count = len(session.views)
    photographs[:count] = sorted(photographs[:count], key=lambda view: float(np.nanstd(view.corners)))
    return session.with_photographs(photographs)


_FAULTS: Final[dict[str, Callable[[int], Observations]]] = {
    "bent_boards": _bent,
    "stripes_of_another_place": _two_boards,
    "another_lens_near_to_far": _other_lens,
}
