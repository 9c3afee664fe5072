"""What `calibrate` refuses, and why: too little to work with, what is not determined, and what ran away."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from jaxscan.axis_details import is_detail
from jaxscan.calibration.bundle import MAX_STEPS
from jaxscan.calibration.coverage import measure_coverage
from jaxscan.calibration.first_camera import beyond_the_ladder
from jaxscan.calibration.first_poses import poses_of_photographs
from jaxscan.calibration.observability import cause_and_fix, undetermined, undetermined_shape
from jaxscan.calibration.observations import Observations, View
from jaxscan.calibration.rounds import Refined
from jaxscan.calibration.stage_order import stage_orders
from jaxscan.errors import InputError, ObservabilityError, SolveError
from jaxscan.files.rig_checks import image_rays
from jaxscan.phrases import of_laser
from jaxscan.rig import MOTIONS, BowedSheet, Camera, LightPlane, MovingLight, Rig
from jaxscan.rig.board_shape import FEWEST_VIEWS_FOR, bent_by, half_diagonal_of
from jaxscan.rig.fisheye import Fisheye
from jaxscan.rig.opencv_lens import LADDER
from jaxscan.rig.projection import off_axis, pixel_rays
from jaxscan.rig.splined import Splined

_FEWEST_CORNERS = 6
_FARTHEST_PX, _THINNEST_PX = 1e6, 0.1
FEWEST_VIEWS = 3
_FEWEST_VIEWS_OF = {"flat": FEWEST_VIEWS, **FEWEST_VIEWS_FOR}
_OF_SHAPE = {
    "bulge": "the board's bulges along columns and rows",
    "warp": "the board's twist, and what its edges bend more or less than its middle,",
    "bend": "how much the board bends from view to view",
}
# As far off the axis (degrees) the model of a bowed sheet goes.
_BOWS_END_DEG = 80.0
# The range of a shape, as a share of the board, that is no board's any more.
_RUN_AWAY = 0.1
FEWEST_STRIPES = 2
FEWEST_STRIPE_POINTS = 10


@contextmanager
def with_remarks(known: list[Observations], lens: str | None = None) -> Iterator[None]:
    """Add to a refusal what was wrong in the photographs (the last of what is known): often it is the reason.

    Args:
        known: what is known of the photographs, the last is read.
        lens: that was asked for; None where a camera was given.
    """
    try:
        yield
    except (InputError, ObservabilityError, SolveError) as error:
        remarks = known[-1].remarks()
        if isinstance(error, ObservabilityError | SolveError) and (lens in LADDER or lens == Splined.kind):
            angle = beyond_the_ladder(known[-1])
            if angle is not None:
                remarks = (
                    f". The corners are {angle:.0f}° off the camera's axis, where only a fisheye sees them: calibrate "
                    f'with lens = "{Fisheye.kind}"{remarks}'
                )
        if remarks:
            raise type(error)(f"{error}{remarks}") from error
        raise


def refuse_tracers(observations: Observations) -> None:
    """Refuse observations that JAX traces: what is left out is decided by values."""
    values = [jnp.zeros(()), *(view.corners for view in observations.photographs())]
    values += [stripe.pixels for view in observations.photographs() for stripe in view.stripes]
    if any(isinstance(value, jax.core.Tracer) for value in values):
        raise InputError(
            "calibrate decides by values what it leaves out, so jit, grad and vmap cannot go through it: put "
            'jax.config.update("jax_enable_x64", True) before anything else, calibrate outside of them, and '
            "differentiate jaxscan.refit(calibration.adjustment)"
        )


def _lacking(view: View, points: Float[np.ndarray, "corners 3"], pitch_mm: float) -> str:
    """What a photograph lacks of corners enough for its pose, in words; empty where it lacks nothing."""
    used = view.used()
    if used.sum() < _FEWEST_CORNERS:
        return f"{int(used.sum())} corners, fewer than {_FEWEST_CORNERS}"
    points = points[used, :2]
    # Where all but one lie on a line, two of any three do.
    for i, j in ((0, 1), (0, 2), (1, 2)):
        (x, y), offset = points[j] - points[i], points - points[i]
        if (np.abs(offset[:, 1] * x - offset[:, 0] * y) > 1e-6 * pitch_mm**2).sum() < 2:
            return f"its {int(used.sum())} corners lie on one line of the board, or all but one do"
    pixels = view.corners[used]
    if (far := float(np.abs(pixels).max())) > _FARTHEST_PX:
        return f"a corner at {far:.3g} px, where no photograph reaches"
    if np.linalg.svd(pixels - pixels.mean(axis=0), compute_uv=False)[1] < _THINNEST_PX * np.sqrt(len(pixels)):
        return f"its {int(used.sum())} corners lie in one place of the photograph, or on one line"
    return ""


def with_enough_corners(observations: Observations) -> tuple[Observations, tuple[bool, ...]]:
    """Without the photographs that have too few corners for a pose; they are among what was left out.

    Returns:
        The others, and which of `photographs()` they are.
    """
    photographs = observations.photographs()
    points, pitch_mm = observations.board.points(), observations.board.pitch_mm
    lacks = [_lacking(view, points, pitch_mm) for view in photographs]
    enough = tuple(not each for each in lacks)
    left = iter(enough)
    few = [f"{view.name}: {each}" for view, each in zip(photographs, lacks, strict=True) if each]
    usable = replace(
        observations,
        views=tuple(view for view in observations.views if next(left)),
        sequences=tuple(
            sequence.only([i for i in range(len(sequence.views)) if next(left)]) for sequence in observations.sequences
        ),
        left_out=(*observations.left_out, *few),
    )
    return usable, enough


def check_enough(observations: Observations) -> None:
    """Refuse observations that are too few, and say what is missing."""
    views = observations.views
    if len(views) < FEWEST_VIEWS:
        raise InputError(
            f"{len(views)} usable views of the board; at least {FEWEST_VIEWS} are needed: photograph the board in "
            f"more poses, all of it in view and tilted in different directions{_on_axes_alone(observations)}"
        )
    for i, name in enumerate(observations.lasers):
        striped = sum(_stripe_points(view, i) >= FEWEST_STRIPE_POINTS for view in observations.photographs())
        if striped < FEWEST_STRIPES:
            raise InputError(
                f"{striped} usable stripes{of_laser(name)} on the board; at least {FEWEST_STRIPES} are needed, at "
                "different distances: check [laser] color and columns, that the stripe crosses the board, and, where "
                "it has photographs of its own, that boards and stripes are not exchanged"
            )
    for sequence in observations.sequences:
        check_places(sequence.axis, sequence.kind, len(np.unique(sequence.steps)))
    moving = _moving(observations)
    for sequence in observations.sequences:
        for axis, steps in sequence.positions.items():
            if axis not in moving and not is_detail(axis) and np.any(steps):
                raise InputError(
                    f"the {sequence.axis} was photographed away from the {axis}'s step 0, but no board on the {axis} "
                    f"shows how far that is: photograph one, or give {axis}_step = 0 under [{sequence.axis}]"
                )


def _on_axes_alone(observations: Observations) -> str:
    """Why photographs of the board on the axes do not take the place of views, where there are any."""
    count = sum(len(sequence.views) for sequence in observations.sequences)
    if not count:
        return ""
    return (
        f". The {count} photographs of it on the {' and the '.join(_moving(observations))} do not count: they show how "
        "it is moved once the camera is known, and the camera is found from a board that is held in the hand"
    )


def _moving(observations: Observations) -> list[str]:
    """The axes that have photographs, each once."""
    return list(dict.fromkeys(sequence.axis for sequence in observations.sequences))


def _stripe_points(view: View, laser: int) -> int:
    return sum(int(np.isfinite(s.pixels).all(axis=1).sum()) for s in view.stripes if s.laser == laser)


def check_views_for(board_shape: str, views: int) -> None:
    """Refuse views of the board that are too few for the shape that is asked for.

    Raises:
        InputError: they are.
    """
    fewest = _FEWEST_VIEWS_OF[board_shape]
    if views < fewest:
        simpler = [name for name, count in _FEWEST_VIEWS_OF.items() if count <= views]
        raise InputError(
            f'{views} usable views of the board; board_shape = "{board_shape}" needs {fewest}, to distinguish '
            f"{_OF_SHAPE[board_shape]} from the camera: photograph it in more poses, tilted in different directions, "
            f'or ask for board_shape = "{simpler[-1]}"'
        )


def check_places(axis: str, kind: str, places: int) -> None:
    """Refuse photographs of the board on an axis that are at too few places for the kind of its motion.

    Raises:
        InputError: they are.
    """
    fewest = MOTIONS[kind].fewest
    if places < fewest:
        raise InputError(
            f"{places} usable {axis} photographs at different step counts; at least {fewest} are needed to find a "
            f"motion of the kind {kind}: photograph the board at more places of the {axis}, or ask for a simpler kind"
        )


def _positions(observations: Observations, laser: int) -> Float[np.ndarray, "positions"]:
    """The positions of what moves a light at which its stripes were seen, motor steps, each once."""
    seen = [s.position for view in observations.photographs() for s in view.stripes if s.laser == laser]
    return np.unique(np.array(seen, np.float64))


def check_bows(observations: Observations, camera: Camera, kinds: Sequence[str]) -> None:
    """Refuse stripes beside the camera and behind it where a sheet is to be bowed.

    The apex of the sheet's cone is taken to be in the plane of the camera's centre. One that is off that by a share of
    the distance changes the bow by that share / cos θ, at the angle θ from the axis: 1 / cos 80° is 6.

    Args:
        observations: photographs with their stripes.
        camera: as it is known, by the corners.
        kinds: of each laser's sheet.

    Raises:
        InputError: a stripe is more than 80° off the axis.
    """
    if BowedSheet.kind not in kinds:
        return
    found: list[tuple[float, str]] = []
    for view in observations.photographs():
        for stripe in view.stripes:
            if kinds[stripe.laser] == BowedSheet.kind:
                rays = pixel_rays(camera, stripe.pixels[np.isfinite(stripe.pixels).all(axis=1)])
                angles = np.degrees(off_axis(rays))
                found.append((float(np.nanmax(angles, initial=0.0)), view.name))
    angle, name = max(found, default=(0.0, ""))
    if angle > _BOWS_END_DEG:
        count = sum(each > _BOWS_END_DEG for each, _ in found)
        raise InputError(
            f"the stripe in {name} is {angle:.0f}° off the camera's axis, and a bowed sheet is known only up to "
            f"{_BOWS_END_DEG:g}°, since its light is taken to come from beside the camera: calibrate with a flat sheet "
            f'(light = "{LightPlane.kind}", --sheet {LightPlane.kind}), or leave out the {count} stripes that are '
            "farther off"
        )


def check_solved(refined: Refined, observations: Observations, free: Bool[Array, "shared"]) -> None:
    """Refuse what is no calibration."""
    rig, names = refined.system.rig, np.array(refined.system.shared_names())
    at = np.flatnonzero(free)
    values = np.array(refined.system.values())
    spread = refined.precision.covariance[np.ix_(at, at)]
    directions = refined.precision.directions[at]
    noise_px = max(float(refined.noise.corner), float(refined.noise.stripe))
    open_question = None
    if np.isfinite(values).all() and np.isfinite(spread).all():
        eigenvalues = refined.precision.eigenvalues
        open_question = undetermined(names[at].tolist(), values[at], eigenvalues, directions, spread, noise_px)
        for i, light in enumerate(rig.lights if open_question is None else ()):
            own = [k for k, name in enumerate(names[at]) if name.startswith(f"lights.{i}.")]
            if own and open_question is None:
                covariance = spread[np.ix_(own, own)]
                rays = image_rays(rig.camera)
                positions = _positions(observations, i) if isinstance(light, MovingLight) else None
                open_question = undetermined_shape(
                    light, names[at][own].tolist(), covariance, rays, noise_px, positions
                )
    if open_question:
        with_rig = rig if any(name.startswith("lights") for name in names[at]) else Rig(rig.camera)
        coverage = measure_coverage(
            observations, with_rig, poses_of_photographs(observations, rig.camera, refined.system.poses[0][:, :6])
        )
        for mixed in stage_orders(observations, rig):
            raise ObservabilityError(". ".join(mixed.statement))
        raise ObservabilityError(
            f"from these {len(observations.views)} views {open_question.words}: "
            f"{cause_and_fix(open_question, coverage, float(refined.noise.corner))}"
        )
    _refuse_what_ran_away(refined, observations)
    # Last, since what is not determined is mostly not reached either.
    if refined.outcome.result != optx.RESULTS.successful:
        raise SolveError(
            f"the solve did not reach a minimum within {MAX_STEPS} steps ({refined.solves} rounds): the photographs "
            "may not belong to one camera, or the lens may need a simpler model"
        )


def _refuse_what_ran_away(refined: Refined, observations: Observations) -> None:
    """A board bent by a tenth of itself is none: its shape took up what something else is at fault for."""
    shape, board = refined.system.shape, observations.board
    if shape is None:
        return
    size = 2 * half_diagonal_of(board.points())
    range_mm = bent_by(np.array([float(term) for term in jax.tree.leaves(shape)]))[0]
    if not range_mm <= _RUN_AWAY * size:
        raise SolveError(
            f"the solve for the board's shape diverged: it came out bent by {range_mm:.3g} mm, over {size:.0f} mm. "
            "If the board is bent so far, which no shape describes, make it flat. If not, something else does not fit, "
            'and the shape absorbed it: calibrate with board_shape = "flat" and see which photographs do not fit, '
            "whether all show one board, and whether the lens needs more terms"
        )
