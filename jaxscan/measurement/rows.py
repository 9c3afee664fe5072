"""A measurement as rows of plain values: for tables, JSON, CSV and control charts."""

from typing import Any

from jaxscan.measurement.measure import Measurement


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
    text = f"{row['value']:.4f}"
    if row["uncertainty"] is not None:
        text += f" ± {row['uncertainty']:.4f}"
    text += f" {row['unit']}"
    if row["verdict"]:
        text += f", {row['verdict']} ({row['least']:.6g} to {row['largest']:.6g})"
    out = f", {row['left_out']} left out" if row["left_out"] else ""
    return f"{text}; {row['points']} points{out}"
