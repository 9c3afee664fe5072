"""The closed-form start: homographies → intrinsics → poses.

The corner of a planar board and its undistorted pixel are related by a homography H ~ K [r1 r2 t]. Two constraints
for each view, h1ᵀ ω h2 = 0 and h1ᵀ ω h1 = h2ᵀ ω h2 with ω = K⁻ᵀ K⁻¹, are linear in 1/f² when the principal point is
known (Z. Zhang, PAMI 2000); it starts at the image centre. Everything here is NumPy, vectorised over views.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.geometry import vector_to_matrix

_FOCAL_GRID = np.geomspace(0.3, 20.0, 24)
# A start whose reprojection is off by more than this share of the image width is not trusted.
_POOR_START = 0.02
# A view that has a ray farther off the axis (radians) is looked at along its own middle.
_FAR_OFF: Final = np.radians(60)
# The least cosine between a ray of a view and their middle.
_LEAST_AHEAD: Final = 0.05


def homographies(
    points: Float[np.ndarray, "corners 2"],
    seen: Float[np.ndarray, "views corners 2"],
    used: Bool[np.ndarray, "views corners"],
) -> Float[np.ndarray, "views 3 3"]:
    """H with (seen, 1) ~ H (point, 1), by the normalised direct linear transformation.

    Args:
        points: board coordinates, any unit.
        seen: image coordinates, any unit; not read where `used` is false.
        used: at least four of each view, not on one line.
    """
    board, T_board = _normalised(points[None], np.ones((1, len(points)), bool))
    image, T_image = _normalised(seen, used)
    p = np.concatenate([board, np.ones_like(board[..., :1])], axis=-1)
    p = np.broadcast_to(p, (*image.shape[:2], 3)) * used[..., None]
    # The normal matrix of the rows [p 0 −u p] and [0 p −v p], block by block.
    A = np.zeros((len(image), 9, 9))
    pt = np.swapaxes(p, 1, 2)
    A[:, :3, :3] = A[:, 3:6, 3:6] = pt @ p
    for i in (0, 1):
        weighted = -(pt @ (image[..., i, None] * p))
        A[:, 3 * i : 3 * i + 3, 6:] = weighted
        A[:, 6:, 3 * i : 3 * i + 3] = weighted
    A[:, 6:, 6:] = pt @ ((image**2).sum(-1)[..., None] * p)
    H = np.linalg.eigh(A)[1][:, :, 0].reshape(-1, 3, 3)
    return np.linalg.inv(T_image) @ H @ T_board


def _normalised(
    x: Float[np.ndarray, "views points 2"], used: Bool[np.ndarray, "views points"]
) -> tuple[Float[np.ndarray, "views points 2"], Float[np.ndarray, "views 3 3"]]:
    """Points moved to their centroid and scaled to mean square 2 (Hartley), and the matrix that does it."""
    x = np.where(used[..., None], x, 0.0)
    count = np.maximum(used.sum(axis=1), 1)[:, None]
    centre = x.sum(axis=1) / count
    moved = np.where(used[..., None], x - centre[:, None], 0.0)
    scale = np.sqrt(2 * count[:, 0] / np.maximum((moved**2).sum(axis=(1, 2)), 1e-300))
    T = np.zeros((len(x), 3, 3))
    T[:, 0, 0] = T[:, 1, 1] = scale
    T[:, :2, 2] = -scale[:, None] * centre
    T[:, 2, 2] = 1
    return moved * scale[:, None, None], T


def focal_length(
    points: Float[np.ndarray, "corners 2"],
    seen: Float[np.ndarray, "views corners 2"],
    used: Bool[np.ndarray, "views corners"],
    image_size: tuple[int, int],
) -> Float[np.ndarray, "2"]:
    """Focal lengths in pixels, with the principal point at the image centre and no distortion.

    Where the closed form gives no usable answer the best of a grid of focal lengths is taken, by reprojection.
    """
    centre = (np.asarray(image_size) - 1) / 2
    offset = np.where(used[..., None], seen, 0.0) - centre
    H = homographies(points, offset, used)
    h1, h2 = H[:, :, 0], H[:, :, 1]
    weight = 1 / (np.linalg.norm(h1, axis=1) * np.linalg.norm(h2, axis=1))[:, None]
    rows = np.concatenate([h1[:, :2] * h2[:, :2], h1[:, :2] ** 2 - h2[:, :2] ** 2])
    right = np.concatenate([-h1[:, 2] * h2[:, 2], h2[:, 2] ** 2 - h1[:, 2] ** 2])
    both = np.concatenate([weight, weight])
    inverse_squares = np.linalg.lstsq(rows * both, right * both[:, 0], rcond=None)[0]
    width = float(image_size[0])
    candidates = []
    if (inverse_squares > 0).all():
        candidates.append(1 / np.sqrt(inverse_squares))
        if _reprojection(points, offset, used, H, candidates[0]) < _POOR_START * width:
            return candidates[0]
    candidates += [np.full(2, g * width) for g in _FOCAL_GRID]
    return min(candidates, key=lambda f: _reprojection(points, offset, used, H, f))


def _reprojection(
    points: Float[np.ndarray, "corners 2"],
    offset: Float[np.ndarray, "views corners 2"],
    used: Bool[np.ndarray, "views corners"],
    H: Float[np.ndarray, "views 3 3"],
    focal: Float[np.ndarray, "2"],
) -> float:
    """RMS distance in pixels with poses from the homographies."""
    R, t = poses_from_homographies(H / np.append(focal, 1.0)[:, None])
    X = np.einsum("vij,nj->vni", R[:, :, :2], points) + t[:, None]
    error = focal * X[..., :2] / np.where(X[..., 2:] > 0, X[..., 2:], np.nan) - offset
    square = np.where(used, (error**2).sum(-1), 0.0)
    return float(np.sqrt(square.sum() / max(used.sum(), 1))) if np.isfinite(square).all() else np.inf


def poses_from_homographies(
    H: Float[np.ndarray, "views 3 3"],
) -> tuple[Float[np.ndarray, "views 3 3"], Float[np.ndarray, "views 3"]]:
    """T_cam_board of planar boards from H ~ [r1 r2 t], the homographies to normalised image coordinates.

    Returns:
        Rotation matrices and translations (in the unit of the board), with the board's origin in front of the camera.
    """
    scale = 2 / (np.linalg.norm(H[:, :, 0], axis=1) + np.linalg.norm(H[:, :, 1], axis=1))
    M = H * (scale * np.where(H[:, 2, 2] < 0, -1.0, 1.0))[:, None, None]
    r1, r2, t = M[:, :, 0], M[:, :, 1], M[:, :, 2]
    U, _, Vt = np.linalg.svd(np.stack([r1, r2, np.cross(r1, r2)], axis=2))
    sign = np.where(np.linalg.det(U @ Vt) < 0, -1.0, 1.0)
    U[:, :, 2] *= sign[:, None]
    return U @ Vt, t


def board_poses(
    points: Float[np.ndarray, "corners 2"],
    rays: Float[np.ndarray, "views corners 3"],
    used: Bool[np.ndarray, "views corners"],
) -> tuple[Float[np.ndarray, "views 3 3"], Float[np.ndarray, "views 3"]]:
    """T_cam_board of each view for a known camera: rays of its corners, of any length.

    A view far off the axis is looked at along the middle of its own rays, so that those at 90° to the axis and beyond
    have an image too.
    """
    rays = np.where(used[..., None], rays, [0.0, 0.0, 1.0])
    turns = _towards(rays, used)
    seen = np.einsum("vij,vcj->vci", turns, rays)
    # A board in one piece spans less than 180°; a camera for which it does not is none.
    ahead = np.maximum(seen[..., 2:], _LEAST_AHEAD * np.linalg.norm(seen, axis=-1, keepdims=True))
    R, t = poses_from_homographies(homographies(points, seen[..., :2] / ahead, used))
    back = np.swapaxes(turns, 1, 2)
    return back @ R, (back @ t[..., None])[..., 0]


def _towards(
    rays: Float[np.ndarray, "views corners 3"], used: Bool[np.ndarray, "views corners"]
) -> Float[np.ndarray, "views 3 3"]:
    """For each view a rotation that brings the middle of its rays to the axis; none where they are all near it."""
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    middle = (unit * used[..., None]).sum(axis=1)
    turns = np.broadcast_to(np.eye(3), (len(rays), 3, 3)).copy()
    for i in np.flatnonzero((used & (unit[..., 2] < np.cos(_FAR_OFF))).any(axis=1)):
        aside = np.array([middle[i, 1], -middle[i, 0], 0.0])
        angle = np.arctan2(np.linalg.norm(aside), middle[i, 2])
        turns[i] = vector_to_matrix(angle * aside / max(float(np.linalg.norm(aside)), 1e-300))
    return turns


def usual_rotation(vectors: Float[np.ndarray, "images 3"]) -> Float[np.ndarray, "3"]:
    """That rotation vector whose median angle to all the others is least: one photograph turned or mirrored has no say.

    The unit quaternions of two rotations have the product |q_a · q_b| = cos θ/2, θ the angle between the rotations.
    """
    half = 0.5 * np.linalg.norm(vectors, axis=1, keepdims=True)
    q = np.hstack([np.cos(half), 0.5 * np.sinc(half / np.pi) * vectors])
    return vectors[int(np.argmax(np.median(np.abs(q @ q.T), axis=1)))]
