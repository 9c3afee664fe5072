from types import SimpleNamespace
from typing import Any

import numpy as np

from jaxscan.calibration.observations import StripePoints
from jaxscan.view import calibration_sections as sections


def test_the_report_says_what_the_light_was():
    light = np.array([2.0, 0.5, 0.18, 252.0])
    stripes = [StripePoints(np.zeros((1, 2)), laser=i, light=each) for i, each in enumerate((light, None))]
    observations = SimpleNamespace(views=[SimpleNamespace(stripes=stripes)], lasers=("upper", "lower"))
    calibration: Any = SimpleNamespace(observations=observations)
    section = sections.light(calibration)
    assert section is not None
    (said,) = section.paragraphs
    assert said.startswith('In photographs of laser "upper", in the median: read noise 2 grey levels')
    stripes.pop(0)
    assert sections.light(calibration) is None
