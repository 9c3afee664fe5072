"""What is measured: points, and where they come from a range image and its rig, how each moves with every error.

A point X(s; θ) of a range image moves with the stripe's position s in its column (or row), which is its own, and with
the rig's numbers θ, which all points share. Both derivatives are at hand: the first from the direction in which the
stripe runs on the sheet and the file's σ of the pixel's part along the ray, the second from the rig's own formula
(`reconstruction.point_sigma`). Without a rig that fits the points there are no intervals, and `why_not` says so.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
import trimesh
from jaxtyping import Float, Int

from jaxscan.errors import InputError
from jaxscan.files.part_file import IN_A_SECTION, OF_TWO_PLANES, Part
from jaxscan.files.region import AnyRegion
from jaxscan.files.rig_file import RigFile
from jaxscan.files.units import UNITS
from jaxscan.measurement.shapes import lengths
from jaxscan.reconstruction import RangeImage
from jaxscan.reconstruction.point_sigma import point_jacobians, ray_jacobian
from jaxscan.rig import Light, Rig
from jaxscan.rig.light import light_at
from jaxscan.rig.projection import project_points
from jaxscan.rig.rig import parameter_names
from jaxscan.surface.side import along_line

# A stripe that the rig would see further from where it was seen than this is not the rig's, px; of this many points.
_OFF_PX: Final = 0.5
_OFF_SHEET: Final = 1e-4
_CHECKED: Final = 500
# Points so far outside of a region may belong to it, but for their errors.
_BEYOND_MM: Final = 2.0

ByRig = Callable[[Int[np.ndarray, "some"]], Float[np.ndarray, "some 3 leaves"]]


@dataclass(frozen=True)
class Scanned:
    """Points to be measured, and what is known of their errors.

    Attributes:
        points: object frame, mm.
        place: frame and column of each point in a range image; of an outline 0 and its order; None without an order.
        stripe: by how much, and where to, an error of one σ of its stripe moves each point, mm; None where that is not
            known.
        sigma: of each point along its ray by the pixel alone, mm; 1 for all where it is not known.
        by_rig: how points of these numbers move with the rig's leaves; None without a rig.
        covariance: of the rig's leaves.
        parameters: the names of these.
        camera: from where each point was seen, mm; None where that is not known.
        why_not: why there are no intervals, and how to have them; "" where there are.
        image: the range image, where they are one's.
        pitch_px: how far a column of it is from the next in the photographs, px.
        column_mm: how wide a pixel is where the points are, mm; 0 without a rig.
        stripe_mm: how far an error of the stripe of one pixel moves a point, mm; 0 without a rig.
        mesh: the mesh whose corners they are, if they are.
    """

    points: Float[np.ndarray, "points 3"]
    place: Int[np.ndarray, "points 2"] | None = None
    stripe: Float[np.ndarray, "points 3"] | None = None
    sigma: Float[np.ndarray, "points"] | None = None
    by_rig: ByRig | None = None
    covariance: Float[np.ndarray, "leaves leaves"] | None = None
    parameters: tuple[str, ...] = ()
    camera: Float[np.ndarray, "points 3"] | None = None
    why_not: str = ""
    image: RangeImage | None = None
    pitch_px: float = 1.0
    column_mm: float = 0.0
    stripe_mm: float = 0.0
    mesh: trimesh.Trimesh | None = field(default=None, repr=False)

    def within(self, region: AnyRegion | None) -> Int[np.ndarray, "some"]:
        """The numbers of the points in a region; all without one."""
        if region is None:
            return np.arange(len(self.points))
        low, high = region.bounds()
        inside = np.flatnonzero((self.points[:, 2] >= low[2]) & (self.points[:, 2] <= high[2]))
        return inside[region.holds(self.points[inside])]

    def not_empty(self, region: AnyRegion | None) -> Int[np.ndarray, "some"]:
        """As `within`.

        Raises:
            InputError: there are none; it says so where there would be some with the region in another unit.
        """
        inside = self.within(region)
        if region is None or len(inside):
            return inside
        for unit, factor in UNITS.items():
            if len(self.within(region.scaled(factor))):
                raise InputError(
                    f'no point lies in its region, but some would, were it in {unit}: {_SAY_UNITS} "{unit}"'
                )
            if len(self.within(region.scaled(1 / factor))):
                raise InputError(
                    f'no point lies in its region, but some would, were it in mm and not in {unit}: {_SAY_UNITS} "mm"'
                )
        raise InputError(
            "no point lies in its region: enlarge the region, or see that it is in the object frame, in mm "
            "(`jaxscan inspect` says how far the points reach)"
        )

    def part(self, some: Int[np.ndarray, "some"]) -> "Scanned":
        """Some of the points."""
        known = {name: getattr(self, name) for name in ("place", "stripe", "sigma", "camera")}
        chosen: dict[str, Any] = {name: None if value is None else value[some] for name, value in known.items()}
        by_rig = self.by_rig
        chosen["by_rig"] = None if by_rig is None else lambda index: by_rig(some[index])
        return replace(self, points=self.points[some], **chosen, image=None, mesh=None)


def scanned_points(points: Float[np.ndarray, "points 3"], mesh: trimesh.Trimesh | None = None) -> Scanned:
    """Points without further information, or the corners of a mesh.

    Raises:
        InputError: there are none.
    """
    if not len(points):
        raise InputError("there are no points to measure: check the file")
    what = "a mesh" if mesh is not None else "a cloud"
    why = f"{what} does not say how its points were made: for intervals measure the range image (.npz) with --rig"
    return Scanned(np.asarray(points, np.float64), why_not=why, mesh=mesh)


def scanned_image(image: RangeImage, rig: RigFile | None = None, part: Part | None = None) -> Scanned:
    """The points of a range image.

    Args:
        image: as it was reconstructed; it may be cropped or cleaned.
        rig: with which it was reconstructed. Without its covariance nothing has an interval. Without a rig the
            direction in which errors move a point is not known either, and round shapes come out too large.
        part: what will be measured: points that no feature uses are ignored, which saves time.

    Raises:
        InputError: there are no points, or the rig is not the one that they come from.
    """
    if not image.valid.any():
        raise InputError("has no points: check that the photographs show the stripe")
    image = image if part is None else _looked_for(image, part)
    place = np.argwhere(image.valid)
    frame = place[:, 0]
    points = image.points[image.valid].astype(np.float64)
    plain = Scanned(points, place, image=image, camera=image.cameras()[frame])
    if rig is None:
        why = (
            "no rig is given: for intervals, and for balls and cylinders that are not too large, add --rig with the "
            "rig of the scan"
        )
        return replace(plain, why_not=why)
    laser, columns, known = _as_the_rig_sees_it(image, rig.rig)
    motion = rig.rig.pose({axis: np.asarray(steps, np.float64) for axis, steps in image.positions.items()})
    R = np.broadcast_to(np.asarray(motion.matrix()), (len(image.valid), 3, 3))
    T = np.broadcast_to(np.asarray(motion.translation), (len(image.valid), 3))
    # Frame by frame: a matrix for each point would not fit the processor's cache.
    seen = (np.matmul(image.points.astype(np.float64), R.swapaxes(1, 2)) + T[:, None])[image.valid]
    light = _stood(rig.rig.lights[laser], image, frame)
    e = along_line(np.asarray(light.gradient(seen)), seen, 0 if columns else 1)
    along = np.abs((e * seen).sum(axis=1)) / np.linalg.norm(seen, axis=1)
    sigma = image.sigma_pixel[image.valid].astype(np.float64)
    sigma = sigma if known else np.ones(len(points))
    e *= (sigma / np.maximum(along, 1e-3 * np.linalg.norm(e, axis=1)))[:, None]
    stripe = np.empty_like(e)
    for f, (start, end) in enumerate(_runs(frame, len(image.valid))):
        stripe[start:end] = e[start:end] @ R[f]
    q = {axis: np.asarray(steps, np.float64) for axis, steps in image.positions.items()}
    name = rig.rig.lights[laser].name

    def by_rig(some: Int[np.ndarray, "some"]) -> Float[np.ndarray, "some 3 leaves"]:
        pixels = project_points(rig.rig.camera, seen[some]).pixels
        each = {axis: steps[frame[some]] for axis, steps in q.items()}
        return point_jacobians(rig.rig, name, pixels, each, columns)[0]

    some = np.unique(np.linspace(0, len(points) - 1, _CHECKED).astype(int))
    pixels = project_points(rig.rig.camera, seen[some]).pixels
    per_px = np.abs(
        ray_jacobian(rig.rig, name, pixels, {axis: each[frame[some]] for axis, each in q.items()}, columns)[1]
    )
    focal = float(rig.rig.camera.focal[0 if columns else 1])
    why = "" if rig.covariance is not None else "the rig has no covariance: give one that calibrate wrote"
    return replace(
        plain,
        why_not=why,
        stripe=stripe,
        sigma=sigma,
        by_rig=by_rig,
        covariance=None if rig.covariance is None else rig.covariance.of_leaves(rig.rig),
        parameters=tuple(parameter_names(rig.rig)),
        pitch_px=_pitch_px(rig.rig, place, seen, columns),
        column_mm=float(np.median(rig.rig.camera.chart.range_of(seen[some]))) / focal,
        stripe_mm=float(np.median(lengths(stripe[some]) / sigma[some] * per_px)),
    )


def _pitch_px(
    rig: Rig, place: Int[np.ndarray, "points 2"], seen: Float[np.ndarray, "points 3"], columns: bool
) -> float:
    """From one column (or row) of the grid to the next, px: 1 but where the image has been thinned."""
    beside = np.flatnonzero((np.diff(place, axis=0) == [0, 1]).all(axis=1))
    if not len(beside):
        return 1.0
    beside = beside[np.unique(np.linspace(0, len(beside) - 1, _CHECKED).astype(int))]
    a, b = (project_points(rig.camera, seen[some]).pixels[:, 0 if columns else 1] for some in (beside, beside + 1))
    return max(float(np.round(np.median(np.abs(b - a)))), 1.0)


def _looked_for(image: RangeImage, part: Part) -> RangeImage:
    """The points in the boxes around all regions; all, where a feature grows or has no region, or regions are moved."""
    regions = [feature.region for feature in part.features if feature.kind not in (*OF_TWO_PLANES, *IN_A_SECTION)]
    if any(region is None for region in regions) or any(feature.grow for feature in part.features) or part.fit:
        return image
    inside = np.zeros(image.valid.shape, bool)
    coordinates = [np.ascontiguousarray(image.points[..., axis]) for axis in range(3)]
    for region in regions:
        assert region is not None
        low, high = (np.asarray(corner, np.float32) for corner in region.wider(_BEYOND_MM).bounds())
        box = image.valid.copy()
        with np.errstate(invalid="ignore"):
            for axis, values in enumerate(coordinates):
                box &= (values >= low[axis]) & (values <= high[axis])
        inside |= box
    return replace(image, valid=inside) if inside.any() else image


def _runs(frame: Int[np.ndarray, "points"], frames: int) -> list[tuple[int, int]]:
    """Where the points of each frame begin and end; they are in the order of frames."""
    ends = np.searchsorted(frame, np.arange(frames + 1))
    return list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))


def _stood(light: Light, image: RangeImage, frame: Int[np.ndarray, "points"]) -> Light:
    """A light as it stood while each point of some frames was seen."""
    return light_at(light, {axis: np.asarray(steps, np.float64)[frame] for axis, steps in image.positions.items()})


def _as_the_rig_sees_it(image: RangeImage, rig: Rig) -> tuple[int, bool, bool]:
    """Which of the rig's lights it was, whether the stripe was looked for in columns, and whether its σ is known.

    Raises:
        InputError: the points do not lie on the rig's light, or the stripe is not where the rig would see it.
    """
    rig.light(image.sheets[0].name if image.sheets and len(rig.lights) > 1 else "")
    laser = [light.name for light in rig.lights].index(image.sheets[0].name) if len(rig.lights) > 1 else 0
    frames, columns = np.nonzero(image.valid)
    some = np.unique(np.linspace(0, len(frames) - 1, _CHECKED).astype(int))
    frames, columns = frames[some], columns[some]
    pose = rig.pose({axis: np.asarray(steps, np.float64)[frames] for axis, steps in image.positions.items()})
    X = image.points[frames, columns].astype(np.float64)
    seen = np.asarray(pose.apply(X[:, None]))[:, 0]
    ranges = rig.camera.chart.range_of(seen)
    if not (ranges > 0).all():
        raise InputError(_NOT_THIS_RIG)
    w = np.asarray(_stood(rig.lights[laser], image, frames).inverse_depth(seen / ranges[:, None]))
    if not float(np.median(np.abs(w * ranges - 1))) < _OFF_SHEET:
        raise InputError(_NOT_THIS_RIG)
    pixels = project_points(rig.camera, seen).pixels
    measured = image.pixels[frames, columns].astype(np.float64)
    if np.isfinite(measured).any():
        off = np.nanmedian(np.abs(pixels - measured[:, None]), axis=0)
        if not off.min() < _OFF_PX:
            raise InputError(_NOT_THIS_RIG)
        by_columns = bool(off[1] <= off[0])
    else:
        # An older file: columns are what stands at whole numbers.
        fraction = np.abs(pixels - np.round(pixels)).mean(axis=0)
        by_columns = bool(fraction[0] <= fraction[1])
    sigma = image.sigma_pixel[image.valid]
    return laser, by_columns, bool(len(sigma) and (np.isfinite(sigma) & (sigma > 0)).all())


_SAY_UNITS: Final = "say so in part.toml by [part] units ="
_NOT_THIS_RIG: Final = (
    "the points are not where this rig would see the stripe: give the rig.json with which the scan was reconstructed"
)
