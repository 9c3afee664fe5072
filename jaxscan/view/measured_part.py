"""Pictures and a report of a measurement, and the control charts of many."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from jaxscan.measurement.fit import few
from jaxscan.measurement.measure import Measurement
from jaxscan.measurement.rows import rows_of
from jaxscan.measurement.scanned import Scanned
from jaxscan.view.matplotlib_setup import pyplot
from jaxscan.view.report import Box, Figure, Report, Section, Table, draw
from jaxscan.view.surface_plots import save_figure

_BACKGROUND, _OF_FEATURE = 20_000, 3_000
_LEVELS: Final = {"conforming": "good", "not conforming": "stop", "not decided": "care"}
# σ from the mean of ranges of two: the mean range of two normal numbers over their σ.
_D2: Final = 1.128


def draw_measurement(scanned: Scanned, found: Measurement) -> Any:
    """The surface as the camera sees it, each feature's points in its own colour; a matplotlib figure."""
    plt = pyplot()
    figure, ax = plt.subplots(figsize=(9, 7), layout="constrained")
    middle = scanned.points.mean(axis=0)
    toward = -middle if scanned.camera is None else scanned.camera.mean(axis=0) - middle
    z = toward / max(float(np.linalg.norm(toward)), 1e-300)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    # Right and down, as in the photographs.
    axes = np.stack([-x, -np.cross(z, x)], axis=1)
    background = scanned.points[few(len(scanned.points), _BACKGROUND)] @ axes
    ax.scatter(*background.T, s=0.3, c="0.8", linewidths=0)
    for each in found.features:
        cloud = each.some_points(_OF_FEATURE)
        if len(cloud):
            flat = cloud @ axes
            ax.scatter(*flat.T, s=1.5, linewidths=0, label=each.feature.name)
            ax.annotate(each.feature.name, flat.mean(axis=0), ha="center", fontsize=8)
    ax.set(aspect="equal", xlabel="mm", ylabel="mm", title=found.part.name)
    ax.invert_yaxis()
    return figure


def write_measurement_png(path: str | os.PathLike[str], figure: Any) -> None:
    """The picture as a PNG; it is closed."""
    save_figure(pyplot(), figure, path)


def measurement_report(scanned: Scanned, found: Measurement, surface: str) -> Report:
    """A page that prints: the verdict, a table of dimensions, the picture, features, and what was left out."""
    rows = rows_of(found)
    said = found.verdict or "measured, without tolerances"
    level = _LEVELS.get(said, "care" if found.problems else "good")
    cells = [
        (
            row["name"],
            _number(row["value"]),
            "" if row["low"] is None else f"{row['low']:.4f} to {row['high']:.4f}",
            row["unit"],
            "" if row["least"] is None else f"{row['least']:.6g} to {row['largest']:.6g}",
            row["verdict"] or "",
            str(row["points"]),
            str(row["left_out"]),
        )
        for row in rows
    ]
    heads = ("dimension", "value", "interval (95 %)", "unit", "limits", "verdict", "points", "left out")
    features = [
        (
            each.feature.name,
            each.feature.kind,
            str(each.points),
            str(each.left_out),
            "" if each.fit is None else f"{each.fit.rms_mm:.4f}",
            "" if each.fit is None else f"{each.fit.form_mm:.4f}",
        )
        for each in found.features
    ]
    notes = [f"{row['name']}: {note}" for row in rows for note in row["notes"]]
    picture: Figure = draw("features", "The features over the surface.", draw_measurement(scanned, found))
    return Report(
        kind="measurement",
        title=f"{found.part.name}: {surface}",
        verdict=Box(level, f"{found.part.name}: {said}.", " ".join(found.notes)),  # type: ignore[arg-type]
        sections=(
            Section(
                "Dimensions", tables=(Table("with intervals that hold the true value with 95 %", heads, tuple(cells)),)
            ),
            Section("Features", figures=(picture,), tables=(_features(features),)),
            Section("Notes", items=(*notes, *found.problems)),
        ),
        numbers={"dimensions": rows},
    )


def _features(rows: Sequence[tuple[str, ...]]) -> Table:
    heads = ("feature", "kind", "points", "left out", "RMS (mm)", "lowest to highest (mm)")
    return Table("as they were found", heads, tuple(rows))


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"


def control_charts(path: str | os.PathLike[str], scans: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """A chart of individual values for each dimension over many scans, with limits of 3 σ from moving ranges.

    (W. A. Shewhart, 1931; ISO 7870-2.) Bars are the 95 % intervals; dashed lines the tolerance.
    """
    plt = pyplot()
    names = list(dict.fromkeys(row["name"] for rows in scans.values() for row in rows))
    figure, axes = plt.subplots(len(names), 1, figsize=(10, 2.4 * len(names)), layout="constrained", squeeze=False)
    for name, ax in zip(names, axes[:, 0], strict=True):
        rows = [next((row for row in each if row["name"] == name), None) for each in scans.values()]
        at = [i for i, row in enumerate(rows) if row is not None and row["value"] is not None]
        kept = [row for row in rows if row is not None and row["value"] is not None]
        values = np.array([row["value"] for row in kept], float)
        ends = [[row["value"] if row[end] is None else row[end] for row in kept] for end in ("low", "high")]
        ax.errorbar(at, values, yerr=np.abs(np.array(ends, float) - values), fmt=".", lw=0.8)
        if len(values) > 2:
            centre, sigma = values.mean(), np.abs(np.diff(values)).mean() / _D2
            for y in (centre - 3 * sigma, centre, centre + 3 * sigma):
                ax.axhline(y, c="tab:green", lw=0.8)
            out = np.flatnonzero(np.abs(values - centre) > 3 * sigma)
            ax.plot(np.array(at)[out], values[out], "rx")
        for limit in ("least", "largest"):
            if kept and kept[0][limit] is not None:
                ax.axhline(kept[0][limit], c="tab:red", ls="--", lw=0.8)
        ax.set(title=name, ylabel=kept[0]["unit"] if kept else "", xlim=(-0.5, max(len(rows) - 0.5, 0.5)))
    axes[-1, 0].set(xlabel="scan")
    save_figure(plt, figure, path)
