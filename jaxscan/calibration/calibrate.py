"""`calibrate`: from observations to a rig with its covariance."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.blocks import sequence_blocks, view_blocks
from jaxscan.calibration.bundle import MAX_STEPS, Factor
from jaxscan.calibration.coverage import measure_coverage
from jaxscan.calibration.diagnostics.board_flatness import board_flatness
from jaxscan.calibration.diagnostics.changes import find_change
from jaxscan.calibration.diagnostics.light_planes import light_plane_doubts
from jaxscan.calibration.diagnostics.sheet_curves import sheet_curves
from jaxscan.calibration.diagnostics.stripe_shapes import stripe_shapes
from jaxscan.calibration.first_camera import first_camera
from jaxscan.calibration.first_motions import first_motions, no_motion_yet
from jaxscan.calibration.first_poses import first_poses, poses_of_photographs
from jaxscan.calibration.held import held_parameters
from jaxscan.calibration.observability import cause_and_mend, undetermined, undetermined_shape
from jaxscan.calibration.observations import Kept, Observations, Unused, View
from jaxscan.calibration.on_board import stripe_on_board, stripe_points_in_space
from jaxscan.calibration.residuals import Blocks, Noise, far_away
from jaxscan.calibration.result import Calibration, assemble
from jaxscan.calibration.rounds import Refined, refine
from jaxscan.calibration.second_poses import better_poses
from jaxscan.errors import InputError, ObservabilityError, SolveError
from jaxscan.files.rig_checks import image_rays
from jaxscan.geometry import Pose
from jaxscan.images import Board
from jaxscan.precision import as_float64, as_jax, float64
from jaxscan.rig import LIGHTS, MOTIONS, BoardShape, Camera, Light, LightPlane, Rig, System
from jaxscan.rig.board_shape import BENDS, BOARD_SHAPES, FEWEST_VIEWS_FOR, bent_by
from jaxscan.rig.kinds import lens_of_kind

_FEWEST_CORNERS = 6
FEWEST_VIEWS = 3
_FEWEST_VIEWS_OF = {"flat": FEWEST_VIEWS, **FEWEST_VIEWS_FOR}
_OF_SHAPE = {
    "bulge": "the board's bulges along columns and rows",
    "warp": "the board's twist, and what its edges bend more or less than its middle,",
    "bend": "how much the board bends from view to view",
}
# σ of the bends to begin with, as a share of the board; and the range of a shape that is no board's any more.
_FIRST_BEND = 5e-4
_RUN_AWAY = 0.1
_FEWEST_STRIPES = 2
_FEWEST_STRIPE_POINTS = 10
_PLAIN = "plain least squares: every corner took part with the same weight, also where it does not fit the others"


def calibrate(
    observations: Observations,
    *,
    lens: str = "radial1",
    principal_point: str = "free",
    start: Camera | None = None,
    hold: Sequence[str] = (),
    tilted: bool = False,
    board_shape: str = "flat",
    plain: bool = False,
    keep: Sequence[Kept] | None = None,
    light: str | Sequence[str] = LightPlane.kind,
    factors: Sequence[Factor] = (),
    advance: Callable[[str], object] = lambda doing: None,
) -> Calibration:
    """Refine camera, lens, lights, the motion of every axis and all board poses together.

    Not to be traced, since values decide what is left out; `refit` differentiates the result.

    Args:
        observations: corners and stripes.
        lens: a kind of lens: none, radial1, radial2, radial3, brown, rational, fisheye, or one
            that was registered.
        principal_point: "free", or "centre" to hold it at the image centre.
        start: a camera to start from; its lens takes the place of `lens`. Without it a closed-form start is used.
        hold: names of the camera's parameters, as in `rig.json`, that keep the value of `start`; without a start lens
            terms can be held, at 0: `lens="brown", hold=["camera.radial.2"]` is k1 k2 p1 p2 with k3 = 0. Zeros of a
            camera that was read from a file were mostly held there: `hold=start.zero_terms()` holds them here.
        tilted: whether the sensor's tilt against the lens is found too, from that of `start`, or from none.
        board_shape: what of the board's shape is found too. "flat": nothing. "bulge": how far it bulges along columns
            and rows, the same in all photographs. "warp": its twist, and by how much one edge bends more than the
            other, besides. "bend": how far it bulges in each photograph, and on each axis, besides.
        plain: plain least squares, the estimate that OpenCV and Bouguet's toolbox make: every corner takes part with
            the same weight. What it gives up: outliers are not left out, a blurred photograph counts like a sharp
            one, and what the detector knows of each corner is not used.
        keep: which observations take part, as the `kept` of a finished calibration says it. None of them is then
            rejected, and nothing else is read, neither for the start nor later; σ and the photographs' weights are
            estimated as ever.
        light: the kind of the lasers' light, one of `rig.LIGHTS`: "plane", "bowed", or one that was registered; or one
            for each laser.
        factors: what else is known of the rig, besides boards and stripes; each with residuals in units of its σ.
        advance: called as each solve begins, with what it is, in words.

    Raises:
        InputError: too little to work with, or a trace; the text says what.
        ObservabilityError: the photographs do not determine the rig.
        SolveError: no minimum was reached.
    """
    kinds = [light] * len(observations.lasers) if isinstance(light, str) else list(light)
    if unknown := {light if isinstance(light, str) else LightPlane.kind, *kinds} - set(LIGHTS):
        raise InputError(f'light = "{min(unknown)}": this version knows {", ".join(LIGHTS)}; register the kind before')
    if isinstance(light, str) and light != LightPlane.kind and not kinds:
        raise InputError(f'light = "{light}": no laser was observed whose light that could be: leave it out')
    if len(kinds) != len(observations.lasers):
        raise InputError(f"light names {len(kinds)} kinds for {len(observations.lasers)} lasers: give one for each")
    if board_shape not in BOARD_SHAPES:
        raise InputError(f'board_shape = "{board_shape}": there are {", ".join(BOARD_SHAPES)}')
    tilted = tilted or bool(start and start.tilt)
    if tilted and not any(lens_of_kind(start.lens.kind if start else lens).numbers.values()):
        raise InputError(
            "a lens without distortion does not show where its axis is, so the tilt of the sensor cannot be told from "
            'the principal point: ask for lens = "radial1" or a richer one, or leave out the tilt'
        )
    held = held_parameters(
        hold, start.lens.kind if start else lens, principal_point, has_start=start is not None, tilted=tilted
    )
    _refuse_tracers(observations)
    if keep is not None:
        observations = observations.only(keep)
    if plain:
        observations = observations.unweighted()
    judge = keep is None and not plain
    usable = _with_enough_corners(observations)
    # What is known so far of photographs and stripes that cannot be used.
    known = [usable]
    with float64(), _with_remarks(known):
        _check_enough(usable)
        unused = Unused(usable.left_out)
        _check_views_for(board_shape, usable)
        camera = as_float64(start) if start else first_camera(usable, lens)
        if tilted and not camera.tilt:
            camera = replace(camera, tilt=(jnp.zeros(()), jnp.zeros(())))
        terms, bends = BOARD_SHAPES[board_shape]
        shape = BoardShape.of(jnp.zeros(terms)) if terms else None

        # The camera first, from the views' corners alone: lights and motion are there already, but held, and what they
        # would be found from is masked, so that both solves are one compiled function.
        lights = tuple(LIGHTS[kind].somewhere(name) for kind, name in zip(kinds, usable.lasers, strict=True))
        system = System(Rig(camera, lights, no_motion_yet(usable)), (), shape)
        views = view_blocks(usable)
        groups = (views, sequence_blocks(usable)) if usable.sequences else (views,)
        free = _free(system, held, ("camera",))
        poses = (first_poses(camera, views), *(far_away(len(group.points)) for group in groups[1:]))
        poses = tuple(_with_bends(each, bends) for each in poses)
        corners = _corners_of_views(groups)
        rounds = partial(refine, reject=judge, weigh=not plain)
        of_camera = partial(rounds, begins=lambda solve: advance(f"camera, round {solve}"))
        refined = of_camera(replace(system, poses=poses), free, corners, _first_noise(usable, bends))
        if judge and (elsewhere := better_poses(refined.system, corners, refined.noise)) is not None:
            refined = of_camera(elsewhere, free, corners, refined.noise)
        _check(refined, usable, free)

        if usable.lasers or usable.sequences:
            camera, view_poses = refined.system.rig.camera, refined.system.poses[0]
            stood = poses_of_photographs(usable, camera, view_poses[:, :6])
            if keep is None:
                usable, off_board = stripe_on_board(usable, camera, stood)
                unused = unused.and_then(off_board)
                known.append(replace(usable, left_out=unused.left_out))
            motion, moved_poses = first_motions(usable, stood)
            moved_poses = tuple(_with_bends(each, bends) for each in moved_poses)
            rig = Rig(camera, _first_lights(usable, camera, stood, kinds), motion)
            groups = (view_blocks(usable), sequence_blocks(usable)) if usable.sequences else (view_blocks(usable),)
            system = System(rig, (view_poses, *moved_poses), refined.system.shape)
            system = replace(system, poses=(*system.poses, *(factor.start(system) for factor in factors)))
            free = _free(system, held | rig.surplus(), ("camera", "lights", "motion"))
            of_rig = partial(rounds, begins=lambda solve: advance(f"whole rig, round {solve}"))
            refined = of_rig(system, free, groups, refined.noise, tuple(factors))
            _check(refined, usable, free)
        advance("uncertainty")
        result = assemble(refined, free, usable, held, unused, tuple(factors))
        curves = sheet_curves(refined)
        flatness = board_flatness(refined, result, curves)
        change = find_change(refined, result)
    kept = iter(result.kept)
    return replace(
        result,
        kept=tuple(
            Kept.none(view) if _lacking(view, observations.board) else next(kept) for view in observations.photographs()
        ),
        plain=plain,
        notes=(*result.notes, _PLAIN) if plain else result.notes,
        warnings=(
            *(f"{what}. {mend}".removesuffix(".") for what, mend in flatness.statements),
            *light_plane_doubts(stripe_shapes(result), curves),
            *([] if change is None else [f"{change.statement[0]}. {change.statement[1]}".removesuffix(".")]),
        ),
        flatness=flatness,
        sheet_curves=curves,
        change=change,
    )


@contextmanager
def _with_remarks(known: list[Observations]) -> Iterator[None]:
    """Let a refusal say what was seen amiss in the photographs (the last of what is known): often it is the reason."""
    try:
        yield
    except (InputError, ObservabilityError, SolveError) as error:
        if remarks := known[-1].remarks():
            raise type(error)(f"{error}{remarks}") from error
        raise


def _refuse_tracers(observations: Observations) -> None:
    values = [jnp.zeros(()), *(view.corners for view in observations.photographs())]
    values += [stripe.pixels for view in observations.photographs() for stripe in view.stripes]
    if any(isinstance(value, jax.core.Tracer) for value in values):
        raise InputError(
            "calibrate decides by values what it leaves out, so jit, grad and vmap cannot go through it: put "
            'jax.config.update("jax_enable_x64", True) before anything else, calibrate outside of them, and '
            "differentiate jaxscan.refit(calibration.adjustment)"
        )


def _lacking(view: View, board: Board) -> str:
    """What a photograph lacks of corners enough for its pose, in words; empty where it lacks nothing."""
    used = view.used()
    if used.sum() < _FEWEST_CORNERS:
        return f"{int(used.sum())} corners, fewer than {_FEWEST_CORNERS}"
    points = board.points()[used, :2]
    # Where all but one lie on a line, two of any three do.
    for i, j in ((0, 1), (0, 2), (1, 2)):
        (x, y), offset = points[j] - points[i], points - points[i]
        if (np.abs(offset[:, 1] * x - offset[:, 0] * y) > 1e-6 * board.pitch_mm**2).sum() < 2:
            return f"its {int(used.sum())} corners lie on one line of the board, or all but one do"
    return ""


def _with_enough_corners(observations: Observations) -> Observations:
    """Without the photographs that have too few corners for a pose; they are among what was left out."""
    board = observations.board
    few = [f"{view.name}: {lacks}" for view in observations.photographs() if (lacks := _lacking(view, board))]
    return replace(
        observations,
        views=tuple(view for view in observations.views if not _lacking(view, board)),
        sequences=tuple(
            sequence.only([i for i, view in enumerate(sequence.views) if not _lacking(view, board)])
            for sequence in observations.sequences
        ),
        left_out=(*observations.left_out, *few),
    )


def _check_enough(observations: Observations) -> None:
    """Refuse observations that are too few, and say what is missing."""
    views = observations.views
    if len(views) < FEWEST_VIEWS:
        raise InputError(
            f"{len(views)} usable views of the board; at least {FEWEST_VIEWS} are needed: photograph the board in "
            f"more poses, all of it in view and tilted in different directions{_on_axes_alone(observations)}"
        )
    for i, name in enumerate(observations.lasers):
        striped = sum(_stripe_points(view, i) >= _FEWEST_STRIPE_POINTS for view in observations.photographs())
        if striped < _FEWEST_STRIPES:
            which = f'of laser "{name}" ' if name else ""
            raise InputError(
                f"{striped} usable stripes {which}on the board; at least {_FEWEST_STRIPES} are needed, at different "
                f"distances: check [laser] color and columns, that the stripe crosses the board, and, where it has "
                f"photographs of its own, that boards and stripes are not exchanged"
            )
    for sequence in observations.sequences:
        places, fewest = len(np.unique(sequence.steps)), MOTIONS[sequence.kind].fewest
        if places < fewest:
            raise InputError(
                f"{places} usable {sequence.axis} photographs at different step counts; at least {fewest} are needed"
            )
    moving = _moving(observations)
    for sequence in observations.sequences:
        for axis, steps in sequence.positions.items():
            if axis not in moving and np.any(steps):
                raise InputError(
                    f"the {sequence.axis} was photographed away from the {axis}'s step 0, but no board on the {axis} "
                    f"tells how far that is: photograph one, or give {axis}_step = 0 under [{sequence.axis}]"
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


def _first_lights(
    observations: Observations, camera: Camera, poses: Pose[np.ndarray], kinds: Sequence[str]
) -> tuple[Light, ...]:
    lights = []
    for i, (kind, name) in enumerate(zip(kinds, observations.lasers, strict=True)):
        points, view = stripe_points_in_space(observations, camera, poses, i)
        if len(np.unique(view)) < _FEWEST_STRIPES:
            which = f'laser "{name}": ' if name else ""
            raise InputError(
                f"{which}the stripe lies on the board in {len(np.unique(view))} views; at least {_FEWEST_STRIPES} are "
                "needed: check [laser] color and columns, and that the stripe crosses the board"
            )
        lights.append(LIGHTS[kind].fitted(points, view, name))
    return tuple(lights)


def _corners_of_views(groups: tuple[Blocks, ...]) -> tuple[Blocks, ...]:
    """The same arrays with everything but the views' corners masked."""
    no_stripes = [replace(group, stripe_used=as_jax(np.zeros(group.stripe_used.shape, bool))) for group in groups]
    views, *moved = no_stripes
    return views, *(replace(group, corner_used=as_jax(np.zeros(group.corner_used.shape, bool))) for group in moved)


