"""A drawn world for the pipeline of 2003: noisy corners, and photographs in which nothing but the stripe is painted.

What takes a renderer seconds a photograph takes a tenth of one here, and it is exact enough to time pipelines on and to
check them against each other.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from benchmarks.pipeline_2003 import Job
from jaxscan.calibration import BoardSequence, Observations, StripePoints, View
from jaxscan.calibration.observe import stripe_points
from jaxscan.images import Board, StripeSettings, read_image, write_image
from jaxscan.precision import as_numpy, float64
from jaxscan.rig import Camera, LightPlane, Linear, Rig

OMEGA = np.array([0.0001, -0.00494, 0.00303])
# From one photograph to the next, mm; and in how many motor steps.
MOVE, STEPS_APART = np.array([0.06, 1.84, -0.78]), 2000
# The floor at step 0, dual, 1/mm.
FLOOR = np.array([0.0, -0.0005, 1 / 350])
BOARD = Board.checkerboard((9, 6), 16.0)
_K1 = -0.134
_CORNER_NOISE_PX = 0.005


@dataclass(frozen=True)
class Drawing:
    """A camera like that of 2003, of any image size.

    Attributes:
        folder: where photographs go.
        image_size: columns and rows; the focal lengths grow with the columns.
        every: stripes on boards are painted in each so-manieth column.
        ending: file format.
    """

    folder: Path
    image_size: tuple[int, int] = (640, 480)
    every: int = 1
    ending: str = ".png"

    @cached_property
    def K(self) -> Float[np.ndarray, "3 3"]:  # noqa: N802
        """The camera matrix."""
        columns, rows = self.image_size
        scale = columns / 640
        return np.array([[697.7 * scale, 0, columns / 2 - 10], [0, 690.4 * scale, rows / 2 - 12], [0, 0, 1]])

    @property
    def lens(self) -> Float[np.ndarray, "4"]:
        """As OpenCV has it."""
        return np.array([_K1, 0.0, 0.0, 0.0])

    @cached_property
    def _rays(self) -> Float[np.ndarray, "rows columns 2"]:
        columns, rows = self.image_size
        pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(float)
        return cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.K, self.lens).reshape(rows, columns, 2)

    def rig(self) -> Rig:
        """The true rig."""
        with float64():
            camera = Camera.create(self.image_size, np.diag(self.K)[:2], self.K[:2, 2], "radial1", np.array([_K1]))
            return as_numpy(Rig(camera, (LightPlane.create(OMEGA),), Linear.create(MOVE / STEPS_APART)))

    def job(self, views: int, stage_views: int, frames: int) -> Job:
        """Boards with stripes, boards on the stage, and a scan of the bare floor."""
        random = np.random.default_rng(0)
        points = BOARD.points()[:, :2]
        away = np.diag([1.0, -1.0, -1.0])  # z points at the camera
        corners, photos, staged = [], [], []
        for i in range(views):
            R = cv2.Rodrigues(random.uniform(-0.5, 0.5, 3))[0] @ away
            t = np.array([0.0, 30.0 * i / views - 15.0, 340.0]) - R @ [64, 40, 0]
            corners.append(self._seen(points, R, t, random))
            photos.append(self.paint(f"board-{i}", R[:, 2] / (R[:, 2] @ t), random, self.every))
        for i in range(stage_views):
            staged.append(self._seen(points, away, np.array([-64.0, 30.0, 340.0]) + i * MOVE, random))
        scan = [self.paint(f"scan-{i}", FLOOR / (1 + i * FLOOR @ MOVE), random) for i in range(frames)]
        return Job(self.image_size, points, np.array(corners), np.array(staged), tuple(photos), tuple(scan))

    def observations(self, job: Job, *, stripes: bool = True) -> Observations:
        """The same for other pipelines: corners in the order in which z points away, stripes by our own detector."""
        columns, rows = BOARD.counts

        def corners(seen: Float[np.ndarray, "corners 2"]) -> Float[np.ndarray, "corners 2"]:
            return seen.reshape(rows, columns, 2)[::-1].reshape(-1, 2)

        def lit(photo: Path) -> tuple[StripePoints, ...]:
            return (stripe_points(read_image(photo), StripeSettings("red"), 0),) if stripes else ()

        views = tuple(
            View(photo.name, corners(seen), stripes=lit(photo))
            for seen, photo in zip(job.corners, job.board_photos, strict=True)
        )
        along = tuple(View(f"stage-{i}", corners(seen)) for i, seen in enumerate(job.stage_corners))
        steps = STEPS_APART * np.arange(len(along), dtype=float)
        return Observations(self.image_size, BOARD, views, (BoardSequence({"stage": steps}, along),), lasers=("",))

    def _seen(
        self,
        board: Float[np.ndarray, "corners 2"],
        R: Float[np.ndarray, "3 3"],
        t: Float[np.ndarray, "3"],
        random: np.random.Generator,
    ) -> Float[np.ndarray, "corners 2"]:
        points = np.column_stack([board, np.zeros(len(board))])
        exact = cv2.projectPoints(points, cv2.Rodrigues(R)[0], t, self.K, self.lens)[0][:, 0]
        return exact + _CORNER_NOISE_PX * random.normal(size=exact.shape)

    def paint(self, name: str, plane: Float[np.ndarray, "3"], random: np.random.Generator, every: int = 1) -> Path:
        """A photograph of the sheet's line on a dual plane, whose light falls off over a few pixels.

        Two columns in the middle stay dark, and all those that are no multiple of `every`.
        """
        columns, rows = self.image_size
        off = self._rays @ (OMEGA - plane)[:2] + (OMEGA - plane)[2]
        from_line = off / np.gradient(off, axis=0)
        image = random.integers(0, 6, (rows, columns, 3)).astype(np.float32)
        image[..., 0] += 240 * np.exp(-0.5 * (from_line / 1.8) ** 2)
        image[:, np.arange(columns) % every > 0] = image[:, columns // 2 : columns // 2 + 2] = 0
        path = self.folder / f"{name}{self.ending}"
        write_image(path, image.clip(0, 255).astype(np.uint8))
        return path
