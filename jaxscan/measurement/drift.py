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
from scipy.stats import t as students_t

from jaxscan.measurement.accept import EXPANDED, Acceptance, AcceptanceFigure

_CONFIDENCE: Final = 0.95
# The fewest scans that show how far places differ.
_PLACES: Final = 3


@dataclass(frozen=True)
class Change:
    """The change of a figure since the first test.

    Attributes:
        artefact, figure, of: whose it is.
        first, last: dates.
        change: of the mean error, mm.
        uncertainty: of this, expanded, mm; None where neither a rig's covariance nor three scans tell it.
        tests: how many there were.
    """

    artefact: str
    figure: str
    of: str
    first: str
    last: str
    change: float
    uncertainty: float | None
    tests: int

    @property
    def real(self) -> bool:
        """Whether it is more than its uncertainty."""
        return self.uncertainty is not None and abs(self.change) > self.uncertainty


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
    """The change of every figure that was tested twice or more, from its first test to its last."""
    found = []
    for (artefact, figure, of), each in series(tests).items():
        if len(each) < 2:
            continue
        (first, a), (last, b) = each[0], each[-1]
        known = a["sigma"] is not None and b["sigma"] is not None
        variance = sum((row["sigma"] or 0.0) ** 2 for row in (a, b))
        if first["rig"] != last["rig"] or min(a["scans"], b["scans"]) < _PLACES:
            variance += sum((row["sigma_rig"] or 0.0) ** 2 for row in (a, b))
        if first["certificate"] != last["certificate"]:
            variance += sum((row["uncertainty"] / EXPANDED) ** 2 for row in (a, b))
        found.append(
            Change(
                artefact,
                figure,
                of,
                first["date"],
                last["date"],
                b["mean"] - a["mean"],
                EXPANDED * float(np.sqrt(variance)) if known else None,
                len(each),
            )
        )
    return found
