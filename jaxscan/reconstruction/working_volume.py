"""Predicted σ of a triangulated point over the working volume, and which part of the rig it comes from.

The working volume is the part of the light sheet that the camera sees between the nearest and the farthest stripe point
of the calibration. A point of it is given by its depth z and by its position s along the sheet, at right angles to the
optical axis; of a fisheye, by its distance from the camera and the arc within the sheet around the camera, on the
circle of the middle distance. Its σ is that along its ray, at motor step 0.

If a part of the rig (camera, light plane) were known exactly, the rest would have the conditional covariance
Σ_rr − Σ_rk Σ_kk⁻¹ Σ_kr; how much σ would fall says what limits it.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.axis_details import POSES
from jaxscan.calibration import Calibration, Observations
from jaxscan.reconstruction.point_sigma import jacobian_along, sigma_of
from jaxscan.rig import Camera, Covariance, Light, Rig
from jaxscan.rig.chart import AROUND
from jaxscan.rig.light import section, section_around
from jaxscan.rig.projection import project_points, within_fold

_DEPTHS, _POSITIONS = 25, 41


@dataclass(frozen=True)
class WorkingVolume:
    """σ of a point over the sheet of one laser; NaN where the camera does not see it.

    Attributes:
        laser: its name, "" for the only one.
        columns: whether its stripe is found column by column.
        depths_mm: along the optical axis; of a fisheye, from the camera's centre.
        positions_mm: along the sheet; of a fisheye, along the arc.
        sigma_mm: of a point along its ray, rig and pixel together.
        pixel_mm: the pixel's part.
        if_known_mm: for "camera" and "light plane" the median σ of a point if that part were known exactly.
        travelled_mm: median σ after the longest travel of the calibration, along the ray too; None where nothing moves.
    """

    laser: str
    columns: bool
    depths_mm: Float[np.ndarray, "depths"]
    positions_mm: Float[np.ndarray, "positions"]
    sigma_mm: Float[np.ndarray, "depths positions"]
    pixel_mm: Float[np.ndarray, "depths positions"]
    if_known_mm: dict[str, float]
    travelled_mm: float | None

    @property
    def median_mm(self) -> float:
        """The median of σ over the volume, mm."""
        return float(np.nanmedian(self.sigma_mm))

    @property
    def worst_mm(self) -> float:
        """The largest σ in the volume."""
        return float(np.nanmax(self.sigma_mm))

    @property
    def rig_share(self) -> float:
        """The rig's share of the variance, in the median."""
        return float(np.nanmedian(1 - (self.pixel_mm / self.sigma_mm) ** 2))


def working_volumes(calibration: Calibration) -> tuple[WorkingVolume, ...]:
    """σ over the sheet of each laser that was seen on a board, between its nearest and farthest stripe point."""
    observations, rig = calibration.observations, calibration.rig
    volumes = []
    for i, laser in enumerate(rig.lights):
        points, _ = calibration.stripe_points(i)
        if not len(points):
            continue
        columns = next(s.columns for view in observations.photographs() for s in view.stripes if s.laser == i)
        ranges = rig.camera.chart.range_of(points)
        depths = float(ranges.min()), float(ranges.max())
        sigma = calibration.stripe_sigma_px or 0.0
        farthest = _farthest(observations)
        volumes.append(working_volume(rig, laser.name, calibration.covariance, sigma, columns, depths, farthest))
    return tuple(volume for volume in volumes if volume is not None)


