"""A sheet of laser light that is curved across its fan.

A cylinder lens keeps the part of each ray's direction along its axis. If the beam is not square to that axis by τ, all
rays make the angle 90° − τ with it: they lie on a shallow cone whose apex is the laser's line of light. At the distance
e from the apex and f across the fan it leaves the plane that touches it in the fan's middle by

    √(e² + f²) tan τ − e tan τ ≈ f² τ / 2e:

curved across the fan, straight along each ray, in proportion to the distance at a given angle of the fan. A Powell lens
whose beam is off its middle does the same to second order.

The apex itself does not show at bows of a millimetre. It is taken to be beside the camera, in the plane of its centre:
where the laser of a scanner is, more or less. Then e is in proportion to the depth z, f to the camera's own coordinate
along the stripe, and the inverse depth is a polynomial of the ray. What an apex elsewhere changes goes into the plane,
but for a few hundredths of the bow (docs/decisions/0026).
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Int

from jaxscan.geometry.rotation import A, namespace
from jaxscan.precision import Leaf
from jaxscan.rig.light_plane import LightPlane
from jaxscan.rig.readable import Readable

# Rays that leave a cylinder lens on a steeper cone (radians) are of no line laser: 11°.
_STEEPEST = 0.2


class BowedSheet(Readable):
    """The points X = x z of the camera frame, x = (x, y, 1), with ω · x + b (ω₂ x − ω₁ y)² = 1 / z; none behind it.

    At ± f along the stripe and at depth z it is b (ω₁² + ω₂²) f² / (z |ω|) nearer to the camera than its plane, and the
    cone's slope τ is 2 b √(ω₁² + ω₂²). If it is turned about the camera's axis, the bow stays the same.

    Attributes:
        plane: ω of the plane that touches it, 1/mm.
        bow: b, mm.
        name: which laser of several this is; the only one needs none.
    """

    kind: ClassVar[str] = "bowed"
    numbers: ClassVar[Mapping[str, int]] = {"plane": 3, "bow": 1}
    units: ClassVar[Mapping[str, str]] = {"plane": "1/mm", "bow": "mm"}

    plane: tuple[Leaf, Leaf, Leaf]
    bow: tuple[Leaf]
    name: str = eqx.field(static=True, default="")

    @staticmethod
    def create(omega: ArrayLike | Sequence[float], bow: ArrayLike, name: str = "") -> "BowedSheet":
        """From the plane's three numbers (1/mm) and b (mm)."""
        return BowedSheet(LightPlane.create(omega).plane, (jnp.asarray(bow, dtype=float),), name)

    @staticmethod
    def unbowed(sheet: LightPlane) -> "BowedSheet":
        """The same sheet as one whose bow is 0."""
        return BowedSheet(sheet.plane, (jnp.zeros(()),), sheet.name)

    @staticmethod
    def curved(
        omega: ArrayLike | Sequence[float], sag_mm: float, half_width_mm: float, depth_mm: float, name: str = ""
    ) -> "BowedSheet":
        """From its sag (mm, positive towards the camera) at ± `half_width_mm` along the stripe, at `depth_mm`."""
        unbowed = BowedSheet.create(omega, 0.0, name)
        return BowedSheet.create(omega, sag_mm / unbowed.of_bow(half_width_mm, depth_mm), name)

    @classmethod
    def fitted(
        cls, points: Float[np.ndarray, "points 3"], view: Int[np.ndarray, "points"], name: str = ""
    ) -> "BowedSheet":
        """A flat one, from which the solve finds the bow.

        Raises:
            ObservabilityError: the points lie on one line, or on a plane through the camera's centre.
        """
        return cls.unbowed(LightPlane.fitted(points, view, name))

    @classmethod
    def somewhere(cls, name: str = "") -> "BowedSheet":
        """Across the view, half a metre away."""
        return cls.unbowed(LightPlane.somewhere(name))

    def sag(self, half_width_mm: float, depth_mm: float) -> float:
        """Distance from its plane at ± `half_width_mm` along the stripe, at `depth_mm`; mm, positive to the camera."""
        return float(self.bow[0]) * self.of_bow(half_width_mm, depth_mm)

    def level(
        self, ray: Float[A, "*points 3"], inverse_depth: Float[A, "*points"] | float = 1.0
    ) -> Float[A, "*points"]:
        """ω · x − w + b (ω₂ x − ω₁ y)² / x₃, w the inverse depth; beside the camera, where x₃ is 0, its plane's."""
        bent = self.bow[0] * (self._along(ray) * self._slant(ray))
        return namespace(ray, self.bow[0]).asarray(LightPlane(self.plane).level(ray, inverse_depth) + bent)

    def gradient(self, point: Float[A, "*points 3"]) -> Float[A, "*points 3"]:
        """Gradient of the level; beside the camera, where the depth is 0, that of the plane."""
        slant = self._slant(point)
        steep = 2 * self.bow[0] * slant
        bent = [steep * self.plane[1], -steep * self.plane[0], -self.bow[0] * slant * slant]
        bent = namespace(point, *self.plane).stack(bent, axis=-1)
        return LightPlane(self.plane).gradient(point) + bent

    def inverse_depth(self, ray: Float[A, "*rays 3"]) -> Float[A, "*rays"]:
        """ω · x + b (ω₂ x − ω₁ y)² / x₃; 0 where x₃ is not positive: the light comes from there."""
        xp = namespace(ray, self.bow[0])
        bent = LightPlane(self.plane).inverse_depth(ray) + self.bow[0] * self.by_bow(ray)
        return xp.where(ray[..., 2] > 0, bent, 0.0)

    def by_bow(self, ray: Float[A, "*rays 3"]) -> Float[A, "*rays"]:
        """The derivative of the inverse depth by b, 1/mm²: (ω₂ x − ω₁ y)² / x₃."""
        return namespace(ray, self.bow[0]).asarray(self._along(ray) * self._slant(ray))

    def fault(self, rays: Float[np.ndarray, "rays 3"]) -> tuple[str, str] | None:
        """A plane through the camera, one that no pixel sees, or a bow that no laser has."""
        slope = abs(2 * float(self.bow[0]) * float(np.hypot(float(self.plane[0]), float(self.plane[1]))))
        if not slope < _STEEPEST:
            return "bow", (
                f"the sheet lies on a cone of slope {slope:.2g}, which no line laser makes, {_STEEPEST:g} at most: "
                "calibrate again, with long stripes at several distances, or with a flat sheet"
            )
        return LightPlane(self.plane).fault(rays)

    def _along(self, ray: Float[A, "*rays 3"]) -> Float[A, "*rays"]:
        """The coordinate along the stripe on a board that faces the camera, in units of |(ω₁, ω₂)|."""
        return namespace(ray, self.plane[0]).asarray(self.plane[1] * ray[..., 0] - self.plane[0] * ray[..., 1])

    def _slant(self, ray: Float[A, "*rays 3"]) -> Float[A, "*rays"]:
        """The same over the depth; 0 where that is 0."""
        xp, z = namespace(ray, self.plane[0]), ray[..., 2]
        return xp.where(z == 0, 0.0, self._along(ray) / xp.where(z == 0, 1.0, z))

    def of_bow(self, half_width_mm: float, depth_mm: float) -> float:
        """Mm of `sag` for each mm of b."""
        a, b, c = (float(leaf) for leaf in self.plane)
        return (a * a + b * b) * half_width_mm**2 / (depth_mm * float(np.sqrt(a * a + b * b + c * c)))
