"""Where on its board each residual's point lies."""

import numpy as np
from jaxtyping import Float

from jaxscan.calibration.blocks import photographs_in_blocks
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined
from jaxscan.geometry import dual_plane_of
from jaxscan.rig.board_shape import middle_and_half, places_on_board
from jaxscan.rig.projection import pixel_rays


def places_of_residuals(refined: Refined, calibration: Calibration) -> list[Float[np.ndarray, "blocks residuals 2"]]:
    """The numbers s and t (`rig.board_shape`) of what each residual of each group sees, NaN where it sees nothing.

    Both residuals of a corner have its place; behind the corners stand the stripe points, where their rays meet the
    board's plane.
    """
    observations, poses = calibration.observations, calibration.photograph_poses()
    points = observations.board.points()
    middle, half = middle_and_half(points)
    corners = np.repeat(np.stack(places_on_board(points), axis=-1), 2, axis=0)
    # Padding stands with the first photograph; its pixels are NaN.
    at = [np.zeros(group.stripe.shape[:2], int) for group in refined.groups]
    for i, (_, group, block, k) in enumerate(photographs_in_blocks(observations)):
        at[group][block, k] = i
    places = []
    for group, i in zip(refined.groups, at, strict=True):
        R, t = poses.matrix()[i], poses.translation[i]
        pixels = np.asarray(group.stripe)
        x = pixel_rays(calibration.rig.camera, pixels.reshape(-1, 2)).reshape(*pixels.shape[:3], 3)
        with np.errstate(divide="ignore", invalid="ignore"):
            X = x / np.einsum("bpsi,bpi->bps", x, dual_plane_of(R, t))[..., None]
        stripes = (((X - t[:, :, None]) @ R)[..., :2] - middle) / half
        blocks, photographs = i.shape
        of_corners = np.broadcast_to(np.tile(corners, (photographs, 1)), (blocks, photographs * len(corners), 2))
        places.append(np.concatenate([of_corners, stripes.reshape(blocks, -1, 2)], axis=1))
    return places
