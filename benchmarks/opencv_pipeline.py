"""A line scanner by OpenCV and NumPy, one thing after the other: careful, or as makers usually build it.

`calibrateCamera` with one radial term on the corners of `cornerSubPix`; the light plane by total least squares through
the stripe on the boards, beyond 4 σ left out; the stage by PnP and a least-squares line. Makers cut the stripe's centre
of mass to a whole pixel, and do not take the distortion out of its rays, though they have it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from benchmarks.found import Found
from benchmarks.sequential import stage_by_line, total_least_squares
from jaxscan.calibration import Observations
from jaxscan.files.scan import Scan
from jaxscan.images import read_image
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, LightPlane, Linear, Rig

# Responses, (R − G) + (R − B): a peak of less is no stripe; the centre is that of what reaches a part of the peak,
# within this number of rows of it.
_LEAST_PEAK, _PART, _HALF = 60.0, 0.2, 8
_UNDISTORT: Final = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-12)


def opencv_pipeline(observations: Observations, folder: Path, scans: Sequence[Scan], *, careful: bool) -> Found:
    """Calibrate, then reconstruct.

    Args:
        observations: corners of `cornerSubPix`; the stripes are found again.
        folder: of the session's photographs.
        scans: to be reconstructed.
        careful: sub-pixel stripes and undistorted rays; else as makers do.
    """
    used = [view.used() for view in observations.views]
    points = observations.board.points()
    _, K, k, rotations, translations = cv2.calibrateCamera(
        [points[mask].astype(np.float32) for mask in used],
        [view.corners[mask].astype(np.float32) for view, mask in zip(observations.views, used, strict=True)],
        observations.image_size,
        None,  # pyright: ignore[reportArgumentType]
        None,  # pyright: ignore[reportArgumentType]
        flags=cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-15),
    )
    # Makers have the distortion, and leave it in the rays.
    k = np.ravel(k)[:4]
    model = k if careful else np.zeros(4)
    lit, on_boards = [], []
    for view, rotation, translation in zip(observations.views, rotations, translations, strict=True):
        rows = stripe_rows(read_image(folder / view.name), careful)
        n = cv2.Rodrigues(rotation)[0][:, 2]
        x = _rays(rows, K, model)
        X = x * (n @ translation.ravel() / (x @ n))[:, None]
        on_boards.append(X[np.isfinite(rows)])
        lit.append(np.isfinite(rows))
    omega = total_least_squares(np.concatenate(on_boards))
    per_step = stage_by_line(observations, K, k)
    return found(observations.image_size, K, model, omega, per_step, scans, np.stack(lit), careful=careful)


def found(
    image_size: tuple[int, int],
    K: Float[np.ndarray, "3 3"],
    k: Float[np.ndarray, "4"],
    omega: Float[np.ndarray, "3"],
    per_step: Float[np.ndarray, "3"],
    scans: Sequence[Scan],
    lit: Bool[np.ndarray, "views columns"],
    *,
    careful: bool = True,
) -> Found:
    """Reconstruct scans with a rig in OpenCV's terms: k holds k1, k2, p1 and p2."""
    clouds = []
    for scan in scans:
        cloud = []
        for frame, steps in zip(scan.frames, scan.axes["stage"], strict=True):
            x = _rays(stripe_rows(read_image(frame), careful), K, k)
            cloud.append(x / (x @ omega)[:, None] - steps * per_step)
        clouds.append(np.stack(cloud))
    with float64():
        camera = Camera.create(image_size, np.diag(K)[:2], K[:2, 2], "brown", k[:2], k[2:])
        rig = as_numpy(Rig(camera, (LightPlane.create(omega),), Linear.create(jnp.asarray(per_step))))
    return Found(rig, tuple(clouds), lit)


def _rays(
    rows: Float[np.ndarray, "columns"], K: Float[np.ndarray, "3 3"], k: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "columns 3"]:
    pixels = np.column_stack([np.arange(len(rows)), rows])
    rays = cv2.undistortPoints(pixels[:, None], K, k, criteria=_UNDISTORT)
    return np.column_stack([rays[:, 0], np.ones(len(rows))])


def stripe_rows(image: np.ndarray, careful: bool) -> Float[np.ndarray, "columns"]:
    """The centre of mass of each column's stripe, in rows; NaN where there is none."""
    red, green, blue = np.moveaxis(image.astype(float), -1, 0)
    response = 2 * red - green - blue
    response -= np.median(response, axis=0)
    peak = response.max(axis=0)
    row = np.arange(len(response))[:, None]
    near = np.abs(row - response.argmax(axis=0)) <= _HALF
    weight = np.where(near & (response >= _PART * peak), response, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        centre = (weight * row).sum(axis=0) / weight.sum(axis=0)
    return np.where(peak >= _LEAST_PEAK, centre if careful else np.floor(centre), np.nan)
