"""Several exposures of a step merged: a surface of reflectances 1:50 against each exposure by itself; speed.

- The simulated rig of 2003 sees the bare platform in five bands of albedo 0.9 to 0.018 in a dim room, with a sheet so
  bright that the shortest exposure is about full on the brightest. Errors are against the row in which an ideal camera
  sees the middle of the sheet, completeness is of the columns in which it sees one; both of the worst band.
- `merged_over_averaged`: RMS of one merged photograph over that of the positions of each exposure by itself, averaged
  with their 1 / σ²; for stripes of σ 1.5 px with exact pixel areas, free and full, with and without a halo to one side.
"""

import time
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr

from benchmarks.metric import Metric
from jaxscan.detectors import DEFAULT, DETECTORS, Detector
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.exposures import merge_exposures
from jaxscan.rig import Rig
from jaxscan.simulation import Lighting, Scene, Sensor, render, rig_2003, true_profile
from jaxscan.simulation.shapes import floor

_ALBEDOS = np.geomspace(0.9, 0.018, 5)
_EDGES = np.linspace(-85.0, 85.0, len(_ALBEDOS) + 1)
_EXPOSURES = (1.0, 4.0, 16.0)
_LIGHTING = Lighting(ambient=3.0, directional=2.0, laser_power=600.0)
# Columns this near to an edge between bands see both of them, mm.
_EDGE_MM = 2.0


def measure(quick: bool) -> list[Metric]:
    """All figures; in the long form more frames, more detectors and the speed."""
    names: tuple[Detector, ...] = (DEFAULT,) if quick else tuple(name for name in DETECTORS if name != "threshold")
    return surface(2 if quick else 10, names) + ([] if quick else [*merged_or_averaged(), *speed()])


def surface(frames: int, names: tuple[Detector, ...]) -> list[Metric]:
    """Bands of reflectance."""
    rig = rig_2003.simulated_rig(0)
    R, origin = rig_2003.platform(rig)
    bands = zip(pairwise(_EDGES), _ALBEDOS, strict=True)
    scene = Scene(tuple(floor((low, -15.0), (high, 95.0), albedo).moved(R, origin) for (low, high), albedo in bands))
    photographs, truth, within = [], [], []
    for i in range(frames):
        steps = rig_2003.STEPS_APART * i
        photographs.append([_photograph(rig, scene, steps, t, i) for t in _EXPOSURES])
        seen = true_profile(rig, scene, {"stage": steps}, lighting=_LIGHTING)
        x = (seen.points - origin) @ R[:, 0]
        apart = np.abs(x[:, None] - _EDGES).min(axis=1)
        truth.append(seen.position)
        within.append([(x > low) & (x < high) & (apart > _EDGE_MM) for low, high in pairwise(_EDGES)])
    rows, inside = np.stack(truth), np.stack(within, axis=1)
    single = {f"exposed_{t:g}": np.stack([shots[k] for shots in photographs]) for k, t in enumerate(_EXPOSURES)}
    merged = np.stack([np.asarray(merge_exposures(np.stack(shots), _EXPOSURES)[0]) for shots in photographs])
    metrics = []
    print("  RMS, px (completeness) in bands of albedo " + ", ".join(f"{albedo:.3f}" for albedo in _ALBEDOS))
    for name in names:
        worst = {}
        for kind, images in {**single, "merged": merged}.items():
            complete, rms = _by_band(images, rows, inside, name)
            print(
                f"    {name:11} {kind:11}" + "".join(f"{e:8.3f} ({c:.2f})" for e, c in zip(rms, complete, strict=True))
            )
            worst[kind] = min(complete), max(rms)
        best = min(rms for complete, rms in (worst[kind] for kind in single) if complete > 0.99)
        complete, rms = worst["merged"]
        figures = (("worst_band_complete", complete), ("worst_band_rms", rms), ("over_the_best_single", rms / best))
        metrics += [_metric(name, figure, value) for figure, value in figures]
    return metrics


