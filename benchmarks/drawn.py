"""Observations drawn, not photographed: what an ideal detector sees of the simulated rig of 2003, plus noise."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxscan.calibration import BoardSequence, Observations, StripePoints, View
from jaxscan.geometry import Pose
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Camera, Rig
from jaxscan.simulation import rig_2003
from jaxscan.simulation.profile import true_profile

# Half as many photographs of the board on the turntable as are simulated: a draw takes half the time.
_TURNTABLE_VIEWS = 16


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what is seen, pixels."""

    corner: float = 0.02
    stripe: float = 0.06


def exact_session(seed: int, lasers: int = 1) -> tuple[Rig, Observations]:
    """The rig of a seed, and what is seen of its boards without any noise."""
    rig = rig_2003.simulated_rig(seed, lasers)
    poses, stage = rig_2003.board_poses(rig, seed), rig_2003.stage_pose(rig, seed)
    points = rig_2003.BOARD.points()
    steps = rig_2003.STEPS_APART * np.arange(rig_2003.STAGE_VIEWS, dtype=float)
    first = stage.apply(points)
    along = tuple(
        View(f"stage-{i}", project(rig.camera, first + moved))
        for i, moved in enumerate(rig_2003.stage_travel(rig, steps))
    )
    return rig, Observations(
        rig_2003.IMAGE_SIZE,
        rig_2003.BOARD,
        exact_views(rig, poses),
        (BoardSequence({"stage": steps}, along),),
        lasers=tuple(laser.name for laser in rig.lights),
    )


def exact_turn(rig: Rig, seed: int, columns_apart: int | None = None) -> BoardSequence:
    """What is seen of the board on the turntable of a rig that has one, without any noise.

    Args:
        rig: the rig.
        seed: of where the board lies.
        columns_apart: from one stripe point to the next; None for no stripes.
    """
    turns = rig_2003.turns_of(_TURNTABLE_VIEWS)
    steps = np.full(len(turns), float(rig_2003.turntable_stage_step(rig)))
    boards = rig_2003.turned_boards(rig, rig_2003.turntable_pose(rig, seed), turns)
    rotations = np.stack([board.rotation for board in boards])
    translations = np.stack([board.translation for board in boards]) + rig_2003.stage_travel(rig, steps)
    views = exact_views(rig, Pose(rotations, translations), "turntable", columns_apart)
    return BoardSequence({"stage": steps, "turntable": turns.astype(float)}, views, "turntable", "rotary")


def exact_views(rig: Rig, poses: Pose, stem: str = "view", columns_apart: int | None = 1) -> tuple[View, ...]:
    """What is seen of the board in some poses, stacked, with each laser on it as in `exact_turn`."""
    points, views = rig_2003.BOARD.points(), []
    for i, (rotation, translation) in enumerate(
        zip(np.asarray(poses.rotation), np.asarray(poses.translation), strict=True)
    ):
        scene = rig_2003.board_scene(rotation, translation)
        X = Pose(rotation, translation).apply(points)
        lasers = range(len(rig.lights)) if columns_apart else ()
        stripes = tuple(_stripe(true_profile(rig, scene, laser=n).position, n, columns_apart) for n in lasers)
        views.append(View(f"{stem}-{i}", project(rig.camera, X), stripes=stripes))
    return tuple(views)


def _stripe(position: Float[np.ndarray, "columns"], laser: int, columns_apart: int | None) -> StripePoints:
    columns = np.where(np.isfinite(position), np.arange(len(position)), np.nan)
    # No squares were drawn, so that their edges need not be kept away from.
    pixels = np.stack([columns, position], axis=-1)[::columns_apart]
    return StripePoints(pixels, laser=laser, half_width_px=1e-6)


def redrawn(exact: Observations, noise: Noise, random: np.random.Generator) -> Observations:
    """The same observations with fresh noise."""

    def corners(view: View) -> View:
        return replace(view, corners=view.corners + noise.corner * random.normal(size=view.corners.shape))

    def stripes(view: View) -> View:
        return replace(
            view,
            stripes=tuple(
                replace(s, pixels=s.pixels + noise.stripe * random.normal(size=(len(s.pixels), 1)) * [0.0, 1.0])
                for s in view.stripes
            ),
        )

    return replace(
        exact,
        views=tuple(stripes(corners(view)) for view in exact.views),
        sequences=tuple(
            replace(sequence, views=tuple(stripes(corners(view)) for view in sequence.views))
            for sequence in exact.sequences
        ),
    )


def project(camera: Camera, X: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 2"]:
    """Where points (camera frame, mm) are seen."""
    with float64():
        return np.asarray(_projected(as_float64(camera), jnp.asarray(X)))


@jax.jit
def _projected(camera: Camera, X: Float[Array, "points 3"]) -> Float[Array, "points 2"]:
    return jax.vmap(camera.project)(X)
