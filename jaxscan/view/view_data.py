"""What `jaxscan view` shows of a file: points or a mesh, what is known of each point, and where the scanner stood."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from jaxscan.errors import InputError, error_context
from jaxscan.files.cloud import Cloud, cloud_of
from jaxscan.files.floor_note import FloorNote, floor_of_file, floor_of_lines
from jaxscan.files.mesh import colours_of, has_faces, mesh_of, read_mesh
from jaxscan.files.ply_read import read_ply_file
from jaxscan.geometry import Pose
from jaxscan.geometry.robust_plane import dominant_plane
from jaxscan.images.shaded import TextureMap
from jaxscan.reconstruction import RangeImage, read_range_image
from jaxscan.rig import Light, Rig
from jaxscan.rig.light import section, sheet_axes
from jaxscan.surface.floor import find_floor

UNITS: Final = {"height": "mm", "z": "mm", "sigma": "mm", "strength": "grey levels", "albedo": "of the scan's median"}
# What the points are coloured by if they have colours of their own.
PHOTOGRAPH: Final = "photograph"
# How far the sheet is drawn before the nearest and beyond the farthest point, in parts of their depth.
_BEFORE, _BEYOND = 0.95, 1.02
# How wide, in widths of the points about the camera's axis.
_WIDER: Final = 1.1
# Where no floor is noted, a plane is one if this part of all points is within this distance of it, and less than the
# other part is under it.
_FLOOR_SHARE, _ON_FLOOR_MM, _UNDER_FLOOR = 0.25, 0.3, 0.01
# Of a scan no more places of the camera are drawn than twice this.
_MOST_CAMERAS: Final = 50


@dataclass(frozen=True)
class Setup:
    """The scanner around what it has seen, object frame, mm.

    Attributes:
        at: T_object_camera from the first frame to the last, some in between; the identity where it did not move.
        frames: the scan's frame at which each of these was, from 0; 0 where the scan is not known.
        sheet: corners of the light plane at the first frame, as far as the camera sees it there; none without a laser.
        fov: the camera's vertical field of view, radians.
        aspect: width of its image over the height.
    """

    at: Pose[np.ndarray]
    frames: Int[np.ndarray, "poses"]
    sheet: Float[np.ndarray, "corners 3"]
    fov: float
    aspect: float


@dataclass(frozen=True)
class ViewData:
    """Something to look at.

    Attributes:
        points: mm.
        up: the direction that is up.
        values: for each name of `UNITS` that is known, a number for each point; NaN where it is not known.
        triangles: between the points; none for a cloud.
        setup: where the scanner stood.
        colours: red, green, blue as photographed, where they are known; 0, 0, 0 for a point without one.
        texture: of a mesh that has one; `colours` are then what it shows at the points.
    """

    points: Float32[np.ndarray, "points 3"]
    up: Float[np.ndarray, "3"]
    values: dict[str, Float[np.ndarray, "points"]] = field(default_factory=dict)
    triangles: Int[np.ndarray, "triangles 3"] | None = None
    setup: Setup | None = None
    colours: UInt8[np.ndarray, "points 3"] | None = None
    texture: TextureMap | None = None

    @property
    def looks(self) -> tuple[str, ...]:
        """What they can be coloured by."""
        return (*self.values, *([] if self.colours is None else [PHOTOGRAPH]))

    def colour(self, name: str | None) -> str:
        """The name of the values to colour by; by default the colours that a mesh has, or else the height, or z.

        Raises:
            InputError: they are not known.
        """
        if name is not None and name not in self.looks:
            raise InputError(f'"{name}" is not known of these points: choose {", ".join(self.looks)}')
        if name is None and self.triangles is not None and self.colours is not None:
            return PHOTOGRAPH
        return name or next(iter(self.values))


def view_data(path: Path, rig: Rig | None = None) -> ViewData:
    """Read a range image (.npz), a cloud, or a mesh, with the rig that scanned it.

    Raises:
        InputError: the file cannot be read, or holds no points.
    """
    ending = path.suffix.lower()
    if ending == ".npz":
        image = read_range_image(path)
        with error_context(path):
            return _of_image(image, rig)
    if ending != ".ply":
        mesh = read_mesh(path)
        colours, texture = colours_of(mesh)
        cloud = Cloud(np.asarray(mesh.vertices, np.float32), colours=colours)
        return replace(_of_points(cloud, np.asarray(mesh.faces), rig, floor_of_file(path)), texture=texture)
    content = read_ply_file(path)
    faces = np.asarray(mesh_of(path, content, merge=False).faces) if has_faces(content) else None
    return _of_points(cloud_of(path, content), faces, rig, floor_of_lines(content.comments))


def _of_image(image: RangeImage, rig: Rig | None) -> ViewData:
    if not image.valid.any():
        raise InputError("has no points: check that the photographs show the stripe")
    points = image.points[image.valid]
    try:
        floor = find_floor(image).note()
    except InputError:
        floor = None
    (up, values), cloud = _upright(points, floor), image.cloud()
    for name in ("sigma", "strength", "albedo"):
        known = getattr(cloud, name)
        if known is not None and np.isfinite(known).any():
            values[name] = known.astype(np.float64)
    at, every = image.from_camera(), max(1, len(image.valid) // _MOST_CAMERAS)
    some = np.append(np.arange(0, len(image.valid) - 1, every), len(image.valid) - 1)
    seen = image.seen()[image.valid]
    setup = _setup(seen, Pose(at.rotation[some], at.translation[some]), some, rig, image.sheets)
    return ViewData(points, up, values, None, setup, cloud.colours)


def _of_points(
    cloud: Cloud, triangles: Int[np.ndarray, "triangles 3"] | None, rig: Rig | None, floor: FloorNote | None
) -> ViewData:
    up, values = _upright(cloud.points, floor or _floor_of_most(cloud.points))
    sigma = cloud.sigma_pixel if cloud.sigma is None else cloud.sigma
    if sigma is not None:
        values["sigma"] = sigma.astype(np.float64)
    for name in ("strength", "albedo"):
        known = getattr(cloud, name)
        if known is not None:
            values[name] = known.astype(np.float64)
    setup = _setup(cloud.points, Pose(*np.zeros((2, 1, 3))), np.zeros(1, int), rig)
    return ViewData(cloud.points, up, values, triangles, setup, cloud.colours)


def _upright(
    points: Float32[np.ndarray, "points 3"], floor: FloorNote | None
) -> tuple[Float[np.ndarray, "3"], dict[str, Float[np.ndarray, "points"]]]:
    """What is up, and the height over the floor; of points without one z, and up is where the camera was.

    A file of another program has z up, unless all of it is in front of its origin, as what a camera sees is.
    """
    points = points.astype(np.float64)
    if floor is not None:
        return floor.up, {"height": floor.height(points)}
    middle, size = points.mean(axis=0), float(np.ptp(points, axis=0).max())
    seen = points[:, 2].min() > 0 and middle[2] > max(size, float(np.hypot(*middle[:2])))
    return np.array([0.0, 0.0, -1.0 if seen else 1.0]), {"z": points[:, 2]}


def _floor_of_most(points: Float32[np.ndarray, "points 3"]) -> FloorNote | None:
    """The plane that most points lie on, if it is a floor: it has enough of them, and nothing is under it."""
    cloud = points.astype(np.float64)
    try:
        plane = dominant_plane(cloud)
    except InputError:
        return None
    note = FloorNote(plane.matrix()[:, 2], -float(plane.translation @ plane.matrix()[:, 2]))
    height = note.height(cloud)
    on = np.abs(height) < _ON_FLOOR_MM
    return note if on.mean() > _FLOOR_SHARE and (height < -_ON_FLOOR_MM).mean() < _UNDER_FLOOR else None


def _setup(
    seen: Float[np.ndarray, "points 3"],
    at: Pose[np.ndarray],
    frames: Int[np.ndarray, "poses"],
    rig: Rig | None,
    sheets: tuple[Light, ...] = (),
) -> Setup | None:
    """From the points in the frame of the camera that saw them, in the light that lit them or the rig's first."""
    if rig is None:
        return None
    columns, rows = rig.camera.image_size
    focal = [float(f) for f in rig.camera.focal]
    half = 0.5 * np.array([columns, rows]) / focal
    sheet = np.zeros((0, 3))
    for light in (sheets or rig.lights)[:1]:
        near, far = _BEFORE * float(seen[:, 2].min()), _BEYOND * float(seen[:, 2].max())
        along = seen @ sheet_axes(light)[0]
        ends = _WIDER * np.array([along.min(), along.max()])
        sheet = section(light, np.array([near, far]), ends).reshape(-1, 3)[[0, 1, 3, 2]]
        sheet = Pose(at.rotation[0], at.translation[0]).apply(sheet)
    return Setup(at, frames, sheet, float(2 * np.arctan(half[1])), columns / rows)