def _metric(name: Detector, figure: str, value: float) -> Metric:
    """Goals are those of the default detector."""
    label, unit = f"exposures.{name}.{figure}", "px" if figure == "worst_band_rms" else ""
    if name == DEFAULT and figure == "worst_band_complete":
        return Metric(label, value, unit, "higher", 0.99)
    if name == DEFAULT and figure == "over_the_best_single":
        return Metric(label, value, unit, "lower", 1.0, slack=0.2)
    return Metric(label, value, unit)


def _photograph(rig: Rig, scene: Scene, steps: int, exposure: float, seed: int) -> np.ndarray:
    sensor = Sensor(gain=exposure, noise=2.0)
    seeds = (seed, round(exposure))
    return render(rig, scene, q={"stage": steps}, laser=0, lighting=_LIGHTING, sensor=sensor, seed=seeds)


def _by_band(
    images: np.ndarray,
    rows: Float[np.ndarray, "frames columns"],
    inside: Bool[np.ndarray, "bands frames columns"],
    detector: Detector,
) -> tuple[list[float], list[float]]:
    """Completeness and RMS error of each band; the error is infinite where nothing is found."""
    position = np.asarray(detect_stripe(images, StripeSettings("red"), detector=detector).position, np.float64)
    complete, rms = [], []
    for band in inside:
        known = band & np.isfinite(rows)
        error = (position - rows)[known]
        found = error[np.isfinite(error)]
        complete.append(len(found) / len(error))
        rms.append(float(np.sqrt((found**2).mean())) if len(found) else np.inf)
    return complete, rms


def merged_or_averaged() -> list[Metric]:
    """Drawn stripes: merged into one photograph, or measured in each exposure."""
    columns, rows, grey = 3000, 64, StripeSettings("grey")
    random = np.random.default_rng(0)
    centre = rows / 2 + 4 * np.sin(np.arange(columns) / 40) + random.uniform(-0.5, 0.5, columns)
    metrics = []
    print("  RMS merged / averaged, px, by the peak's grey levels in the shortest exposure")
    for halo in (0.0, 0.03):
        light = _profile(rows, centre, 1.5) + halo * _profile(rows, centre + 3, 5.0)
        ratios, cells = [], ""
        for peak in (2, 6, 20, 60, 200, 600):
            levels = np.asarray(_EXPOSURES)[:, None, None] * (1 + peak * light)
            frames = np.rint(levels + 2.0 * random.standard_normal(levels.shape)).clip(0, 255).astype(np.uint8)
            one, each = detect_stripe(merge_exposures(frames, _EXPOSURES)[0], grey), detect_stripe(frames, grey)
            weight = np.where(each.valid, np.asarray(each.sigma, np.float64) ** -2, 0.0)
            mean = (weight * np.nan_to_num(each.position)).sum(axis=0) / weight.sum(axis=0)
            rms = [float(np.sqrt(np.nanmean((x - centre) ** 2))) for x in (np.asarray(one.position[0]), mean)]
            ratios.append(rms[0] / rms[1])
            cells += f"  {peak}: {rms[0]:.4f} / {rms[1]:.4f}"
        print(f"    halo {halo:.0%} {cells}")
        label = f"exposures.merged_over_averaged.halo_{halo:.0%}".replace("%", "")
        metrics += [Metric(f"{label}.worst", max(ratios)), Metric(f"{label}.best", min(ratios))]
    return metrics


def _profile(rows: int, centre: Float[np.ndarray, "columns"], s: float) -> Float[np.ndarray, "rows columns"]:
    edges = (np.arange(rows + 1)[:, None] - 0.5 - centre) / s
    return s * np.sqrt(2 * np.pi) * np.diff(ndtr(edges), axis=0)


def speed() -> list[Metric]:
    """Three exposures of 1920 × 1080, three bytes a pixel, prepared buffers."""
    random = np.random.default_rng(0)
    light = random.integers(0, 60, (1080, 1920, 3))
    frames = np.stack([(light * t).clip(0, 255).astype(np.uint8) for t in _EXPOSURES])
    merge_exposures(frames, _EXPOSURES)[0].block_until_ready()
    times = []
    for _ in range(9):
        begin = time.perf_counter()
        merge_exposures(frames, _EXPOSURES)[0].block_until_ready()
        times.append(time.perf_counter() - begin)
    return [Metric("exposures.merge_three_1920", 1e3 * float(np.median(times)), "ms")]
