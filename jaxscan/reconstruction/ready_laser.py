"""One laser of a rig, made ready: from photographs of its stripe to points with their σ.

What depends on the laser alone is made once: the kernel that triangulates, the band in which the stripe can be, the map
of σ, and the thickness of the sheet of light.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.detectors import Choice, Detector
from jaxscan.files.rig_file import RigFile
from jaxscan.images import Stripe, StripeSettings, detect_stripe
from jaxscan.images.stripes.settle import Band
from jaxscan.reconstruction.frames import Frames
from jaxscan.reconstruction.pose_sigma import PoseSigma
from jaxscan.reconstruction.range_image import RangeImage
from jaxscan.reconstruction.scan_colours import own_colours
from jaxscan.reconstruction.sheet_band import sheet_band, swept_band
from jaxscan.reconstruction.sigma_map import MovedFrames, SigmaMap, SweptMap, point_sigmas
from jaxscan.reconstruction.spacetime import Geometry, spacetime_profiles
from jaxscan.reconstruction.thick_sheet import Looked, ThickSheet, frames_apart, middles
from jaxscan.reconstruction.triangulate import FramePoses, Kernel, triangulate_stripes
from jaxscan.rig import MovingLight, Positions
from jaxscan.rig.light import light_at


class ReadyLaser:
    """One laser of a rig, made ready: its kernel, where its stripe can be, and the σ of its points.

    Args:
        content: the rig, with its covariance if it has one.
        laser: which, and how its stripe is looked for.
        detector: how the stripe's centre is measured.
        choice: which stripe is taken where a line has several.
        depths_mm: nearest and farthest depth at which there can be a stripe, mm; None for any.
    """

    def __init__(
        self,
        content: RigFile,
        laser: StripeSettings,
        detector: Detector,
        choice: Choice,
        depths_mm: tuple[float, float] | None,
    ) -> None:
        rig, name = content.rig, laser.name
        self._laser = laser
        self._detector: Detector = detector
        self._choice: Choice = choice
        self._kernel = Kernel.create(rig, name)
        size = rig.camera.image_size
        self._light = rig.light(name)
        self._moves = isinstance(self._light, MovingLight)
        # Of a light that moves by the positions of the axes.
        self._band: Band | Callable[[Positions], Band] | None = None
        if depths_mm is not None and self._moves:
            self._band = swept_band(rig, laser, depths_mm)
        elif depths_mm is not None:
            self._band = sheet_band(self._kernel, laser, size, depths_mm)
        self._map = None
        if content.covariance is not None:
            self._map = (SweptMap if self._moves else SigmaMap.create)(rig, name, content.covariance, laser.columns)
        # What boards have shown the detector's own prediction to be short of. Of what it exceeds there nothing is
        # taken off: black squares make it cautious, and other surfaces have none.
        self._ratio = np.float32(max(float(content.fit.get("stripe_sigma_ratio", 1.0)), 1.0))
        self._of_poses = PoseSigma.of(content)
        self._rig = rig
        thick = content.fit.get("sheet_sigma_mm", ())
        which = rig.lights.index(self._light)
        self._thickness_mm = float(thick[which]) if which < len(thick) else 0.0

    def range_image(self, frames: Frames, axes: Sequence[str], standing: bool = False) -> tuple[RangeImage, Stripe]:
        """Find the stripe in some frames and triangulate it; with the colours that the laser-off photographs show.

        Args:
            frames: photographs.
            axes: of their positions.
            standing: whether the object does not move, so that one laser-off photograph shows it for all frames.
        """
        count, size = len(frames.positions), len(frames.images)
        positions = np.pad(frames.positions, ((0, size - count), (0, 0)), mode="edge")
        q = dict(zip(axes, positions.T, strict=True))
        stripe = detect_stripe(
            frames.images,
            self._laser,
            frames.backgrounds,
            detector=self._detector,
            choice=self._choice,
            count=count,
            band=self._band(q) if callable(self._band) else self._band,
        )
        # Whatever follows keeps the buffer's size too.
        position, sigma, strength = (
            np.pad(x, ((0, size - count), (0, 0)), constant_values=np.nan)
            for x in (stripe.position, stripe.sigma, stripe.strength)
        )
        points = triangulate_stripes(
            self._kernel_at(q), FramePoses.create(self._rig.motion, q, size), position, self._laser.columns
        )
        found = self.with_sigma(position, sigma, strength, points, q)[:count, :]
        colours = None
        if frames.backgrounds is not None and (standing or frames.background is None):
            colours = own_colours(frames.backgrounds, stripe.position, columns=self._laser.columns)
        width = np.where(stripe.burnt, np.float32(np.nan), stripe.width)
        return replace(found, light=stripe.light, colours=colours, width=width), stripe

    def _kernel_at(self, q: Positions) -> Kernel:
        """The kernel with the light as it stands in some frames."""
        return self._kernel.with_lights(light_at(self._light, q)) if self._moves else self._kernel

    def frames_apart(self, two: Mapping[str, Int[np.ndarray, "2"]] | None) -> int:
        """How many frames before and behind one show the surface beside the sheet; 0 where it is taken to be thin.

        Args:
            two: positions of the axes at two frames, one after the other; None where there are none.
        """
        if two is None or not self._thickness_mm:
            return 0
        return frames_apart(self._rig, self._laser.name, self._thickness_mm, two)

    def middles(self, found: Iterator[Looked], apart: int) -> Iterator[Looked]:
        """The same in the middle of the sheet, which has a thickness."""
        if not apart:
            return found
        sheet = ThickSheet.create(self._rig, self._laser.name, self._thickness_mm, self._laser.columns)

        def light_of(q: Positions) -> tuple[ThickSheet, Kernel]:
            there = sheet.with_lights(light_at(self._light, q)) if self._moves else sheet
            return there, self._kernel_at(q)

        return middles(found, apart, light_of, self._rig.motion)

    def passages(
        self, geometry: Geometry, width: float, batches: Iterable[Frames], axes: Sequence[str]
    ) -> Iterator[tuple[RangeImage, None]]:
        """Find when the light passes over each point, `width` frames long, and where that is."""

        def frames_at(positions: Int[np.ndarray, "frames axes"]) -> FramePoses:
            return FramePoses.create(self._rig.motion, dict(zip(axes, positions.T, strict=True)), len(positions))

        for found in spacetime_profiles(geometry, width, self._laser, batches, self._detector, self._choice, frames_at):
            q = dict(zip(axes, found.positions.T, strict=True))
            yield self.with_sigma(found.position, found.sigma, found.strength, found.points, q), None

    def with_sigma(
        self,
        position: Float[np.ndarray, "frames lines"],
        stripe_sigma: Float[np.ndarray, "frames lines"],
        strength: Float[np.ndarray, "frames lines"],
        points: Float[np.ndarray, "frames lines 3"],
        q: dict[str, Int[np.ndarray, "frames"]],
    ) -> RangeImage:
        """Points with what is known of them."""
        valid: Bool[np.ndarray, "frames lines"] = np.all(np.isfinite(points), axis=-1)
        sigma = sigma_pixel = np.full(valid.shape, np.nan, np.float32)
        if self._map is not None:
            own, moved = self._ratio * stripe_sigma, MovedFrames.create(self._rig, q, len(position))
            maps = self._map.at(q)
            sigma, sigma_pixel = (np.asarray(x) for x in point_sigmas(maps, moved, position, points, own))
            if self._of_poses is not None:
                sigma = np.hypot(sigma, self._of_poses.along_rays(points, q))
        points = np.where(valid[..., None], points, np.float32(np.nan))
        return RangeImage(points, position, strength, sigma, sigma_pixel, valid, q, self._rig.motion, (self._light,))
