"""Whether a calibration ends in the same minimum wherever it starts: hard boards, cameras and outliers, poor starts.

Each session is calibrated from the start that the library finds by itself, or is given, and from the true camera. What
ends at another focal length (by more than a thousandth), or in an error that the start from the truth does not meet, is
lost. All sessions have ten views of a board of 9 × 6 corners and the same lens, so that they share what is compiled.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from benchmarks.metric import Metric
from jaxscan.calibration import Observations, View, calibrate
from jaxscan.errors import InputError, ObservabilityError, SolveError
from jaxscan.images import Board
from jaxscan.rig import Camera

_BOARD = Board.checkerboard([9, 6], 16.0)
_SIZE = (640, 480)
_VIEWS = 10
LENS = "radial2"
_SEEDS = 6
# How far a wrong corner is from its place, px.
_ASTRAY_PX = 20.0


@dataclass(frozen=True)
class Hardship:
    """How a session is drawn.

    Attributes:
        focal: f_u, f_v, px.
        off_centre: of the principal point, px.
        radial: k1, k2.
        tilt: of the boards, from and to, radians.
        fill: width of a board as a part of the image's.
        noise: σ of a corner, px.
        astray: part of the corners that are elsewhere.
        strangers: views whose corners belong to no board, or are mirrored.
    """

    focal: tuple[float, float] = (700.0, 700.0)
    off_centre: tuple[float, float] = (0.0, 0.0)
    radial: tuple[float, float] = (-0.13, 0.02)
    tilt: tuple[float, float] = (0.1, 0.6)
    fill: float = 0.4
    noise: float = 0.2
    astray: float = 0.0
    strangers: int = 0


HARDSHIPS = {
    "plain": Hardship(),
    "cropped": Hardship(off_centre=(180.0, -120.0)),
    "tall_pixels": Hardship(focal=(700.0, 1400.0)),
    "wide_angle": Hardship(focal=(260.0, 260.0), radial=(-0.33, 0.07), fill=0.8),
    "steep": Hardship(tilt=(0.9, 1.25), fill=0.3),
    "small": Hardship(tilt=(0.5, 1.0), fill=0.2),
    "astray": Hardship(astray=0.45),
    "wide_angle_astray": Hardship(focal=(300.0, 300.0), radial=(-0.3, 0.05), fill=0.6, astray=0.3),
    "strangers": Hardship(strangers=3),
}
# Given starts: the focal length is this multiple of the true one, the lens has no distortion.
_GIVEN = (0.3, 0.5, 2.0, 4.0)
_GIVEN_FOR = ("plain", "wide_angle", "steep", "astray")


def measure(quick: bool) -> list[Metric]:
    """All hardships, or three of them."""
    seeds, cases = (3, ("plain", "steep", "astray")) if quick else (_SEEDS, tuple(HARDSHIPS))
    own = {name: sum(_lost(HARDSHIPS[name], seed, None) for seed in range(seeds)) for name in cases}
    given = {
        name: sum(_lost(HARDSHIPS[name], seed, factor) for seed in range(seeds) for factor in _GIVEN)
        for name in cases
        if name in _GIVEN_FOR
    }
    for name, lost in own.items():
        also = f"; from starts that were given {given[name]} of {seeds * len(_GIVEN)}" if name in given else ""
        print(f"  {name}: lost {lost} of {seeds}{also}", flush=True)
    return [
        Metric("starts.own.lost", sum(own.values()), "", "lower", 0),
        Metric("starts.given.lost", sum(given.values()), "", "lower", 0),
        Metric("starts.sessions", len(own) * seeds),
    ]


def _lost(hardship: Hardship, seed: int, factor: float | None) -> bool:
    observations = session(hardship, seed)
    middle = (np.asarray(_SIZE) - 1) / 2
    start = None if factor is None else Camera.create(_SIZE, factor * np.asarray(hardship.focal), middle, LENS)
    truth = Camera.create(_SIZE, hardship.focal, middle + hardship.off_centre, LENS, hardship.radial)
    best = _focal(observations, truth)
    found = _focal(observations, start)
    return np.isfinite(best) and not abs(found / best - 1) < 1e-3


def _focal(observations: Observations, start: Camera | None) -> float:
    try:
        return float(calibrate(observations, lens=LENS, start=start).rig.camera.focal[0])
    except (InputError, ObservabilityError, SolveError):
        return np.nan


def session(hardship: Hardship, seed: int) -> Observations:
    """Boards about the middle of the view, within the part of it in which the lens does not fold back."""
    random = np.random.default_rng(seed)
    board = _BOARD.points()
    centred = board - board.mean(axis=0)
    size, focal = np.asarray(_SIZE), np.asarray(hardship.focal)
    K = np.eye(3)
    K[[0, 1], [0, 1]], K[:2, 2] = focal, (size - 1) / 2 + hardship.off_centre
    k1, k2 = hardship.radial
    views: list[View] = []
    while len(views) < _VIEWS:
        about, tilt, turn = random.uniform(0, 2 * np.pi), random.uniform(*hardship.tilt), random.uniform(-np.pi, np.pi)
        R = (
            cv2.Rodrigues(tilt * np.array([np.cos(about), np.sin(about), 0]))[0]
            @ cv2.Rodrigues(np.array([0, 0, turn]))[0]
        )
        depth = focal[0] * np.ptp(board[:, 0]) / (size[0] * hardship.fill * random.uniform(0.8, 1.2))
        X = centred @ R.T + [*(random.uniform(-0.25, 0.25, 2) * size / focal * depth), depth]
        r2 = (X[:, :2] ** 2).sum(axis=1) / X[:, 2] ** 2
        if (X[:, 2] < 10).any() or (1 + 3 * k1 * r2 + 5 * k2 * r2**2 < 0.05).any():
            continue
        seen = cv2.projectPoints(X, np.zeros(3), np.zeros(3), K, np.array([k1, k2, 0, 0]))[0].reshape(-1, 2)
        seen += hardship.noise * random.normal(size=seen.shape)
        astray = random.random(len(seen)) < hardship.astray
        seen[astray] += _ASTRAY_PX * random.normal(size=(astray.sum(), 2))
        seen[((seen < 0) | (seen > size - 1)).any(axis=1)] = np.nan
        if np.isfinite(seen[:, 0]).sum() >= 15:
            views.append(View(f"{len(views)}", seen))
    for i in range(hardship.strangers):
        corners = views[i].corners
        wrong = corners[random.permutation(len(corners))] if i % 2 else corners * [-1, 1] + [size[0] - 1, 0]
        views[i] = replace(views[i], corners=wrong)
    return Observations(_SIZE, _BOARD, tuple(views))
