"""The same photographs through every pipeline: the MATLAB pipeline of 2003, makers' recipe, careful OpenCV, and ours.

- `headline`: the simulated rig of 2003 without speckle, twenty seeds; a cup, and a bench with steps, ball and floor.
- `quirks`: the same with each quirk of the pipeline of 2003 put right, alone and all together.
- `sweeps`: one thing changed at a time, on a third of the photographs of a scan.

Figures are medians over the seeds; the interval beside them holds the true median with 95 % (bootstrap). A pipeline
that fails on a session, or finds less than a tenth of the points, counts as failed there, and is said so.

The 2003 pipeline runs in Octave where that is installed; its NumPy transcription, equal to 1e-9, does the sweeps.
"""

import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from benchmarks import octave, transcription
from benchmarks.conditions import SHORT, Condition, Photographed, photograph, read_bench
from benchmarks.found import Found
from benchmarks.metric import Metric
from benchmarks.pipeline_2003 import Quirks
from benchmarks.pipelines import MATLAB, OURS, PIPELINES, Pipeline, Taken, matlab
from benchmarks.simulated import rig_errors
from jaxscan.errors import JaxscanError
from jaxscan.files.axes import STAGE
from jaxscan.files.scan import Scan
from jaxscan.precision import as_numpy
from jaxscan.simulation.accuracy import cloud_errors
from jaxscan.simulation.distance import distance
from jaxscan.simulation.light import Sensor

_SEEDS, _SWEEP_SEEDS = 20, 5
_LEAST_FOUND = 0.1
# Further than this from every true surface a point is a stray, of which a few decide an RMS.
_STRAY_MM = 2.0
# Errors of one session by one pipeline; what is missing failed.
Errors = Mapping[str, float]

SWEEPS: Final[dict[str, dict[str, Condition]]] = {
    "as in 2003": {"": SHORT},
    "noise, grey levels": {f"{x:g}": replace(SHORT, sensor=Sensor(0.6, x)) for x in (0.5, 5.0, 10.0)},
    "blur, px": {f"{x:g}": replace(SHORT, sensor=Sensor(x, 2.0)) for x in (0.3, 1.2, 2.0)},
    "board views": {f"{x}": replace(SHORT, views=x) for x in (5, 20)},
    "lens k1": {f"{x:g}": replace(SHORT, k1=x) for x in (0.0, -0.3)},
    "sheet σ, mm": {f"{x:g}": replace(SHORT, lighting={"sheet_sigma_mm": x}) for x in (0.12, 0.5, 1.0)},
    "speckle": {
        f"{x:g}": replace(SHORT, lighting={"speckle": x, "speckle_length_px": (grain, grain)})
        for x, grain in ((0.2, 0.0), (0.37, 1.4), (0.74, 1.4))
    },
    "floor's darker squares": {f"{x:g}": replace(SHORT, floor_ink=x) for x in (0.5, 0.2)},
    "ambient light, grey levels": {f"{x:g}": replace(SHORT, lighting={"ambient": x}) for x in (10.0, 120.0)},
    "red spots a photograph": {f"{x}": replace(SHORT, spots=x) for x in (3, 20)},
    "file format": {
        "JPEG": replace(SHORT, ending=".jpg"),
        "JPEG of quality 90": replace(SHORT, ending=".jpg", quality=90),
    },
}


def measure(quick: bool) -> list[Metric]:
    """All seeds and sweeps; in the short form one seed of the headline."""
    print(f"  the pipeline of 2003 runs in {'Octave' if octave.octave() else 'NumPy: ' + octave.MISSING}")
    metrics = headline(range(1 if quick else _SEEDS))
    return metrics if quick else metrics + sweeps(range(_SWEEP_SEEDS))


def headline(seeds: Sequence[int]) -> list[Metric]:
    """The rig of 2003."""
    pipelines = {**PIPELINES, **variants()}
    table: dict[str, list[Errors]] = {name: [] for name in pipelines}
    for seed in seeds:
        for name, errors in of_a_seed(Condition(), seed, ("cup", "bench"), pipelines).items():
            table[name].append(errors)
        print(f"  seed {seed}: " + "; ".join(f"{n} {e[-1].get('cup.absolute', np.nan):.4f}" for n, e in table.items()))
    print_table(table, _HEADLINE)
    return _headline_metrics(table)


def variants() -> dict[str, Pipeline]:
    """The pipeline of 2003 with each quirk that moves points put right, alone and together; and with harsher input."""
    moving = (
        "pixels_from_one",
        "whole_rows",
        "few_iterations",
        "board_sign",
        "mean_line",
        "mean_of_pairs",
        "first_and_last",
    )
    rights = {name.replace("_", " ") + " put right": Quirks(**{name: False, "loops": False}) for name in moving} | {
        "all put right": Quirks(**dict.fromkeys(Quirks().as_dict(), False))
    }
    pipelines = {words: matlab(quirks, transcription) for words, quirks in rights.items()}
    return {
        **{f"{MATLAB}, {words}": pipeline for words, pipeline in pipelines.items()},
        f"{MATLAB}, move not added": _one_move_off,
        f"{MATLAB}, corners at the stripe too": _with_all_corners(matlab(Quirks(loops=False), transcription)),
        "opencv, corners at the stripe too": _with_all_corners(PIPELINES["opencv"]),
    }


