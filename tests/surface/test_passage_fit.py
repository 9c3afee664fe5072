"""A table that turned the other way is pointed out where the passages show it, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.geometry.rotation import vector_to_matrix
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import RangeImage
from jaxscan.rig import Rig, Rotary
from jaxscan.simulation import rig_2003
from jaxscan.simulation.drawn import drawn_scan
from jaxscan.simulation.scene import Body, Scene
from jaxscan.simulation.shapes import box, figure, grey
from jaxscan.simulation.solids import Sphere
from jaxscan.surface.passage_fit import PassageFit, passage_fit
from jaxscan.surface.passages import passages
from tests.surface.test_passages import rig_with_its_axis_in_the_sheet

TURN = rig_2003.STEPS_PER_TURN
STEPS = {"turntable": np.arange(0, TURN, 40)}
# Stands so that a turn shows its sides at different distances from the axis.
BLOCK = (box(12.0, (30.0, 20.0, 25.0)),)


def leaning(deg: float, aside_mm: float) -> Rig:
    """The rig whose axis lies in the sheet, with the axis turned out of it, or moved beside it."""
    rig = rig_with_its_axis_in_the_sheet()
    turntable = rig.axis("turntable")
    assert isinstance(turntable, Rotary)
    axis, centre = np.asarray(turntable.direction()), np.asarray(turntable.centre)
    normal = np.array([float(leaf) for leaf in rig.lights[0].plane])
    normal /= np.linalg.norm(normal)
    axis = vector_to_matrix(np.radians(deg) * np.cross(axis, normal)) @ axis
    with float64():
        return as_numpy(Rig(rig.camera, rig.lights, Rotary.create(2 * np.pi / TURN * axis, centre + aside_mm * normal)))


def drawn(rig: Rig, bodies: tuple[Body, ...], noise_px: float = 0.1) -> RangeImage:
    R, origin = rig_2003.platform(rig_2003.simulated_rig(3))
    return drawn_scan(rig, Scene(tuple(body.moved(R, origin) for body in bodies)), STEPS, noise_px).image


def other_way(image: RangeImage) -> RangeImage:
    """What the same photographs make where the steps are counted the other way."""
    back = {axis: -np.asarray(steps) for axis, steps in image.positions.items()}
    pose = as_numpy(image.motion.pose({axis: steps.astype(float) for axis, steps in back.items()}))
    return replace(image, points=pose.inverse().apply(image.seen()).astype(np.float32), positions=back)


def fit_of(image: RangeImage) -> PassageFit:
    fit = passage_fit(image, passages(image))
    assert fit is not None
    return fit


@pytest.mark.parametrize(
    ("bodies", "deg", "aside_mm", "noise_px"),
    [(figure(0.0), 7.0, 0.0, 0.1), (BLOCK, 7.0, 0.0, 0.1), (BLOCK, -3.0, 0.0, 0.02), (BLOCK, 0.0, 3.0, 0.5)],
)
def test_the_direction_of_a_turn_shows(bodies, deg, aside_mm, noise_px):
    image = drawn(leaning(deg, aside_mm), bodies, noise_px)
    right, wrong = fit_of(image), fit_of(other_way(image))
    assert not right.turned_the_other_way
    assert wrong.turned_the_other_way
    np.testing.assert_allclose(right, wrong[::-1], rtol=0.05)


def test_an_axis_in_the_sheet_shows_nothing():
    """The wrong direction makes the mirror image, in which the passages fit as well."""
    image = drawn(leaning(0.0, 0.0), BLOCK)
    for each in (image, other_way(image)):
        assert not fit_of(each).turned_the_other_way


def test_a_round_body_on_the_axis_shows_nothing():
    rig = leaning(7.0, 0.0)
    turntable = rig.axis("turntable")
    assert isinstance(turntable, Rotary)
    ball = Body(Sphere(np.asarray(turntable.centre) + 20.0 * np.asarray(turntable.direction()), 20.0), grey(0.6))
    image = drawn_scan(rig, Scene((ball,)), STEPS, 0.1).image
    for each in (image, other_way(image)):
        assert not fit_of(each).turned_the_other_way


def test_a_part_of_a_turn_and_a_stage_say_nothing():
    image = drawn(leaning(7.0, 0.0), BLOCK)
    for each in (
        image[: len(image.valid) // 3, :],
        replace(image, positions={"stage": image.positions["turntable"]}),
    ):
        assert passage_fit(each, passages(each)) is None
