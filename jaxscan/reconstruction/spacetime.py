"""Spacetime analysis: the light's passage over each point of the surface, in time rather than across the image.

A detector that looks for the middle of a stripe in one frame takes for granted that the surface reflects alike on both
sides of it and goes on to both sides of it. Where it does not, at the border of a print or of the object, the middle is
off. B. Curless and M. Levoy (1995) look along time instead. Let a point P of the object (object frame) be carried by
the stage, X(n) = P + n p with p its way for one motor step, at motor step n. Its distance from the sheet is

    d(n) = (ω · X(n) − 1) / |ω| = (ω · P − 1 + n ω · p) / |ω|

and so the light that it sends back, ρ exp(−d² / 2 σ²), is a Gaussian in n of standard deviation σ |ω| / |ω · p|, whose
centre n₀ = (1 − ω · P) / (ω · p) depends neither on its reflectance ρ nor on what lies beside it.

Camera and sheet are fixed to each other, the object moves; so a point of it is not seen by one pixel. In the slice of
spacetime that a line of the image sweeps out it draws a slanted track, which Curless and Levoy turn upright by
resampling the slice bilinearly. The slant is known: whatever crosses the sheet at pixel q does so at the one point
X(q) = x / (ω · x) that q, with ray x, sees of the sheet, and is seen m motor steps later at

    q(m) = π(X(q) + m p),

π the camera. Frames are taken as they are, and in each the pixels about the track are interpolated, with a cubic across
the stripe, which blurs less than a bilinear one. A frame's own stripe leads to the tracks: where a detector finds it,
biased or not, some point of the surface is near the sheet, and its track is looked along. The centre of what is seen
there, δ frames off, gives the point

    P = X(q(δ)) − (n + δ Δn) p,    Δn the motor steps from frame to frame.

Of an object that turns under the light the same holds for the time in which a point passes it: the track is
q(m) = π(M_m X(q)), M_m the motion of m frames, which is the same from any frame on where one axis moves in equal steps.

A second look starts at q(δ) in place of q, so that the points stand where the surface crosses the sheet at frame n and
not where the stripe was thought to be. X(q) is taken to be on the sheet though its pixel was off by some part of the
stripe's width: as long as that is narrow for the depth, the slant of tracks hardly differs across it.

The frames at either end of a scan, whose passages are not seen whole, have no points; a turn that closes has no ends.

What is left of an error at an edge is the light that lens and pixels let in from beyond it. It counts little where the
sheet is seen some pixels wide.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxscan.detectors import Choice, Detector
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripes.detectors import Measured, measure
from jaxscan.images.stripes.surroundings import ambient_levels
from jaxscan.images.stripes.survey import LEAST_SIGNAL
from jaxscan.images.stripes.tracks import Tracks, gather_passage, number_scale, passage_windows, survey_passage
from jaxscan.kept_programs import compiled
from jaxscan.reconstruction.frames import Frames
from jaxscan.reconstruction.overlapping import overlapping
from jaxscan.reconstruction.triangulate import FramePoses, Kernel, triangulate
from jaxscan.rig import Camera, Motion, Rig
from jaxscan.rig.motion import carried as carried_by_motion

Lines = Float[Array, "frames lines"]
# The poses of frames at positions of the axes.
FramesAt = Callable[[Int[np.ndarray, "frames axes"]], FramePoses]

# How the stripe is found from which tracks start, and how the first look along them is taken.
_START: Detector = "gravity"
# How many frames to either side are looked at: this number of standard deviations of the passage plus a margin, so
# that the detectors see what is beside the light; and the least.
_REACH, _MARGIN, _LEAST_HALF = 4.0, 4, 8
# Tracks whose light passes further off than this, in standard deviations, are another stripe's.
_FARTHEST = 4.0
# Number of lines of a frame from which its noise is estimated.
_SURVEYED = 96
_BATCH = 16


class Profiles(NamedTuple):
    """Points of some frames, one for each line: the surface where it crosses the sheet about the time of the frame.

    Attributes:
        position: where it does so: v of each column (or u of each row), px; NaN for none.
        sigma: that of the position whose error would displace the point as much as that of the centre in time, px.
        strength: of the light in time, grey levels of its response.
        points: mm, object frame; NaN for none.
        positions: of the axes at each frame, motor steps.
    """

    position: Float[np.ndarray, "frames lines"]
    sigma: Float[np.ndarray, "frames lines"]
    strength: Float[np.ndarray, "frames lines"]
    points: Float[np.ndarray, "frames lines 3"]
    positions: Int[np.ndarray, "frames axes"]


class Geometry(eqx.Module):
    """The rig as tracks need it, in float32.

    Attributes:
        kernel: of the laser.
        camera: where points are seen.
        motion: of the object.
        still: positions of the axes that stand still.
        per_frame: motor steps of the axis that moves from one frame to the next.
        axis: its name.
        columns: whether lines are columns of the image.
    """

    kernel: Kernel
    camera: Camera
    motion: Motion
    still: dict[str, Float[Array, ""]]
    per_frame: Float[Array, ""]
    axis: str = eqx.field(static=True)
    columns: bool = eqx.field(static=True)

    @staticmethod
    def create(rig: Rig, settings: StripeSettings, axis: str, per_frame: int, still: Mapping[str, int]) -> "Geometry":
        """The rig made ready.

        Args:
            rig: the rig.
            settings: the laser.
            axis: the one that moves.
            per_frame: its motor steps from one frame to the next.
            still: where the others stand.

        Raises:
            InputError: the rig has no such axis or no such laser.
        """
        rig.axis(axis)
        kernel = Kernel.create(rig, settings.name)
        others = {name: step for name, step in still.items() if name != axis}
        given = (rig.camera, rig.motion, others, per_frame)
        camera, motion, others, step = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), given)
        return Geometry(kernel, camera, motion, others, step, axis, settings.columns)

    def later(self, frames: Float[Array, "*some"]) -> tuple[Float[Array, "*some 3 3"], Float[Array, "*some 3"]]:
        """The motion over a number of frames, in the camera's frame: R and t (mm)."""
        still = {axis: jnp.broadcast_to(step, frames.shape) for axis, step in self.still.items()}
        then, now = {**self.still, self.axis: jnp.zeros(())}, {**still, self.axis: self.per_frame * frames}
        return carried_by_motion(self.motion, now, then, Pose.from_vector(jnp.zeros(6, jnp.float32)))

    def pixels(self, position: Lines) -> tuple[Lines, Lines]:
        """(u, v) of a position in each line."""
        line = jnp.broadcast_to(jnp.arange(position.shape[1], dtype=jnp.float32), position.shape)
        return (line, position) if self.columns else (position, line)

    def across(self, u: Lines, v: Lines) -> Lines:
        """The position in its line of each pixel."""
        return v if self.columns else u


