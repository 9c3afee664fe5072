"""The rig: what calibration finds and reconstruction uses."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Bool, Float, Float64, Real

from jaxscan.axis_details import is_detail
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.kept_programs import compiled
from jaxscan.precision import as_float64, float64
from jaxscan.rig.batches import over_batch
from jaxscan.rig.camera import Camera
from jaxscan.rig.light import Light, MovingLight, light_at, light_axes, meet
from jaxscan.rig.motion import AxisMotion, Fixed, Motion, Positions, motion_of, normal_motion
from jaxscan.rig.play import ScrewOnGuideWithPlay
from jaxscan.rig.readable import Readable

_STAGE_SHAPES: Final = ScrewOnGuideWithPlay.shape()


class Rig(Readable):
    """A camera, its lights, and the motion of the object.

    Attributes:
        camera: the camera.
        lights: the sheets; none for a rig calibrated without a laser, several for several lasers.
        motion: of the object, by the positions of the axes.
    """

    camera: Camera
    lights: tuple[Light, ...] = ()
    motion: Motion = Fixed()

    def _said(self) -> list[str]:
        """A line for the camera, for each light and for each axis."""
        parts = [self.camera, *self.lights, *self.motion.parts()]
        return ["\n    " + ",\n    ".join(map(repr, parts)) + ",\n"]

    def light(self, name: str = "") -> Light:
        """The light of a laser; without a name, the only one.

        Raises:
            InputError: there is no such laser, or more than one and no name.
        """
        if not self.lights:
            raise InputError("the rig has no laser: calibrate it with photographs of the stripe on the board")
        chosen = [light for light in self.lights if light.name == name] if name else list(self.lights)
        if len(chosen) != 1:
            names = ", ".join(f'"{light.name}"' for light in self.lights)
            if not name:
                raise InputError(f"the rig has the lasers {names}, and none is named: name one, in [laser] of a scan")
            if len(self.lights) == 1 and not self.lights[0].name:
                raise InputError(f'the rig has no laser "{name}", its only one has no name: leave the name out')
            raise InputError(f'the rig has no laser "{name}", it has {names}: name one of them')
        return chosen[0]

    def axes(self) -> dict[str, AxisMotion]:
        """The motions of its axes by their names, from the room to the object."""
        return {part.axis: part for part in self.motion.parts()}

    def axis(self, name: str) -> AxisMotion:
        """The motion of one axis.

        Raises:
            InputError: there is no such axis.
        """
        axes = self.axes()
        if name not in axes:
            has = f"it has {', '.join(axes)}" if axes else "nothing of it moves"
            raise InputError(f'the rig has no axis "{name}", {has}: calibrate with photographs of the board on it')
        return axes[name]

    def with_axis(self, part: AxisMotion) -> "Rig":
        """The same with this motion in place of that of its axis, or as the one that carries the object."""
        axes = {**self.axes(), part.axis: part}
        return Rig(self.camera, self.lights, motion_of(tuple(axes.values())))

    def normal(self) -> "Rig":
        """The same rig by the numbers that its file keeps."""
        return Rig(self.camera, self.lights, normal_motion(self.motion))

    def surplus(self) -> set[str]:
        """Parameters to hold while the others are sought: of each idle way of the motion the one that it moves most."""
        names = np.array(parameter_names(self))
        return {str(names[np.argmax(np.abs(way))]) for way in idle_ways(self)}

    def given(self) -> set[str]:
        """Parameters that a solve takes as they are, without covariance: what a kind of part names as `given`."""
        names = parameter_names(self)
        stems = [f"motion.{part.axis}.{name}." for part in self.motion.parts() for name in getattr(part, "given", ())]
        stems += [f"camera.{name}." for name in getattr(self.camera.lens, "given", ())]
        stems += [f"lights.{i}.{name}." for i, light in enumerate(self.lights) for name in getattr(light, "given", ())]
        return {name for name in names if name.startswith(tuple(stems))}

    def light_axis(self, name: str) -> MovingLight:
        """The light that an axis moves, the first of several.

        Raises:
            InputError: it moves none.
        """
        moved = [light for light in self.lights if isinstance(light, MovingLight) and light.axis == name]
        if not moved:
            raise InputError(f'no light of the rig is moved by an axis "{name}"')
        return moved[0]

    def with_lights_at(self, q: Positions) -> "Rig":
        """The same rig with lights that stand where those that move are at positions of the axes, motor steps."""
        return Rig(self.camera, tuple(light_at(light, q) for light in self.lights), self.motion)

    def pose(self, q: Positions) -> Pose:
        """T_camera_object at positions of the axes (motor steps); one that is not named stands at 0."""
        return self.motion.pose(q)

    def _check_axes(self, q: Positions) -> None:
        """Refuse what are no positions, and names that no axis has in place of those of the rig's axes.

        Axes beside the rig's own, of a scanner that has more, may be named.
        """
        own = [*(part.axis for part in self.motion.parts()), *light_axes(self.lights)]
        has = f"this rig's axes: {', '.join(own)}" if own else "this rig has none"
        if not isinstance(q, Mapping):
            raise InputError(
                f'{q} are no positions: give motor steps by the names of the axes, as {{"stage": 4000}}; {has}'
            )
        strange = [axis for axis in q if axis not in own and not is_detail(axis)]
        if strange and any(axis not in q for axis in own):
            raise InputError(f'there is no axis "{strange[0]}": {has}')

    def triangulate(
        self, pixel: Real[ArrayLike, "*batch uv"] | Sequence[Any], q: Positions, light: str = ""
    ) -> Float[Array, "*batch 3"]:
        """Stripe pixels (u, v) at positions of the axes to points of the object frame (mm): M(q)⁻¹ (x z).

        z is the depth at which the pixel's ray x meets the sheet. The plain statement of what `reconstruction` does at
        speed; NaN where the pixel cannot see the sheet.

        Args:
            pixel: one, of shape (2,), or any number of them, (…, 2).
            q: motor steps of each axis: a number that holds for all pixels, or one for each.
            light: which laser; may be left out where there is one.

        Raises:
            InputError: the last axis is not u, v; an axis of the rig is called by a wrong name, or has neither one
                position nor one for each pixel; no such laser.
        """
        sheet = self.light(light)
        self._check_axes(q)
        if isinstance(sheet, MovingLight) and sheet.axis not in q:
            raise InputError(
                f'the light is moved by the axis "{sheet.axis}": give its position among those of the axes'
            )

        def one(pixel: Array, q: Positions) -> Array:
            return self.pose(q).inverse().apply(meet(light_at(sheet, q), self.camera.ray(pixel)))

        batch = np.shape(pixel)[:-1]
        if batch:
            q = {axis: _for_each(axis, steps, batch) for axis, steps in q.items()}
        return over_batch(one, 2, "Rig.triangulate takes pixels u, v", pixel, q)


def _for_each(axis: str, steps: ArrayLike, batch: tuple[int, ...]) -> Array:
    """The position of an axis at each pixel."""
    if jnp.shape(steps) not in ((), batch):
        raise InputError(
            f'the axis "{axis}" has positions of shape {jnp.shape(steps)}, and the pixels have {(*batch, 2)}: give one '
            f"number for all, or an array of shape {batch}"
        )
    return jnp.broadcast_to(jnp.asarray(steps, float), batch)


def parameter_names(rig: Rig) -> list[str]:
    """The names of the rig's leaves in their order: `camera.focal.0`, `lights.0.plane.2`, `motion.stage.per_step.1`.

    The lens's are the camera's own: `camera.radial.0`.
    """
    parts = rig.motion.parts()
    names = []
    for path, _ in jax.tree_util.tree_leaves_with_path(rig):
        keys = [str(getattr(key, "name", getattr(key, "idx", ""))) for key in path]
        if keys[:2] == ["camera", "lens"]:
            del keys[1]
        if keys[0] == "motion":
            keys[1:-2] = [parts[int(keys[2])].axis if keys[1] == "links" else parts[0].axis]
        names.append(".".join(keys))
    return names


def is_place(name: str) -> bool:
    """Whether a parameter says where an axis stands: a share of such a number means nothing."""
    return ".centre." in f"{name}."


def is_stage_shape(name: str, names: Collection[str]) -> bool:
    """Whether a parameter, of all these, says how a stage's motion differs from a line: it may be 0, and has no share.

    Other motions may use the same names for their parameters, but these have no travel for each step.
    """
    parts = name.split(".")
    return parts[0] == "motion" and parts[2] in _STAGE_SHAPES and f"motion.{parts[1]}.per_step.0" in names


def leaves_of(rig: Rig, stem: str) -> list[int]:
    """Where the parameters whose names begin so stand among a rig's leaves."""
    return [i for i, name in enumerate(parameter_names(rig)) if name.startswith(stem)]


