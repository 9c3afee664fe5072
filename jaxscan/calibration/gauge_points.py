"""From scans of gauges to `GaugePoints`: nearest points of their shapes, and which stripe points can be used."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from jaxscan.buckets import bucket
from jaxscan.calibration.gauge_residuals import GaugePoints, gauge_errors, points_of_object
from jaxscan.calibration.gauge_shapes import Shape, Steps
from jaxscan.geometry import Pose
from jaxscan.kept_programs import compiled
from jaxscan.rig import Rig, System

# A surface seen at less than this angle to the way the stripe moves on it says nothing of where it is.
_GRAZING: Final = np.sin(np.radians(12.0))
# A nearest point that is further to the side than this is on an edge, mm.
_ASIDE_MM: Final = 1e-3


@dataclass(frozen=True)
class GaugeScan:
    """The stripe in the frames of a scan of a gauge.

    Attributes:
        pixels: where it was seen: v for each image column, or u for each row; NaN for none.
        positions: motor steps of each axis at each frame.
        columns: whether v was measured, or u.
        laser: the laser's name, "" for the only one.
    """

    pixels: Float[np.ndarray, "frames columns"]
    positions: Mapping[str, Real[np.ndarray, "frames"]]
    columns: bool = True
    laser: str = ""


@dataclass(frozen=True)
class Gauge:
    """An object of known shape in one place.

    Attributes:
        scan: what was seen of it there.
        shape: what it is.
    """

    scan: GaugeScan
    shape: Shape


def stripe_points(gauges: Sequence[Gauge], rig: Rig) -> GaugePoints:
    """All stripe points, one padded block a scan, with nothing known yet of where they lie on the gauges."""
    size = bucket(max(gauge.scan.pixels.size for gauge in gauges))
    names = [light.name for light in rig.lights]
    stripe = np.full((len(gauges), size, 2), np.nan)
    axes = sorted({axis for gauge in gauges for axis in gauge.scan.positions})
    q = {axis: np.zeros((len(gauges), size)) for axis in axes}
    for i, gauge in enumerate(gauges):
        scan = gauge.scan
        index = np.broadcast_to(np.arange(scan.pixels.shape[1], dtype=float), scan.pixels.shape)
        pixels = np.stack([index, scan.pixels] if scan.columns else [scan.pixels, index], axis=-1)
        stripe[i, : scan.pixels.size] = pixels.reshape(-1, 2)
        for axis, steps in scan.positions.items():
            # Padding stands with the last frame, so that it begins none.
            each = np.repeat(np.asarray(steps, float), scan.pixels.shape[1])
            q[axis][i] = np.pad(each, (0, size - scan.pixels.size), mode="edge")

    def of_scans(values: list) -> Array:
        return jnp.asarray(np.broadcast_to(np.array(values)[:, None], stripe.shape[:2]))

    return GaugePoints(
        stripe=jnp.asarray(stripe),
        columns=of_scans([gauge.scan.columns for gauge in gauges]),
        q={axis: jnp.asarray(steps) for axis, steps in q.items()},
        light=of_scans([names.index(rig.light(gauge.scan.laser).name) for gauge in gauges]),
        surface=jnp.zeros((*stripe.shape[:2], 3)),
        normals=jnp.zeros((*stripe.shape[:2], 3)).at[..., 2].set(1.0),
        used=jnp.asarray(np.isfinite(stripe).all(axis=-1)),
        weights=jnp.ones(stripe.shape[:2]),
        laid=jnp.zeros((len(gauges), 6)),
        laid_to=jnp.ones((len(gauges), 6)),
    )


def facing(gauges: Sequence[Gauge], system: System, seen: GaugePoints) -> GaugePoints:
    """The points with the nearest ones of the shapes and the normals there; and which of them can be used.

    A point whose nearest one is on an edge is off to the side of the shape; a face turned from the camera is not what
    was seen; and where the surface lies nearly along the way on which the stripe moves, it may be anywhere on it.
    """
    rig = system.rig
    points, along = (np.asarray(a) for a in on_object(rig, seen))
    surface, normals, used = np.array(seen.surface), np.array(seen.normals), np.zeros(seen.used.shape, bool)
    # From the camera, as the object sees it.
    rays = points - np.asarray(rig.pose(seen.q).inverse().translation)
    for i, gauge in enumerate(gauges):
        local, at = _in_gauge(system, points, seen, i)
        on, m = gauge.shape.nearest(local)
        away = local - on
        aside = np.linalg.norm(away - (away * m).sum(axis=1, keepdims=True) * m, axis=1)
        outwards = m @ _pose(system, i).matrix().T
        slope = np.abs((outwards * along[i, at]).sum(axis=1)) / np.linalg.norm(along[i, at], axis=1)
        towards = (outwards * rays[i, at]).sum(axis=1) < 0
        surface[i, at], normals[i, at] = on, m
        used[i, at] = (aside <= _ASIDE_MM) & towards & (slope >= _GRAZING)
    return eqx.tree_at(
        lambda s: (s.surface, s.normals, s.used),
        seen,
        (jnp.asarray(surface), jnp.asarray(normals), jnp.asarray(used)),
    )


def distances(gauges: Sequence[Gauge], system: System, seen: GaugePoints) -> Float[np.ndarray, "scans points"]:
    """Distances of the stripe points from the surfaces, mm; NaN where there is no stripe."""
    points = np.asarray(on_object(system.rig, seen)[0])
    found = np.full(seen.used.shape, np.nan)
    for i, gauge in enumerate(gauges):
        local, at = _in_gauge(system, points, seen, i)
        found[i, at] = np.linalg.norm(local - gauge.shape.nearest(local)[0], axis=1)
    return found


@dataclass(frozen=True)
class Level:
    """How a level face of a gauge reads.

    Attributes:
        known_mm: its height above the lowest level that is seen, as it is known to be.
        read_mm: as it reads, the median of its points; NaN where it has none.
        points: how many it has.
    """

    known_mm: float
    read_mm: float
    points: int


def levels_read(gauge: Gauge, system: System, scans: GaugePoints, i: int) -> tuple[Level, ...]:
    """How the levels above the lowest read; none of a shape without levels.

    Args:
        gauge: that of scan `i`.
        system: with the pose of the gauge.
        scans: the points, those alone in use that lie on the gauge.
        i: which scan.
    """
    if not isinstance(gauge.shape, Steps):
        return ()
    local, _ = _in_gauge(system, np.asarray(on_object(system.rig, scans)[0]), scans, i)
    z, level = local[:, 2], gauge.shape.nearest(local)[0][:, 2]
    lowest = level.min()
    foot = np.median(z[level == lowest])
    above = [(float(height - lowest), z[level == height]) for height in gauge.shape.heights if height > lowest]
    return tuple(Level(h, float(np.median(its) - foot) if its.size else np.nan, its.size) for h, its in above)


def _in_gauge(
    system: System, points: Float[np.ndarray, "scans points 3"], seen: GaugePoints, i: int
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "n"]]:
    """The points of a scan where a stripe is, in the gauge's frame (mm), and which they are."""
    at = np.flatnonzero(np.asarray(seen.used[i]) & np.isfinite(points[i]).all(axis=1))
    return _pose(system, i).inverse().apply(points[i, at]), at


def _pose(system: System, i: int) -> Pose[np.ndarray]:
    """T_object_gauge of a scan."""
    return Pose.from_vector(np.asarray(system.poses[-1][i]))


@compiled(filtered=True)
def on_object(rig: Rig, seen: GaugePoints) -> tuple[Float[Array, "scans points 3"], Float[Array, "scans points 3"]]:
    """The points of the object frame, mm, and how they move with the stripe, mm a pixel."""
    return jax.vmap(lambda scan: points_of_object(rig, scan, scan.stripe))(seen)


@compiled(filtered=True)
def errors(system: System, scans: GaugePoints) -> tuple[Float[Array, "scans points"], Float[Array, "scans points"]]:
    """`gauge_errors` of every scan."""
    rig = system.rig
    return jax.vmap(lambda pose, scan: gauge_errors(rig, pose, scan))(system.poses[-1], scans)
