"""The pipeline of 2003 once more, in NumPy.

Written from its description, not from the scripts in `benchmarks/matlab/`, so that each checks the other. It is
quicker, and runs where there is no Octave. Derivatives are OpenCV's, rotations SciPy's, and all points of a photograph
go at once.
"""

import time

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from benchmarks.pipeline_2003 import BOARD_THRESHOLD, SCAN_THRESHOLD, Job, Outcome, Quirks
from jaxscan.images import read_image

_FEW, _MANY = 20, 200
_FLOOR_MM, _LONG_MM = 5.0, 5.0

Camera = tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"], float]


def run(job: Job, quirks: Quirks | None = None) -> Outcome:
    """Run the pipeline. `loops` makes no difference here."""
    quirks = quirks or Quirks()
    seconds = {}
    begin = time.perf_counter()
    camera, poses = calibrate(job)
    seconds["camera"] = time.perf_counter() - begin
    planes, lines, stripes, board_stripes = [], [], [], []
    for i, (photo, pose) in enumerate(zip(job.board_photos, poses, strict=True)):
        n = Rotation.from_rotvec(pose[:3]).as_matrix()[:, 2]
        planes.append(-n / abs(n @ pose[3:]) if quirks.board_sign else n / (n @ pose[3:]))
        pixels = stripe(read_image(photo), BOARD_THRESHOLD, quirks)
        stripes.append(triangulate(pixels, camera, planes[-1], quirks))
        lines.append(_line(stripes[-1], quirks))
        board_stripes.append(np.column_stack([np.full(len(pixels), i + 1), pixels]))
    laser = _laser_plane(np.array(planes), np.array(lines), stripes, quirks)
    staged = np.array([_pose(job.board, corners, camera)[3:] for corners in job.stage_corners])
    if quirks.first_and_last:
        move = (staged[-1] - staged[0]) / (len(staged) - 1)
    else:
        move = np.polyfit(np.arange(len(staged)), staged, 1)[0]
    begin = time.perf_counter()
    points, frame, columns = [], [], []
    for k, photo in enumerate(job.scan_photos):
        pixels = stripe(read_image(photo), SCAN_THRESHOLD, quirks)
        index = k + 1 if quirks.index_from_one else k
        points.append(triangulate(pixels, camera, laser, quirks) - index * move)
        frame.append(np.full(len(pixels), k))
        columns.append(pixels[:, 0].astype(int) - (1 if quirks.pixels_from_one else 0))
    seconds["scan"] = time.perf_counter() - begin
    cloud = np.concatenate([np.zeros((0, 3)), *points])
    kept = _above_floor(cloud, job.clicks, quirks) if len(job.clicks) and len(cloud) else np.ones(len(cloud), bool)
    faces = _faces(cloud[kept], quirks) if job.ply is not None else np.zeros((0, 3), int)
    return Outcome(
        focal=camera[0],
        principal=camera[1],
        k1=camera[2],
        rotations=poses[:, :3],
        translations=poses[:, 3:],
        planes=np.array(planes),
        lines=np.array(lines),
        laser_plane=laser,
        stage_move=move,
        board_stripes=np.concatenate(board_stripes),
        points=cloud,
        frame=np.concatenate([np.zeros(0, int), *frame]),
        column=np.concatenate([np.zeros(0, int), *columns]),
        kept=kept,
        faces=faces,
        seconds=seconds,
    )


