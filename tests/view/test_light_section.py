import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxscan.calibration.observations import StripePoints
from jaxscan.reconstruction.working_volume import working_volumes
from jaxscan.rig.speckle_limit import Optics
from jaxscan.view import calibration_sections as sections


def test_the_report_says_what_the_light_was():
    light = np.array([2.0, 0.5, 0.18, 252.0])
    stripes = [StripePoints(np.zeros((1, 2)), laser=i, light=each) for i, each in enumerate((light, None))]
    photographs = [SimpleNamespace(stripes=stripes)]
    observations = SimpleNamespace(photographs=lambda: photographs, lasers=("upper", "lower"))
    calibration: Any = SimpleNamespace(observations=observations)
    section = sections.light(calibration, (), None)
    assert section is not None
    (said,) = section.paragraphs
    assert said.startswith('In photographs of laser "upper", in the median: read noise 2 grey levels')
    stripes.pop(0)
    assert sections.light(calibration, (), None) is None


def test_the_report_says_how_near_the_limit_of_speckle_is(calibration):
    views = [
        replace(view, stripes=tuple(replace(s, light=np.array([2.0, 0.5, 0.2, 252.0])) for s in view.stripes))
        for view in calibration.observations.views
    ]
    seen = replace(calibration, observations=replace(calibration.observations, views=tuple(views)))
    volumes = working_volumes(calibration)
    section = sections.light(seen, volumes, Optics(8.0, 650.0, 5.0))
    assert section is not None
    limits = [re.search(r"leaves (\S+) mm at a contrast of 0\.20 .* (\S+) times that", p) for p in section.paragraphs]
    (found,) = [limit for limit in limits if limit]
    limit = float(found[1])
    # By hand in the middle of the volume: 650 nm, f/8, the focal length in pixels of 5 µm.
    rig, depth = seen.rig, float(np.median(volumes[0].depths_mm))
    omega = np.array([float(w) for w in rig.lights[0].plane])
    aperture = float(rig.camera.focal[0]) * 0.005 / 8 / 2
    by_hand = 0.2 * 0.00065 / (2 * np.pi * (aperture / depth) / (depth * np.linalg.norm(omega)))
    assert limit == pytest.approx(by_hand, rel=0.3)
    assert float(found[2]) == pytest.approx(np.nanmedian(volumes[0].pixel_mm) / limit, rel=0.05)
