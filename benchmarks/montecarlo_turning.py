"""Predicted against actual scatter of a rig with a turntable, and of points scanned while it turns.

The session of `montecarlo`, and 16 photographs of the board on the turntable with some columns of the stripe on them.
The points are those that the same pixels see at eight angles of a full turn. Asked besides

- of the rig each part by itself, and of the turntable the direction of its axis, the place where that goes through the
  platform, and the angle of a step,
- `points_by_rig`: the points without the noise of their own stripe,
- `half_a_turn_apart`: where a point stands from the one that the same pixel sees half a turn later, which no shift
  common to all points touches.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from benchmarks.drawn import exact_session, exact_turn
from benchmarks.metric import Metric
from benchmarks.montecarlo import DRAWS_QUICK, PIXELS, Session, compared, leaves, triangulated
from jaxscan.rig import Rig, Rotary
from jaxscan.simulation import rig_2003

_DRAWS = 900
_ANGLES = 8
# Of the stripe on the turning board: with every column a draw takes three times as long.
_COLUMNS_APART = 16
_PIXELS = np.tile(PIXELS, (_ANGLES, 1))
_TURNS = np.repeat(rig_2003.STEPS_PER_TURN / _ANGLES * np.arange(_ANGLES), len(PIXELS))
_UNDER_SHEET = float(rig_2003.turning_axes(rig_2003.TURN_APART)["stage"][0])
_POSITIONS = {"stage": np.full(len(_TURNS), _UNDER_SHEET), "turntable": _TURNS}
_PLATFORM = rig_2003.platform(rig_2003.simulated_rig(0))


def measure(quick: bool) -> list[Metric]:
    """Draw, solve, compare."""
    plain, exact = exact_session(seed=0)
    rig = rig_2003.with_turntable(plain, 0)
    session = Session(
        "montecarlo_turning",
        rig,
        replace(exact, sequences=(*exact.sequences, exact_turn(rig, 0, _COLUMNS_APART))),
        rig_2003.board_poses(rig, 0),
        (rig_2003.stage_pose(rig, 0), rig_2003.turntable_pose(rig, 0)),
        _PIXELS,
        _POSITIONS,
        {
            "focal": lambda rig: leaves(rig.camera.focal),
            "principal_point": lambda rig: leaves(rig.camera.principal),
            "lens": lambda rig: leaves(rig.camera.lens),
            "light_plane": lambda rig: leaves(rig.lights),
            "stage": lambda rig: leaves(rig.axis("stage")),
            "axis_direction": lambda rig: _axis(rig)[:2],
            "axis_place": lambda rig: _axis(rig)[2:4],
            "axis_step": lambda rig: _axis(rig)[4:],
            "points_by_rig": _points,
            "half_a_turn_apart": lambda rig: _points(rig)[: len(_PIXELS) // 2] - _points(rig)[len(_PIXELS) // 2 :],
        },
    )
    return compared(session, DRAWS_QUICK if quick else _DRAWS, quick)


@jax.jit
def _axis(rig: Rig) -> Float[Array, "5"]:
    """Direction of the axis across the platform's upright, its place on the platform (mm), the angle of a step."""
    turntable = rig.axis("turntable")
    assert isinstance(turntable, Rotary)
    w, centre = leaves(turntable.per_step), leaves(turntable.centre)
    step = jnp.linalg.norm(w)
    R, origin = _PLATFORM
    direction, from_origin = R.T @ (w / step), R.T @ (centre - origin)
    through = from_origin - direction * from_origin[2] / direction[2]
    return jnp.stack([*direction[:2], *through[:2], step])


def _points(rig: Rig) -> Float[Array, "points 3"]:
    return triangulated(rig, jnp.asarray(_PIXELS), {axis: jnp.asarray(steps) for axis, steps in _POSITIONS.items()})
