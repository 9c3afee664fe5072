"""The flat sheet of laser light, as a plane in dual space."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from jaxscan.errors import ObservabilityError
from jaxscan.geometry.robust_plane import planes_through, refined_plane
from jaxscan.geometry.rotation import A, namespace
from jaxscan.phrases import laser_prefix
from jaxscan.precision import Leaves
from jaxscan.rig.readable import Readable

# A sheet nearer to the centre of projection than this (mm) is seen edge on: its depth is lost in rounding.
_NEAREST = 1e-3
# Number of random triples; each trial is judged by this number of points: enough for a median.
_TRIALS = 500
_SAMPLE = 500


class LightPlane(Readable):
    """The points X of the camera frame with ω · X = 1; or a stack of such planes, whose numbers are arrays.

    Attributes:
        plane: the three components of ω, 1/mm.
        name: which laser of several this is; the only one needs none.
    """

    kind: ClassVar[str] = "plane"
    numbers: ClassVar[Mapping[str, int]] = {"plane": 3}
    units: ClassVar[Mapping[str, str]] = {"plane": "1/mm"}

    plane: tuple[Leaves, Leaves, Leaves]
    name: str = eqx.field(static=True, default="")

    @staticmethod
    def create(omega: ArrayLike | Sequence[float], name: str = "") -> "LightPlane":
        """A light plane from three numbers (1/mm)."""
        a, b, c = jnp.asarray(omega, dtype=float)
        return LightPlane((a, b, c), name)

    @classmethod
    def fitted(
        cls, points: Float[np.ndarray, "points 3"], view: Int[np.ndarray, "points"], name: str = ""
    ) -> "LightPlane":
        """The plane by least median of squares over random triples, then a fit. A triple needs two views, not one line.

        Raises:
            ObservabilityError: the points lie on one line, or on a plane through the camera's centre.
        """
        which = laser_prefix(name)
        omega = robust_plane(points, view)
        if np.isnan(omega).all():
            raise ObservabilityError(
                f"{which}the stripes of all views lie on one line, which does not make a plane: hold the board at "
                "different distances"
            )
        if not np.isfinite(omega).all() or np.linalg.norm(omega) > 1.0:
            raise ObservabilityError(
                f"{which}the stripes lie on a plane through the camera's centre, which cannot measure: move the laser "
                "to the side of the camera, or check that the stripe, not its reflection, is found"
            )
        return cls.create(omega, name)

    @classmethod
    def somewhere(cls, name: str = "") -> "LightPlane":
        """Across the view, half a metre away."""
        return cls.create((0.0, 0.0, 0.002), name)

    @property
    def omega(self) -> Float[Array, "3"]:
        """ω as one vector (1/mm)."""
        return jnp.stack(self.plane)

    def level(
        self, ray: Float[A, "*points 3"], inverse_depth: Float[A, "*points"] | float = 1.0
    ) -> Float[A, "*points"]:
        """ω · x − w, w the inverse depth."""
        return namespace(ray, self.plane[0]).asarray(self.inverse_depth(ray) - inverse_depth)

    def gradient(self, point: Float[A, "*points 3"]) -> Float[A, "*points 3"]:
        """ω."""
        xp = namespace(point, *self.plane)
        return xp.broadcast_to(xp.stack([xp.asarray(leaf) for leaf in self.plane], axis=-1), point.shape)

    def inverse_depth(self, ray: Float[A, "*rays 3"]) -> Float[A, "*rays"]:
        """ω · x."""
        a, b, c = self.plane
        # In brackets, each term is one instruction with the next.
        return namespace(ray, a).asarray(a * ray[..., 0] + (b * ray[..., 1] + c * ray[..., 2]))

    def fault(self, rays: Float[np.ndarray, "rays 3"]) -> tuple[str, str] | None:
        """A plane through the camera, or one that no pixel sees."""
        length = float(np.linalg.norm([float(leaf) for leaf in self.plane]))
        if length > 1 / _NEAREST:
            return "plane", (
                f"the light plane passes through the camera, {1 / length:.1g} mm from its centre: "
                "the laser must stand beside the camera; calibrate again, with the board tilted and at several "
                "distances"
            )
        if not np.any(np.asarray(self.inverse_depth(rays)) > 0):
            return "plane", (
                "no pixel sees the light plane (ω · x is nowhere positive, so the sheet lies behind the camera): "
                "check its sign; ω · X = 1 on the sheet, with z forward"
            )
        return None


def robust_plane(points: Float[np.ndarray, "points 3"], view: Int[np.ndarray, "points"]) -> Float[np.ndarray, "3"]:
    """The dual plane that most of the points lie on: least median of squares over random triples, then a fit.

    Args:
        points: stripe points in the camera frame, mm.
        view: which photograph each is from: a triple is drawn from two views, since one view's points lie on a line.

    Returns:
        ω, 1/mm; NaN where no three points span a plane, infinite where it holds the origin.
    """
    rng = np.random.default_rng(0)
    sample = points[rng.permutation(len(points))[:_SAMPLE]]
    # Two points of one view and one of another, for all trials at once: points sorted by view, drawn by their rank.
    order = np.argsort(view, kind="stable")
    views, first, count = np.unique(view[order], return_index=True, return_counts=True)
    one = rng.integers(len(views), size=_TRIALS)
    other = (one + rng.integers(1, len(views), size=_TRIALS)) % len(views)
    at = [first[view] + rng.integers(count[view]) for view in (one, one, other)]
    a, b, c = (points[order[i]] for i in at)
    centres, normals = planes_through(a, b, c)
    if not len(normals):
        return np.full(3, np.nan)
    score = np.median(np.abs(sample @ normals.T - (centres * normals).sum(axis=1)), axis=0)
    least = int(np.argmin(score))
    centre, normal = refined_plane(points, centres[least], normals[least])
    with np.errstate(divide="ignore", invalid="ignore"):
        return normal / (normal @ centre)