def spacetime_profiles(
    geometry: Geometry,
    sigma: float,
    settings: StripeSettings,
    batches: Iterable[Frames],
    detector: Detector,
    choice: Choice,
    frames_at: FramesAt,
) -> Iterator[Profiles]:
    """The surface of a scan whose object moves under the light in small, equal steps.

    Args:
        geometry: of the rig.
        sigma: about what standard deviation in frames the light's passage over a point has (`spacetime_geometry`).
        settings: the laser.
        batches: the scan's frames in their order, of any size: the points do not depend on it.
        detector: how the centre in time is measured.
        choice: which stripe is followed where a line has several.
        frames_at: the poses of frames at positions of the axes.

    Raises:
        InputError: there are too few frames.
    """
    half, frames = half_window(sigma), 0
    for batch in overlapping(batches, half, half, _BATCH):
        count = batch.inner.stop - batch.inner.start
        # The last batch is filled up with its last frame, so that it compiles nothing again.
        some = batch.inner.start + np.minimum(np.arange(_BATCH), count - 1)
        yield Profiles(
            *(x[:count] for x in _profiles(geometry, settings, batch, some, sigma, detector, choice, frames_at))
        )
        frames += count
    if frames <= 2 * half:
        raise InputError(
            f"{frames} frames: spacetime analysis looks at {2 * half + 1} together: scan further, or reconstruct "
            "without it"
        )