def _with_all_corners(pipeline: Pipeline) -> Pipeline:
    """The pipeline with those corners too in whose window the stripe lies."""
    return lambda taken, scans: pipeline(replace(taken, sub_pix=taken.with_stripe), scans)


def _one_move_off(taken: Taken, scans: Sequence[Scan]) -> Found:
    """The clouds as the pipeline of 2003 leaves them, one stage move from the first photograph's frame."""
    found = matlab(Quirks(loops=False), transcription)(taken, scans)
    steps = taken.own.sequences[0].steps
    move = as_numpy(found.rig.pose({STAGE: np.float64(np.diff(steps).mean())})).translation
    return replace(found, clouds=tuple(cloud - move for cloud in found.clouds))


def sweeps(seeds: Sequence[int]) -> list[Metric]:
    """One thing changed at a time."""
    pipelines = {**PIPELINES, MATLAB: matlab(runner=transcription)}
    metrics = []
    for what, conditions in SWEEPS.items():
        for value, condition in conditions.items():
            table: dict[str, list[Errors]] = {name: [] for name in pipelines}
            for seed in seeds:
                for name, errors in of_a_seed(condition, seed, ("bench",), pipelines).items():
                    table[name].append(errors)
            print(f"\n  {what} {value}".rstrip())
            print_table(table, _SWEPT)
            stem = "accuracy.sweep." + f"{what} {value}".strip().replace(" ", "_")
            ours, others = (_median(table[name], "bench.to_true_point") for name in (OURS, MATLAB))
            metrics += [
                Metric(f"{stem}.ours", ours, "mm", "lower", slack=0.1),
                Metric(f"{stem}.ours_over_2003", ours / others),
                Metric(f"{stem}.ours_over_opencv", _over_opencv(table, "bench.to_true_point")),
                Metric(f"{stem}.strays", _median(table[OURS], "bench.strays"), "", "lower", floor=0.001),
            ]
    return metrics


def of_a_seed(
    condition: Condition, seed: int, scenes: tuple[str, ...], pipelines: Mapping[str, Pipeline]
) -> dict[str, Errors]:
    """Photograph once, and run every pipeline on it."""
    with tempfile.TemporaryDirectory() as folder:
        return of_photographs(photograph(Path(folder), condition, seed, scenes), pipelines)


def of_photographs(photographed: Photographed, pipelines: Mapping[str, Pipeline]) -> dict[str, Errors]:
    """Run every pipeline on the same photographs."""
    taken, scans = Taken.of(photographed.session), list(photographed.scans.values())
    return {name: errors_of(lambda p=p: p(taken, scans), photographed) for name, p in pipelines.items()}


def errors_of(pipeline: Callable[[], Found], photographed: Photographed) -> Errors:
    """All figures of one pipeline on one session; none of what failed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            found = pipeline()
        except (JaxscanError, RuntimeError, np.linalg.LinAlgError, ValueError) as error:
            print(f"  failed: {error}")
            return {}
    rig = rig_errors(found.rig, photographed.rig)
    errors = {f"rig.{part}": getattr(rig, part) for part in ("camera", "plane", "stage", "points")}
    errors["boards.lit"] = float((found.lit & photographed.lit[: len(found.lit)]).sum() / photographed.lit.sum())
    for (name, truth), cloud in zip(photographed.truths.items(), found.clouds, strict=True):
        valid = np.isfinite(cloud[..., 0])
        share = float((valid & np.isfinite(truth.points[..., 0])).sum() / np.isfinite(truth.points[..., 0]).sum())
        errors[f"{name}.completeness"] = share
        if share < _LEAST_FOUND:
            continue
        errors |= {
            f"{name}.{figure}": value
            for figure, value in cloud_errors(photographed.scenes[name], truth.points, cloud, valid).as_dict().items()
        }
        off = distance(photographed.scenes[name], cloud[valid])
        errors[f"{name}.strays"] = float((off > _STRAY_MM).mean())
        if name == "bench":
            reading = read_bench(cloud, truth.points, photographed.rig)
            errors |= {f"bench.step_{i + 1}": float(off) for i, off in enumerate(reading.heights)}
            errors["bench.steps"] = float(np.abs(reading.heights).max())
            errors["bench.radius"] = abs(reading.radius)
            errors["bench.flatness"] = reading.flatness
    return errors


_BOTH: Final = {
    "boards.lit": "boards lit",
    "bench.steps": "steps",
    "bench.radius": "radius",
    "bench.flatness": "flatness",
    "rig.camera": "camera",
    "rig.plane": "plane",
    "rig.stage": "stage",
}
_HEADLINE: Final = {
    "cup.absolute": "cup",
    "cup.absolute_after_fit": "… fitted",
    "cup.to_true_point": "to point",
    "cup.to_true_point_after_fit": "… fitted",
    "cup.completeness": "complete",
    **_BOTH,
}
_SWEPT: Final = {
    "bench.absolute": "absolute",
    "bench.to_true_point": "to point",
    "bench.to_true_point_after_fit": "… fitted",
    "bench.strays": "strays",
    "bench.completeness": "complete",
    **_BOTH,
}


def print_table(table: Mapping[str, Sequence[Errors]], columns: Mapping[str, str]) -> None:
    """Medians and their 95 % intervals, mm but for the shares; in brackets how many sessions failed."""
    print("    " + " " * 42 + "".join(f"{words:>25}" for words in columns.values()))
    for name, errors in table.items():
        cells = [_cell(_values(errors, figure)) for figure in columns]
        print(f"    {name:42}" + "".join(f"{cell:>25}" for cell in cells), flush=True)


def _cell(values: Float[np.ndarray, "seeds"]) -> str:
    good = values[np.isfinite(values)]
    failed = f" [{len(values) - len(good)}]" if len(good) < len(values) else ""
    if not len(good):
        return "failed"
    low, high = interval(good)
    return f"{np.median(good):.3f} ({low:.3f}-{high:.3f}){failed}"


def interval(values: Float[np.ndarray, "seeds"]) -> tuple[float, float]:
    """Where the median is with 95 %: the bootstrap's percentiles."""
    drawn = np.random.default_rng(0).choice(values, (2000, len(values)))
    low, high = np.percentile(np.median(drawn, axis=1), [2.5, 97.5])
    return float(low), float(high)


