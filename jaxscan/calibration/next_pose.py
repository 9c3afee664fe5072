"""Where to hold the board next: the poses whose photographs lower a wanted uncertainty most.

A photograph of the board at pose p adds its own Schur complement to that of the rig's parameters θ,

    S' = S + I(p)        I(p) = U − W V⁻¹ Wᵀ

with U, V, W the blocks of JᵀJ of its residuals, corners and stripe, each divided by its σ: only where they would be
seen enters. Where boards bend from photograph to photograph the new one has bulges of its own too, with their σ; what
all boards share of their shape is taken as known. With S⁻¹ = Σ = L Lᵀ and A = Lᵀ I(p) L

    Σ' = L (I + A)⁻¹ Lᵀ

and wanted quantities with the derivatives w = ∂f/∂θ have the mean variance tr(w Σ' wᵀ) / m, which is to be least
(V. V. Fedorov, "Theory of optimal experiments", 1972: L-optimal design). The least lies on limits more often than not,
at the image's edge, at the largest tilt, so it is sought by differential evolution (R. Storn and K. Price 1997), one
photograph after the other, each with what those before it add: docs/next-pose.md.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.optimize import differential_evolution

from jaxscan.calibration.block_arrow import NormalEquations, linearise
from jaxscan.calibration.bundle import as_arrow
from jaxscan.calibration.placement import Reach, outline_of
from jaxscan.calibration.residuals import Blocks, Noise
from jaxscan.calibration.result import Calibration
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.kept_programs import compiled
from jaxscan.precision import as_float64, as_jax, float64
from jaxscan.rig import BoardShape, Covariance, Light, MovingLight, Rig, System
from jaxscan.rig.board_shape import BENDS
from jaxscan.rig.light import light_axes, stood
from jaxscan.rig.rig import parameter_names

# Number of generations, and of poses in each. Always the same number, so that nothing is compiled again.
_GENERATIONS, _AT_ONCE = 60, 120
# The stripe is summed over this number of its parts.
_STRIPE_PARTS = 16
# How far beyond the boards that there are the next one may be held, how far from the image's edge (as a share of its
# width) it stays, and how far it may be tilted: corners are found as well up to 55°, and a hand wants room.
_NEARER_FARTHER, _MARGIN, _TILT_DEG = 1.1, 0.015, 45.0


@dataclass(frozen=True)
class NextPose:
    """A pose of the board to photograph.

    Attributes:
        pose: T_cam_board, mm; NumPy leaves.
        distance_mm: from the camera's centre to the middle of the board.
        tilt_deg: of the board out of the plane at right angles to the line of sight: by how much its right side, and
            its lower side, is nearer than the other.
        outline_px: where the corners of the printed pattern are seen, in turn: first points, end of the first row, …
        stripes_px: for each laser, where its stripe crosses the pattern; NaN where it does not. Of a light that moves
            there are three, at the ends of its sweep and in the middle.
        covariance: predicted of the rig's parameters, with this photograph and those before it.
    """

    pose: Pose
    distance_mm: float
    tilt_deg: Float[np.ndarray, "2"]
    outline_px: Float[np.ndarray, "4 2"]
    stripes_px: Float[np.ndarray, "stripes parts 2"]
    covariance: Covariance


class Scene(eqx.Module):
    """What a photograph of a new pose has in common with those that there are.

    Attributes:
        rig: as calibrated.
        free: which of its parameters are not held.
        shape: of the board, as found; None for a flat one.
        noise: σ of a corner, of a stripe point times √τ, and of the additional bulges of each photograph.
        points: of the board, mm.
        outline: corners of the printed pattern, mm.
        columns: for each stripe, whether it is found column by column.
        lasers: which light each stripe is of: one that moves has several.
        at: motor steps of the axis that moves that light, where one does.
    """

    rig: Rig
    free: Bool[Array, "leaves"]
    shape: BoardShape | None
    noise: Noise
    points: Float[Array, "points 3"]
    outline: Float[Array, "4 3"]
    columns: Bool[Array, "stripes"]
    at: Float[Array, "stripes"]
    lasers: tuple[int, ...] = eqx.field(static=True)

    def information(self, pose: Float[Array, "6"]) -> Float[Array, "leaves leaves"]:
        """I(p) = U − W V⁻¹ Wᵀ: the information of a photograph of the board at a pose on the rig's leaves."""
        blocks = jax.tree.map(lambda leaf: leaf[None], self.seen(pose))
        leaves = len(self.free)
        own = pose if self.noise.bend is None else jnp.pad(pose, (0, BENDS))
        system = System(self.rig, (own[None],), self.shape)
        free = jnp.pad(self.free, (0, len(system.shared_names()) - leaves))
        y, _, residual = as_arrow(system, free, (blocks,), self.noise)
        normal = NormalEquations.create(*linearise(residual, y))
        # A parameter that no residual depends on has a 1 there that the elimination needs.
        told = jnp.diagonal(normal.U)[:leaves] > 0
        return jnp.where(told[:, None] & told[None], normal.schur_complement()[:leaves, :leaves], 0.0)

    def seen(self, pose: Float[Array, "6"]) -> Blocks:
        """A block as an ideal detector sees it. Corners enter the residuals' derivatives nowhere, and are not made."""
        count = len(self.points)
        pixels, weights = self.stripes(pose)
        return Blocks(
            points=self.points,
            q={},
            reference={},
            corners=jnp.zeros((1, count, 2)),
            weights=jnp.ones((1, count)),
            corner_used=jnp.ones((1, count), bool),
            stripe=pixels.reshape(1, -1, 2),
            stripe_weights=weights.reshape(1, -1),
            stripe_used=weights.reshape(1, -1) > 0,
            stripe_columns=jnp.repeat(self.columns, _STRIPE_PARTS)[None],
            stripe_light=jnp.repeat(jnp.asarray(self.lasers, int), _STRIPE_PARTS)[None],
            stripe_at=jnp.repeat(self.at, _STRIPE_PARTS)[None] if light_axes(self.rig.lights) else None,
        )

    def stripes(self, pose: Float[Array, "6"]) -> tuple[Float[Array, "stripes parts 2"], Float[Array, "stripes parts"]]:
        """Each stripe across the pattern, in equal parts: middle pixel, √ of its columns (or rows).

        The line in which the sheet's level vanishes on the board, as it runs at the board's middle: a · (x, y) = c with
        a the level's gradient there. Weights are zero where it misses the pattern.
        """
        T = Pose.from_vector(pose)
        R = T.matrix()
        low, high = self.outline[0, :2], self.outline[2, :2]
        middle = (low + high) / 2

        def each(light: Light, columns: Bool[Array, ""]) -> tuple[Array, Array]:
            level, a = jax.value_and_grad(lambda at: light.level(R[:, :2] @ at + T.translation))(middle)
            height = a @ middle - level
            foot = middle + a * (height - a @ middle) / (a @ a)
            along = jnp.stack([-a[1], a[0]]) / jnp.linalg.norm(a)
            along = jnp.where(jnp.abs(along) < 1e-9, 1e-9, along)
            one, other = (low - foot) / along, (high - foot) / along
            start, end = jnp.minimum(one, other).max(), jnp.maximum(one, other).min()
            crosses = end > start
            s = start + (end - start) * jnp.linspace(0.0, 1.0, 2 * _STRIPE_PARTS + 1)
            at = jnp.where(crosses, foot[None] + s[:, None] * along[None], middle[None])
            X = at @ R[:, :2].T + T.translation[None]
            pixels = jax.vmap(self.rig.camera.project)(X)
            count = jnp.abs(jnp.diff(jnp.where(columns, pixels[:, 0], pixels[:, 1])[::2]))
            return pixels[1::2], jnp.where(crosses, jnp.sqrt(count), 0.0)

        if not self.rig.lights:
            return jnp.zeros((0, _STRIPE_PARTS, 2)), jnp.zeros((0, _STRIPE_PARTS))
        parts = [each(stood(self.rig.lights[i], self.at[k]), self.columns[k]) for k, i in enumerate(self.lasers)]
        return jnp.stack([pixels for pixels, _ in parts]), jnp.stack([weights for _, weights in parts])


