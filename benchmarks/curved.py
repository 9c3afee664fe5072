"""Balls and cylinders under a sheet of light that has a thickness: how far stripes are from where its middle is seen.

Photographs of the simulated rig of 2003, reconstructed with the true rig, once as if nothing were known of the sheet's
thickness and once with it. The truth is where an ideal camera sees the sheet's own middle.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from benchmarks.metric import Metric
from jaxscan.files.rig_file import RigFile
from jaxscan.reconstruction import reconstruct
from jaxscan.simulation import rig_2003
from jaxscan.simulation.light import Sensor
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.render import render
from jaxscan.simulation.scene import Body
from jaxscan.simulation.shapes import grey
from jaxscan.simulation.solids import Cylinder, Sphere

_Y, _STEPS = 30.0, np.arange(12_000, 50_000, 1000)
_BALLS = {"ball_12": (-55.0, 12.0), "ball_10": (-5.0, 10.0), "ball_5": (-27.0, 5.0)}
# Beyond this error a point is at an edge, or is no stripe's, px; surfaces up to 60° askew count.
_EDGE_PX, _UPWARDS = 0.3, 0.5
# What is left of the mean error of balls of 10 mm and more, over what it is without; of planes' RMS error.
_LEFT, _PLANE = 0.5, 1.01

Lines = Float[np.ndarray, "frames columns"]


def measure(quick: bool) -> list[Metric]:
    """Sheets of σ 0.25 and 0.4 mm, without speckle and with; or the thinner one with."""
    cases = ((0.25, 0.2),) if quick else ((0.25, 0.0), (0.25, 0.2), (0.4, 0.0), (0.4, 0.2))
    return [metric for sigma, speckle in cases for metric in _case(sigma, speckle)]


def _case(sigma_mm: float, speckle: float) -> list[Metric]:
    rig = rig_2003.simulated_rig(0)
    solids = [Sphere(np.array([x, _Y, r]), r) for x, r in _BALLS.values()]
    across = Cylinder(np.array([12.0, _Y, 8.0]), np.array([1.0, 0.0, 0.0]), 8.0, 20.0)
    along = Cylinder(np.array([48.0, _Y - 15, 8.0]), np.array([0.0, 1.0, 0.0]), 8.0, 30.0)
    scene = rig_2003.scan_scene(rig, [Body(each, grey(0.6)) for each in (*solids, across, along)])
    light = replace(rig_2003.SCAN_LIGHTING, sheet_sigma_mm=sigma_mm, speckle=speckle)
    frames, true = [], []
    for i, step in enumerate(_STEPS.tolist()):
        q = {"stage": step}
        frames.append((render(rig, scene, q=q, laser=0, lighting=light, sensor=Sensor(), seed=i), q))
        true.append(true_profile(rig, scene, q, lighting=light))
    position = np.stack([each.position for each in true])
    R, origin = rig_2003.platform(rig)
    parts = _parts((np.stack([each.points for each in true]) - origin) @ R)
    off = [reconstruct(RigFile(rig, None, {"sheet_sigma_mm": [s]}), frames).pixels - position for s in (0.0, sigma_mm)]
    return [metric for name, part in parts.items() for metric in _metrics(f"{sigma_mm}.{speckle}.{name}", part, *off)]


def _parts(X: Float[np.ndarray, "frames columns 3"]) -> dict[str, Bool[np.ndarray, "frames columns"]]:
    """Which points of the platform's frame are of which body, and face upwards."""
    x, y, z = np.moveaxis(X, -1, 0)
    parts = {}
    with np.errstate(invalid="ignore"):
        for name, (middle, r) in _BALLS.items():
            on = np.abs(np.linalg.norm(X - np.array([middle, _Y, r]), axis=-1) - r) < 1e-3
            parts[name] = on & (z > (1 + _UPWARDS) * r)
        up = z > (1 + _UPWARDS) * 8
        parts["cylinder_across"] = (np.abs(np.hypot(y - _Y, z - 8) - 8) < 1e-3) & up & (x > 14) & (x < 30)
        parts["cylinder_along"] = (np.abs(np.hypot(x - 48, z - 8) - 8) < 1e-3) & up
        parts["floor"] = np.abs(z) < 1e-3
    return parts


def _metrics(name: str, part: Bool[np.ndarray, "frames columns"], before: Lines, after: Lines) -> list[Metric]:
    with np.errstate(invalid="ignore"):
        some = part & (np.abs(before) < _EDGE_PX) & np.isfinite(after)
    means, rms = ([float(f(off[some])) for off in (before, after)] for f in (np.mean, _rms))
    found = [
        Metric(f"curved.{name}.mean_px", means[1], "px"),
        Metric(f"curved.{name}.mean_px_without", means[0], "px"),
        Metric(f"curved.{name}.rms_px", rms[1], "px", "lower", slack=0.05, floor=0.001),
        Metric(f"curved.{name}.rms_px_without", rms[0], "px"),
    ]
    if name.endswith(("ball_12", "ball_10", "cylinder_across")):
        found.append(Metric(f"curved.{name}.mean_left", abs(means[1] / means[0]), "", "lower", _LEFT, 0.2, 0.1))
    if name.endswith("floor"):
        found.append(Metric(f"curved.{name}.rms_over_without", rms[1] / rms[0], "", "lower", _PLANE))
    return found


def _rms(values: Float[np.ndarray, "points"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
