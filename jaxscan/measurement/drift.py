"""How a scanner's figures change from test to test, and which change is more than its uncertainty.

Of a figure a test has the mean error over its scans, and σ of this mean: from the noise of the points, or from how the
scans differ, whichever is more. What the certificate is wrong by is the same in every test by one artefact, and goes
away in a change; so does what the rig is wrong by, where it is one rig and the scans' scatter says what other places
make of it. Else it is in the change's uncertainty.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.stats import norm
from scipy.stats import t as students_t

from jaxscan.measurement.accept import EXPANDED, Acceptance, AcceptanceFigure

_CONFIDENCE: Final = 0.95
# The fewest scans that show how far places differ.
_PLACES: Final = 3


@dataclass(frozen=True)
class Change:
    """The change of a figure since the first test by the rig of the last one.

    Attributes:
        artefact, figure, of: whose it is.
        first, last: dates.
        change: of the mean error, mm.
        uncertainty: of this, expanded, mm; None where neither a rig's covariance nor three scans tell it.
        tests: how many there were, with both.
        recalibrated: whether the last test is the only one by its rig: the change is from the test before it, by
            another rig, and no drift.
        between: where there was a real change in between that is gone: the date when it was largest, and how large.
    """

    artefact: str
    figure: str
    of: str
    first: str
    last: str
    change: float
    uncertainty: float | None
    tests: int
    recalibrated: bool = False
    between: tuple[str, float] | None = None

    @property
    def real(self) -> bool:
        """Whether it is more than its uncertainty, and not another rig's."""
        return not self.recalibrated and self.uncertainty is not None and abs(self.change) > self.uncertainty


def as_test(found: Acceptance, date: str, certificate: str, rig: str | None) -> dict[str, Any]:
    """What the history keeps of a test: a row for each figure, over all scans.

    Args:
        found: the test.
        date: when, ISO 8601.
        certificate: what tells the artefact's certified values from others.
        rig: what tells the rig from others; None without one.
    """
    rows = []
    for figure, of in dict.fromkeys((each.figure, each.of) for each in found.figures):
        rows.append(_row(figure, of, [each for each in found.of(figure) if each.of == of]))
    return {
        "date": date,
        "artefact": found.artefact.name,
        "certificate": certificate,
        "rig": rig,
        "verdict": found.verdict,
        "scans": list(found.scans),
        "figures": rows,
    }


def _row(figure: str, of: str, each: Sequence[AcceptanceFigure]) -> dict[str, Any]:
    errors = np.array([one.error for one in each])
    noise = [one.sigma for one in each if one.sigma is not None]
    rig = [one.sigma_rig for one in each if one.sigma_rig is not None]
    sigmas = [float(np.sqrt(np.sum(np.square(noise)))) / len(noise)] if noise else []
    if len(errors) >= _PLACES:
        # Student's factor over that of the normal law: few scans say little of how they differ.
        wider = students_t.ppf((1 + _CONFIDENCE) / 2, len(errors) - 1) / EXPANDED
        sigmas.append(float(wider * errors.std(ddof=1) / np.sqrt(len(errors))))
    return {
        "figure": figure,
        "of": of,
        "mean": float(errors.mean()),
        "worst": float(errors[np.argmax(np.abs(errors))]),
        "uncertainty": max(one.uncertainty for one in each),
        "limit": each[0].limit,
        "sigma": max(sigmas) if sigmas else None,
        "sigma_rig": max(rig) if rig else None,
        "scans": len(errors),
    }


def series(tests: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str, str], list[tuple[Mapping[str, Any], Any]]]:
    """The tests of each figure of each artefact in time, with the figure's row."""
    found: dict[tuple[str, str, str], list[tuple[Mapping[str, Any], Any]]] = {}
    for test in sorted(tests, key=lambda each: each["date"]):
        for row in test["figures"]:
            found.setdefault((test["artefact"], row["figure"], row["of"]), []).append((test, row))
    return found


def changes(tests: Sequence[Mapping[str, Any]]) -> list[Change]:
    """The change of every figure that was tested twice or more, in the tests by the rig of the last one."""
    found = []
    for (artefact, figure, of), each in series(tests).items():
        if len(each) < 2:
            continue
        other = [i for i, (test, _) in enumerate(each) if test["rig"] != each[-1][0]["rig"]]
        own = each[other[-1] + 1 :] if other else each
        recalibrated = len(own) < 2
        own = each[-2:] if recalibrated else own
        since = [_change(own[0], later) for later in own[1:]]
        change, uncertainty = since[-1]
        found.append(
            Change(
                artefact,
                figure,
                of,
                own[0][0]["date"],
                own[-1][0]["date"],
                change,
                uncertainty,
                len(own),
                recalibrated,
                _between(own, since),
            )
        )
    return found


def _between(
    own: Sequence[tuple[Mapping[str, Any], Any]], since: list[tuple[float, float | None]]
) -> tuple[str, float] | None:
    """As `Change` has it: more than the uncertainty of its difference from either end."""
    inner = own[1:-1]
    back = [_change(each, own[-1]) for each in inner]
    # The largest of many is beyond a limit for one by chance (Bonferroni).
    each = (1 - _CONFIDENCE) / 2
    wider = norm.isf(each / max(len(inner), 1)) / norm.isf(each)
    real = [
        (abs(there), test["date"], there)
        for (test, _), (there, U), (gone, V) in zip(inner, since, back, strict=False)
        if U is not None and V is not None and abs(there) > wider * U and abs(gone) > wider * V
    ]
    return max(real)[1:] if real else None


def _change(before: tuple[Mapping[str, Any], Any], after: tuple[Mapping[str, Any], Any]) -> tuple[float, float | None]:
    """From one test to another, mm, and its expanded uncertainty; None where that is not known."""
    (first, a), (last, b) = before, after
    known = a["sigma"] is not None and b["sigma"] is not None
    variance = sum((row["sigma"] or 0.0) ** 2 for row in (a, b))
    if first["rig"] != last["rig"] or min(a["scans"], b["scans"]) < _PLACES:
        variance += sum((row["sigma_rig"] or 0.0) ** 2 for row in (a, b))
    if first["certificate"] != last["certificate"]:
        variance += sum((row["uncertainty"] / EXPANDED) ** 2 for row in (a, b))
    return b["mean"] - a["mean"], EXPANDED * float(np.sqrt(variance)) if known else None
