"""Dimensions between shapes that are known: slots, gaps, widths, steps, edges; and their derivatives' directions."""

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.part_file import Dimension, Feature
from jaxscan.measurement.dimensions import Shapes, edge_of, slot_of, width_of
from jaxscan.measurement.shapes import Ball, Line, Plane

Z = np.array([0.0, 0.0, 1.0])


def plane(point, normal):
    normal = np.asarray(normal, float)
    return Plane(np.asarray(point, float), normal / np.linalg.norm(normal), 5.0)


LEFT, RIGHT = plane([-3, 0, -2], [1, 0, 0]), plane([4, 1, -2], [-1, 0, 0])


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_slots_width_is_between_its_sides_however_they_face(way):
    """Its sides face each other, those of a rib away from each other; a scanner may see two that face one way."""
    other = plane(RIGHT.point, way * RIGHT.axis)
    assert width_of(LEFT, other) == pytest.approx(7.0)
    middle = slot_of(LEFT, other)
    assert middle.point[0] == pytest.approx(0.5)
    assert abs(middle.normal[0]) == pytest.approx(1.0)


def test_sides_that_are_not_parallel_have_their_width_at_the_middle():
    """A wedge of 10 degrees: at the height of the middle of all points the sides are 7 mm apart."""
    t = np.radians(5.0)
    a = plane([-3.5, 0, 0], [np.cos(t), 0, np.sin(t)])
    b = plane([3.5, 0, 0], [-np.cos(t), 0, np.sin(t)])
    assert width_of(a, b) == pytest.approx(7.0)
    # Points higher up on one side move the middle of all, and the wedge is as wide as it is there.
    up = 4.0
    higher = plane([3.5 + up * np.tan(t), 0, up], b.axis)
    assert width_of(a, higher) == pytest.approx(7.0 + 2 * (up / 2) * np.tan(t), rel=1e-3)


def test_what_is_no_slot_and_no_edge_is_refused():
    with pytest.raises(InputError, match="more than 30° to each other: name the two sides of one slot or rib"):
        slot_of(LEFT, plane([0, 0, 0], Z))
    with pytest.raises(InputError, match="parallel within 5°, so that they have no edge: name two that meet"):
        edge_of(LEFT, RIGHT)


def test_gap_width_and_distance_of_made_features():
    fitted = {
        "left": LEFT,
        "right": RIGHT,
        "floor": plane([0, 0, -5], Z),
        "top": plane([-8, 0, 2], Z),
        "line": Line(np.array([6.0, 9, 2]), np.array([0.0, 1, 0]), 5.0, Z),
        "ball": Ball(np.array([0.5, 3, 1]), Z, 1.0, 2.0),
    }
    made = {"slot": Feature("slot", "slot", of=("left", "right")), "edge": Feature("edge", "edge", of=("left", "top"))}
    shapes = Shapes(fitted, made, {"flush": np.array([0.0, 0, 0])})

    def value(kind, *of, name="x"):
        return shapes.value(Dimension(name, kind, of))

    assert value("width", "slot") == pytest.approx(7.0)
    # Between the two edges of a gap: across the first, at the middle of the second.
    assert value("gap", "edge", "line") == pytest.approx(9.0)
    assert value("gap", "left", "right") == pytest.approx(7.0)
    assert value("distance", "slot", "ball") == pytest.approx(0.0, abs=1e-12)
    assert value("step", "floor", "top") == pytest.approx(7.0)
    assert value("step", "top", "floor") == pytest.approx(-7.0)
    assert value("flush", "floor", "top", name="flush") == pytest.approx(7.0)
    assert value("angle", "slot", "floor") == pytest.approx(90.0)
    assert shapes.fitted_of(("slot", "left")) == ("left", "right")
    # One side moved outwards makes the slot wider by as much.
    moved = shapes.moved("left", np.array([0.0, 0.0, -0.25]))
    assert moved.value(Dimension("x", "width", ("slot",))) == pytest.approx(7.25)