def working_volume(
    rig: Rig,
    laser: str,
    covariance: Covariance,
    stripe_sigma_px: float,
    columns: bool,
    depths_mm: tuple[float, float],
    farthest: Mapping[str, float] | None = None,
) -> WorkingVolume | None:
    """σ over the sheet of a laser; None where the camera sees none of it.

    Args:
        rig: the rig.
        laser: which of its lasers; "" for the only one.
        covariance: of its parameters.
        stripe_sigma_px: σ of the stripe's position.
        columns: whether v is measured, or u.
        depths_mm: the nearest and the farthest stripe point.
        farthest: positions of the axes at the end of the longest travel, for `travelled_mm`.
    """
    light = rig.light(laser)
    depths = np.linspace(*depths_mm, _DEPTHS)
    # Wide enough for the image's diagonal at the largest depth; what the camera does not see is left out below.
    reach = 0.6 * np.hypot(*rig.camera.image_size) * depths[-1] / float(min(rig.camera.focal))
    if rig.camera.chart is AROUND:
        reach = np.pi * _middle(depths)
    positions = np.linspace(-reach, reach, 8 * _POSITIONS)
    seen = _seen(rig.camera, _section(rig.camera, light, depths, positions))
    if not seen.any():
        return None
    within = positions[seen.any(axis=0)]
    positions = np.linspace(within[0], within[-1], _POSITIONS)
    sheet = _section(rig.camera, light, depths, positions)
    seen = _seen(rig.camera, sheet)
    rays = _rays(rig.camera, sheet).reshape(-1, 3)

    def sigma(covariance: Covariance, at: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        q = {axis: np.full(seen.size, steps) for axis, steps in at.items()}
        jacobian = jacobian_along(rig, laser, rays, q, columns)
        parts = sigma_of(rig, covariance, stripe_sigma_px, *jacobian)
        total, pixel = (np.where(seen, part.reshape(seen.shape), np.nan) for part in parts)
        return total, pixel

    # Where hand or base is moves all points alike, and no two of them apart.
    still = without(covariance, f"motion.{POSES}.")
    total, pixel = sigma(still, {})
    known = {
        words: float(np.nanmedian(sigma(given(still, stem), {})[0]))
        for words, stem in (("camera", "camera"), ("light plane", "lights"))
    }
    travelled = float(np.nanmedian(sigma(covariance, farthest)[0])) if farthest else None
    return WorkingVolume(laser, columns, depths, positions, total, pixel, known, travelled)


def without(covariance: Covariance, stem: str) -> Covariance:
    """The covariance of the parameters whose names do not begin with the stem."""
    left = [i for i, name in enumerate(covariance.names) if not name.startswith(stem)]
    return Covariance(tuple(covariance.names[i] for i in left), covariance.matrix[np.ix_(left, left)])


def given(covariance: Covariance, stem: str) -> Covariance:
    """The covariance of the other parameters if those whose names begin with the stem were known exactly."""
    known = np.array([name.startswith(stem) for name in covariance.names])
    if not known.any():
        return covariance
    scale = np.sqrt(np.diagonal(covariance.matrix))
    S = covariance.matrix / np.outer(scale, scale)
    S = S - S[:, known] @ np.linalg.solve(S[np.ix_(known, known)], S[known])
    S[known] = S[:, known] = 0.0
    return Covariance(covariance.names, S * np.outer(scale, scale))


def volume_rays(rig: Rig, volume: WorkingVolume) -> Float[np.ndarray, "points 3"]:
    """The rays of those points of a working volume that the camera sees."""
    sheet = _section(rig.camera, rig.light(volume.laser), volume.depths_mm, volume.positions_mm)
    return _rays(rig.camera, sheet)[_seen(rig.camera, sheet)]


def _section(
    camera: Camera, light: Light, depths: Float[np.ndarray, "depths"], positions: Float[np.ndarray, "positions"]
) -> Float[np.ndarray, "depths positions 3"]:
    if camera.chart is AROUND:
        return section_around(light, depths, positions / _middle(depths))
    return section(light, depths, positions)


def _middle(depths: Float[np.ndarray, "depths"]) -> float:
    return float(depths[0] + depths[-1]) / 2


def _rays(camera: Camera, X: Float[np.ndarray, "*points 3"]) -> Float[np.ndarray, "*points 3"]:
    """The rays to points, of the length that the camera gives them."""
    return X / camera.chart.range_of(X)[..., None]


def _farthest(observations: Observations) -> dict[str, float]:
    """The positions farthest from 0 at which the board was photographed, axis by axis."""
    farthest: dict[str, float] = {}
    for sequence in observations.sequences:
        farthest[sequence.axis] = max(farthest.get(sequence.axis, 0.0), float(np.abs(sequence.steps).max()))
    return farthest


def _seen(camera: Camera, X: Float[np.ndarray, "depths positions 3"]) -> Bool[np.ndarray, "depths positions"]:
    """Whether each point is in the image."""
    points = X.reshape(-1, 3)
    pixels = project_points(camera, points).pixels
    inside = np.all((pixels > -0.5) & (pixels < np.array(camera.image_size) - 0.5), axis=-1)
    # Beyond the fold of a lens a point has a pixel too, but that pixel's ray is another.
    seen = np.zeros(len(points), bool)
    seen[inside] = within_fold(camera, points[inside])
    return seen.reshape(X.shape[:-1])