def half_window(sigma: float) -> int:
    """How many frames to either side of one are looked at, for a passage of standard deviation `sigma`, frames."""
    return max(int(np.ceil(_REACH * sigma)) + _MARGIN, _LEAST_HALF)


def _profiles(
    geometry: Geometry,
    settings: StripeSettings,
    batch: Frames,
    some: Int[np.ndarray, "frames"],
    sigma: float,
    detector: Detector,
    choice: Choice,
    frames_at: FramesAt,
) -> Profiles:
    own = batch.background is None
    dark = batch.backgrounds[some] if own and batch.backgrounds is not None else batch.backgrounds
    stripe = detect_stripe(batch.images[some], settings, dark, detector=_START, choice=choice)
    scale = number_scale(batch.images.dtype)
    ambient = jnp.asarray(scale * ambient_levels(batch.images[some], dark, settings.color))
    surveyed = jnp.asarray(_some_lines(stripe.valid))
    images, grounds = jax.device_put((batch.images, batch.backgrounds))
    half, farthest = half_window(sigma), _FARTHEST * sigma
    window = some[:, None] + np.arange(-half, half + 1)
    within = (window >= 0) & (window < len(batch.positions))
    frame = jnp.asarray(window.clip(0, len(batch.positions) - 1), jnp.int32)
    begin = jnp.full(stripe.valid.shape, -half, jnp.int32)
    group = jnp.broadcast_to(jnp.arange(len(some), dtype=jnp.int32)[:, None], stripe.valid.shape)

    def look(u: Lines, v: Lines, which: Detector) -> tuple[Measured, Float[Array, "frames 1"]]:
        """The passage of light along the tracks through these pixels, and how much it must stand out."""
        tracks = Tracks(frame, *_track(geometry, u, v, half))
        lit = gather_passage(images, tracks, geometry.columns)
        dark_tracks = tracks if own else tracks.of_one_frame()
        unlit = None if grounds is None else gather_passage(grounds, dark_tracks, geometry.columns)
        sensor = survey_passage(lit, unlit, surveyed, ambient, settings.color)
        windows = passage_windows(lit, unlit, sensor, group, begin, settings.color)
        seen = measure(windows, sensor, group, which)
        if which == "likelihood" and bool(seen.burnt.any()):
            full = measure(windows, sensor, group, which, "censored")
            seen = jax.tree.map(lambda new, old: jnp.where(seen.burnt, new, old), full, seen)
        return seen, LEAST_SIGNAL * sensor.ground[:, None]

    u, v = geometry.pixels(jnp.where(stripe.valid, stripe.position, 0.0))
    seen, _ = look(u, v, _START)
    u, v = carried(geometry, u, v, _believed(seen, farthest))
    seen, least = look(u, v, detector)
    u, v = carried(geometry, u, v, _believed(seen, farthest))
    columns, rows = geometry.camera.image_size
    valid = stripe.valid & seen.whole & (jnp.abs(seen.position) < farthest) & (seen.strength > least)
    valid &= (u >= -0.5) & (u <= columns - 0.5) & (v >= -0.5) & (v <= rows - 0.5)
    valid &= jnp.asarray(within.all(axis=1))[:, None]
    points, pixels_per_frame = _points(geometry, frames_at(batch.positions[some]), u, v, seen.position)
    return Profiles(
        np.asarray(jnp.where(valid, geometry.across(u, v), jnp.nan)),
        np.asarray(jnp.where(valid, seen.sigma * pixels_per_frame, jnp.nan)),
        np.asarray(seen.strength / scale),
        np.asarray(jnp.where(valid[..., None], points, jnp.nan)),
        batch.positions[some],
    )


