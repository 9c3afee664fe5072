"""Corners of checkerboards: how exact, how sure of themselves, how fast, and what they are worth to a calibration.

Boards are rendered by `benchmarks.board_images`. Beside the library's corners stand OpenCV's, which start from the
truth moved by up to 0.7 px. The second part calibrates simulated sessions of the rig of 2003 twice, from the same
photographs and the same stripes: once with the library's corners and once with those of `cornerSubPix`.
"""

import os
import statistics
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from benchmarks.board_images import COUNTS, Photograph, Shot
from benchmarks.burnt_rows import burnt_rows
from benchmarks.corner_errors import Errors, of_ours, photographs, refined, rms
from benchmarks.metric import Metric
from benchmarks.simulated import rig_errors
from benchmarks.sub_pix import USUAL, corner_sub_pix, with_sub_pix
from jaxscan.calibration import Observations, calibrate
from jaxscan.calibration.observe import observe
from jaxscan.calibration.residuals import stripe_error
from jaxscan.files.session import read_session
from jaxscan.geometry import dual_plane
from jaxscan.images import to_grey
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Rig
from jaxscan.simulation.folders import SessionTruth, simulate_session

_SESSIONS = 20
# Half of a wide window for `cornerSubPix`.
_WIDE = 11
_PLAIN = [Shot(square_px=float(s)) for s in (20, 24, 28, 32, 35)]
_VARIED = {
    "small": [Shot(square_px=8.0), Shot(square_px=12.0)],
    "large": [Shot(square_px=60.0)],
    "facing": [Shot(tilt=0.0)],
    "steep": [Shot(tilt=np.radians(55.0))],
    "wide_angle": [Shot(square_px=s, focal_px=256.0, undistort=0.25) for s in (45.0, 60.0)],
    "turned": [Shot(turn=np.pi)],
    "sharp": [Shot(blur_px=0.2)],
    "blur_0.5": [Shot(blur_px=0.5)],
    "blur_1.0": [Shot(blur_px=1.0)],
    "blur_1.5": [Shot(blur_px=1.5)],
    "noise_1": [Shot(noise=1.0)],
    "noise_4": [Shot(noise=4.0)],
    "defocus": [Shot(disc_px=3.0)],
    "burnt_out": [Shot(exposure=330.0)],
    "dark": [Shot(exposure=50.0)],
    "gamma": [Shot(gamma=0.45)],
    "jpeg": [Shot(jpeg=80)],
    "bayer": [Shot(bayer=True)],
}
_TROUBLES = {
    trouble: [Shot(square_px=float(s), trouble=trouble) for s in (14, 20, 28, 35)]
    for trouble in ("stripe", "highlight", "occluder", "border")
}