def suggest(
    calibration: Calibration, wanted: Float[np.ndarray, "quantities leaves"], *, count: int = 3, seed: int = 0
) -> tuple[NextPose, ...]:
    """The poses of the board that lower the mean variance of what is wanted most, the best first.

    Each is within `reachable`, and counts those before it as photographed.

    Args:
        calibration: with the σ and the correlation of what was seen.
        wanted: derivative of each wanted quantity by the rig's leaves: of points `reconstruction.point_sigma
            .ray_jacobian`, of pixels `rig.covariance.projection_jacobian`.
        count: how many.
        seed: of the search.

    Returns:
        The poses; none where the board's pattern is nowhere wholly in the image, or where every parameter that the
        wanted quantities depend on is held.

    Raises:
        InputError: derivatives of another rig, or that are not numbers; no count.
    """
    leaves = len(parameter_names(calibration.rig))
    if np.ndim(wanted) != 2 or np.shape(wanted)[1] != leaves or not len(wanted) or not np.isfinite(wanted).all():
        raise InputError(
            f"wanted has the shape {np.shape(wanted)}: give a row of {leaves} finite derivatives, by each of the "
            "rig's leaves, for each quantity"
        )
    if count < 1:
        raise InputError(f"count = {count}: ask for one pose or more")
    goal, found = wanted.T @ wanted / len(wanted), []
    with float64():
        scene, reach, root = _scene(calibration), reachable(calibration), _root(calibration)
        for i in range(count):
            pose = _search(scene, reach, root, goal, np.random.default_rng([seed, i]))
            if pose is None:
                break
            root = _updated(root, _told(scene, pose[None])[0])
            found.append(_described(calibration, scene, pose, root))
    return tuple(found)