def _free(system: System, held: set[str], parts: tuple[str, ...]) -> Bool[Array, "shared"]:
    """Which shared parameters are refined: those of some parts of the rig that are not held, and the board's shape."""
    names = system.shared_names()
    return as_jax(np.array([name.startswith((*parts, "shape")) and name not in held for name in names]))


def _with_bends(poses: Float[Array, "blocks 6"], bends: bool) -> Float[Array, "blocks size"]:
    """Poses with bulges of zero behind them, where each board may have its own."""
    return jnp.pad(poses, ((0, 0), (0, BENDS if bends else 0)))


def _first_noise(observations: Observations, bends: bool) -> Noise:
    """What the first rounds begin with."""
    extent = float(np.ptp(observations.board.points()[:, :2], axis=0).max())
    return Noise.create(bend=_FIRST_BEND * extent if bends else None)


def _check_views_for(board_shape: str, observations: Observations) -> None:
    """Refuse views that are too few for the shape that is asked for."""
    views, fewest = len(observations.views), _FEWEST_VIEWS_OF[board_shape]
    if views < fewest:
        simpler = [name for name, count in _FEWEST_VIEWS_OF.items() if count <= views]
        raise InputError(
            f'{views} usable views of the board; board_shape = "{board_shape}" needs {fewest}, to tell '
            f"{_OF_SHAPE[board_shape]} from the camera: photograph it in more poses, tilted in different directions, "
            f'or ask for board_shape = "{simpler[-1]}"'
        )


