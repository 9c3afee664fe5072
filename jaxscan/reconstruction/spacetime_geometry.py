"""Whether a scan's steps are fine enough for spacetime analysis: how many frames the light takes to pass a point."""

from itertools import islice

import jax.numpy as jnp
import numpy as np

from jaxscan.errors import InputError
from jaxscan.files.scan import Scan
from jaxscan.images import Stripe, detect_stripe, read_image, read_video
from jaxscan.images.stripes.bell import FWHM
from jaxscan.reconstruction.merged_steps import step_groups
from jaxscan.reconstruction.spacetime import Geometry, carried, half_window
from jaxscan.reconstruction.turns import full_turn, gaps_between
from jaxscan.rig import MovingLight, Rig

# Frames of the scan that are looked at; of a video, every Nth from its first on.
_LOOKED_AT, _EVERY = 16, 12
# Standard deviation in frames of what is seen often enough, and of what is seen in more frames than are looked at.
_LEAST_SIGMA, _MOST_SIGMA = 0.7, 10.0
# Below this the photographs alone measure most of a surface better.
_GOOD_SIGMA = 2.0


def spacetime_geometry(rig: Rig, scan: Scan) -> tuple[Geometry, float]:
    """What spacetime analysis needs to know of a scan: its geometry, and for how many frames the light passes.

    Returns:
        The geometry, and the standard deviation of a passage in frames.

    Raises:
        InputError: not one axis of the rig moves, the steps are not equal, or they are too coarse or far too fine.
    """
    if scan.poses is not None:
        raise InputError(
            f"{scan.path}: [scan] poses: spacetime analysis follows an axis with equal motor steps: leave "
            "--spacetime out"
        )
    if isinstance(rig.light(scan.laser.name), MovingLight):
        raise InputError(
            f"{scan.path}: [scan] the light moves and the object stands: spacetime analysis works only if the object "
            "moves: leave --spacetime out"
        )
    places = [scan.positions[group.start] for group in step_groups(scan)]
    _check_enough(scan, len(places), _LEAST_SIGMA)
    if len(scan.moving) != 1:
        raise InputError(
            f"{scan.path}: [scan] spacetime analysis follows the motion of one axis, here move "
            f"{', '.join(scan.moving) or 'none'}: scan along one axis at a time, or leave --spacetime out"
        )
    (axis,) = scan.moving
    at = scan.axis_names.index(axis)
    steps = [place[at] for place in places]
    gaps = gaps_between(np.asarray(steps), full_turn(rig.motion, scan.moving))[: max(len(steps) - 1, 0)]
    apart = {scan.rules[axis].per_frame} if scan.rules else set(gaps.tolist())
    if len(apart) != 1 or 0 in apart:
        raise InputError(
            f"{scan.path}: [scan] steps: spacetime analysis needs frames that are equally many motor steps apart, "
            f"these are {', '.join(map(str, sorted(apart)[:4]))}: scan in equal steps, or leave --spacetime out"
        )
    step = apart.pop()
    still = {name: rule.start for name, rule in scan.rules.items()} | dict(
        zip(scan.axis_names, places[0] if places else (), strict=False)
    )
    geometry = Geometry.create(rig, scan.laser, axis, step, still)
    if scan.video is None:
        some = np.linspace(0, len(scan.frames) - 1, _LOOKED_AT).astype(int)
        frames = [read_image(scan.frames[i]) for i in some]
    else:
        frames = list(islice(read_video(scan.video), 0, _EVERY * _LOOKED_AT, _EVERY))
    stripe = detect_stripe(np.stack(frames), scan.laser, detector="gravity")
    sigma, speed = passage_sigma(geometry, stripe)
    if not np.isfinite(sigma):
        raise InputError(
            f"{scan.path}: no stripe was found in {len(frames)} frames of it: check [laser] color and columns, and "
            "look at one with jaxscan inspect SCAN --frame 0 --png"
        )
    if sigma < _LEAST_SIGMA:
        raise InputError(
            f"{scan.path}: the surface moves {speed:.2g} px a frame through a stripe of σ {sigma * speed:.2g} px, and "
            f"so it is lit for {sigma:.2g} frames (σ); spacetime analysis needs {_LEAST_SIGMA}: scan in steps of at "
            f"most {int(abs(step) * sigma / _LEAST_SIGMA)} in place of {abs(step)}, or leave --spacetime out"
        )
    if sigma > _MOST_SIGMA:
        raise InputError(
            f"{scan.path}: the light takes {sigma:.3g} frames (σ) to pass a point, and more than {_MOST_SIGMA:g} are "
            f"of no use: list every {int(sigma / _MOST_SIGMA) + 1}th frame, or leave --spacetime out"
        )
    _check_enough(scan, len(places), sigma)
    return geometry, sigma


def coarse_notes(geometry: Geometry, sigma: float) -> list[str]:
    """What is said of steps that are fine enough, and coarse.

    Args:
        geometry: of the scan.
        sigma: for how many frames the light passes (standard deviation).
    """
    if sigma >= _GOOD_SIGMA:
        return []
    step = abs(float(geometry.per_frame))
    finer = max(int(step * sigma / _GOOD_SIGMA), 1)
    return [
        f"each point is lit for {sigma:.2g} frames (σ): away from edges of depth and print the same photographs "
        f"measure better without --spacetime: scan in steps of at most {finer} in place of {step:.0f}, or leave "
        "--spacetime out"
    ]


def _check_enough(scan: Scan, frames: int, sigma: float) -> None:
    """A video is as long as it is."""
    needed = 2 * half_window(sigma) + 1
    if scan.video is None and frames < needed:
        raise InputError(
            f"{scan.path}: {frames} frames: spacetime analysis looks at {needed} together: scan further, or leave "
            "--spacetime out"
        )


def passage_sigma(geometry: Geometry, stripe: Stripe) -> tuple[float, float]:
    """For how many frames the light passes over a point (standard deviation), and the speed of points there.

    The stripe's width over the speed of tracks across it, px for each frame; medians, NaN where there is no stripe.
    """
    u, v = geometry.pixels(jnp.where(stripe.valid, stripe.position, 0.0))
    before, after = (geometry.across(*carried(geometry, u, v, jnp.asarray(m))) for m in (-0.5, 0.5))
    speed = np.where(stripe.valid, jnp.abs(after - before), np.nan)
    sigma = stripe.width / FWHM / np.maximum(speed, np.finfo(np.float32).tiny)
    known = np.isfinite(sigma)
    return (float(np.median(sigma[known])), float(np.median(speed[known]))) if known.any() else (np.nan, np.nan)