def idle_ways(rig: Rig) -> Float64[np.ndarray, "ways leaves"]:
    """Ways of the leaves along which the rig stays the same."""
    ways = []
    for part in rig.motion.parts():
        at = leaves_of(rig, f"motion.{part.axis}.")
        for way in np.asarray(part.idle(), np.float64):
            ways.append(np.zeros(len(parameter_names(rig))))
            ways[-1][at] = way
    return np.array(ways).reshape(-1, len(parameter_names(rig)))


def normal_jacobian(rig: Rig) -> Float64[np.ndarray, "leaves leaves"]:
    """How the leaves of `rig.normal()` move with those of the rig.

    By whatever the surplus numbers were held to find their covariance Σ, J Σ Jᵀ is that of the normal ones
    (W. Baarda's S-transformation, 1973).
    """
    J, at = np.eye(len(parameter_names(rig))), leaves_of(rig, "motion.")
    if len(idle_ways(rig)):
        J[np.ix_(at, at)] = motion_normal_jacobian(rig.motion)
    return J


def motion_normal_jacobian(motion: Motion) -> Float64[np.ndarray, "numbers numbers"]:
    """How the numbers of the normal motion move with those of a motion."""
    with float64():
        return np.asarray(_normal_jacobian(as_float64(motion)))