def calibrate(job: Job) -> tuple[Camera, Float[np.ndarray, "views 6"]]:
    """Camera and poses: a closed-form start, then at most 30 Gauss-Newton steps on the dense Jacobian."""
    principal = (np.asarray(job.image_size, float) - 1) / 2
    rows, right = [], []
    for corners in job.corners:
        seen = np.isfinite(corners[:, 0])
        H = _homography(job.board[seen], corners[seen] - principal)
        a, b = (H / np.linalg.norm(H)).T[:2]
        rows += [a[:2] * b[:2], a[:2] ** 2 - b[:2] ** 2]
        right += [-a[2] * b[2], b[2] ** 2 - a[2] ** 2]
    focal = 1 / np.sqrt(np.abs(np.linalg.lstsq(np.array(rows), np.array(right), rcond=None)[0]))
    camera: Camera = (focal, principal, 0.0)
    poses = np.array([_pose(job.board, corners, camera) for corners in job.corners])
    for _ in range(30):
        J, errors = np.zeros((job.corners.size, 5 + poses.size)), np.empty(job.corners.size)
        size = job.corners[0].size
        for i, corners in enumerate(job.corners):
            seen, by_camera, by_pose = _project(job.board, poses[i], camera)
            here = slice(i * size, (i + 1) * size)
            J[here, :5], J[here, 5 + 6 * i : 11 + 6 * i] = by_camera, by_pose
            errors[here] = (corners - seen).ravel()
        used = np.isfinite(errors)
        step = np.linalg.lstsq(J[used], errors[used], rcond=None)[0]
        camera = (camera[0] + step[:2], camera[1] + step[2:4], camera[2] + float(step[4]))
        poses = poses + step[5:].reshape(-1, 6)
        if np.linalg.norm(step[:5]) < 1e-9 * np.linalg.norm([*camera[0], *camera[1], camera[2]]):
            break
    return camera, poses


def stripe(image: np.ndarray, threshold: float, quirks: Quirks) -> Float[np.ndarray, "points 2"]:
    """Column and row of the mean of what reaches the threshold in each column."""
    red, green, blue = np.moveaxis(image.astype(float), -1, 0)
    bright = 2 * red - green - blue >= threshold
    count = bright.sum(axis=0)
    u = np.flatnonzero(count)
    v = (bright * (np.arange(len(bright)) + 1)[:, None]).sum(axis=0)[u] / count[u]
    # Halves are rounded up, not to even.
    v = np.floor(v + 0.5) if quirks.whole_rows else v
    pixels = np.column_stack([u + 1.0, v])
    return pixels if quirks.pixels_from_one else pixels - 1


def triangulate(
    pixels: Float[np.ndarray, "points 2"], camera: Camera, plane: Float[np.ndarray, "3"], quirks: Quirks
) -> Float[np.ndarray, "points 3"]:
    """Where the rays of pixels meet a plane."""
    rays = _rays(pixels, camera, _FEW if quirks.few_iterations else _MANY)
    return rays / (rays @ plane)[:, None]


def _rays(pixels: Float[np.ndarray, "points 2"], camera: Camera, iterations: int) -> Float[np.ndarray, "points 3"]:
    focal, principal, k1 = camera
    distorted = (pixels - principal) / focal
    x = distorted
    for _ in range(iterations):
        x = distorted / (1 + k1 * (x**2).sum(axis=1, keepdims=True))
    return np.column_stack([x, np.ones(len(x))])