def _check(refined: Refined, observations: Observations, free: Bool[Array, "shared"]) -> None:
    """Refuse what is no calibration."""
    rig, names = refined.system.rig, np.array(refined.system.shared_names())
    at = np.flatnonzero(free)
    values = np.array(refined.system.values())
    spread = np.asarray(refined.precision.covariance)[np.ix_(at, at)]
    directions = np.asarray(refined.precision.directions)[at]
    noise_px = max(float(refined.noise.corner), float(refined.noise.stripe))
    open_question = None
    if np.isfinite(values).all() and np.isfinite(spread).all():
        eigenvalues = np.asarray(refined.precision.eigenvalues)
        open_question = undetermined(names[at].tolist(), values[at], eigenvalues, directions, spread, noise_px)
        for i, light in enumerate(rig.lights if open_question is None else ()):
            own = [k for k, name in enumerate(names[at]) if name.startswith(f"lights.{i}.")]
            if own and open_question is None:
                covariance = spread[np.ix_(own, own)]
                rays = image_rays(rig.camera)
                open_question = undetermined_shape(light, names[at][own].tolist(), covariance, rays, noise_px)
    if open_question:
        with_rig = rig if any(name.startswith("lights") for name in names[at]) else Rig(rig.camera)
        coverage = measure_coverage(
            observations, with_rig, poses_of_photographs(observations, rig.camera, refined.system.poses[0][:, :6])
        )
        raise ObservabilityError(
            f"from these {len(observations.views)} views {open_question.words}: "
            f"{cause_and_mend(open_question, coverage)}"
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
    size = float(np.linalg.norm(np.ptp(board.points()[:, :2], axis=0)))
    range_mm = bent_by(np.array([float(term) for term in jax.tree.leaves(shape)]))[0]
    if not range_mm <= _RUN_AWAY * size:
        raise SolveError(
            f"the board's shape ran away: it came out bent by {range_mm:.3g} mm, over {size:.0f} mm. Something else "
            'does not fit, and the shape took it up: calibrate with board_shape = "flat" and see which photographs '
            "do not fit, whether all show one board, and whether the lens needs more terms"
        )
