"""What `calibrate` returns: the rig, its covariance, how every photograph fits, and what was left out."""

from dataclasses import dataclass, field

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration.adjustment import Adjustment
from jaxscan.calibration.changed import Change
from jaxscan.calibration.drifted import Drift
from jaxscan.calibration.flatness import BoardFlatness
from jaxscan.calibration.hand import Hand
from jaxscan.calibration.model import Choice
from jaxscan.calibration.observations import InlierMask, Observations
from jaxscan.calibration.off_grid import OffGrid
from jaxscan.calibration.on_board import stripe_points_in_space
from jaxscan.calibration.parted import Parted
from jaxscan.calibration.sheet_curve import SheetCurve
from jaxscan.calibration.sheet_thickness import sheet_sigma_mm
from jaxscan.calibration.stage_shape import StageShape
from jaxscan.files.rig_file import RigFile
from jaxscan.geometry import Pose
from jaxscan.precision import as_numpy
from jaxscan.rig import Covariance, Rig, System
from jaxscan.rig.board_shape import BOARD_SHAPES, BentBoard, bent_by, middle_and_half
from jaxscan.rig.light import distance, stood
from jaxscan.rig.rig import parameter_names
from jaxscan.robust import NORMAL_MAD

# Stripe points this number of σ off their light belong to another light.
_FAR_OFF = 6.0


@dataclass(frozen=True)
class PhotographFit:
    """How one photograph fits.

    Attributes:
        name: of the photograph.
        corner_errors: predicted minus seen (u, v), pixels; NaN where no corner was seen.
        corner_sigmas: σ of each corner along each axis as it was weighted, pixels.
        corner_kept: which corners took part.
        stripe_pixels: (u, v) of the stripe points that were candidates, pixels.
        stripe_errors: predicted minus seen along the axis of detection, pixels.
        stripe_sigmas: σ of each stripe point by itself, pixels.
        stripe_kept: which of them took part.
    """

    name: str
    corner_errors: Float[np.ndarray, "corners 2"]
    corner_sigmas: Float[np.ndarray, "corners"]
    corner_kept: Bool[np.ndarray, "corners"]
    stripe_pixels: Float[np.ndarray, "points 2"]
    stripe_errors: Float[np.ndarray, "points"]
    stripe_sigmas: Float[np.ndarray, "points"]
    stripe_kept: Bool[np.ndarray, "points"]


