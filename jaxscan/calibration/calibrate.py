"""`calibrate`: from observations to a rig with its covariance."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxscan.calibration.assemble import assemble
from jaxscan.calibration.blocks import sequence_blocks, view_blocks
from jaxscan.calibration.bundle import Factor
from jaxscan.calibration.diagnostics.sheet_curves import unclear_bows
from jaxscan.calibration.first_camera import first_camera
from jaxscan.calibration.first_motions import first_motions, no_motion_yet
from jaxscan.calibration.first_poses import first_poses, poses_of_photographs
from jaxscan.calibration.hand import check_enough_poses
from jaxscan.calibration.held import held_parameters, parameters_beyond_camera, with_held_values
from jaxscan.calibration.judged import judged
from jaxscan.calibration.lens_field import (
    FieldPrior,
    base_of,
    check_enough_for_field,
    first_field,
    held_beside_field,
    with_field,
)
from jaxscan.calibration.observations import InlierMask, Observations, Unused
from jaxscan.calibration.on_board import stripe_on_board, stripe_points_in_space
from jaxscan.calibration.pose_ambiguity import resolve_pose_ambiguity
from jaxscan.calibration.refusals import (
    FEWEST_STRIPES,
    check_bows,
    check_enough,
    check_solved,
    check_views_for,
    refuse_tracers,
    with_enough_corners,
    with_remarks,
)
from jaxscan.calibration.residuals import Blocks, Noise, far_away
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import refine
from jaxscan.calibration.stage_kinds import begun, first_approach, shape_parameters, with_kinds
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.phrases import laser_called, laser_prefix
from jaxscan.precision import as_float64, as_jax, float64
from jaxscan.rig import LIGHTS, BoardShape, Camera, Light, LightPlane, Rig, System
from jaxscan.rig.board_shape import BENDS, BOARD_SHAPES
from jaxscan.rig.light import moves
from jaxscan.rig.splined import Splined
from jaxscan.rig.stripe_way import steep_notes

# σ of the bends to begin with, as a share of the board.
_FIRST_BEND = 5e-4
PLAIN = "plain least squares: every corner took part with the same weight, also where it does not fit the others"


def calibrate(
    observations: Observations,
    *,
    lens: str = "radial1",
    principal_point: str = "free",
    start: Camera | Rig | None = None,
    hold: Sequence[str] = (),
    tilted: bool = False,
    board_shape: str = "flat",
    plain: bool = False,
    keep: Sequence[InlierMask] | None = None,
    light: str | Sequence[str] = LightPlane.kind,
    motion: Mapping[str, str] | None = None,
    periods: Mapping[str, float] | None = None,
    factors: Sequence[Factor] = (),
    advance: Callable[[str], object] = lambda doing: None,
) -> Calibration:
    """Refine camera, lens, lights, the motion of every axis and all board poses together.

    JAX cannot trace it, because values decide what is left out; `refit` differentiates the result.

    Args:
        observations: corners and stripes.
        lens: a kind of lens: none, radial1, radial2, radial3, brown, rational, fisheye, splined, or one
            that was registered.
        principal_point: "free", or "centre" to hold it at the image centre.
        start: a camera to start from; its lens replaces `lens`. Or a rig: its camera is used, and its lights and motion
            are found from the photographs unless they are held. Without it a closed-form start is used.
        hold: names of parameters, as in `rig.json`, that keep the value of `start`, those of lights and motion that of
            a rig: `motion.stage.per_step.0`. Without a start lens terms can be held, at 0: `lens="brown",
            hold=["camera.radial.2"]` is k1 k2 p1 p2 with k3 = 0. Zeros of a camera that was read from a file were
            mostly held there: `hold=start.zero_terms()` holds them here.
        tilted: whether the sensor's tilt against the lens is found too, from that of `start`, or from none.
        board_shape: what of the board's shape is found too. "flat": nothing. "bulge": how far it bulges along columns
            and rows, the same in all photographs. "warp": also its twist, and by how much one edge bends more than
            the other. "bend": also how far it bulges in each photograph, and on each axis.
        plain: plain least squares, the estimate that OpenCV and Bouguet's toolbox make: every corner takes part with
            the same weight. Its cost: outliers are not left out, a blurred photograph counts like a sharp one, and the
            detector's σ of each corner is not used.
        keep: which observations take part, as in the `kept` of a finished calibration. None of them is then rejected,
            and no others are read, neither for the start nor later; σ and the photographs' weights are estimated as
            usual.
        light: the kind of the lasers' light, one of `rig.LIGHTS`: "plane", "bowed", or one that was registered; or one
            for each laser.
        motion: the kind of motion of an axis, by its name, one of `rig.MOTIONS`: "linear", a line; "guide", a bowed
            one; "screw", whose screw has a period; "screw_on_guide", both; or one that was registered. An axis that is
            not named has the kind of its photographs.
        periods: steps of one turn of an axis's screw, by its name, where they are known; else they are found.
        factors: further knowledge of the rig, in addition to boards and stripes; each with residuals in units of its σ.
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
    for kind, name in zip(kinds, observations.lasers, strict=True):
        if moves(LIGHTS[kind]) != (name in observations.light_axes):
            raise InputError(
                f'{laser_called(name)}: light = "{kind}", and light_axes of the observations is '
                f"{dict(observations.light_axes)}: name there what moves it if its light moves, and only then"
            )
    if board_shape not in BOARD_SHAPES:
        raise InputError(f'board_shape = "{board_shape}": there are {", ".join(BOARD_SHAPES)}')
    known_rig = start if isinstance(start, Rig) else None
    start = start.camera if isinstance(start, Rig) else start
    tilted = tilted or bool(start and start.tilt)
    held = held_parameters(
        hold,
        start.lens.kind if start else lens,
        principal_point,
        has_start=start is not None,
        tilted=tilted,
        beyond=parameters_beyond_camera(known_rig) if known_rig else (),
    )
    refuse_tracers(observations)
    if keep is not None:
        observations = observations.only(keep)
    if plain:
        observations = observations.unweighted()
    observations = with_kinds(observations, motion or {}, periods or {})
    judge = keep is None and not plain
    usable, enough = with_enough_corners(observations)
    # What is known so far of photographs and stripes that cannot be used.
    known: list[Observations] = [usable]
    aliases: list[str] = []
    approached: list[str] = []
    with float64(), with_remarks(known, None if start else lens):
        check_enough(usable)
        check_enough_poses(usable)
        unused = Unused(usable.left_out)
        check_views_for(board_shape, len(usable.views))
        kind = start.lens.kind if start else lens
        if kind == Splined.kind:
            check_enough_for_field(usable)
        camera = as_float64(start) if start else first_camera(usable, base_of(lens))
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
        held = held | system.rig.given() | held_beside_field(camera)
        free = _free(system, held, ("camera",))
        poses = (first_poses(camera, views), *(far_away(len(group.points)) for group in groups[1:]))
        poses = tuple(_with_bends(each, bends) for each in poses)
        corners = _corners_of_views(groups)
        rounds = partial(refine, reject=judge, weigh=not plain)
        of_camera = partial(rounds, begins=lambda solve: advance(f"camera, round {solve}"))
        noise = replace(_first_noise(usable, bends), field=_first_field(system, free))
        refined = of_camera(replace(system, poses=poses), free, corners, noise)
        if judge and (elsewhere := resolve_pose_ambiguity(refined, corners)) is not None:
            refined = of_camera(elsewhere, free, corners, refined.noise)
        if kind != camera.lens.kind:
            # A field of shifts on top of the terms, on a grid over the image as these see it.
            camera = with_field(refined.system.rig.camera)
            system = replace(refined.system, rig=replace(refined.system.rig, camera=camera))
            held = held | system.rig.given() | held_beside_field(camera)
            free = _free(system, held, ("camera",))
            noise = replace(refined.noise, field=_first_field(system, free))
            refined = of_camera(system, free, corners, noise)
        check_solved(refined, usable, free)

        if usable.lasers or usable.sequences:
            camera, view_poses = refined.system.rig.camera, refined.system.poses[0]
            stood = poses_of_photographs(usable, camera, view_poses[:, :6])
            if keep is None:
                usable, off_board = stripe_on_board(usable, camera, stood)
                unused = unused.and_then(off_board)
                known.append(replace(usable, left_out=unused.left_out))
            check_bows(usable, camera, kinds)
            first, moved_poses = first_motions(usable, stood)
            moved_poses = tuple(_with_bends(each, bends) for each in moved_poses)
            rig = Rig(camera, _first_lights(usable, camera, stood, kinds), first)
            rig = rig if known_rig is None else with_held_values(rig, known_rig, hold)
            groups = (view_blocks(usable), sequence_blocks(usable)) if usable.sequences else (view_blocks(usable),)
            system = System(rig, (view_poses, *moved_poses), refined.system.shape)
            system = replace(system, poses=(*system.poses, *(factor.start(system) for factor in factors)))
            of_rig = partial(rounds, begins=lambda solve: advance(f"whole rig, round {solve}"))
            held = held | rig.given()
            solved_for, shapes = ("camera", "lights", "motion"), shape_parameters(rig)
            free = _free(system, held | rig.surplus() | shapes, solved_for)
            refined = of_rig(system, free, groups, refined.noise, tuple(factors))
            check_solved(refined, usable, free)
            if shapes:
                as_lines = assemble(refined, free, usable, held, unused, tuple(factors))
                usable, approached = first_approach(usable, as_lines)
                if approached:
                    groups = (view_blocks(usable), sequence_blocks(usable))
                    as_lines = replace(as_lines, observations=usable)
                system, no_wave, aliases = begun(refined.system, as_lines, periods or {})
                if known_rig is not None:
                    system = replace(system, rig=with_held_values(system.rig, known_rig, hold))
                held = held | no_wave
                free = _free(system, held | rig.surplus(), solved_for)
                refined = of_rig(system, free, groups, refined.noise, tuple(factors))
                check_solved(refined, usable, free)
        advance("uncertainty")
        result = judged(refined, free, usable, held, unused, tuple(factors), aliases, plain=plain)
    kept = iter(result.kept)
    return replace(
        result,
        kept=tuple(
            next(kept) if has_enough else InlierMask.none(view)
            for view, has_enough in zip(observations.photographs(), enough, strict=True)
        ),
        notes=(
            *result.notes,
            *approached,
            *unclear_bows(result.rig, result.covariance),
            *_across(observations, result.rig),
            *((PLAIN,) if plain else ()),
        ),
    )