def predict(calibration: Calibration, poses: Pose) -> Covariance:
    """The covariance of the rig's parameters if the board were photographed at some poses more.

    Args:
        calibration: as it is.
        poses: T_cam_board, stacked, mm; the whole pattern in the image.
    """
    with float64():
        scene, root = _scene(calibration), _root(calibration)
        for told in _told(scene, np.concatenate([poses.rotation, poses.translation], axis=1)):
            root = _updated(root, told)
    return _covariance(calibration, root)


def reachable(calibration: Calibration) -> Reach:
    """Where `suggest` would have the board held; inside a `float64` block.

    The whole pattern in the image, tilted against the line of sight by 45° at most, and its middle within the depths of
    the boards that there are, or a tenth beyond: nothing says that it would be in focus elsewhere.
    """
    observations = calibration.observations
    boards = calibration.system.boards if observations.views else calibration.photograph_poses()
    outline = outline_of(observations.board)
    depths = calibration.rig.camera.chart.range_of(boards.apply(outline.mean(axis=0)))
    return Reach(
        camera=as_float64(calibration.rig.camera),
        outline=jnp.asarray(outline),
        log_depths=jnp.asarray(np.log([depths.min() / _NEARER_FARTHER, depths.max() * _NEARER_FARTHER])),
        tilt=jnp.asarray(np.radians(_TILT_DEG)),
        margin_px=jnp.asarray(_MARGIN * observations.image_size[0]),
    )


def _search(
    scene: Scene,
    reach: Reach,
    root: Float[np.ndarray, "leaves leaves"],
    goal: Float[np.ndarray, "leaves leaves"],
    random: np.random.Generator,
) -> Float[np.ndarray, "6"] | None:
    """The pose with the least variance of what is wanted; None where none within the limits lowers it."""
    before = float(np.sum(root * (goal @ root)))

    def variance(places: Float[np.ndarray, "6 places"]) -> Float[np.ndarray, "places"]:
        excess, poses = (np.asarray(x) for x in _placed(reach, jnp.asarray(places.T)))
        told = _told(scene, poses)
        within = (excess == 0) & np.isfinite(told).all(axis=(1, 2))
        told = np.where(within[:, None, None], told, 0.0)
        after = np.linalg.inv(np.eye(len(root)) + root.T @ told @ root)
        # What is beyond the limits is worse than any photograph, and the worse the farther.
        beyond = before * (2 + np.nan_to_num(excess, nan=1e3))
        return np.where(within, np.einsum("ij,pji->p", root.T @ goal @ root, after), beyond)

    best = differential_evolution(
        variance,
        reach.bounds(),
        maxiter=_GENERATIONS,
        popsize=_AT_ONCE // 6,
        tol=1e-3,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=random,
    )
    if not best.fun < before:
        return None
    return np.asarray(_placed(reach, jnp.asarray(np.resize(best.x, (_AT_ONCE, 6))))[1])[0]


@compiled(filtered=True)
def _placed(reach: Reach, places: Float[Array, "places 6"]) -> tuple[Float[Array, "places"], Float[Array, "places 6"]]:
    """How far each place is beyond the limits, and its pose."""
    return jax.vmap(reach.excess)(places), jax.vmap(reach.pose)(places)


