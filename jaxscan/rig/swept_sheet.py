"""A flat sheet of light that a motor or a mirror turns: it sweeps over an object that stands still."""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float, Int

from jaxscan.errors import ObservabilityError
from jaxscan.geometry.rotation import A, namespace, vector_to_matrix
from jaxscan.phrases import laser_prefix
from jaxscan.precision import Leaf
from jaxscan.rig.light_plane import LightPlane
from jaxscan.rig.motion import unit_vector
from jaxscan.rig.readable import Readable

# Fewer positions leave a turn and a shift of the sheet alike.
FEWEST_POSITIONS: Final = 3
# Points that a start is found from.
_SAMPLE: Final = 3000
# Rounds of weighted least squares, how far off a point may be to count in full, as a multiple of the usual, and the
# least that is taken for usual, mm.
_ROUNDS, _USUAL, _LEAST_USUAL = 3, 2.0, 1e-6
# Sheets whose first and last normal differ by a smaller sine do not turn.
_LEAST_TURN: Final = 1e-3
_ABSOLUTE_ROUNDS: Final = 12


class SweptSheet(Readable):
    """A plane that turns about an axis by motor steps; asked without a position, it stands in the middle of its sweep.

    With w the rotation vector of a step, n the steps from the middle, θ = |w| n, ω the plane there, n̂ its unit
    normal and 1/|ω| its distance from the camera, the normal is R(n w) n̂, and with c a point of the axis the distance

        R(n w) n̂ · c + const = 1/|ω| + p (cos θ − 1) + s sin θ,    p = n̂ · c across the axis, s = (w/|w| × n̂) · c.

    So p and s say all of where the axis is. A mirror turns the light by twice its own angle about its own axis if its
    surface holds that axis; then the same formula holds, with the turn of the light in w.

    Attributes:
        plane: ω in the middle, 1/mm.
        per_step: rotation vector of one motor step: the axis, times the angle by which the light turns (radians).
        centre: p and s, mm.
        middle: of the positions at which it was calibrated, motor steps.
        name: which laser of several this is; the only one needs none.
        axis: what turns it.
    """

    kind: ClassVar[str] = "swept"
    numbers: ClassVar[Mapping[str, int]] = {"plane": 3, "per_step": 3, "centre": 2, "middle": 1}
    units: ClassVar[Mapping[str, str]] = {"plane": "1/mm", "per_step": "rad", "centre": "mm", "middle": "steps"}
    # Where the numbers are counted from: no solve seeks it.
    given: ClassVar[tuple[str, ...]] = ("middle",)

    plane: tuple[Leaf, Leaf, Leaf]
    per_step: tuple[Leaf, Leaf, Leaf]
    centre: tuple[Leaf, Leaf]
    middle: tuple[Leaf]
    name: str = eqx.field(static=True, default="")
    axis: str = eqx.field(static=True, default="sweep")

    @staticmethod
    def create(
        plane: ArrayLike | Sequence[float],
        per_step: ArrayLike | Sequence[float],
        centre: ArrayLike | Sequence[float],
        middle: float = 0.0,
        name: str = "",
        axis: str = "sweep",
    ) -> "SweptSheet":
        """From ω (3 numbers, 1/mm), the turn of a step (3, radians), p and s (mm), and the middle (motor steps)."""
        a, b, c = jnp.asarray(plane, dtype=float)
        x, y, z = jnp.asarray(per_step, dtype=float)
        p, s = jnp.asarray(centre, dtype=float)
        return SweptSheet((a, b, c), (x, y, z), (p, s), (jnp.asarray(middle, dtype=float),), name, axis)

    @staticmethod
    def about(
        plane: ArrayLike,
        per_step: ArrayLike,
        point: ArrayLike,
        middle: float = 0.0,
        name: str = "",
        axis: str = "sweep",
    ) -> "SweptSheet":
        """As `create`, about an axis through a point of the camera frame, mm."""
        omega, turn, c = (np.asarray(part, np.float64) for part in (plane, per_step, point))
        return SweptSheet.create(omega, turn, _across(omega, turn) @ c, middle, name, axis)

    @classmethod
    def fitted(
        cls,
        points: Float[np.ndarray, "points 3"],
        view: Int[np.ndarray, "points"],
        name: str = "",
        positions: Float[np.ndarray, "points"] | None = None,
        axis: str = "sweep",
    ) -> "SweptSheet":
        """A start for a solve: a sheet whose dual plane is quadratic in the steps, and then the turn itself.

        Raises:
            ObservabilityError: there are too few positions, or the points do not make such a light.
        """
        from scipy.optimize import least_squares  # 0.3 s, and a scan needs no start

        del view
        which = laser_prefix(name)
        steps = np.zeros(len(points)) if positions is None else np.asarray(positions, np.float64)
        if len(np.unique(steps)) < FEWEST_POSITIONS:
            raise ObservabilityError(
                f"{which}the sheet is swept, and its stripes are of {len(np.unique(steps))} positions of the {axis}: "
                f"photograph the board with the light at {FEWEST_POSITIONS} positions or more, over the whole sweep"
            )
        chosen = np.random.default_rng(0).permutation(len(points))[:_SAMPLE]
        X, n = points[chosen], steps[chosen]
        middle, half = (n.max() + n.min()) / 2, np.ptp(n) / 2
        start = _turn_of(_dual_planes(X, (n - middle) / half), half)
        if start is None:
            raise ObservabilityError(
                f"{which}the stripes on the boards make no sheet of light that turns: hold the boards at different "
                f"distances, and check the steps of the {axis} and that the stripe, not its reflection, is found"
            )

        def off(numbers: Float[np.ndarray, "8"]) -> Float[np.ndarray, "points"]:
            planes = np.stack(_of(numbers, middle).at(n).plane, axis=-1)
            return ((X * planes).sum(axis=1) - 1) / np.linalg.norm(planes, axis=1)

        for _ in range(_ROUNDS):
            usual = float(np.median(np.abs(off(start)))) + _LEAST_USUAL
            # Numbers of an angle, of a distance and of its inverse: each in its own scale.
            start = least_squares(off, start, loss="soft_l1", f_scale=_USUAL * usual, x_scale="jac").x
        return _of(start, middle, name, axis)

    @classmethod
    def somewhere(cls, name: str = "") -> "SweptSheet":
        """Across the view, half a metre away, turning hardly."""
        return cls.create((0.0, 0.0, 0.002), (1e-6, 0.0, 0.0), (0.0, 0.0), name=name)

    def at(self, position: ArrayLike) -> LightPlane:
        """The sheet at positions of its axis, motor steps: one plane, or a stack of them."""
        xp = namespace(*self.plane, *self.per_step, position if isinstance(position, jax.Array) else 0.0)
        position = xp.asarray(position) - self.middle[0]
        omega, w = (xp.stack([xp.asarray(leaf) for leaf in part]) for part in (self.plane, self.per_step))
        theta = xp.sqrt((w * w).sum()) * position
        turned = vector_to_matrix(xp.expand_dims(position, -1) * w) @ omega
        further = self.centre[0] * (xp.cos(theta) - 1) + self.centre[1] * xp.sin(theta)
        turned = turned / (1 + xp.sqrt((omega * omega).sum()) * further)[..., None]
        return LightPlane((turned[..., 0], turned[..., 1], turned[..., 2]), self.name)

    def level(
        self, ray: Float[A, "*points 3"], inverse_depth: Float[A, "*points"] | float = 1.0
    ) -> Float[A, "*points"]:
        """That of the plane in the middle."""
        return LightPlane(self.plane).level(ray, inverse_depth)

    def gradient(self, point: Float[A, "*points 3"]) -> Float[A, "*points 3"]:
        """That of the plane in the middle."""
        return LightPlane(self.plane).gradient(point)

    def inverse_depth(self, ray: Float[A, "*rays 3"]) -> Float[A, "*rays"]:
        """That of the plane in the middle."""
        return LightPlane(self.plane).inverse_depth(ray)

    def direction(self) -> Float[np.ndarray, "3"]:
        """Unit vector of its axis; it turns about it by the right-hand rule."""
        return unit_vector(self.per_step)

    def amount(self, steps: float) -> tuple[float, str]:
        """Degrees."""
        return abs(steps) * float(np.degrees(np.linalg.norm([float(leaf) for leaf in self.per_step]))), "degrees"

    def fault(self, rays: Float[np.ndarray, "rays 3"]) -> tuple[str, str] | None:
        """A light that does not turn, or whose middle is no light plane."""
        if not any(float(leaf) for leaf in self.per_step):
            return "per_step", 'the sheet does not turn: calibrate it as a "plane"'
        return LightPlane(self.plane).fault(rays)