def _homography(
    board: Float[np.ndarray, "corners 2"], seen: Float[np.ndarray, "corners 2"]
) -> Float[np.ndarray, "3 3"]:
    def normalised(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        scale = np.sqrt(2 / ((x - x.mean(axis=0)) ** 2).sum(axis=1).mean())
        T = np.diag([scale, scale, 1.0])
        T[:2, 2] = -scale * x.mean(axis=0)
        return np.column_stack([x, np.ones(len(x))]) @ T.T, T

    (p, T_board), (q, T_seen) = normalised(board), normalised(seen)
    # q × H p = 0, two rows for each corner.
    A = np.concatenate(
        [
            np.column_stack([np.zeros_like(p), -p, q[:, 1:2] * p]),
            np.column_stack([p, np.zeros_like(p), -q[:, :1] * p]),
        ]
    )
    H = np.linalg.svd(A, full_matrices=False)[2][-1].reshape(3, 3)
    return np.linalg.inv(T_seen) @ H @ T_board


def _pose(
    board: Float[np.ndarray, "corners 2"], corners: Float[np.ndarray, "corners 2"], camera: Camera
) -> Float[np.ndarray, "6"]:
    seen = np.isfinite(corners[:, 0])
    board, corners = board[seen], corners[seen]
    H = _homography(board, _rays(corners, camera, _FEW)[:, :2])
    H *= 2 * np.sign(H[2, 2]) / (np.linalg.norm(H[:, 0]) + np.linalg.norm(H[:, 1]))
    U, _, Vt = np.linalg.svd(np.column_stack([H[:, :2], np.cross(H[:, 0], H[:, 1])]))
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    pose = np.concatenate([Rotation.from_matrix(R).as_rotvec(), H[:, 2]])
    for _ in range(20):
        seen, _, J = _project(board, pose, camera)
        step = np.linalg.lstsq(J, (corners - seen).ravel(), rcond=None)[0]
        pose = pose + step
        if np.linalg.norm(step) < 1e-10 * np.linalg.norm(pose):
            break
    return pose


def _project(
    board: Float[np.ndarray, "corners 2"], pose: Float[np.ndarray, "6"], camera: Camera
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels, and their derivatives by (f_u, f_v, u₀, v₀, k₁) and by the pose; rows as `pixels.ravel()`."""
    (f_u, f_v), (u, v), k1 = camera
    K = np.array([[f_u, 0, u], [0, f_v, v], [0, 0, 1]])
    points = np.column_stack([board, np.zeros(len(board))])
    pixels, J = cv2.projectPoints(points, pose[:3], pose[3:], K, np.array([k1, 0.0, 0.0, 0.0]))
    return pixels[:, 0], J[:, 6:11], J[:, :6]


def _line(points: Float[np.ndarray, "points 3"], quirks: Quirks) -> Float[np.ndarray, "3"]:
    if not quirks.mean_line:
        return np.linalg.svd(points, full_matrices=False)[2][2]
    i, j = np.triu_indices(len(points), 1)
    pairs = i < len(points) - 2
    normals = np.cross(points[i[pairs]], points[j[pairs]])
    return (normals / np.linalg.norm(normals, axis=1, keepdims=True)).mean(axis=0)


def _laser_plane(
    planes: Float[np.ndarray, "views 3"],
    lines: Float[np.ndarray, "views 3"],
    stripes: list[Float[np.ndarray, "points 3"]],
    quirks: Quirks,
) -> Float[np.ndarray, "3"]:
    if not quirks.mean_of_pairs:
        X = np.concatenate(stripes)
        normal = np.linalg.svd(X - X.mean(axis=0), full_matrices=False)[2][2]
        return normal / (normal @ X.mean(axis=0))
    found = []
    for i, j in zip(*np.triu_indices(len(planes), 1), strict=True):
        if i < len(planes) - 2:
            a, b = np.linalg.lstsq(np.column_stack([lines[i], -lines[j]]), planes[j] - planes[i], rcond=None)[0]
            found += [planes[i] + a * lines[i], planes[j] + b * lines[j]]
    return np.mean(found, axis=0)


def _above_floor(
    points: Float[np.ndarray, "points 3"], clicks: Float[np.ndarray, "clicks 2"], quirks: Quirks
) -> np.ndarray:
    nearest = ((points[:, None, :2] - clicks[None]) ** 2).sum(axis=-1).argmin(axis=0)
    picks = points[nearest]
    through = picks[0] if quirks.first_pick else picks.mean(axis=0)
    others = (picks[1:] if quirks.first_pick else picks) - through
    slopes = np.linalg.lstsq(others[:, :2], others[:, 2], rcond=None)[0]
    return np.abs((points - through) @ [-slopes[0], -slopes[1], 1.0]) > _FLOOR_MM


def _faces(points: Float[np.ndarray, "points 3"], quirks: Quirks) -> np.ndarray:
    if len(points) < 3:
        return np.zeros((0, 3), int)
    faces = Delaunay(points[:, :2]).simplices
    sides = points[faces] - points[np.roll(faces, -1, axis=1)]
    return faces if quirks.bridged else faces[np.linalg.norm(sides, axis=-1).max(axis=1) <= _LONG_MM]