def _some_lines(valid: Bool[np.ndarray, "frames lines"]) -> Int[np.ndarray, "frames some"]:
    """Lines of each frame that have a stripe, evenly spread; any lines where none has."""
    lines = valid.shape[1]
    which = [np.flatnonzero(row) if row.any() else np.arange(lines) for row in valid]
    count = min(_SURVEYED, lines)
    return np.stack([each[np.linspace(0, len(each) - 1, count).astype(np.int32)] for each in which]).astype(np.int32)


def _believed(seen: Measured, farthest: float) -> Lines:
    return jnp.where(seen.whole, jnp.clip(seen.position, -farthest, farthest), 0.0)


@compiled()
def carried(geometry: Geometry, u: Lines, v: Lines, frames: Lines | Float[Array, ""]) -> tuple[Lines, Lines]:
    """q(m): where what crosses the sheet at pixel (u, v) is seen `frames` frames later."""
    R, t = geometry.later(jnp.broadcast_to(frames, u.shape))
    q = jax.vmap(jax.vmap(geometry.camera.project))((R @ _on_sheet(geometry, u, v)[..., None])[..., 0] + t)
    return q[..., 0], q[..., 1]


@compiled(static_argnames="half")
def _track(
    geometry: Geometry, u: Lines, v: Lines, half: int
) -> tuple[Float[Array, "frames window lines"], Float[Array, "frames window lines"]]:
    """The track through each pixel, for `half` frames to either side."""
    R, t = geometry.later(jnp.arange(-half, half + 1, dtype=jnp.float32))
    moved = jnp.einsum("wij,flj->fwli", R, _on_sheet(geometry, u, v)) + t[None, :, None]
    q = jax.vmap(jax.vmap(jax.vmap(geometry.camera.project)))(moved)
    return q[..., 0], q[..., 1]


def _on_sheet(geometry: Geometry, u: Lines, v: Lines) -> Float[Array, "frames lines 3"]:
    """X(q), mm, camera frame."""
    still = FramePoses(jnp.tile(jnp.eye(3, dtype=u.dtype), (len(u), 1, 1)), jnp.zeros((len(u), 3), u.dtype))
    return triangulate(geometry.kernel, still, u, v)


@compiled()
def _points(
    geometry: Geometry, frames: FramePoses, u: Lines, v: Lines, after: Lines
) -> tuple[Float[Array, "frames lines 3"], Lines]:
    """Points of the object frame, and by how many pixels a stripe would be off for one frame.

    The light of a point P that is thought to pass dn frames later puts it on the same ray where that meets the sheet
    later, (g · p) / (g · d) dn further along the ray's direction d, with g the sheet's normal and p the way of P in a
    frame; a stripe ds pixels off does so by d · ∂X / ∂s ds.
    """
    X, position = _on_sheet(geometry, u, v), geometry.across(u, v)
    R, t = geometry.later(after)
    at_frame = (R.swapaxes(-1, -2) @ (X - t)[..., None])[..., 0]
    points = jnp.einsum("fij,flj->fli", frames.A, at_frame) + frames.b[:, None]
    ends = [(u, position + h) if geometry.columns else (position + h, v) for h in (-0.5, 0.5)]
    along = _on_sheet(geometry, *ends[1]) - _on_sheet(geometry, *ends[0])
    norm = jnp.linalg.norm(X, axis=-1)
    light = jax.tree.map(lambda leaf: leaf[0], geometry.kernel.light)
    one = jnp.ones(())
    (_, _), (dR, dt) = jax.jvp(geometry.later, (0 * one,), (one,))
    way, g = X @ dR.T + dt[None, None], light.gradient(X)
    by_frame = jnp.abs((g * way).sum(-1) / (g * X).sum(-1)) * norm
    return points, by_frame / jnp.abs((along * X).sum(-1) / norm)
