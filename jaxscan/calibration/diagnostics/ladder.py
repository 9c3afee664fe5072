"""Which lens do the photographs support? Every rung of the ladder is solved, and judged on views that it has not seen.

Rungs are nested (none ⊂ radial1 ⊂ radial2 ⊂ radial3 ⊂ brown ⊂ rational), and all are solved on the same corners with
the same σ: those that the richest polynomial lens keeps. Two criteria, both of which a rung has to meet against the
best one below it:

- the F-test of nested least squares, F = ((χ²_poor − χ²_rich) / Δp) / (χ²_rich / ν), at 0.1 %;
- cross-validation: views are dealt into folds, the camera is found from the others, the fold's boards are placed by
  their own corners with the camera held, and each view's mean squared error has to fall, in the mean of its logarithm
  over views by more than two standard errors, and by 5 %. What only fits noise, or the bend of a plate, does not pass.

Every rung is the rational lens with what it lacks held at zero, so the whole ladder is one compiled function. What the
calibration held stays as it was on every rung; of rungs that then seek the same terms one is tried.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float
from scipy.special import fdtrc

from jaxscan.buckets import bucket
from jaxscan.calibration.blocks import view_blocks
from jaxscan.calibration.bundle import Outcome, solve
from jaxscan.calibration.residuals import Blocks, Noise, far_away
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import refine
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Rig, System
from jaxscan.rig.camera import camera_parameters, lens_parameters
from jaxscan.rig.opencv_lens import LADDER, Rational
from jaxscan.rig.projection import with_richest_lens
from jaxscan.rig.rig import parameter_names

_FOLDS = 5
_P = 1e-3
_STANDARD_ERRORS = 2.0
# Less than this share of the squared error is not worth a coefficient.
_WORTH = 0.05
# The rung whose corners count, unless the calibration's own is richer still.
_REFERENCE = "brown"


@dataclass(frozen=True)
class Rung:
    """One lens of the ladder.

    Attributes:
        lens: its name.
        terms: how many coefficients were sought; those that the calibration held are not among them.
        rms_px: RMS distance of the corners in the fit; NaN where no minimum was found.
        held_out_px: RMS distance of corners in views that the camera was not fitted to, their boards placed again.
        p: of the F-test against the best rung below it; None for the first.
        gain: by which share of the squared held-out error it is better than the best rung below it.
        gain_error: its standard error, from view to view.
        supported: whether both criteria are met.
    """

    lens: str
    terms: int
    rms_px: float
    held_out_px: float
    p: float | None
    gain: float | None
    gain_error: float | None
    supported: bool


@dataclass(frozen=True)
class Ladder:
    """The lenses tried.

    Attributes:
        rungs: from none to rational.
        chosen: the calibration's own lens.
        supported: the richest one that the photographs support.
        views: how many views were held out in turn.
        held_out_of_views_px: of the chosen lens, the RMS distance of each view when it was held out.
    """

    rungs: tuple[Rung, ...]
    chosen: str
    supported: str
    views: int
    held_out_of_views_px: Float[np.ndarray, "views"]


@dataclass(frozen=True)
class _Solved:
    """A rung's χ² on all corners, RMS distance, and squared held-out error and its count for each view."""

    chi2: float
    rms: float
    held_out: Float[np.ndarray, "views"]
    count: Float[np.ndarray, "views"]


def climb(calibration: Calibration) -> Ladder | None:
    """Solve every rung on the corners of the views; None where the calibration's own lens is none of them."""
    chosen = calibration.rig.camera.lens.kind
    if chosen not in LADDER:
        return None
    with float64():
        system, group = _corners_alone(calibration)
        held = {
            name for name in parameter_names(Rig(calibration.rig.camera)) if name not in calibration.covariance.names
        }
        tilted = bool(calibration.rig.camera.tilt)
        names = _distinct(chosen, held)
        reference = max(_REFERENCE, chosen, key=list(LADDER).index)
        shape = len(jax.tree.leaves(system.shape))

        def free(lens: str) -> Bool[Array, "shared"]:
            return jnp.pad(_free(lens, held, tilted), (0, shape))

        noise = calibration.adjustment.noise.of(calibration.corner_sigma_px, 1.0)
        judge = not calibration.plain
        best = refine(system, free(reference), (group,), noise, reject=judge, weigh=judge)
        n = len(calibration.observations.views)
        solved = {
            lens: _solve_rung(_without(system, lens, held), free(lens), best.groups[0], best.noise, n) for lens in names
        }
    observations = float(2 * np.asarray(best.groups[0].corner_used).sum())
    rungs, top = [], names[0]
    for lens in names:
        own, below = solved[lens], solved[top]
        if lens == names[0]:
            rungs.append(_rung(lens, _sought(lens, held), own, None, None, None, supported=True))
            continue
        terms = _sought(lens, held) - _sought(top, held)
        dof = observations - 6 * n - float(_free(lens, held, tilted).sum())
        p = f_test(below.chi2, own.chi2, terms, dof)
        gain, error = _gain(below, own)
        supported = bool(np.isfinite(own.chi2) and p < _P and gain > max(_WORTH, _STANDARD_ERRORS * error))
        rungs.append(_rung(lens, _sought(lens, held), own, p, gain, error, supported))
        top = lens if supported else top
    own = solved[chosen]
    return Ladder(tuple(rungs), chosen, top, n, np.sqrt(2 * own.held_out / np.maximum(own.count, 1)))


