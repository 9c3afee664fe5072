"""Corners of a row along which a burnt-out laser line runs: how many are left in, and how far off those are.

A line that hides one edge of a whole row moves all its corners alike, and at the board's end no neighbour tells. A line
that crosses the row at an angle leaves more of both edges, and is to cost fewer corners.
"""

from unittest.mock import patch

import numpy as np

from benchmarks.board_images import COUNTS, Line, Shot
from benchmarks.corner_errors import Errors, of_ours, photographs
from benchmarks.metric import Metric
from jaxscan.images import refine

_SQUARE_PX = 30.0
_ROWS = (2, 5)
# How wide it is burnt out, px, and its light, grey levels: a flat top with long flanks, and steeper ones.
_LINES = ((13.0, 400.0), (5.0, 1500.0), (9.0, 1500.0), (9.0, 6000.0))
# How far the line runs beside the row's middle, px, and at which angles to it.
_ALONG = [(float(x), 0.0) for x in range(-9, 10, 3)]
_SLANTED = [(x, float(slant)) for x in (-6.0, 0.0, 6.0) for slant in np.radians((-25, -10, 10, 25))]


def burnt_rows(seeds: int, quick: bool) -> list[Metric]:
    """Along the rows and at angles to them, with the rule that leaves out what is hidden and without it."""
    metrics = []
    for name, places in (("along", _ALONG), ("slanted", _SLANTED)):
        lines = [
            Line(row, beside, core, power, slant)
            for row in _ROWS
            for core, power in _LINES
            for beside, slant in (places[1::4] if quick else places)
        ]
        shots = [Shot(square_px=_SQUARE_PX, line=line) for line in lines]
        found, without = [], []
        # One pose after the other, whose paper is drawn once.
        for seed in range(seeds):
            taken = photographs(shots, [seed])
            found.append(_of_rows(of_ours(taken), lines))
            with patch.object(refine, "_LEAST_TOLD", -np.inf):
                without.append(_of_rows(of_ours(taken), lines))
        metrics += [*_figures(f"corners.{name}", found), *_figures(f"corners.{name}.without_the_rule", without)]
    return metrics


def _of_rows(errors: Errors, lines: list[Line]) -> Errors:
    """Those of the row that each photograph's line runs along."""
    at = [
        np.ravel_multi_index((k, line.row, i), (len(lines), *COUNTS[::-1]))
        for k, line in enumerate(lines)
        for i in range(COUNTS[0])
    ]
    return Errors(errors.pixels[at], errors.sigma[at])


def _figures(name: str, parts: list[Errors]) -> list[Metric]:
    errors = Errors(np.concatenate([e.pixels for e in parts]), np.concatenate([e.sigma for e in parts]))
    far = np.linalg.norm(errors.pixels, axis=1)
    return [
        Metric(f"{name}.left_in", float(np.isfinite(errors.sigma).mean())),
        Metric(f"{name}.rms_in_sigma", errors.in_sigma()),
        Metric(f"{name}.largest_in_sigma", float(np.nanmax(far / errors.sigma))),
        Metric(f"{name}.largest", float(np.nanmax(far)), "px"),
    ]