def _told(scene: Scene, poses: Float[np.ndarray, "poses 6"]) -> Float[np.ndarray, "poses leaves leaves"]:
    """I(p) of each pose."""
    padded = np.resize(poses, (-(-len(poses) // _AT_ONCE), _AT_ONCE, 6))
    return np.concatenate([np.asarray(_information(scene, jnp.asarray(part))) for part in padded])[: len(poses)]


@compiled(filtered=True)
def _information(scene: Scene, poses: Float[Array, "poses 6"]) -> Float[Array, "poses leaves leaves"]:
    return jax.vmap(scene.information)(poses)


def _updated(
    root: Float[np.ndarray, "leaves leaves"], told: Float[np.ndarray, "leaves leaves"]
) -> Float[np.ndarray, "leaves leaves"]:
    """The root of the covariance with one photograph more: L C⁻ᵀ with I + Lᵀ I(p) L = C Cᵀ."""
    C = np.linalg.cholesky(np.eye(len(root)) + root.T @ told @ root)
    return np.linalg.solve(C, root.T).T


def _root(calibration: Calibration) -> Float[np.ndarray, "leaves leaves"]:
    """L with Σ = L Lᵀ, of the rig's leaves; a parameter that is held has a row of zeros."""
    sigma = calibration.covariance.of_leaves(calibration.rig)
    scale = np.sqrt(np.diagonal(sigma))
    unit = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(sigma / np.outer(unit, unit))
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def _covariance(calibration: Calibration, root: Float[np.ndarray, "leaves leaves"]) -> Covariance:
    names = parameter_names(calibration.rig)
    at = [names.index(name) for name in calibration.covariance.names]
    return Covariance(calibration.covariance.names, (root @ root.T)[np.ix_(at, at)])


def _described(
    calibration: Calibration,
    scene: Scene,
    pose: Float[np.ndarray, "6"],
    root: Float[np.ndarray, "leaves leaves"],
) -> NextPose:
    outline, stripes, weights, middle, R = (np.asarray(x) for x in _shown(scene, jnp.asarray(pose)))
    distance = float(np.linalg.norm(middle))
    sight, normal = middle / distance, R[:, 2]
    # The normal, which points away from the camera, leans towards the nearer side.
    leaning = (normal - (normal @ sight) * sight)[:2]
    angle = np.degrees(np.arccos(np.clip(normal @ sight, -1, 1)))
    return NextPose(
        pose=Pose(pose[:3], pose[3:]),
        distance_mm=distance,
        tilt_deg=angle * leaning / max(float(np.linalg.norm(leaning)), 1e-12),
        outline_px=outline,
        stripes_px=np.where(weights[..., None] > 0, stripes, np.nan),
        covariance=_covariance(calibration, root),
    )


@compiled(filtered=True)
def _shown(scene: Scene, pose: Float[Array, "6"]) -> tuple[Array, Array, Array, Array, Array]:
    """Outline in the image, stripes and their weights, middle and rotation in the camera frame."""
    T = Pose.from_vector(pose)
    outline = jax.vmap(lambda X: scene.rig.camera.project(T.apply(X)))(scene.outline)
    return outline, *scene.stripes(pose), T.apply(scene.outline.mean(axis=0)), T.matrix()


def _scene(calibration: Calibration) -> Scene:
    """The scene of a calibration; inside a `float64` block."""
    observations, rig = calibration.observations, calibration.rig
    lasers, columns, at = [], [], []
    for i, light in enumerate(rig.lights):
        seen = [stripe for view in observations.photographs() for stripe in view.stripes if stripe.laser == i]
        positions = np.array([stripe.position for stripe in seen] or [0.0])
        places = np.quantile(positions, (0.0, 0.5, 1.0)) if isinstance(light, MovingLight) else positions[:1]
        lasers += [i] * len(places)
        columns += [seen[0].columns if seen else True] * len(places)
        at += places.tolist()
    # A part of a session may have no views.
    fits = calibration.fits or calibration.moved_fits
    corner = _usual([fit.corner_sigmas[fit.corner_kept] for fit in fits])
    stripe = _usual([fit.stripe_sigmas[fit.stripe_kept] for fit in fits])
    stripe *= np.sqrt(calibration.stripe_correlation or 1.0)
    return Scene(
        rig=as_float64(rig),
        free=jnp.asarray([name in calibration.covariance.names for name in parameter_names(rig)]),
        shape=as_jax(calibration.system.shape),
        noise=Noise.create(corner, stripe, bend=calibration.bend_sigma_mm),
        points=jnp.asarray(observations.board.points()),
        outline=jnp.asarray(outline_of(observations.board)),
        columns=jnp.asarray(columns, bool),
        at=jnp.asarray(at, float),
        lasers=tuple(lasers),
    )


def _usual(sigmas: list[Float[np.ndarray, "_"]]) -> float:
    """The median σ; 1 where nothing was seen."""
    each = np.concatenate(sigmas)
    return float(np.median(each)) if len(each) else 1.0
