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
        View(f"stage-{i}", _project(rig.camera, first + moved))
        for i, moved in enumerate(rig_2003.stage_travel(rig, steps))
    )
    return rig, Observations(
        rig_2003.IMAGE_SIZE,
        rig_2003.BOARD,
        exact_views(rig, poses),
        (BoardSequence({"stage": steps}, along),),
        lasers=tuple(laser.name for laser in rig.lights),
    )


def exact_turn(rig: Rig, seed: int) -> BoardSequence:
    """What is seen of the board on the turntable of a rig that has one, without any noise."""
    points, turns = rig_2003.BOARD.points(), rig_2003.TURNS_APART * np.arange(rig_2003.TURNTABLE_VIEWS)
    steps = np.full(len(turns), float(rig_2003.TURNTABLE_STAGE_STEP))
    boards = rig_2003.turned_boards(rig, rig_2003.turntable_pose(rig, seed), turns)
    views = tuple(
        View(
            f"turntable-{i}",
            _project(rig.camera, board.apply(points) + moved),
        )
        for i, (board, moved) in enumerate(zip(boards, rig_2003.stage_travel(rig, steps), strict=True))
    )
    return BoardSequence({"stage": steps, "turntable": turns.astype(float)}, views, "turntable", "rotary")


def exact_views(rig: Rig, poses: Pose) -> tuple[View, ...]:
    """What is seen of the board in some poses, stacked, with each laser on it."""
    points, views = rig_2003.BOARD.points(), []
    for i, (rotation, translation) in enumerate(
        zip(np.asarray(poses.rotation), np.asarray(poses.translation), strict=True)
    ):
        scene = rig_2003.board_scene(rotation, translation)
        X = Pose(rotation, translation).apply(points)
        stripes = tuple(_stripe(true_profile(rig, scene, laser=n).position, n) for n in range(len(rig.lights)))
        views.append(View(f"view-{i}", _project(rig.camera, X), stripes=stripes))
    return tuple(views)


def _stripe(position: Float[np.ndarray, "columns"], laser: int) -> StripePoints:
    columns = np.where(np.isfinite(position), np.arange(len(position)), np.nan)
    # No squares were drawn, so that their edges need not be kept away from.
    return StripePoints(np.stack([columns, position], axis=-1), laser=laser, half_width_px=1e-6)


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
        sequences=tuple(replace(stage, views=tuple(map(corners, stage.views))) for stage in exact.sequences),
    )


def _project(camera: Camera, X: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 2"]:
    with float64():
        return np.asarray(_projected(as_float64(camera), jnp.asarray(X)))


@jax.jit
def _projected(camera: Camera, X: Float[Array, "points 3"]) -> Float[Array, "points 2"]:
    return jax.vmap(camera.project)(X)