@compiled()
def _normal_jacobian(motion: Motion) -> Float[Array, "leaves leaves"]:
    numbers, unravel = ravel_pytree(motion)
    return jax.jacfwd(lambda numbers: ravel_pytree(normal_motion(unravel(numbers)))[0])(numbers)


def held_jacobian(rig: Rig) -> Float64[np.ndarray, "leaves leaves"]:
    """The way back: how the leaves move when the surplus ones are held."""
    J = np.eye(len(parameter_names(rig)))
    for way in idle_ways(rig):
        k = int(np.argmax(np.abs(way)))
        J[:, k] -= way / way[k]
        J[k] = 0.0
    return J


def with_normal_numbers(
    matrix: Float64[np.ndarray, "*blocks n n"], rig: Rig, free: Bool[Array | np.ndarray, "shared"]
) -> Float64[np.ndarray, "*blocks n n"]:
    """The covariance of a rig's leaves, and of what follows them, once the rig is `normal`.

    Args:
        matrix: in which what is not free stands with any numbers.
        rig: where it was found.
        free: which shared parameters were refined, in their order.
    """
    if not len(idle_ways(rig)):
        return matrix
    J = np.diag(np.pad(np.asarray(free, float), (0, matrix.shape[-1] - len(free)), constant_values=1.0))
    n = len(parameter_names(rig))
    J[:n, :n] = normal_jacobian(rig) @ J[:n, :n]
    return J @ matrix @ J.T
