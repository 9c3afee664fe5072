"""Pictures and pages of acceptance tests: the figures of one, and the drift of many."""

import os
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any, Final

from jaxscan.files.artefact_file import FORMS
from jaxscan.measurement.accept import EXPANDED, Acceptance, AcceptanceFigure, expanded
from jaxscan.measurement.drift import Change, series
from jaxscan.view.matplotlib_setup import pyplot, with_dates
from jaxscan.view.report import Box, Level, Report, Section, Table, draw
from jaxscan.view.surface_plots import save_figure

_LEVELS: Final[dict[str | None, Level]] = {
    "conforming": "good",
    "not conforming": "stop",
    "not decided": "care",
    None: "care",
}
# Left free before the first test and after the last.
_BESIDE: Final = timedelta(days=1)


def write_picture(path: str | os.PathLike[str], figure: Any) -> None:
    """The picture as a PNG; it is closed."""
    save_figure(pyplot(), figure, path)


def draw_acceptance(found: Acceptance) -> Any:
    """The errors of each kind, scan by scan, with the test's uncertainty and the limits; a matplotlib figure."""
    kinds = list(dict.fromkeys(each.figure for each in found.figures)) or ["nothing was tested"]
    figure, axes = _panels(len(kinds))
    for kind, ax in zip(kinds, axes, strict=True):
        for of in dict.fromkeys(each.of for each in found.of(kind)):
            rows = [each for each in found.of(kind) if each.of == of]
            at = [found.scans.index(each.scan) + 1 for each in rows]
            bars = [each.uncertainty for each in rows]
            ax.errorbar(at, [each.error for each in rows], yerr=bars, fmt="o", ms=4, lw=0.8, label=of)
        _limits(ax, found.artefact.limits.get(kind), form=kind in FORMS)
        ax.set(title=kind, ylabel="mm", xlim=(0.5, len(found.scans) + 0.5))
        if found.of(kind):
            ax.legend(fontsize=8)
        # A tick is a scan: there is none between two.
        ax.xaxis.get_major_locator().set_params(integer=True)
    axes[-1].set(xlabel="scan")
    return figure


def draw_drift(tests: Sequence[Mapping[str, Any]]) -> Any:
    """The mean error of each figure over time, with twice its σ and the limits; a matplotlib figure."""
    found = series(tests)
    figure, axes = _panels(max(len(found), 1))
    taken = [datetime.fromisoformat(test["date"]) for each in found.values() for test, _ in each]
    for ax, ((artefact, kind, of), each) in zip(axes, found.items(), strict=False):
        dates = [datetime.fromisoformat(test["date"]) for test, _ in each]
        bars = [EXPANDED * (row["sigma"] or 0.0) for _, row in each]
        ax.errorbar(dates, [row["mean"] for _, row in each], yerr=bars, fmt="o-", ms=4, lw=0.8)
        _limits(ax, each[-1][1]["limit"], form=kind in FORMS)
        ax.set(title=f"{artefact}: {kind} of {of}", ylabel="mm")
        # The same time in all panels; days of the calendar, not minutes, where all tests are of one.
        ax.set_xlim(min(taken) - _BESIDE, max(taken) + _BESIDE)
        with_dates(ax)
    return figure


def _panels(count: int) -> tuple[Any, list[Any]]:
    figure, axes = pyplot().subplots(count, 1, figsize=(9, 2.4 * count), layout="constrained", squeeze=False)
    return figure, list(axes[:, 0])


def _limits(ax: Any, limit: float | None, form: bool) -> None:
    ax.axhline(0.0, c="0.6", lw=0.8)
    for side in () if limit is None else (limit,) if form else (-limit, limit):
        ax.axhline(side, c="tab:red", ls="--", lw=0.8)


def acceptance_report(found: Acceptance) -> Report:
    """A page that prints: the verdict, the picture, every figure of every scan, and what the figures mean."""
    said = f"{found.verdict} {found.places}".rstrip() if found.verdict else "tested, without limits"
    heads = ("figure", "of", "scan", "error", "± (test)", "limit", "verdict", "± (predicted)", "points", "left out")
    table = Table("in mm", heads, tuple(_cells(each) for each in found.figures))
    return Report(
        kind="acceptance",
        title=f"{found.artefact.name}: acceptance test",
        verdict=Box(_LEVELS[found.verdict], f"{found.artefact.name}: {said}.", " ".join(found.notes)),
        sections=(
            Section("Figures", figures=(draw("errors", "Bars: of the test. Dashed: limits.", draw_acceptance(found)),)),
            Section("Every scan", tables=(table,), items=found.problems),
            Section("What they mean", items=_MEANING),
        ),
        numbers={"figures": [vars(each) for each in found.figures]},
    )


def drift_report(tests: Sequence[Mapping[str, Any]], found: Sequence[Change]) -> Report:
    """A page that prints: what has changed, and the figures over time."""
    changed = [each for each in found if each.real]
    said = f"{len(changed)} of {len(found)} figures have changed by more than their uncertainty."
    rows = tuple(
        (
            each.artefact,
            each.figure,
            each.of,
            each.first[:10],
            each.last[:10],
            f"{each.change:+.4f}",
            "" if each.uncertainty is None else f"{each.uncertainty:.4f}",
            "changed" if each.real else f"was {each.between[1]:+.4f} on {each.between[0][:10]}" if each.between else "",
        )
        for each in found
    )
    heads = ("artefact", "figure", "of", "first", "last", "change", "± (95 %)", "")
    return Report(
        kind="drift",
        title="Drift of the scanner",
        verdict=Box("stop" if changed else "good", said, "Calibrate again, then test again." if changed else ""),
        sections=(
            Section("Changes", tables=(Table("of the mean error, mm", heads, rows),)),
            Section("Over time", figures=(draw("drift", "Mean errors with twice their σ.", draw_drift(tests)),)),
        ),
        numbers={"changes": [vars(each) for each in found]},
    )


_MEANING: Final = (
    "probing_form: the narrowest band about a fitted ball that holds 95 % of its points.",
    "probing_size: the ball's diameter less the certified one.",
    "distance: the distance of two centres less the certified one.",
    "flatness: the narrowest band about a fitted plane that holds 95 % of its points.",
    "± (test): the uncertainty of the certificate; a limit is met only if the whole interval lies within it.",
    "± (predicted): twice the error to be expected from the rig's covariance and the points' noise.",
)


def _cells(each: AcceptanceFigure) -> tuple[str, ...]:
    predicted = expanded(each.sigma, each.sigma_rig)
    return (
        each.figure,
        each.of,
        each.scan,
        f"{each.error:+.4f}",
        f"{each.uncertainty:.4f}",
        "" if each.limit is None else f"{each.limit:g}",
        each.verdict or "",
        "" if predicted is None else f"{predicted:.4f}",
        str(each.points),
        str(each.left_out),
    )
