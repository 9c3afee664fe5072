"""Sessions in which something was changed, solved in two parts: which parts are found to differ, and how good rigs are.

The sessions are those of `changes`, and as many in which nothing changed. Points that the rig triangulates after the
change are compared with those of the true rig then, beside the rigs of the photographs after the change alone, and of a
split that is told which parts differ.

With JAXSCAN_DATA real photographs are moved by whole pixels from one of them on, as by a lens that was pushed, and the
session is split there, one photograph too early, and one too late.
"""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import jax
import numpy as np
from jaxtyping import Float

from benchmarks.changes import changed_rig, changed_session
from benchmarks.metric import Metric
from jaxscan.calibration import Calibration, Observations, Split, calibrate, calibrate_split, split
from jaxscan.calibration.observe import observe
from jaxscan.calibration.split_parts import Chosen
from jaxscan.errors import InputError
from jaxscan.files.session import read_session
from jaxscan.precision import float64
from jaxscan.rig import Rig
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003

_SEEDS, _SEEDS_QUICK = 20, 3
# What differs, of what both parts of such a session show: the stage is photographed behind the views.
_TRUE: Final = {
    "refocus": ("focus",),
    "lens_pushed": ("image",),
    "laser_turned": ("light",),
    "camera_turned": ("light",),
    "board_pushed": ("place",),
    "nothing": (),
}
# Real sessions, and how far they are moved along v from the middle photograph on, px; where they are split.
_REAL: Final = {"opencv-left": 20.0, "etna-3": 60.0}
_PLACES: Final = {"too_early": -1, "there": 0, "too_late": 1}
_PARTS: Final = ("focus", "image", "lens", "light")
# Along each side of the image, pixels whose points are compared where they are this far away, mm.
_GRID, _NEAR, _FAR = 12, 300.0, 400.0


def measure(quick: bool) -> list[Metric]:
    """Each change with many seeds."""
    metrics = []
    for name in _TRUE:
        found = [_one(seed, name) for seed in range(_SEEDS_QUICK if quick else _SEEDS)]
        right, ours, alone, told, z = zip(*found, strict=True)
        stem, z = f"split.{name}", np.concatenate(z)
        metrics += [
            Metric(f"{stem}.right_parts", float(np.mean(right)), "", "higher", 0.95),
            Metric(f"{stem}.points_over_told", _rms(ours) / _rms(told), "", "lower", 1.05),
            Metric(f"{stem}.within_3_sigma", float(np.mean(z <= 3)), "", "higher", 0.98),
            Metric(f"{stem}.rms_in_sigma", _rms(z)),
        ]
        if np.isfinite(alone).all():
            metrics.append(Metric(f"{stem}.points_over_side_alone", _rms(ours) / _rms(alone), "", "lower", 1.0))
        print("  " + ", ".join(f"{m.name} {m.value:.3f}" for m in metrics if m.name.startswith(stem)), flush=True)
    return metrics if quick else [*metrics, *photographs()]


def photographs() -> list[Metric]:
    """Real sessions: how far the principal points of both parts are off, in their σ, by where the session is split.

    They are compared with that of the session as it is, and with that moved.
    """
    folder, along = os.environ.get("JAXSCAN_DATA"), np.array([0.0, 1.0])
    metrics: list[Metric] = []
    if not folder:
        print("  JAXSCAN_DATA is not set: no real photographs", flush=True)
        return metrics
    for name, px in _REAL.items():
        session = observe(read_session(Path(folder) / name))
        behind, v = len(session.views) // 2, "camera.principal.1"
        true = float(calibrate(session, lens="radial2").rig.camera.principal[1])
        moved = tuple(
            replace(
                view,
                corners=view.corners + px * along,
                stripes=tuple(replace(stripe, pixels=stripe.pixels + px * along) for stripe in view.stripes),
            )
            for view in session.views[behind:]
        )
        pushed = replace(session, views=(*session.views[:behind], *moved))
        for word, place in _PLACES.items():
            both = calibrate_split(pushed, pushed.views[behind + place].name, lens="radial2")
            kinds = [each.part for each in both.parted.differ]
            off = [
                (float(side.rig.camera.principal[1]) - true - by) / (side.covariance.sigma(v) or np.nan)
                for side, by in ((both.before, 0.0), (both.after, px))
            ]
            stem = f"split.real.{name}.{word}"
            metrics.append(Metric(f"{stem}.image_alone_differs", float(kinds == ["image"])))
            metrics.append(Metric(f"{stem}.principal_off", float(np.abs(off).max()), "σ"))
            print(f"  {stem}: {kinds}, {', '.join(f'{each:.2f} σ' for each in off)}", flush=True)
    return metrics


def _one(seed: int, name: str) -> tuple[bool, float, float, float, Float[np.ndarray, "numbers"]]:
    """Whether the right parts differ; errors of points of the split, the side alone, and the split that is told (mm).

    The last are the errors of all numbers of both rigs that their photographs show, in σ.
    """
    session, behind = changed_session(seed, name) if name != "nothing" else changed_session(seed, "refocus", 0.0)
    photograph = session.photographs()[behind].name
    found = calibrate_split(session, photograph)
    rig = rig_2003.simulated_rig(seed)
    later = changed_rig(rig, name)
    right = tuple(each.part for each in found.parted.differ) == _TRUE[name]
    told = found if right else _told(session, photograph, _TRUE[name])
    errors = [_error(each.after.rig, later) for each in (found, told)]
    try:
        alone = _error(calibrate(session.since(photograph)).rig, later)
    except InputError:
        # There is no view, where the board was pushed.
        alone = float("nan")
    z = [_in_sigma(found.after, later)]
    z += [_in_sigma(found.before, rig)] if found.parted.rig_differs else []
    return right, errors[0], alone, errors[1], np.concatenate(z)


def _told(session: Observations, photograph: str, parts: Sequence[str]) -> Split:
    """The split that is told which parts differ."""
    chooses = split.choose_parts
    split.choose_parts = lambda numbers, d, C: Chosen(tuple(i for i, p in enumerate(_PARTS) if p in parts), 0.0)
    try:
        return calibrate_split(session, photograph)
    finally:
        split.choose_parts = chooses


def _in_sigma(found: Calibration, rig: Rig) -> Float[np.ndarray, "numbers"]:
    """Errors of a rig's numbers in σ, but those that it has from the other part alone."""
    lent = found.parted is not None and any("motion" in each for each in found.parted.lent)
    names = [n for n in parameter_names(found.rig) if not (lent and n.startswith("motion"))]
    off = {n: a - b for n, a, b in zip(parameter_names(rig), _leaves(found.rig), _leaves(rig), strict=True)}
    return np.array([abs(off[n]) / sigma for n in names if (sigma := found.covariance.sigma(n))])


def _leaves(rig: Rig) -> list[float]:
    return [float(leaf) for leaf in jax.tree.leaves(rig)]


def _error(rig: Rig, true: Rig) -> float:
    """RMS distance of the points of some pixels, of those that see the sheet within the working distance, mm."""
    columns, rows = true.camera.image_size
    u, v = np.meshgrid(np.linspace(0, columns - 1, _GRID), np.linspace(0, rows - 1, _GRID))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    with float64():
        a, b = (np.asarray(each.triangulate(pixels, {"stage": 0.0})) for each in (rig, true))
    near = (b[:, 2] > _NEAR) & (b[:, 2] < _FAR)
    return float(np.sqrt(((a - b)[near] ** 2).sum(axis=1).mean()))


def _rms(values: Sequence[float] | np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
