"""What the residuals of a calibration say of its model: photograph by photograph, against the normal, over the image.

Errors that are noise alone are normal in units of their σ, the same in every photograph, and have no direction that
depends on where in the image they are. Each statistic here looks for one way in which they are not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.coverage import CELLS
from jaxscan.calibration.result import Calibration, PhotographFit

_RADIUS_BINS = 8
_HISTOGRAM = np.linspace(-4.5, 4.5, 46)
# A cell is off if its mean exceeds both limits: standard errors, and σ of a corner. Chance never gives this share of
# such cells.
_ERRORS, _OFF_IN_SIGMA, _SHARE_OFF = 5.0, 0.5, 0.1
_FEWEST_IN_A_CELL = 5


@dataclass(frozen=True)
class PhotographStatistics:
    """One photograph.

    Attributes:
        name: of the photograph.
        staged: whether the board was on the stage.
        corners: how many were seen.
        corners_kept: how many took part.
        corner_rms_px: RMS distance of those that took part; NaN without any.
        corner_worst_px: the largest distance, rejected ones included.
        stripe_points: how many lie on the board.
        stripe_kept: how many took part.
        stripe_rms_px: RMS error of those that took part; None without any.
    """

    name: str
    staged: bool
    corners: int
    corners_kept: int
    corner_rms_px: float
    corner_worst_px: float
    stripe_points: int
    stripe_kept: int
    stripe_rms_px: float | None


@dataclass(frozen=True)
class Normality:
    """Residuals in units of their σ against the standard normal.

    Attributes:
        count: how many.
        sigma: their RMS; 1 by construction but for the observations' different redundancy.
        skewness: 0 for the normal.
        excess_kurtosis: 0 for the normal; positive for long tails.
        beyond_2: share beyond 2 σ; 0.0455 for the normal.
        beyond_3: share beyond 3 σ; 0.0027 for the normal.
        edges: of the histogram's bins, σ.
        density: the histogram, with the integral 1 over all residuals.
    """

    count: int
    sigma: float
    skewness: float
    excess_kurtosis: float
    beyond_2: float
    beyond_3: float
    edges: Float[np.ndarray, "edges"]
    density: Float[np.ndarray, "bins"]


@dataclass(frozen=True)
class ByRadius:
    """Corner residuals by their distance from the principal point, in bins of equally many corners.

    Attributes:
        radius_px: mean of each bin.
        radial_px: mean residual outwards.
        radial_error_px: its standard error.
        rms_px: RMS distance.
    """

    radius_px: Float[np.ndarray, "bins"]
    radial_px: Float[np.ndarray, "bins"]
    radial_error_px: Float[np.ndarray, "bins"]
    rms_px: Float[np.ndarray, "bins"]


@dataclass(frozen=True)
class OverImage:
    """Mean corner residual in each cell of the image; NaN in a cell with hardly any.

    Attributes:
        mean_px: (u, v), predicted minus seen.
        error_px: its standard error along each axis.
        count: corners in each cell.
    """

    mean_px: Float[np.ndarray, "cell_rows cell_columns 2"]
    error_px: Float[np.ndarray, "cell_rows cell_columns 2"]
    count: Int[np.ndarray, "cell_rows cell_columns"]

    def share_off(self, corner_sigma_px: float) -> float:
        """The share of the cells with corners in which these are clearly off in one direction."""
        with np.errstate(invalid="ignore"):
            errors = np.abs(self.mean_px) / self.error_px
            large = np.nanmax(errors, axis=-1, initial=0.0, where=np.isfinite(self.error_px))
            off = (large > _ERRORS) & (np.linalg.norm(self.mean_px, axis=-1) > _OFF_IN_SIGMA * corner_sigma_px)
        return float(off.sum() / max(np.isfinite(self.mean_px[..., 0]).sum(), 1))

    def left_out(self, corner_sigma_px: float) -> bool:
        """Whether the camera leaves out what moves corners alike in all photographs: a field over the image."""
        return self.share_off(corner_sigma_px) > _SHARE_OFF


@dataclass(frozen=True)
class CornerResiduals:
    """Every corner that took part: where it was seen, and predicted minus seen (pixels)."""

    pixels: Float[np.ndarray, "corners 2"]
    errors: Float[np.ndarray, "corners 2"]
    sigmas: Float[np.ndarray, "corners"]


def photographs(calibration: Calibration) -> tuple[PhotographStatistics, ...]:
    """Every photograph: first those of which no corner took part, then by the RMS of their corners, the worst first."""
    each = [_photograph(fit, staged=False) for fit in calibration.fits]
    each += [_photograph(fit, staged=True) for fit in calibration.moved_fits]
    return tuple(sorted(each, key=lambda p: -np.nan_to_num(p.corner_rms_px, nan=np.inf)))


def _photograph(fit: PhotographFit, staged: bool) -> PhotographStatistics:
    distance = np.linalg.norm(fit.corner_errors, axis=1)
    seen = np.isfinite(distance)
    kept = fit.stripe_errors[fit.stripe_kept]
    return PhotographStatistics(
        name=fit.name,
        staged=staged,
        corners=int(seen.sum()),
        corners_kept=int(fit.corner_kept.sum()),
        corner_rms_px=float(np.sqrt((distance[fit.corner_kept] ** 2).mean())) if fit.corner_kept.any() else np.nan,
        corner_worst_px=float(distance[seen].max()) if seen.any() else np.nan,
        stripe_points=len(fit.stripe_errors),
        stripe_kept=len(kept),
        stripe_rms_px=float(np.sqrt((kept**2).mean())) if len(kept) else None,
    )


def corner_residuals(calibration: Calibration) -> CornerResiduals:
    """The corners of all views and stage photographs."""
    views = calibration.observations.photographs()
    fits = (*calibration.fits, *calibration.moved_fits)
    return CornerResiduals(
        np.concatenate([view.corners[fit.corner_kept] for view, fit in zip(views, fits, strict=True)]),
        np.concatenate([fit.corner_errors[fit.corner_kept] for fit in fits]),
        np.concatenate([fit.corner_sigmas[fit.corner_kept] for fit in fits]),
    )


def corner_normality(residuals: CornerResiduals) -> Normality:
    """Both coordinates of every corner."""
    return normality((residuals.errors / residuals.sigmas[:, None]).ravel())


def stripe_normality(fits: Sequence[PhotographFit]) -> Normality | None:
    """Every stripe point that took part; None without any."""
    each = [(fit.stripe_errors / fit.stripe_sigmas)[fit.stripe_kept] for fit in fits]
    scaled = np.concatenate(each) if each else np.zeros(0)
    return normality(scaled) if scaled.size else None


def normality(scaled: Float[np.ndarray, "n"]) -> Normality:
    """Residuals in units of σ against the normal."""
    centred = scaled - scaled.mean()
    variance = float((centred**2).mean())
    counts = np.histogram(scaled, _HISTOGRAM)[0]
    return Normality(
        count=len(scaled),
        sigma=float(np.sqrt((scaled**2).mean())),
        skewness=float((centred**3).mean()) / variance**1.5,
        excess_kurtosis=float((centred**4).mean()) / variance**2 - 3,
        beyond_2=float((np.abs(scaled) > 2).mean()),
        beyond_3=float((np.abs(scaled) > 3).mean()),
        edges=_HISTOGRAM,
        density=counts / (len(scaled) * np.diff(_HISTOGRAM)),
    )


def by_radius(residuals: CornerResiduals, principal: Float[np.ndarray, "2"]) -> ByRadius:
    """A lens with the wrong terms shows as a mean residual in or out that changes with the radius."""
    offset = residuals.pixels - principal
    radius = np.linalg.norm(offset, axis=1)
    outwards = (residuals.errors * offset).sum(axis=1) / np.maximum(radius, 1e-9)
    bins = [b for b in np.array_split(np.argsort(radius), _RADIUS_BINS) if len(b) > 1]
    return ByRadius(
        np.array([radius[b].mean() for b in bins]),
        np.array([outwards[b].mean() for b in bins]),
        np.array([outwards[b].std(ddof=1) / np.sqrt(len(b)) for b in bins]),
        np.array([np.sqrt((residuals.errors[b] ** 2).sum(axis=1).mean()) for b in bins]),
    )


def over_image(residuals: CornerResiduals, image_size: tuple[int, int]) -> OverImage:
    """What is wrong with the camera is wrong at the same place in every photograph."""
    cell = np.floor((residuals.pixels + 0.5) / image_size * CELLS).astype(int).clip(0, np.array(CELLS) - 1)
    columns, rows = CELLS
    mean, error = np.full((rows, columns, 2), np.nan), np.full((rows, columns, 2), np.nan)
    count = np.zeros((rows, columns), int)
    for row in range(rows):
        for column in range(columns):
            own = residuals.errors[(cell == (column, row)).all(axis=1)]
            count[row, column] = len(own)
            if len(own) >= _FEWEST_IN_A_CELL:
                mean[row, column] = own.mean(axis=0)
                error[row, column] = own.std(axis=0, ddof=1) / np.sqrt(len(own))
    return OverImage(mean, error, count)
