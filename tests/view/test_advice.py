"""What photograph would help most, in words and as a picture."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from jaxscan.calibration import Calibration
from jaxscan.calibration.next_pose import NextPose
from jaxscan.geometry import Pose
from jaxscan.reconstruction.next_best_views import NextBestViews
from jaxscan.rig import Covariance
from jaxscan.view.advice import advise, place

SQUARE = np.array([[-80.0, -50.0], [80.0, -50.0], [80.0, 50.0], [-80.0, 50.0]])


def pose(
    middle: tuple[float, float] = (320.0, 240.0),
    tilt: tuple[float, float] = (0.0, 0.0),
    turn_deg: float = 0.0,
    crossed: bool = True,
) -> NextPose:
    a = np.radians(turn_deg)
    turn = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    stripe = np.full((1, 16, 2), 240.0 if crossed else np.nan)
    none = Covariance((), np.zeros((0, 0)))
    return NextPose(
        Pose(np.zeros(3), np.array([0.0, 0.0, 300.0])), 300.0, np.array(tilt), SQUARE @ turn.T + middle, stripe, none
    )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "the board 300 mm away in the middle part of the image, facing the camera"),
        ({"middle": (100.0, 60.0)}, "in the upper left part of the image"),
        ({"middle": (600.0, 240.0)}, "in the right part of the image"),
        ({"middle": (600.0, 470.0)}, "in the lower right part of the image"),
        ({"tilt": (40.0, 0.0)}, "tilted by 40° with its right side nearer"),
        ({"tilt": (0.0, 40.0)}, "tilted by 40° with its lower side nearer"),
        ({"tilt": (-30.0, -30.0)}, "tilted by 42° with its upper left side nearer"),
        ({"turn_deg": 30.0}, "its rows turned by 30° clockwise"),
        ({"turn_deg": -30.0}, "its rows turned by 30° anticlockwise"),
        ({"turn_deg": 185.0}, "facing the camera, the laser on"),
        ({}, "its stripe across the board"),
        ({"crossed": False}, "the stripe beside it"),
    ],
)
def test_places_in_words(changes, words):
    assert words in place(pose(**changes), (640, 480))


def planned(*medians: float) -> NextBestViews:
    return NextBestViews(tuple(pose() for _ in medians), "mm", 0.08, medians)


def test_each_photograph_counts_those_before_it(calibration: Calibration):
    pytest.importorskip("matplotlib", reason="the extra plots is not installed")
    advice = advise(planned(0.06, 0.05), (), calibration.observations)
    assert len(advice.words) == 2
    assert advice.words[0].endswith("(outline 1): the median σ of a point would fall from 0.0800 to 0.0600 mm")
    assert advice.words[1].startswith("then the board")
    assert advice.words[1].endswith("(outline 2): the median σ of a point would fall from 0.0600 to 0.0500 mm")
    picture = cv2.imdecode(np.frombuffer(advice.figures[0].png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert np.ptp(picture.astype(int), axis=-1).max() > 100


@pytest.mark.parametrize("nothing", [planned(), planned(0.0799)])
def test_where_no_place_helps_more_of_the_same_does(calibration: Calibration, nothing):
    advice = advise(nothing, (), calibration.observations)
    assert advice.words == ("more views like the present ones: each σ falls with the root of their number",)
    assert advice.figures == ()


@pytest.mark.long
def test_a_point_that_the_stripe_limits_is_helped_by_none(calibration: Calibration, report):
    volumes = report.numbers["working_volumes"]
    dim = tuple(replace(v, pixel_mm=0.9 * v.sigma_mm) for v in volumes)
    words = advise(planned(0.06), dim, calibration.observations).words
    assert words[0].startswith(
        "another photograph of the board hardly helps: 81 % of a point's variance is the stripe's own"
    )
    assert words[0].endswith("help more. The most that the board can do is drawn in the report")
    assert "outline 1" in words[1]
