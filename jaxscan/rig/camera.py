"""The camera: a pinhole with a lens and a sensor, from points to pixels and from pixels to rays."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Real

from jaxscan.errors import InputError
from jaxscan.precision import Leaf
from jaxscan.rig.batches import over_batch
from jaxscan.rig.chart import FLAT, Chart
from jaxscan.rig.kinds import LENSES, lens_of_kind
from jaxscan.rig.lens import Lens, undistort, undistorted_change
from jaxscan.rig.readable import Readable
from jaxscan.rig.tilted_sensor import change_off_sensor, off_sensor, onto_sensor

_PINHOLE = {"focal": 2, "principal": 2}
_TILT = {"tilt": 2}


class Camera(Readable):
    """A pinhole camera with a lens. Every number is a leaf of its own, so that each can be held or freed.

    Attributes:
        focal: f_u, f_v in pixels.
        principal: u₀, v₀ in pixels; (0, 0) is the centre of the top left pixel.
        lens: what it does to rays; its numbers are parameters of the camera: `camera.radial.0`.
        image_size: columns and rows.
        tilt: τ_x, τ_y of the sensor against the lens, radians (`rig.tilted_sensor`); empty where it is not tilted.
    """

    focal: tuple[Leaf, Leaf]
    principal: tuple[Leaf, Leaf]
    lens: Lens
    image_size: tuple[int, int] = eqx.field(static=True)
    tilt: tuple[Leaf, ...] = ()

    units: ClassVar[Mapping[str, str]] = {"image_size": "px", "focal": "px", "principal": "px", "tilt": "rad"}

    @staticmethod
    def create(
        image_size: tuple[int, int],
        focal: ArrayLike | Sequence[float],
        principal: ArrayLike | Sequence[float],
        lens: str = "none",
        *numbers: ArrayLike | Sequence[float],
        tilt: ArrayLike | Sequence[float] = (),
        **named: ArrayLike | Sequence[float],
    ) -> "Camera":
        """A camera from plain numbers, in JAX's present default precision.

        Args:
            image_size: columns and rows.
            focal: f_u, f_v in pixels.
            principal: u₀, v₀ in pixels.
            lens: a kind of lens: one of `rig.LENSES`.
            numbers: those of the lens, in their order: for "brown" [k1, k2, k3], [p1, p2]. What is not given is as in
                the kind's nominal lens: 0.
            tilt: τ_x, τ_y of a tilted sensor, radians.
            named: or by their names: radial=[k1, k2, k3], tangential=[p1, p2].

        Raises:
            InputError: an unknown lens, more coefficients than it has, or a tilt that is not two angles.
        """
        kind = lens_of_kind(lens)
        f, c, angles = (jnp.ravel(jnp.asarray(x, dtype=float)) for x in (focal, principal, tilt))
        if f.size != 2 or c.size != 2:
            raise InputError(f"focal and principal take two numbers each; they have {f.size} and {c.size}")
        if angles.size not in (0, 2):
            raise InputError(f"tilt takes two angles, or none for a sensor that is not tilted; it has {angles.size}")
        if len(numbers) > len(kind.numbers) or not named.keys() <= {*list(kind.numbers)[len(numbers) :]}:
            by_name = f" and {', '.join(named)}" if named else ""
            raise InputError(
                f'the lens "{lens}" takes {", ".join(kind.numbers)}, each once; {len(numbers)} in this order{by_name} '
                "were given"
            )
        given = dict(zip(kind.numbers, numbers, strict=False)) | named
        arrays = {name: jnp.ravel(jnp.asarray(given.get(name, ()), dtype=float)) for name in kind.numbers}
        if any(arrays[name].size > count for name, count in kind.numbers.items()):
            has = " and ".join(f"{count} {name}" for name, count in kind.numbers.items())
            raise InputError(
                f'the lens "{lens}" has {has} coefficients; {" and ".join(str(k.size) for k in arrays.values())} were '
                f"given: choose a richer lens of {', '.join(LENSES)}"
            )
        nominal = kind.nominal()
        leaves = {name: (*k, *getattr(nominal, name)[k.size :]) for name, k in arrays.items()}
        return Camera((f[0], f[1]), (c[0], c[1]), kind(**leaves), image_size, tuple(angles))

    def zero_terms(self) -> tuple[str, ...]:
        """The names of those lens terms that are zero: in a file mostly terms that were held there, so also here."""
        terms = [term for name in self.lens.numbers for term in getattr(self.lens, name)]
        names = lens_parameters(self.lens.kind)
        return tuple(name for name, term in zip(names, terms, strict=True) if float(term) == 0)

    def project(self, point: Real[ArrayLike, "*batch xyz"] | Sequence[Any]) -> Float[Array, "*batch 2"]:
        """Points of the camera frame (mm) to their pixels (u, v); NaN for a point that the lens does not see.

        That is one that is not in front of the camera; of a fisheye, one farther from the axis than where its image
        stops growing.

        Args:
            point: one, of shape (3,), or any number of them, (…, 3).

        Raises:
            InputError: the last axis is not x, y, z.
        """
        return over_batch(self._project, 3, "Camera.project takes points x, y, z", point)

    def _project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        x, there = self.chart.coordinates(point)
        return jnp.where(there, self.image(x), jnp.nan)

    def image(self, x: Float[Array, "2"]) -> Float[Array, "2"]:
        """The pixel of a ray by its coordinates in the lens's chart."""
        return jnp.stack(self.focal) * onto_sensor(self.tilt, self.lens.distort(x)) + jnp.stack(self.principal)

    def ray(self, pixel: Real[ArrayLike, "*batch uv"] | Sequence[Any]) -> Float[Array, "*batch 3"]:
        """Pixels (u, v) to their rays (x, y, 1); of a fisheye, of length 1. NaN outside the lens's invertible range.

        The inverse is converged, and its derivative with respect to pixel and lens is exact.

        Args:
            pixel: one, of shape (2,), or any number of them, (…, 2).

        Raises:
            InputError: the last axis is not u, v.
        """
        return over_batch(self._ray, 2, "Camera.ray takes pixels u, v", pixel)

    def _ray(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        return self._along(undistort(self.lens, off_sensor(self.tilt, self._on_sensor(pixel))))

    def ray_and_change(
        self, pixel: Float[Array, "2"], along: Float[Array, "2"]
    ) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """The ray of a pixel, and how it changes for each pixel in the direction `along`."""
        on_sensor = self._on_sensor(pixel)
        x = undistort(self.lens, off_sensor(self.tilt, on_sensor))
        xd_dot = change_off_sensor(self.tilt, on_sensor, along / jnp.stack(self.focal))
        return jax.jvp(self._along, (x,), (undistorted_change(self.lens, x, xd_dot),))

    @property
    def chart(self) -> Chart:
        """The kind of two numbers by which the lens knows a ray."""
        return getattr(self.lens, "chart", FLAT)

    def _along(self, x: Float[Array, "2"]) -> Float[Array, "3"]:
        """The ray by its coordinates in the chart."""
        return jnp.stack(self.chart.components(x[0], x[1]))

    def _on_sensor(self, pixel: Float[Array, "2"]) -> Float[Array, "2"]:
        """Normalised coordinates of a pixel."""
        return (pixel - jnp.stack(self.principal)) / jnp.stack(self.focal)


def camera_parameters(lens: str, *, tilted: bool = False) -> tuple[str, ...]:
    """The names of a camera's parameters, in the order of its leaves: `camera.focal.0` … `camera.tangential.1`.

    Args:
        lens: a kind of lens.
        tilted: whether its sensor is tilted: `camera.tilt.0`, `camera.tilt.1` come last.

    Raises:
        InputError: there is no such lens.
    """
    counts = {**_PINHOLE, **lens_of_kind(lens).numbers, **(_TILT if tilted else {})}
    return tuple(f"camera.{part}.{i}" for part, count in counts.items() for i in range(count))


def lens_parameters(lens: str) -> tuple[str, ...]:
    """Those of `camera_parameters` that are the lens's."""
    return camera_parameters(lens)[sum(_PINHOLE.values()) :]


def lens_numbers(parameter: str) -> str | None:
    """To which of its lens's numbers a camera's parameter belongs, `radial` for `camera.radial.0`; None for others."""
    part, _, name = parameter.partition(".")
    name = name.split(".")[0]
    return name if part == "camera" and name not in {*_PINHOLE, *_TILT} else None
