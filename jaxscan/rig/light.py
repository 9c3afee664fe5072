"""The light: a surface in the camera frame, of which each pixel's ray meets one point.

Which kinds there are is listed in `rig.kinds`. What a kind says of itself is its level and the inverse depth along a
ray; all else that is asked of a sheet, in residuals, pictures and reports, is made of these here.
"""

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Protocol, TypeGuard, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Float, Float64, Int, Real

from jaxscan.geometry.rotation import A, namespace
from jaxscan.kept_programs import compiled
from jaxscan.precision import Leaf, as_float64, as_numpy, batches_of, float64

# Newton's steps onto a sheet that is not flat; a flat one takes one.
_STEPS = 5


@runtime_checkable
class Light(Protocol):
    """A sheet of light. A pytree whose leaves are its numbers. NumPy's arrays in, NumPy's out.

    Attributes:
        kind: what the rig file calls it.
        numbers: its numbers in their order, and how many each has.
        name: which laser of several this is; the only one needs none.
    """

    kind: ClassVar[str]
    numbers: ClassVar[Mapping[str, int]]
    name: str

    @classmethod
    def fitted(cls, points: Float[np.ndarray, "points 3"], view: Int[np.ndarray, "points"], name: str = "") -> "Light":
        """A start for a solve: the light that most of these points (camera frame, mm) lie on.

        Args:
            points: on boards that the stripe crossed.
            view: which photograph each is from.
            name: the light's.

        Raises:
            ObservabilityError: the points do not make such a light.
        """
        ...

    @classmethod
    def somewhere(cls, name: str = "") -> "Light":
        """One across the view: what a solve holds while nothing is known of the light."""
        ...

    def level(
        self, ray: Float[A, "*points 3"], inverse_depth: Float[A, "*points"] | float = 1.0
    ) -> Float[A, "*points"]:
        """Level of the point ray / inverse depth, times the inverse depth, in any scale.

        0 on the sheet, negative on the camera's side of it. With the inverse depth 1 that of the point `ray` itself.
        """
        ...

    def gradient(self, point: Float[A, "*points 3"]) -> Float[A, "*points 3"]:
        """Gradient of the level, which is normal to the sheet."""
        ...

    def inverse_depth(self, ray: Float[A, "*rays 3"]) -> Float[A, "*rays"]:
        """1 / t of the point t ray at which a ray meets the sheet, 1/mm; not positive where it does not.

        Of a ray (x, y, 1) that is 1 / z, and so it is called; any other length is as good.
        """
        ...

    def fault(self, rays: Float[np.ndarray, "rays 3"]) -> tuple[str, str] | None:
        """What is wrong with it for a camera with these rays: the number's name, and the fault with its fix."""
        ...


@runtime_checkable
class MovingLight(Light, Protocol):
    """A light that an axis of its own moves. Asked without a position, it stands in the middle of its travel.

    Attributes:
        axis: the name of its axis.
        middle: of its travel, motor steps; one of its numbers, which is given.
    """

    axis: str
    middle: tuple[Leaf]

    @classmethod
    def fitted(
        cls,
        points: Float[np.ndarray, "points 3"],
        view: Int[np.ndarray, "points"],
        name: str = "",
        positions: Float[np.ndarray, "points"] | None = None,
        axis: str = "",
    ) -> "MovingLight":
        """As `Light.fitted`, with the position of its axis, motor steps, at which each point was seen."""
        ...

    def at(self, position: ArrayLike) -> Light:
        """The light at positions of its axis, motor steps: one, or a stack of them."""
        ...

    def direction(self) -> Float[np.ndarray, "3"]:
        """Unit vector of its travel, or of its axis."""
        ...

    def amount(self, steps: float) -> tuple[float, str]:
        """How far `steps` motor steps move it, and the unit: mm or degrees."""
        ...


def moves(kind: type[Any]) -> TypeGuard[type[MovingLight]]:
    """Whether lights of a kind are moved by an axis of their own."""
    return hasattr(kind, "at")


def stood(light: Light, position: ArrayLike) -> Light:
    """A light where it stands at positions of the axis that moves it, motor steps; itself where none does."""
    return light.at(position) if isinstance(light, MovingLight) else light


def in_the_middle(light: Light) -> Light:
    """A light where it stands in the middle of its travel; itself where nothing moves it."""
    return light.at(np.float64(light.middle[0])) if isinstance(light, MovingLight) else light


def light_at(light: Light, q: Mapping[str, Any]) -> Light:
    """A light where it stands at positions of the axes, motor steps; itself where its axis is not named."""
    return light.at(q[light.axis]) if isinstance(light, MovingLight) and light.axis in q else light


def meet(light: Light, ray: Float[Array, "3"]) -> Float[Array, "3"]:
    """Where a camera ray meets the sheet (mm); NaN where it does not."""
    inverse_depth = light.inverse_depth(ray)
    meets = inverse_depth > 0
    return jnp.where(meets, ray / jnp.where(meets, inverse_depth, 1.0), jnp.nan)


def distance(light: Light, points: Float[A, "*points 3"]) -> Float[A, "*points"]:
    """Distance of points from the sheet, to first order, mm; negative on the camera's side of it."""
    xp = namespace(points)
    light = as_numpy(light) if xp is np else light
    return light.level(points) / xp.linalg.norm(light.gradient(points), axis=-1)


def laser_place(sheet: Light) -> Float[np.ndarray, "3"]:
    """Where a laser is taken to stand: where its sheet meets the camera's u or v axis, the nearer one, mm."""
    gradient = np.asarray(sheet.gradient(np.zeros(3)), np.float64)
    level = float(np.asarray(sheet.level(np.zeros(3))))
    axis = int(np.argmax(np.abs(gradient[:2])))
    place = np.zeros(3)
    place[axis] = -level / gradient[axis]
    return place