def _across(observations: Observations, rig: Rig) -> list[str]:
    """Which lasers' stripes run across the lines in which they were looked for, as their sheets show.

    Where that is so, few points are found, and these may not show it themselves.
    """
    if any("columns =" in note for note in observations.notes):
        return []
    looked = {stripe.laser: stripe.columns for view in observations.photographs() for stripe in view.stripes}
    return [
        note
        for laser, columns in sorted(looked.items())
        for note in steep_notes(rig, observations.lasers[laser], "over the image", columns=columns)
    ]


def _first_lights(
    observations: Observations, camera: Camera, poses: Pose[np.ndarray], kinds: Sequence[str]
) -> tuple[Light, ...]:
    lights = []
    for i, (kind, name) in enumerate(zip(kinds, observations.lasers, strict=True)):
        points, view, positions = stripe_points_in_space(observations, camera, poses, i)
        if len(np.unique(view)) < FEWEST_STRIPES:
            raise InputError(
                f"{laser_prefix(name)}the stripe lies on the board in {len(np.unique(view))} views; at least "
                f"{FEWEST_STRIPES} are needed: check [laser] color and columns, and that the stripe crosses the board"
            )
        light = LIGHTS[kind]
        if moves(light):
            lights.append(light.fitted(points, view, name, positions, observations.light_axes[name]))
        else:
            lights.append(light.fitted(points, view, name))
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


def _first_field(system: System, free: Bool[Array, "shared"]) -> FieldPrior | None:
    """What is known of a lens's field to begin with, where it has one."""
    names = np.array(system.shared_names())[np.asarray(free)]
    return first_field(system.rig.camera, set(names))


def _with_bends(poses: Float[Array, "blocks 6"], bends: bool) -> Float[Array, "blocks size"]:
    """Poses with bulges of zero behind them, where each board may have its own."""
    return jnp.pad(poses, ((0, 0), (0, BENDS if bends else 0)))


def _first_noise(observations: Observations, bends: bool) -> Noise:
    """What the first rounds begin with."""
    extent = float(np.ptp(observations.board.points()[:, :2], axis=0).max())
    return Noise.create(bend=_FIRST_BEND * extent if bends else None)
