"""How the residuals of the joint solve move with lens terms that it did not seek: corners and stripes, without a solve.

A term moves the image of what is predicted by δ. A corner's residual moves by δ; that of a stripe found column by
column by δ_v − s δ_u, with s = dv/du the slope of the stripe there.
"""

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration.blocks import photographs_in_blocks
from jaxscan.calibration.on_board import meet_board, pose_of
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined
from jaxscan.rig.camera import camera_parameters, lens_numbers
from jaxscan.rig.opencv_lens import LADDER, Brown, Rational
from jaxscan.rig.projection import project_points

_FEWEST_FOR_A_SLOPE = 3


def unsought_terms(calibration: Calibration) -> Bool[np.ndarray, "leaves"]:
    """Which leaves of the richest lens's camera are terms that were not sought: those of Brown's lens, held ones too.

    At zero the denominator's terms of the rational lens do what the numerator's do. Of another lens there are none.
    """
    if calibration.rig.camera.lens.kind not in LADDER:
        return np.zeros(0, bool)
    tried = set(camera_parameters(Brown.kind)) - set(calibration.covariance.names)
    names = camera_parameters(Rational.kind, tilted=bool(calibration.rig.camera.tilt))
    return np.array([name in tried and lens_numbers(name) is not None for name in names])


def lens_rows(refined: Refined, calibration: Calibration) -> list[Float[np.ndarray, "_ _ _"]]:
    """The derivatives of each group's residuals, in units of their σ, by `unsought_terms`."""
    terms, camera = unsought_terms(calibration), calibration.rig.camera
    poses, points = calibration.photograph_poses(), calibration.observations.board.points()
    count = int(terms.sum())
    corners = [np.zeros((*group.corners.shape, count)) for group in refined.groups]
    stripes = [np.zeros((*group.stripe.shape[:3], count)) for group in refined.groups]
    if not count:
        return _joined(corners, stripes)

    def moved(X: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 2 terms"]:
        return project_points(camera, X, richest=True).by_camera[..., terms]

    for i, (_, group, block, k) in enumerate(photographs_in_blocks(calibration.observations)):
        own, T = refined.groups[group], pose_of(poses, i)
        weights = np.where(own.corner_used[block, k], own.weights[block, k], 0.0) / float(refined.noise.corner)
        corners[group][block, k] = weights[:, None, None] * moved(T.apply(points))
        used = np.flatnonzero(own.stripe_used[block, k])
        pixels = np.asarray(own.stripe[block, k])[used]
        by_pixel = moved(meet_board(camera, T, pixels)[0]) if len(used) else np.zeros((0, 2, count))
        columns, lights = np.asarray(own.stripe_columns[block, k])[used], np.asarray(own.stripe_light[block, k])[used]
        for light in np.unique(lights):
            at = lights == light
            along, across = (0, 1) if columns[at][0] else (1, 0)
            slope = _slopes(pixels[at][:, along], pixels[at][:, across])
            rows = by_pixel[at][:, across] - slope[:, None] * by_pixel[at][:, along]
            weight = np.asarray(own.stripe_weights[block, k])[used[at]] / float(refined.noise.stripe)
            stripes[group][block, k, used[at]] = weight[:, None] * rows
    return _joined(corners, stripes)


def _joined(corners: list[np.ndarray], stripes: list[np.ndarray]) -> list[Float[np.ndarray, "_ _ _"]]:
    return [
        np.concatenate([c.reshape(len(c), -1, c.shape[-1]), s.reshape(len(s), -1, s.shape[-1])], axis=1)
        for c, s in zip(corners, stripes, strict=True)
    ]


def _slopes(along: Float[np.ndarray, "points"], across: Float[np.ndarray, "points"]) -> Float[np.ndarray, "points"]:
    """Slope of a stripe at each point, from a parabola through it."""
    if len(np.unique(along)) < _FEWEST_FOR_A_SLOPE:
        return np.zeros(len(along))
    return np.asarray(np.polynomial.Polynomial.fit(along, across, 2).deriv()(along))