def sheet_axes(light: Light) -> Float[np.ndarray, "3 3"]:
    """Unit vectors: along the stripe on a board that faces the camera, the light's way, the sheet's normal.

    Of a sheet that is not flat, those where it is nearest to the camera.
    """
    normal = np.asarray(light.gradient(np.zeros(3)), np.float64)
    normal = normal / np.linalg.norm(normal)
    along = np.cross(normal, [0.0, 0.0, 1.0])
    along /= np.linalg.norm(along)
    return np.stack([along, np.cross(along, normal), normal])


def section(
    light: Light, depths: Float[np.ndarray, "depths"], positions: Float[np.ndarray, "positions"]
) -> Float[np.ndarray, "depths positions 3"]:
    """The points of the sheet at each depth and at each place along the stripe there, camera frame, mm."""
    light = as_numpy(light)
    along, _, normal = sheet_axes(light)
    aside = np.array([normal[0], normal[1], 0.0])
    X = depths[:, None, None] * np.array([0.0, 0.0, 1.0]) + positions[:, None] * along
    for _ in range(_STEPS):
        X = X - (light.level(X) / (light.gradient(X) @ aside))[..., None] * aside
    return X


def section_around(
    light: Light, distances: Float[np.ndarray, "distances"], angles: Float[np.ndarray, "angles"]
) -> Float[np.ndarray, "distances angles 3"]:
    """The points of the sheet about as far from the camera's centre, and at angles around it, camera frame, mm.

    Angles (radians) are within the sheet, 0 where the light goes away from the camera. NaN where the sheet does not
    come so near, or has no such point.
    """
    light = as_numpy(light)
    along, way, normal = sheet_axes(light)
    foot = -float(distance(light, np.zeros((1, 3)))[0]) * normal
    with np.errstate(invalid="ignore", divide="ignore"):
        radius = np.sqrt(distances**2 - foot @ foot)
        around = np.cos(angles)[:, None] * way + np.sin(angles)[:, None] * along
        # Of a sheet that is not flat these are points of the plane that touches it.
        rays = foot + radius[:, None, None] * around
        inverse = light.inverse_depth(rays)
        return rays / np.where(inverse > 0, inverse, np.nan)[..., None]


def turned_and_moved(
    light: Light,
    first: Float[np.ndarray, "numbers"],
    last: Float[np.ndarray, "numbers"],
    points: Float[np.ndarray, "points 3"],
    positions: Float[np.ndarray, "points"] | float = 0.0,
) -> tuple[float, float]:
    """How far a sheet goes when its numbers change, where points (camera frame, mm) are: degrees, and mm (RMS).

    Args:
        light: the sheet.
        first: added to its numbers, where it was.
        last: added to its numbers, where it is now.
        points: near it.
        positions: of the axis that moves it at each, motor steps, where one does.
    """
    numbers, unravel = ravel_pytree(as_numpy(light))
    was, now = (stood(as_numpy(unravel(jnp.asarray(numbers + by))), positions) for by in (first, last))
    normals = [np.mean(each.gradient(points), axis=0) for each in (was, now)]
    a, b = (normal / np.linalg.norm(normal) for normal in normals)
    turn = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
    return float(turn), float(np.sqrt(np.mean((distance(was, points) - distance(now, points)) ** 2)))


def nameless(light: Light) -> Light:
    """The same light without its name, so that lights of several names share what was compiled for one."""
    return type(light)(**{**vars(light), "name": ""})


def light_axes(lights: Iterable[Light]) -> tuple[str, ...]:
    """The names of the axes that move lights, each once."""
    return tuple(dict.fromkeys(light.axis for light in lights if isinstance(light, MovingLight)))


def inverse_depths(
    light: Light, rays: Float[np.ndarray, "rays 3"], positions: Real[np.ndarray, "rays"] | float | None = None
) -> tuple[Float64[np.ndarray, "rays"], Float64[np.ndarray, "rays 3"], Float64[np.ndarray, "rays numbers"]]:
    """The inverse depth along rays, and its derivatives by the ray and by the light's numbers.

    Args:
        light: the light.
        rays: of the camera.
        positions: of the axis that moves the light at each, motor steps; None where none does, or in the middle.
    """
    moves = isinstance(light, MovingLight) and positions is not None
    each = np.broadcast_to(np.asarray(positions if moves else 0.0, np.float64), len(rays))[:, None]
    with float64():
        exact = as_float64(nameless(light))
        batches = zip(batches_of(rays), batches_of(each), strict=True)
        parts = [_inverse_depths(exact, some, jnp.asarray(at[:, 0]) if moves else None) for some, at in batches]
    w, by_ray, by_numbers = (
        np.concatenate(list(map(np.asarray, part)))[: len(rays)] for part in zip(*parts, strict=True)
    )
    return w, by_ray, by_numbers


@compiled(filtered=True)
def _inverse_depths(
    light: Light, rays: Float[Array, "batch 3"], positions: Float[Array, "batch"] | None
) -> tuple[Float[Array, "batch"], Float[Array, "batch 3"], Float[Array, "batch numbers"]]:
    numbers, unravel = ravel_pytree(light)

    def inverse_depth(
        ray: Float[Array, "3"], numbers: Float[Array, "numbers"], position: Float[Array, ""] | None
    ) -> Float[Array, ""]:
        light = unravel(numbers)
        return (light if position is None else stood(light, position)).inverse_depth(ray)

    both = jax.value_and_grad(inverse_depth, argnums=(0, 1))
    w, (by_ray, by_numbers) = jax.vmap(both, in_axes=(0, None, None if positions is None else 0))(
        rays, numbers, positions
    )
    return w, by_ray, by_numbers
