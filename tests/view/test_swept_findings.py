"""Of a swept light it is said whether its drive is uneven, has play, or its sheet is curved."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from jaxscan.calibration import Calibration, calibrate
from jaxscan.calibration.diagnostics import Diagnostics, diagnose
from jaxscan.calibration.diagnostics.stripe_shapes import StripeShape, stripe_shapes
from jaxscan.view.findings import findings
from tests.calibration.test_swept_sheets import MIDDLE, observed


@pytest.fixture(scope="module")
def swept() -> Calibration:
    """Eight boards with stripes at five steps each, 0.01 degrees apart."""
    return calibrate(observed(7), light="swept")


@pytest.fixture(scope="module")
def diagnosed(swept) -> Diagnostics:
    return diagnose(swept, thorough=False)


def of_stripes(found: Calibration, diagnostics: Diagnostics) -> list[str]:
    boxes = findings(found, diagnostics, ())
    return [f"{box.statement} {box.advice}" for box in boxes if re.search("[Ss]tripes? |sheet", box.statement)]


def off(steps: Callable[[float, int], float]) -> Callable[[StripeShape], StripeShape]:
    """Stripes at which the light stood so many steps beyond its own, by that, from −1 to 1, and the board's number."""

    def changed(s: StripeShape) -> StripeShape:
        by = steps(((s.position or 0.0) - MIDDLE) / 500, int(s.name[-1]))
        return replace(s, offset_mm=s.offset_mm - by * s.mm_per_step)

    return changed


def sagging(s: StripeShape) -> StripeShape:
    return replace(s, sag_mm=s.length_mm**2 / s.depth_mm * 3e-3, bend_mm=0.3, crooked_mm=0.1, offset_mm=0.1)


def test_of_an_even_drive_nothing_is_said(swept, diagnosed):
    assert not of_stripes(swept, diagnosed)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (
            off(lambda n, i: 8 * (n**3 - n)),
            r"At one step it is alike on all boards \(\d+ % of the squares\): axis \"sweep\" does not turn the light "
            r"evenly. It stood -3 steps off at step 2250 and \+3 at step 1750, 6 steps, or 0.06 degrees .* full steps",
        ),
        (
            off(lambda n, i: 5.0 * (-1) ** i),
            r"On one board it is alike at all steps .* -5\S* steps on view-\d and \+5\S* on view-\d, 10 steps, or 0.1 "
            "degrees of the light, apart. .* same direction",
        ),
        (
            off(lambda n, i: 5 * np.sin(1e3 * n + 7 * i**2)),
            "neither alike at one step nor on one board. .* are view-. at step .* stripe_steps has",
        ),
        (sagging, "curved alike on all boards, by 0.[0-9]+ mm over .* the sheet of light may be curved"),
    ],
)
def test_the_cause_is_named_alone(swept, diagnosed, change, expected):
    changed = replace(diagnosed, stripes=tuple(map(change, diagnosed.stripes)))
    (said,) = of_stripes(swept, changed)
    assert re.search(expected, said)


def test_stripes_are_counted_and_named_with_their_step(swept, diagnosed):
    first, *rest = diagnosed.stripes
    changed = replace(diagnosed, stripes=(replace(first, bend_mm=0.3), *rest))
    (said,) = of_stripes(swept, changed)
    assert said.startswith(
        f"1 of 40 stripes on 8 boards is not straight: {first.name} at step {first.position:g} (0.30"
    )


def test_offsets_are_in_steps_of_the_axis(swept):
    """Whose positions are said to be 3 steps further stood 3 steps before them, near and far."""
    seen = swept.observations
    views = [
        replace(view, stripes=tuple(replace(s, position=s.position + 3) for s in view.stripes)) for view in seen.views
    ]
    later = stripe_shapes(replace(swept, observations=replace(seen, views=tuple(views))))
    assert np.ptp([s.depth_mm for s in later]) > 50
    np.testing.assert_allclose([s.off_steps for s in later], -3, atol=0.5)