def _of(numbers: Float[np.ndarray, "8"], middle: float, name: str = "", axis: str = "sweep") -> SweptSheet:
    a, b, c, x, y, z, p, s, n = map(np.asarray, (*numbers, middle))
    return SweptSheet((a, b, c), (x, y, z), (p, s), (n,), name, axis)


def _across(omega: Float[np.ndarray, "3"], turn: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2 3"]:
    """The directions along which p and s are: the normal's part across the axis, and at right angles to it."""
    normal, axis = omega / np.linalg.norm(omega), turn / np.linalg.norm(turn)
    return np.stack([normal - (normal @ axis) * axis, np.cross(axis, normal)])


def _dual_planes(X: Float[np.ndarray, "points 3"], s: Float[np.ndarray, "points"]) -> Float[np.ndarray, "3 3"]:
    """ω(s) = Σ c_k sᵏ with ω(s) · X = 1 for most points, c_k in its rows: least absolute distances, by weights."""
    powers = s[:, None] ** np.arange(3)
    rows = (powers[:, :, None] * X[:, None, :]).reshape(len(X), 9)
    weights, found = np.ones(len(X)), np.zeros(9)
    for _ in range(_ABSOLUTE_ROUNDS):
        found = np.linalg.lstsq(rows * weights[:, None], weights, rcond=None)[0]
        off = np.abs(rows @ found - 1) / np.linalg.norm(powers @ found.reshape(3, 3), axis=1)
        weights = np.maximum(off, np.median(off) + _LEAST_USUAL) ** -0.5
        weights /= np.linalg.norm(powers @ found.reshape(3, 3), axis=1) * weights.max()
    return found.reshape(3, 3)


def _turn_of(planes: Float[np.ndarray, "3 3"], half: float) -> Float[np.ndarray, "8"] | None:
    """The numbers of a turn whose dual planes are these at s = −1, 0 and 1, `half` steps apart; None where none is."""
    first, middle, last = (planes[0] - planes[1] + planes[2], planes[0], planes.sum(axis=0))
    lengths = [float(np.linalg.norm(each)) for each in (first, middle, last)]
    if not all(np.isfinite(lengths)) or min(lengths) == 0:
        return None
    across = np.cross(first, last) / (lengths[0] * lengths[2])
    sine = float(np.linalg.norm(across))
    if sine < _LEAST_TURN:
        return None
    angle = np.arctan2(sine, first @ last / (lengths[0] * lengths[2])) / 2
    d0, d1, d2 = 1 / np.array([lengths[1], lengths[0], lengths[2]])
    # What an arc shows of its middle is little where it is short: it begins no further away than the sheet.
    p = float(np.clip(((d1 + d2) / 2 - d0) / (np.cos(angle) - 1), -d0, d0))
    return np.concatenate([middle, across / sine * angle / half, [p, (d2 - d1) / (2 * np.sin(angle))]])