def _values(errors: Sequence[Errors], figure: str) -> Float[np.ndarray, "seeds"]:
    return np.array([each.get(figure, np.nan) for each in errors])


def _median(errors: Sequence[Errors], figure: str) -> float:
    """The median of the sessions that did not fail; NaN where most did."""
    values = _values(errors, figure)
    good = values[np.isfinite(values)]
    return float(np.median(good)) if 2 * len(good) > len(values) else np.nan


def _headline_metrics(table: Mapping[str, Sequence[Errors]]) -> list[Metric]:
    figures = (*_HEADLINE, *(f"bench.step_{i}" for i in range(1, 5)))
    ours = {figure: _median(table[OURS], figure) for figure in figures}
    metrics = [
        Metric(f"accuracy.{name}.{figure}", _median(table[name], figure), _unit(figure))
        for name in PIPELINES
        for figure in figures
        if name != OURS
    ]
    metrics += [
        Metric(
            f"accuracy.{OURS}.{figure}",
            value,
            _unit(figure),
            "shown" if ".step_" in figure else "higher" if not _unit(figure) else "lower",
            {"cup.completeness": 0.95, "bench.steps": 0.02}.get(figure),
            slack=0.1,
            floor=0.003 if _unit(figure) else 0.0,
        )
        for figure, value in ours.items()
    ]

    def over(other: str, figure: str, name: str, goal: float) -> Metric:
        return Metric(
            f"accuracy.{name}",
            ours[figure] / _median(table[other], figure),
            "",
            "lower",
            goal,
            0.1,
            target_suffices=True,
        )

    from_zero = f"{MATLAB}, pixels from one put right"
    steps = np.array([[each.get(f"bench.step_{i}", np.nan) for i in range(1, 5)] for each in table[OURS]])
    return [
        *metrics,
        over(MATLAB, "cup.absolute", "ours_over_2003", 1 / 3),
        over(MATLAB, "cup.absolute_after_fit", "ours_over_2003.after_fit", 1 / 4),
        over(from_zero, "cup.absolute", "ours_over_2003_from_zero", 1 / 3),
        over(from_zero, "cup.absolute_after_fit", "ours_over_2003_from_zero.after_fit", 1 / 4),
        over("opencv", "cup.absolute", "ours_over_opencv", 0.55),
        Metric("accuracy.ours_over_opencv.to_point", _over_opencv(table, "cup.to_true_point")),
        Metric("accuracy.boards_lit.2003", _median(table[MATLAB], "boards.lit"), "", "higher", 0.98, floor=0.01),
        Metric(
            "accuracy.completeness.2003", _median(table[MATLAB], "cup.completeness"), "", "higher", 0.95, floor=0.01
        ),
        Metric(f"accuracy.{OURS}.bench.step_worst_seed", float(np.abs(steps).max()), "mm"),
    ]


def _over_opencv(table: Mapping[str, Sequence[Errors]], figure: str) -> float:
    return _median(table[OURS], figure) / _median(table["opencv"], figure)


def _unit(figure: str) -> str:
    return "" if figure.endswith(("completeness", "lit", "strays")) else "mm"