def measure(quick: bool) -> list[Metric]:
    """Boards, then, in the long form, sessions."""
    seeds = 1 if quick else 6
    begin = time.monotonic()
    plain = photographs(_PLAIN[::4] if quick else _PLAIN, range(seeds))
    of_ours(plain[:1])
    first = time.monotonic() - begin
    rows = burnt_rows(max(seeds // 2, 1), quick)
    metrics = [*accuracy(plain, first), *variations(seeds, quick), *rows, *speed(plain)]
    return metrics if quick else [*metrics, *sessions(_SESSIONS)]


def accuracy(plain: list[Photograph], first_s: float) -> list[Metric]:
    """Squares of 20 to 35 px, blur 0.6 px, noise 2 levels, tilt to 35°: ours, OpenCV's, and the bound."""
    ours = of_ours(plain)
    usual, wide = (np.concatenate([_sub_pix(p, half) for p in plain]) for half in (USUAL, _WIDE))
    sectors = np.concatenate([_sectors(p) for p in plain])
    bound = np.concatenate([cramer_rao(p) for p in plain])
    u, v = ours.rms()
    return [
        Metric("corners.rms_u", u, "px", "lower", 0.012, slack=0.1),
        Metric("corners.rms_v", v, "px", "lower", 0.012, slack=0.1),
        Metric("corners.rms_over_cramer_rao", float(np.hypot(u, v) / rms(bound) / 2**0.5), "", "lower", 2.0),
        *(
            []
            if len(plain) < 2 * len(_PLAIN)
            else [Metric("corners.together", _together(ours, len(plain)), "", "lower", 1.15)]
        ),
        Metric("corners.left_out", float(np.isnan(ours.sigma).mean()), "", "lower", 0.0, floor=0.01),
        Metric("corners.corner_sub_pix_rms", rms(usual), "px"),
        Metric("corners.corner_sub_pix_wide_window_rms", rms(wide), "px"),
        Metric("corners.sector_based_rms", rms(sectors), "px"),
        Metric("corners.first_photographs", first_s, "s"),
        *_sure("corners", ours),
    ]


def _together(errors: Errors, photographs: int) -> float:
    """The mean error of a photograph's corners over what it is if each errs by itself, RMS: 1 if none move together."""
    each = errors.pixels.reshape(photographs, -1, 2)
    own = np.nanmean(each, axis=1) * np.sqrt(np.isfinite(each).sum(axis=1))
    return float(np.sqrt((own**2).mean() / np.nanmean(each**2)))


def variations(seeds: int, quick: bool) -> list[Metric]:
    """Other boards, cameras and light; and what may stand in the picture."""
    far, metrics = 0, []
    varied = {name: _VARIED[name] for name in ("small", "blur_1.5")} if quick else _VARIED
    troubles = {name: shots[2:3] for name, shots in _TROUBLES.items()} if quick else _TROUBLES
    for name, shots in {**varied, **troubles}.items():
        errors = of_ours(photographs(shots, range(seeds if quick or name in varied else 2 * seeds)))
        far += errors.far()
        metrics += [
            Metric(f"corners.{name}.rms", rms(errors.pixels), "px"),
            Metric(f"corners.{name}.rms_in_sigma", errors.in_sigma()),
            Metric(f"corners.{name}.largest", float(np.nanmax(np.linalg.norm(errors.pixels, axis=1))), "px"),
            Metric(f"corners.{name}.left_out", float(np.isnan(errors.sigma).mean())),
        ]
    return [*metrics, Metric("corners.beyond_0.3_px_and_not_left_out", far, "", "lower", 0)]


def speed(plain: list[Photograph]) -> list[Metric]:
    """Corners a second on all cores, compiled, and how long they take over OpenCV's sectors, in turn."""
    many = [plain[i % len(plain)] for i in range(20)]

    def seconds(of: Callable[[Photograph], object]) -> float:
        begin = time.monotonic()
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(of, many))
        return time.monotonic() - begin

    ours, theirs = zip(*((seconds(refined), seconds(_sectors)) for _ in range(5)), strict=True)
    ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    return [
        Metric("corners.each_second", sum(len(p.corners) for p in many) / statistics.median(ours), "1/s"),
        Metric("corners.time_over_sectors", ratio, "", "lower", slack=1.0),
    ]


def sessions(count: int) -> list[Metric]:
    """Simulated sessions, calibrated from our corners and from those of `cornerSubPix`."""
    rows = []
    for seed in range(count):
        with tempfile.TemporaryDirectory() as folder:
            truth = simulate_session(Path(folder), seed)
            ours = observe(read_session(Path(folder)))
            theirs = with_sub_pix(ours, Path(folder))
        rows.append([_session_errors(observations, truth) for observations in (ours, theirs)])
        print(f"  seed {seed}: f and c, points, from measured stripes: {np.round(rows[-1], 4).tolist()}", flush=True)
    ours, theirs = np.median(np.array(rows), axis=0)
    metrics = []
    for name, unit, goal, a, b in zip(
        ("f_and_c", "points", "from_measured_stripes"),
        ("px", "mm", "mm"),
        (0.55, 0.65, None),
        ours,
        theirs,
        strict=True,
    ):
        metrics += [
            Metric(f"corners.sessions.{name}", float(a), unit),
            Metric(f"corners.sessions.{name}_by_corner_sub_pix", float(b), unit),
            Metric(
                f"corners.sessions.{name}_ratio",
                float(a / b),
                "",
                "shown" if goal is None else "lower",
                goal,
                slack=0.3,
            ),
        ]
    return metrics


def _session_errors(observations: Observations, truth: SessionTruth) -> tuple[float, float, float]:
    """RMS of f and c (px), of points from exact pixels, and of points from the stripes seen on the boards (mm)."""
    rig = calibrate(observations).rig
    f_and_c = [np.array([float(x) for x in (*r.camera.focal, *r.camera.principal)]) for r in (rig, truth.rig)]
    with float64():
        found, true = as_float64(rig), as_float64(truth.rig)
        boards = as_float64(truth.boards)
        apart = [
            np.asarray(_apart(found, true, jax.tree.map(lambda x, i=i: x[i], boards), jnp.asarray(pixels)))
            for i, pixels in ((int(Path(view.name).stem), view.stripes[0].pixels) for view in observations.views)
        ]
    return rms(f_and_c[0] - f_and_c[1]), rig_errors(rig, truth.rig).points, 3**0.5 * rms(np.concatenate(apart))


@jax.jit
def _apart(rig: Rig, truth: Rig, T_cam_board: object, pixels: Float[Array, "pixels 2"]) -> Float[Array, "pixels 3"]:
    """Triangulated stripe pixels less where the true sheet meets the true board in the same columns (mm)."""
    beta = dual_plane(T_cam_board)  # pyright: ignore[reportArgumentType]

    def each(pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        exact = pixel
        for _ in range(4):
            x, dx = truth.camera.ray_and_change(exact, jnp.array([0.0, 1.0]))
            exact = exact.at[1].add(stripe_error(truth.lights[0], beta, x, dx))
        return rig.triangulate(pixel, {}) - truth.triangulate(exact, {})

    return jax.vmap(each)(pixels)


def _sub_pix(p: Photograph, half: int) -> Float[np.ndarray, "corners 2"]:
    start = p.corners + np.random.default_rng(1).uniform(-0.7, 0.7, p.corners.shape)
    return corner_sub_pix(to_grey(p.image), start, half) - p.corners


def _sectors(p: Photograph) -> Float[np.ndarray, "corners 2"]:
    """`findChessboardCornersSB`; NaN where it finds no board."""
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(to_grey(p.image), COUNTS, flags=flags)
    if not found:
        return np.full_like(p.corners, np.nan)
    either = (corners.reshape(-1, 2)[order] - p.corners for order in (np.s_[:], np.s_[::-1]))
    return min(either, key=lambda errors: np.abs(errors).max())


def cramer_rao(p: Photograph) -> Float[np.ndarray, "corners"]:
    """The bound of each corner's σ along an axis (px), from the photograph without noise.

    The patch holds all pixels nearer than 0.45 squares, and 15 px, along the board's lines. What is not known are the
    corner, the directions of its edges, their blur, and light and contrast as linear functions: the derivatives of
    the patch by these are taken of a picture of two blurred edges with the contrast that the photograph has. The
    noise is the photograph's own and that of rounding.
    """
    columns, rows = COUNTS
    grid = p.corners.reshape(rows, columns, 2)
    steps = [np.asarray(np.gradient(grid, axis=axis)).reshape(-1, 2) for axis in (1, 0)]
    bounds, side = [], np.arange(-16, 17)
    for corner, e1, e2 in zip(p.corners, *steps, strict=True):
        centre = np.rint(corner).astype(int)
        u, v = np.stack([np.tile(side, 33), np.repeat(side, 33)]) + centre[:, None]
        a, b = np.linalg.solve(np.stack([e1, e2], axis=1), np.stack([u, v]) - corner[:, None])
        inside = (np.abs(a) <= min(0.45, 15 / np.linalg.norm(e1))) & (np.abs(b) <= min(0.45, 15 / np.linalg.norm(e2)))
        inside &= (u >= 0) & (v >= 0) & (u < p.clean.shape[1]) & (v < p.clean.shape[0])
        if inside.sum() < 2 * 12:
            bounds.append(np.nan)
            continue
        levels = p.clean[v[inside], u[inside]]
        contrast = np.ptp(np.percentile(levels, (10, 90)))
        blur = np.sqrt(p.shot.blur_px**2 + p.shot.disc_px**2 / 4 + 1 / 12)
        truth = np.array(
            [*corner, np.arctan2(*e1[::-1]), np.arctan2(*e2[::-1]), blur, blur, 0, 0, 0, contrast / 2, 0, 0]
        )
        J = np.asarray(_derivatives(truth, u.astype(float), v.astype(float)))[inside]
        variance = np.linalg.inv(J.T @ J)[[0, 1], [0, 1]].mean() * (p.shot.noise**2 + 1 / 12)
        bounds.append(np.sqrt(variance))
    return np.array(bounds)


@jax.jit
def _derivatives(parameters: Array, u: Array, v: Array) -> Float[Array, "pixels 12"]:
    """The derivatives of the levels of a patch by the corner, two angles, two blurs, and six numbers of the light."""

    def level(p: Array, u: Array, v: Array) -> Array:
        x, y = u - p[0], v - p[1]
        S = jnp.ones(())
        for angle, blur in ((p[2], p[4]), (p[3], p[5])):
            S = S * jax.scipy.special.erf((jnp.cos(angle) * y - jnp.sin(angle) * x) / (2**0.5 * blur))
        return p[6] + p[7] * x + p[8] * y + (p[9] + p[10] * x + p[11] * y) * S

    return jax.vmap(jax.jacfwd(level), in_axes=(None, 0, 0))(parameters, u, v)


def _sure(name: str, errors: Errors) -> list[Metric]:
    """Predicted σ against actual errors."""
    return [
        Metric(f"{name}.rms_in_sigma", errors.in_sigma(), "", "lower", 1.2, slack=0.1),
        Metric(f"{name}.rms_in_sigma_not_too_small", errors.in_sigma(), "", "higher", 0.8, slack=0.1),
    ]
