"""A part with twelve features as the simulated rig of 2003 sees it: its bodies, what is to be measured, and the truth.

On a plate of 4 mm stand two balls, a lying cylinder, a cone, a dome, a block with a groove whose sides lean by 14°, a
roof, and a raised step. Coordinates are those of the platform (`rig_2003.platform`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.files.part_file import OF_TWO_PLANES, Dimension, Feature, Part
from jaxscan.files.region import Region
from jaxscan.measurement.dimensions import Shapes
from jaxscan.measurement.shapes import Ball, Circle, Line, Plane, Shape
from jaxscan.measurement.shapes import Cone as ConeShape
from jaxscan.measurement.shapes import Cylinder as RoundShape
from jaxscan.rig import Rig
from jaxscan.simulation import rig_2003
from jaxscan.simulation.cone import Cone
from jaxscan.simulation.scene import Body
from jaxscan.simulation.shapes import grey
from jaxscan.simulation.solids import Box, Cylinder, Difference, HalfSpace, Intersection, Solid, Sphere

_Y: Final = rig_2003.OBJECT_Y
_UP: Final = np.array([0.0, 0.0, 1.0])
_ALONG: Final = np.array([0.0, 1.0, 0.0])
_ALBEDO: Final = 0.6

# Of the part, mm and degrees: (x, y) of the middles, heights over the plate's top.
PLATE: Final = 4.0
BALL, BALL_AT = 12.0, np.array([-66.0, 21.0, PLATE + 10.0])
SMALL, SMALL_AT = 6.0, np.array([-66.0, 55.0, PLATE + 5.0])
ROUND, ROUND_AT = 9.0, np.array([-38.0, _Y, PLATE + 5.0])
CONE_BASE, CONE_TOP, CONE_HALF, CONE_AT = 15.0, 4.0, 50.0, np.array([32.0, 20.0, PLATE])
DOME, DOME_HIGH, DOME_AT = 16.0, 7.0, np.array([32.0, 53.0, PLATE])
GROOVE, GROOVE_LEAN, GROOVE_FLOOR, BLOCK = 10.0, 14.0, 2.0, np.array([13.0, 25.0, 16.0])
ROOF, ROOF_AT = 9.0, np.array([64.0, 21.0, PLATE + 2.0])
STEP, STEP_AT = 6.0, np.array([64.0, 55.0, PLATE])
CUT: Final = 4.0


@dataclass(frozen=True)
class Photographable:
    """The part on a rig's platform.

    Attributes:
        bodies: in the platform's frame.
        part: what is to be measured, object frame.
        true: the shapes of its fitted features, object frame.
        made: its features of two planes.
        volume: of the dome, mm³.
    """

    bodies: tuple[Body, ...]
    part: Part
    true: dict[str, Shape]
    made: dict[str, Feature]
    volume: float

    def truth(self, dimension: Dimension, fitted: dict[str, Shape]) -> float:
        """The true value of a dimension.

        A plane or a line stands for itself at the middle of its points, so that its true place is where these lie: the
        point of the true plane or line that is nearest to it. Only the width between leaning sides depends on that.
        """
        if dimension.kind == "volume":
            return self.volume
        true = {name: shape.placed(fitted[name].point[None]) for name, shape in self.true.items() if name in fitted}
        return Shapes(true, self.made, {}).value(dimension)


def part_of(rig: Rig) -> Photographable:
    """The part on this rig's platform."""
    R, origin = rig_2003.platform(rig)

    def there(x: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        return R @ x + origin

    def around(x: Float[np.ndarray, "3"], radius: float) -> Region:
        return Region(_triple(there(x)), None, radius)

    s, half = np.sqrt(0.5), np.radians(CONE_HALF)
    on_step = STEP_AT + STEP * _UP
    roof = {"roof left": np.array([-s, 0, s]), "roof right": np.array([s, 0, s])}
    sides = _sides()
    above = CONE_AT + CUT * _UP
    features = (
        Feature("base", "plane", around(np.array([-21.0, _Y, PLATE]), 6.5), grow=True),
        Feature("step", "plane", around(on_step, 9.0)),
        Feature("ball", "ball", around(BALL_AT, 1.25 * BALL)),
        Feature("small ball", "ball", around(SMALL_AT, 1.25 * SMALL)),
        Feature("cylinder", "cylinder", around(ROUND_AT + 3 * _UP, 18.0)),
        Feature("cone", "cone", around(CONE_AT + 4 * _UP, 13.0)),
        *(Feature(name, "plane", around(middle, 6.5)) for name, (middle, _) in sides.items()),
        *(Feature(name, "plane", around(ROOF_AT + ROOF * normal, 8.0)) for name, normal in roof.items()),
        Feature("groove", "slot", of=("groove left", "groove right")),
        Feature("ridge", "edge", of=("roof left", "roof right")),
        Feature("cut", "section", around(above, 16.0), point=_triple(there(above)), normal=_triple(R @ _UP)),
        Feature("circle", "circle", of=("cut",)),
        Feature("across", "section", around(on_step, 10.0), point=_triple(there(on_step)), normal=_triple(R @ _ALONG)),
        Feature("line", "line", of=("across",)),
        Feature("dome", "surface", around(DOME_AT, 15.0)),
    )
    true = {
        "base": _plane(there(PLATE * _UP), R @ _UP),
        "step": _plane(there(on_step), R @ _UP),
        "ball": Ball(there(BALL_AT), R @ _UP, 1.0, BALL),
        "small ball": Ball(there(SMALL_AT), R @ _UP, 1.0, SMALL),
        "cylinder": RoundShape(there(ROUND_AT), R @ _ALONG, 1.0, ROUND),
        "cone": ConeShape(there(CONE_AT), -R @ _UP, 1.0, CONE_BASE, half),
        **{name: _plane(there(middle), R @ normal) for name, (middle, normal) in sides.items()},
        **{name: _plane(there(ROOF_AT + ROOF * normal), R @ normal) for name, normal in roof.items()},
        "circle": Circle(there(above), R @ _UP, 1.0, CONE_BASE - CUT * float(np.tan(half))),
        "line": Line(there(on_step), R @ np.array([1.0, 0, 0]), 1.0, R @ _ALONG),
    }
    made = {feature.name: feature for feature in features if feature.kind in OF_TWO_PLANES}
    dimensions = (
        Dimension("step height", "step", ("base", "step")),
        Dimension("ball radius", "radius", ("ball",)),
        Dimension("small ball radius", "radius", ("small ball",)),
        Dimension("ball distance", "distance", ("ball", "small ball")),
        Dimension("cylinder radius", "radius", ("cylinder",)),
        Dimension("cylinder height", "distance", ("cylinder", "base")),
        Dimension("cone angle", "cone_angle", ("cone",)),
        Dimension("circle radius", "radius", ("circle",)),
        Dimension("groove width", "width", ("groove",)),
        Dimension("groove to ball", "distance", ("groove", "ball")),
        Dimension("roof angle", "angle", ("roof left", "roof right")),
        Dimension("ridge height", "distance", ("ridge", "base")),
        Dimension("line height", "distance", ("line", "base")),
        Dimension("dome volume", "volume", ("dome", "base")),
    )
    volume = float(np.pi * DOME_HIGH**2 * (3 * DOME - DOME_HIGH) / 3)
    part = Part(Path("part.toml"), "photographed", features, dimensions)
    return Photographable(tuple(Body(each, grey(_ALBEDO)) for each in _solids()), part, true, made, volume)


def _triple(x: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    a, b, c = x
    return float(a), float(b), float(c)


def _plane(point: Float[np.ndarray, "3"], normal: Float[np.ndarray, "3"]) -> Plane:
    return Plane(point, normal, 1.0)


def _sides() -> dict[str, tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:
    """The middles of the groove's sides, and their normals out of the block."""
    c, s = np.cos(np.radians(GROOVE_LEAN)), np.sin(np.radians(GROOVE_LEAN))
    high = PLATE + (BLOCK[2] + GROOVE_FLOOR) / 2
    found = {}
    for name, way in (("groove left", -1.0), ("groove right", 1.0)):
        found[name] = np.array([way * GROOVE / 2, _Y, high]), np.array([-way * c, 0.0, s])
    return found


def _solids() -> list[Solid]:
    (left, left_out), (right, right_out) = _sides().values()
    walls = Intersection(HalfSpace(-left_out, -left_out @ left), HalfSpace(-right_out, -right_out @ right))
    groove = Intersection(walls, HalfSpace(-_UP, -(PLATE + GROOVE_FLOOR)))
    block = Box(np.array([0.0, _Y, PLATE + BLOCK[2] / 2]), np.eye(3), BLOCK / [1, 1, 2])
    s = np.sqrt(0.5)
    turned = np.array([[s, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, s]])
    length = (CONE_BASE - CONE_TOP) / np.tan(np.radians(CONE_HALF))
    return [
        Box(np.array([0.0, _Y, PLATE / 2]), np.eye(3), np.array([80.0, 35.0, PLATE / 2])),
        Sphere(BALL_AT, BALL),
        Sphere(SMALL_AT, SMALL),
        Cylinder(ROUND_AT - 25 * _ALONG, _ALONG, ROUND, 50.0),
        Cone(CONE_AT, _UP, CONE_BASE, CONE_TOP, length),
        Sphere(DOME_AT + (DOME_HIGH - DOME) * _UP, DOME),
        Difference(block, groove),
        Box(ROOF_AT, turned, np.array([ROOF, 15.0, ROOF])),
        Box(STEP_AT + STEP / 2 * _UP, np.eye(3), np.array([12.0, 11.0, STEP / 2])),
    ]
