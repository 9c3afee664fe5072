"""Objects to scan, and boards.

Objects stand on the plane z = 0 of a frame of their own: x to the right, y away from the camera's near side, z up, in
millimetres, the middle of the object at x = 0 and `y`. `Body.moved` puts them in front of the camera.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxscan.errors import InputError
from jaxscan.files.mesh import read_mesh
from jaxscan.images import Board
from jaxscan.simulation.bent_plate import bent
from jaxscan.simulation.plate import Checks, Circles, Pattern, Plate
from jaxscan.simulation.scene import Body
from jaxscan.simulation.solids import Box, Cylinder, Difference, HalfSpace, Intersection, Sphere

_UP = np.array([0.0, 0.0, 1.0])
_ACROSS = np.array([0.0, 1.0, 0.0])

# Radius of a calibration board's circles, in parts of their pitch, where the board does not say.
_CIRCLE_RADIUS = 0.3
# From a board's rows to the direction in which it bends.
_ASKEW = np.radians(30.0)
# What a scan of 74 mm takes of a mesh: x, y, z, and the least of its largest extent, mm.
_LARGEST = np.array([140.0, 66.0, 60.0])
_SMALLEST = 5.0
# A hole is made this much longer than what it is cut from, mm.
_BEYOND = 1.0
# What is joined overlaps by this much, mm.
_INTO = 1.0


def grey(albedo: float) -> Float[np.ndarray, "3"]:
    """The same albedo for red, green and blue."""
    return np.full(3, albedo)


def floor(low: Sequence[float], high: Sequence[float], albedo: float = 0.5) -> Body:
    """The platform that objects stand on, from (x, y) to (x, y), mm."""
    x_axis = np.array([1.0, 0.0, 0.0])
    plate = Plate(np.zeros(3), x_axis, _ACROSS, np.asarray(low, float), np.asarray(high, float))
    return Body(plate, grey(albedo))


def cup(
    y: float, radius: float = 30.0, height: float = 42.0, wall: float = 3.5, bottom: float = 5.0, albedo: float = 0.6
) -> tuple[Body, ...]:
    """A cup with a handle on the side of larger x.

    Args:
        y: its middle, mm.
        radius: outside, mm.
        height: mm.
        wall: thickness of the wall, mm.
        bottom: thickness of the bottom, mm.
        albedo: of all of it.

    Raises:
        InputError: the wall or the bottom is thicker than the cup.
    """
    if not (0 < wall < radius and 0 < bottom < height):
        raise InputError(f"a cup of radius {radius} and height {height} mm cannot have wall {wall}, bottom {bottom} mm")
    base = np.array([0.0, y, 0.0])
    hollow = Cylinder(base + bottom * _UP, _UP, radius - wall, height - bottom + _BEYOND)
    pot = Difference(Cylinder(base, _UP, radius, height), hollow)
    # A ring standing on edge, cut off within the wall.
    outer, inner, width = 0.36 * height, 0.2 * height, 0.2 * height
    middle = base + np.array([radius + 0.1 * height, -width / 2, height / 2])
    ring = Cylinder(middle, _ACROSS, outer, width)
    within_wall = HalfSpace(np.array([-1.0, 0.0, 0.0]), wall / 2 - radius)
    bore = Cylinder(middle - _BEYOND * _ACROSS, _ACROSS, inner, width + 2 * _BEYOND)
    handle = Difference(Intersection(ring, within_wall), bore)
    return Body(pot, grey(albedo)), Body(handle, grey(albedo))


def sphere(y: float, radius: float = 25.0, albedo: float = 0.6) -> Body:
    """A ball lying on the floor."""
    return Body(Sphere(np.array([0.0, y, radius]), radius), grey(albedo))


def box(y: float, size: Sequence[float] = (60.0, 40.0, 30.0), albedo: float = 0.6) -> Body:
    """A box of size (x, y, z), mm, standing on the floor."""
    half = np.asarray(size, float) / 2
    return Body(Box(np.array([0.0, y, half[2]]), np.eye(3), half), grey(albedo))


def stair(
    y: float, heights: Sequence[float] = (10.0, 20.0, 30.0), albedo: float = 0.6, width: float = 120.0
) -> tuple[Body, ...]:
    """Boxes of equal width side by side from left to right, each with its height, mm; `width` in all, 50 mm deep."""
    each = width / len(heights)
    steps = []
    for i, height in enumerate(heights):
        left, right = -width / 2 + i * each, -width / 2 + (i + 1) * each
        # A lower step goes on into a higher one, so that the wall between them is buried and not a surface.
        left -= _INTO if i > 0 and heights[i - 1] > height else 0.0
        right += _INTO if i + 1 < len(heights) and heights[i + 1] > height else 0.0
        half = np.array([right - left, 50.0, height]) / 2
        steps.append(Body(Box(np.array([(left + right) / 2, y, height / 2]), np.eye(3), half), grey(albedo)))
    return tuple(steps)


def panda(y: float) -> tuple[Body, ...]:
    """A panda on its back, 66 mm from ears to feet: known at sight, and without deep shadows.

    Its colours are nearly neutral, as a red laser wants them: what is red in the light of the room looks like a stripe.
    """

    def ball(x: float, up: float, high: float, radius: float, colour: Sequence[float]) -> Body:
        return Body(Sphere(np.array([x, y + up, high]), radius), np.asarray(colour, float))

    def pair(x: float, up: float, high: float, radius: float, colour: Sequence[float]) -> tuple[Body, Body]:
        return ball(-x, up, high, radius, colour), ball(x, up, high, radius, colour)

    white, black, pad = (0.84, 0.83, 0.81), (0.26, 0.26, 0.27), (0.62, 0.58, 0.57)
    return (
        ball(0.0, -8.0, 11.0, 17.0, white),
        ball(0.0, 15.0, 13.5, 14.0, white),
        *pair(11.5, 26.5, 12.0, 6.0, black),
        ball(0.0, 11.0, 22.0, 6.6, white),
        ball(0.0, 12.8, 26.2, 2.9, black),
        *pair(5.6, 18.6, 21.6, 4.4, black),
        *pair(16.5, -1.0, 11.0, 6.5, black),
        *pair(22.5, -6.0, 10.0, 6.5, black),
        *pair(13.5, -25.0, 9.0, 8.0, black),
        *pair(13.5, -25.5, 12.5, 5.8, pad),
    )


def figure(y: float, albedo: float = 0.6) -> tuple[Body, ...]:
    """A figure without any symmetry, to be scanned from several sides: plinth, body, head with a hat, arms, a bag."""

    def at(*place: float) -> Float[np.ndarray, "3"]:
        return np.array([0.0, y, 0.0]) + place

    def turned(*angles: float) -> Float[np.ndarray, "3 3"]:
        return Rotation.from_euler("zyx", angles, degrees=True).as_matrix()

    solids = (
        Box(at(1.0, 0.0, 3.0), turned(12.0, 0.0, 0.0), np.array([24.0, 17.0, 3.0])),
        Box(at(0.0, 1.0, 18.0), turned(-25.0, 24.0, 18.0), np.array([13.0, 8.0, 16.0])),
        Sphere(at(-3.0, 2.0, 36.0), 9.0),
        Cylinder(at(-3.0, 2.0, 36.0), np.array([0.64, 0.48, 0.6]), 4.5, 16.0),
        Cylinder(at(4.0, -2.0, 16.0), np.array([0.64, -0.48, 0.6]), 5.0, 21.0),
        Sphere(at(-12.0, -6.0, 22.0), 7.0),
        Box(at(-17.0, 10.0, 9.0), turned(35.0, 30.0, -20.0), np.array([6.0, 5.0, 8.0])),
        Sphere(at(12.0, 13.0, 9.0), 7.0),
    )
    return tuple(Body(solid, grey(albedo)) for solid in solids)


def mesh(y: float, triangles: trimesh.Trimesh, albedo: float = 0.6) -> Body:
    """A triangle mesh, in millimetres and with z up, set down on the floor with its middle at x = 0 and y.

    Raises:
        InputError: the extra `mesh-scenes` is not installed, or the mesh is empty.
    """
    from jaxscan.simulation.mesh import Mesh

    shape = Mesh.create(triangles)
    low, high = triangles.bounds
    middle = (low + high) / 2
    return Body(shape.moved(np.eye(3), np.array([-middle[0], y - middle[1], -low[2]])), grey(albedo))


def mesh_to_scan(path: Path) -> trimesh.Trimesh:
    """A mesh from a file, if it fits under the sheet.

    Raises:
        InputError: the file is missing or holds no mesh, or the mesh is too large or too small.
    """
    triangles = read_mesh(path)
    size = triangles.extents
    if np.any(size > _LARGEST) or size.max() < _SMALLEST:
        words = " x ".join(f"{length:.4g}" for length in size)
        raise InputError(
            f"{path}: is {words} mm large, the scan takes from {_SMALLEST:g} mm to {_LARGEST[0]:g} x {_LARGEST[1]:g} x "
            f"{_LARGEST[2]:g} mm: scale it, or turn it"
        )
    return triangles


def board_plate(
    board: Board, margin_mm: float = 8.0, white: float = 0.9, ink: float = 0.3, bend_mm: float = 0.0
) -> Body:
    """A calibration board in its own frame: the first point at the origin, z away from a camera that sees its front.

    Args:
        board: a checkerboard or a grid of circles.
        margin_mm: white around the pattern.
        white: albedo of the paper.
        ink: brightness of the ink, in parts of the paper's.
        bend_mm: how far its middle is off the line between the ends of the pattern; it bends across its rows, 30°
            askew, as paper does on a cylinder.

    Raises:
        InputError: a ChArUco board, whose markers are not simulated.
    """
    counts, pitch = np.asarray(board.counts), board.pitch_mm
    if board.kind == "charuco":
        raise InputError('boards of kind "charuco" are not simulated: use a checkerboard or circles')
    pattern: Pattern
    if board.kind == "circles":
        pattern, reach = Circles(counts, pitch, board.diameter_mm / 2 or _CIRCLE_RADIUS * pitch), pitch
    else:
        pattern, reach = Checks(counts, pitch), pitch
    low, high = np.full(2, -reach - margin_mm), (counts - 1) * pitch + reach + margin_mm
    x_axis = np.array([1.0, 0.0, 0.0])
    plate = Plate(np.zeros(3), x_axis, _ACROSS, low, high, pattern, ink)
    if bend_mm:
        plate = bent(plate, bend_mm, float((counts[0] - 1) * pitch), _ASKEW)
    return Body(plate, grey(white))