@dataclass(frozen=True)
class Calibration:
    """A calibrated rig, how it was reached, and what was left out.

    Attributes:
        rig: camera, lights, motion; NumPy float64 leaves.
        system: the same with every board pose.
        observations: what it was found from: the usable photographs, with those stripe points that lie on the board.
        covariance: of the rig's parameters; one that was held is not among them.
        board_covariances: view by view, of the rig's parameters and that board's pose together.
        moved_covariances: the same of the pose of each sequence's board with all axes at 0.
        shape_covariance: of the board's shape, `shape.bulge.0` … (mm); None where the board was taken to be flat.
        bend_sigma_mm: σ of each board's bulges in addition to that shape, from the photographs; None where it was
            taken to have none.
        corner_sigma_px: σ of a corner along each axis, from the residuals.
        stripe_sigma_px: σ of a stripe point, from the residuals; None without stripes.
        stripe_correlation: how many neighbouring stripe points are worth one, by the correlation of their errors.
        stripe_sigma_ratio: the scatter of these points over the detector's prediction, where there is one.
        corner_rms_px: root mean square distance of the corners that were kept.
        stripe_rms_px: root mean square stripe error of the points that were kept; None without stripes.
        fits: view by view.
        moved_fits: photograph by photograph of the sequences along the axes.
        left_out: photographs and stripes that were not used, and why, in words.
        rejected: for photographs that were used: how many of their corners and stripe points were not, and why, in
            words.
        notes: what a reader should know.
        warnings: what every user of the rig must know; `rig_file` includes it.
        kept: which points of each photograph took part, in the order of `Observations.photographs`; what `calibrate`
            takes as `keep`.
        adjustment: the last least-squares problem, NumPy leaves; what `refit` takes.
        solves: how many solves it took until σ, weights and outliers settled.
        settled: whether they did; otherwise the rounds ended by their number. A solve that reached no minimum is an
            error.
        steps: evaluations of the last solve.
        flatness: what the residuals say of the board's shape beyond the shape that was solved for.
        plain: whether every observation took part with the same weight.
        sheet_curves: of sheets of light that were assumed flat and are clearly curved.
        change: what changed between two of the photographs.
        undetermined_periods: of screws whose period the photographs do not determine, sentences without their full
            stops.
        stage_shapes: of axes whose path differs from the assumed kind, how it differs.
        off_grid: errors of the board's points that all photographs share.
        drift: what changes slowly from the first photograph to the last.
        choice: how the model was chosen, where it was.
        parted: what differs between the two parts of a session that was solved in two, of which this is one.
        formal_covariance: that of the rig's parameters from noise alone; `covariance` includes what `off_grid` and
            `drift` add.
        held_out: of each photograph, in the order of `Observations.in_order`, −2 log of the density at which the others
            predict it; empty where it was not asked.
        hand: how well given poses fit the photographs, where photographs have given poses.
    """

    rig: Rig
    system: System
    observations: Observations
    covariance: Covariance
    board_covariances: tuple[Covariance, ...]
    moved_covariances: tuple[Covariance, ...]
    shape_covariance: Covariance | None
    bend_sigma_mm: float | None
    corner_sigma_px: float
    stripe_sigma_px: float | None
    stripe_correlation: float | None
    stripe_sigma_ratio: float | None
    corner_rms_px: float
    stripe_rms_px: float | None
    fits: tuple[PhotographFit, ...]
    moved_fits: tuple[PhotographFit, ...]
    left_out: tuple[str, ...]
    rejected: tuple[str, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    kept: tuple[InlierMask, ...]
    adjustment: Adjustment
    solves: int
    settled: bool
    steps: int
    flatness: BoardFlatness | None = None
    plain: bool = False
    sheet_curves: tuple[SheetCurve, ...] = ()
    change: Change | None = None
    undetermined_periods: tuple[str, ...] = ()
    stage_shapes: tuple[StageShape, ...] = ()
    off_grid: OffGrid | None = None
    drift: Drift | None = None
    choice: Choice | None = None
    parted: Parted | None = None
    formal_covariance: Covariance | None = None
    held_out: Float[np.ndarray, "photographs"] = field(default_factory=lambda: np.zeros(0))
    hand: Hand | None = None

    def rig_file(self) -> RigFile:
        """What `write_rig` writes."""
        fit = {
            "corner_rms_px": self.corner_rms_px,
            "corner_sigma_px": self.corner_sigma_px,
            "views": len(self.fits),
            "stage_images": 0,
        }
        for sequence in self.observations.sequences:
            key = f"{sequence.axis}_images"
            fit[key] = fit.get(key, 0) + len(sequence.views)
        if self.stripe_rms_px is not None:
            fit |= {
                "stripe_rms_px": self.stripe_rms_px,
                "stripe_sigma_px": self.stripe_sigma_px,
                "stripe_correlation": self.stripe_correlation,
            }
        if self.hand is not None:
            fit |= self.hand.facts()
        if (depths := self._stripe_depths()) is not None:
            fit["stripe_depths_mm"] = depths
        if swept := self._swept_over():
            fit["light_positions"] = swept
        if any(thickness := self.sheet_sigmas_mm()):
            fit["sheet_sigma_mm"] = thickness
        if self.stripe_sigma_ratio is not None:
            fit["stripe_sigma_ratio"] = self.stripe_sigma_ratio
        fit |= self.shape_facts()
        if self.choice is not None:
            fit["model"] = self.choice.sentence
        if self.parted is not None:
            fit["parted"] = self.parted.sentence
        found = self.off_grid is not None or self.drift is not None
        # Of a rig that is held altogether there are none.
        if found and (ratios := self.widened_by()):
            fit["sigma_over_noise_alone"] = ratios
        if self.warnings:
            fit["warnings"] = list(self.warnings)
        return RigFile(self.rig, self.covariance, fit)

    def widened_by(self) -> dict[str, float]:
        """How much wider σ of each of the rig's parameters is than from noise alone, a factor."""
        formal = self.formal_covariance or self.covariance
        ratios = np.sqrt(np.diagonal(self.covariance.matrix) / np.diagonal(formal.matrix))
        return dict(zip(self.covariance.names, map(float, ratios), strict=True))

    def most_moved(
        self, by: Float[np.ndarray, "unknowns"], sigma: Float[np.ndarray, "unknowns_or_fewer"]
    ) -> tuple[str, float]:
        """Which of the rig's parameters that were sought is moved most, in σ, and by how many.

        Args:
            by: by how much each of the rig's leaves is moved, and behind them whatever else is shared.
            sigma: theirs, at least those of the rig's leaves.
        """
        names = parameter_names(self.rig)
        by, sigma = np.abs(by[: len(names)]), sigma[: len(names)]
        sought = np.isin(names, self.covariance.names) & (sigma > 0)
        in_sigma = np.where(sought, by / np.where(sought, sigma, 1.0), 0.0)
        worst = int(np.argmax(in_sigma))
        return names[worst], float(in_sigma[worst])

    def stripe_points(self, laser: int) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points"]]:
        """Where a laser's stripes lie on the boards, camera frame, mm; without those that are far from its light.

        With the position of the axis that moves the light, motor steps, 0 where none does.
        """
        poses, bent = self.photograph_poses(), self.bent_boards()
        X, _, positions = stripe_points_in_space(self.observations, self.rig.camera, poses, laser, bent)
        off = np.abs(distance(stood(self.rig.lights[laser], positions), X))
        near = off <= _FAR_OFF * NORMAL_MAD * np.median(off) if len(X) else np.zeros(0, bool)
        return X[near], positions[near]

    def photograph_poses(self) -> Pose[np.ndarray]:
        """T_cam_board of every photograph, in the order of `Observations.photographs`."""
        boards = [np.asarray(self.system.boards.as_vector())]
        for sequence, pose in zip(self.observations.sequences, np.asarray(self.system.moved.as_vector()), strict=True):
            boards.append((self.rig.pose(sequence.positions) @ Pose.from_vector(pose)).as_vector())
        return Pose.from_vector(np.concatenate(boards))

    @property
    def board_shape(self) -> str:
        """What was found of the board's shape, as it was asked for."""
        asked = len(jax.tree.leaves(self.system.shape)), self.bend_sigma_mm is not None
        return next(name for name, each in BOARD_SHAPES.items() if each == asked)

    def board_bent_by(self) -> tuple[float, float]:
        """From the lowest to the highest point of the board as all photographs have it, mm, and its σ; 0 if flat."""
        if self.shape_covariance is None:
            return 0.0, 0.0
        return bent_by(np.array([float(x) for x in jax.tree.leaves(self.system.shape)]), self.shape_covariance.matrix)

    def bent_boards(self) -> list[BentBoard] | None:
        """The board where it stood in each photograph, in the order of `Observations.photographs`; None if flat."""
        shape = as_numpy(self.system.shape)
        if shape is None:
            return None
        extent = middle_and_half(self.observations.board.points())
        blocks = [(0, i) for i in range(len(self.observations.views))]
        blocks += [(1, i) for i, each in enumerate(self.observations.sequences) for _ in each.views]
        poses, boards = self.photograph_poses(), []
        for i, (group, block) in enumerate(blocks):
            bends = self.system.bends(group)
            own = shape if bends is None else shape.bent(np.asarray(bends)[block])
            boards.append(BentBoard.create(own, poses.matrix()[i], poses.translation[i], *extent))
        return boards

    def shape_facts(self) -> dict[str, object]:
        """What a rig file has of the board's shape; nothing of a flat one."""
        if self.shape_covariance is None:
            return {}
        bent, sigma = self.board_bent_by()
        summary: dict[str, object] = {
            "board_shape": self.board_shape,
            "board_bent_mm": bent,
            "board_bent_sigma_mm": sigma,
        }
        summary["board_terms_mm"] = [float(term) for term in jax.tree.leaves(self.system.shape)]
        return summary | ({} if self.bend_sigma_mm is None else {"board_bends_sigma_mm": self.bend_sigma_mm})

    def sheet_sigmas_mm(self) -> list[float]:
        """How thick the sheet of each light is, σ in mm; 0 where the stripes' widths do not tell it."""
        poses, bent = self.photograph_poses(), self.bent_boards()
        lights = range(len(self.rig.lights))
        return [sheet_sigma_mm(self.observations, self.rig, poses, laser, bent) or 0.0 for laser in lights]

    def _swept_over(self) -> dict[str, list[float]]:
        """The least and the greatest position at which the stripes of lights that move were seen, by their axes."""
        found: dict[str, list[float]] = {}
        for i, name in enumerate(self.observations.lasers):
            if (axis := self.observations.light_axes.get(name)) is not None:
                _, positions = self.stripe_points(i)
                found[axis] = [float(f(positions.tolist() + found.get(axis, []))) for f in (min, max)]
        return found

    def _stripe_depths(self) -> list[float] | None:
        """The nearest and the farthest depth of a stripe on a board, mm: along the optical axis, or as its rays go."""
        range_of = self.rig.camera.chart.range_of
        seen = [range_of(self.stripe_points(i)[0]) for i in range(len(self.rig.lights))]
        depths = np.concatenate(seen) if seen else np.empty(0)
        return [round(float(depths.min()), 1), round(float(depths.max()), 1)] if depths.size else None
