"""A measurement as rows of plain values: for tables, JSON, CSV and control charts."""

from typing import Any

from jaxscan.measurement.measure import Measurement

# A value is in the middle of its interval if it is off by less than this part of half of it.
_MIDDLE = 0.05


def rows_of(found: Measurement) -> list[dict[str, Any]]:
    """A row for each dimension, in the part's order; None for what is not known."""
    rows = []
    for each in found.dimensions:
        asked, limits = each.dimension, (None, None)
        if asked.nominal is not None and asked.tolerance is not None:
            limits = asked.nominal + asked.tolerance[0], asked.nominal + asked.tolerance[1]
        low, high = each.interval or (None, None)
        rows.append(
            {
                "name": asked.name,
                "kind": asked.kind,
                "of": list(asked.of),
                "value": each.value,
                "uncertainty": each.uncertainty,
                "low": low,
                "high": high,
                "sigma": each.sigma,
                "sigma_rig": each.sigma_rig,
                "unit": asked.unit,
                "nominal": asked.nominal,
                "least": limits[0],
                "largest": limits[1],
                "verdict": each.verdict,
                "form_mm": each.form_mm,
                "points": each.points,
                "left_out": each.left_out,
                "notes": list(each.notes),
                "problem": each.problem or None,
            }
        )
    return rows


def value_in_words(row: dict[str, Any]) -> str:
    """A dimension's value, interval and verdict, as a cell of a table has them."""
    return in_words(row).partition(";")[0]


def in_words(row: dict[str, Any]) -> str:
    """A dimension's value, interval, verdict and points."""
    if row["value"] is None:
        return f"not measured: {row['problem']}"
    text = f"{interval_in_words(row)} {row['unit']}"
    if row["verdict"]:
        text += f", {row['verdict']} ({row['least']:.6g} to {row['largest']:.6g})"
    out = f", {row['left_out']} left out" if row["left_out"] else ""
    return f"{text}; {row['points']} points{out}"


def interval_in_words(row: dict[str, Any]) -> str:
    """A value with its interval: ± half of it, or from where to where if the value is not in its middle."""
    value, half, low, high = (row[name] for name in ("value", "uncertainty", "low", "high"))
    if half is None:
        return f"{value:.4f}"
    if abs((low + high) / 2 - value) < _MIDDLE * half:
        return f"{value:.4f} ± {half:.4f}"
    return f"{value:.4f} ({low:.4f} to {high:.4f})"