def f_test(chi2_poor: float, chi2_rich: float, terms: int, dof: float) -> float:
    """How often so large a fall of χ² would come by chance: F's upper tail."""
    if not np.isfinite(chi2_rich) or dof <= 0 or chi2_rich >= chi2_poor:
        return 1.0
    F = (chi2_poor - chi2_rich) / terms / (chi2_rich / dof)
    return float(fdtrc(terms, dof, F))


def _corners_alone(calibration: Calibration) -> tuple[System, Blocks]:
    """The views' corners, and the calibration's camera as a rational lens; boards have the shape that was found."""
    observations = calibration.observations
    views = tuple(replace(view, stripes=()) for view in observations.views)
    group = view_blocks(replace(observations, views=views, sequences=(), lasers=()))
    camera = with_richest_lens(as_float64(calibration.rig.camera))
    poses = np.asarray(calibration.system.poses[0], np.float64)
    padded = far_away(bucket(len(poses)), poses.shape[1]).at[: len(poses)].set(poses)
    return System(Rig(camera), (padded,), as_float64(calibration.system.shape)), group


def _free(lens: str, held: set[str], tilted: bool) -> Bool[Array, "shared"]:
    """Which leaves of the rational camera are sought with a lens; with a tilted sensor or not."""
    own = set(camera_parameters(lens, tilted=tilted)) - held
    return jnp.asarray([name in own for name in camera_parameters(Rational.kind, tilted=tilted)])


def _sought(lens: str, held: set[str]) -> int:
    """How many coefficients of a lens are sought."""
    return len(set(lens_parameters(lens)) - held)


def _distinct(chosen: str, held: set[str]) -> list[str]:
    """The rungs, without those that seek the same terms as another; the calibration's own is kept."""
    rungs: dict[frozenset[str], str] = {}
    for lens in LADDER:
        sought = frozenset(camera_parameters(lens)) - held
        if sought not in rungs or lens == chosen:
            rungs[sought] = lens
    return list(rungs.values())


def _solve_rung(system: System, free: Bool[Array, "shared"], group: Blocks, noise: Noise, n: int) -> _Solved:
    """One lens on all views, and fold by fold on views that it has not seen."""
    whole = solve(system, free, (group,), noise)
    folds = np.arange(len(group.points)) % min(_FOLDS, n)
    held_out, count = np.zeros(n), np.zeros(n)
    for fold in range(min(_FOLDS, n)):
        inside = jnp.asarray(folds == fold)
        others = solve(whole.system, free, (_only(group, ~inside),), noise)
        own = _only(group, inside)
        placed = solve(others.system, jnp.zeros_like(free), (own,), noise)
        square, used = _squares(placed, own, noise)
        for outcome in (others, placed):
            if outcome.result != optx.RESULTS.successful:
                square = np.where(used > 0, np.nan, square)
        held_out += square[:n]
        count += used[:n]
    square, used = _squares(whole, group, noise)
    chi2 = 2 * float(whole.cost) if whole.result == optx.RESULTS.successful else np.nan
    # Weighted errors in σ, and back to pixels.
    pixels = float(noise.corner)
    return _Solved(chi2, pixels * float(np.sqrt(2 * square.sum() / used.sum())), pixels**2 * held_out, count)


def _without(system: System, lens: str, held: set[str]) -> System:
    """The system with those lens terms at zero that the lens does not have and that are not held."""
    leaves, structure = jax.tree.flatten(system.rig.camera)
    tilted = bool(system.rig.camera.tilt)
    kept, zero = {*camera_parameters(lens, tilted=tilted), *held}, jnp.zeros(())
    names = camera_parameters(Rational.kind, tilted=tilted)
    own = [leaf if name in kept else zero for name, leaf in zip(names, leaves, strict=True)]
    return replace(system, rig=Rig(jax.tree.unflatten(structure, own)))


def _only(group: Blocks, blocks: Bool[Array, "blocks"]) -> Blocks:
    return replace(group, corner_used=group.corner_used & blocks[:, None, None])


def _squares(outcome: Outcome, group: Blocks, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Sum over each block of squared errors in σ, and of coordinates."""
    corner = np.asarray(outcome.errors[0][0])
    used = np.asarray(group.corner_used)
    scaled = np.where(used, np.asarray(group.weights), 0.0)[..., None] * corner / float(noise.corner)
    return (scaled**2).sum(axis=(1, 2, 3)), 2.0 * used.sum(axis=(1, 2))


def _gain(below: _Solved, own: _Solved) -> tuple[float, float]:
    """The share by which the squared held-out error falls, and its standard error from view to view.

    By the logarithm of each view's ratio, so that a view with large errors counts like any other.
    """
    seen = (below.count > 0) & (below.held_out > 0)
    if not np.isfinite(own.held_out[seen]).all() or not np.isfinite(below.held_out[seen]).all() or seen.sum() < 2:
        return -np.inf, np.inf
    fall = np.log(below.held_out[seen] / np.maximum(own.held_out[seen], 1e-300))
    remains = float(np.exp(-fall.mean()))
    return 1 - remains, remains * float(fall.std(ddof=1) / np.sqrt(len(fall)))


def _rung(
    lens: str, terms: int, solved: _Solved, p: float | None, gain: float | None, error: float | None, supported: bool
) -> Rung:
    held_out = float(np.sqrt(2 * solved.held_out.sum() / solved.count.sum()))
    rms = solved.rms if np.isfinite(solved.chi2) else np.nan
    return Rung(lens, terms, rms, held_out, p, gain, error, supported)
