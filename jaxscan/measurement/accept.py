"""Acceptance and re-verification of a scanner: what it makes of an artefact that is known better (ISO 10360-13).

Of every scan of the artefact there are

    probing_form   the narrowest band about a fitted ball that holds 95 % of its points, outliers and all (Form, D95 %)
    probing_size   the ball's diameter less the certified one
    distance       the distance of two centres less the certified one                         (sphere spacing)
    flatness       the narrowest band about a fitted plane that holds 95 % of its points

VDI/VDE 2634 parts 2 and 3 have the same, with the band from the lowest to the highest of all points but 0.3 %.

Each has two uncertainties. That of the test is what the artefact is not known by: its certificate. It decides whether a
limit is met (ISO 14253-1), for the scanner's own errors are what is tested. The other is what rig and noise predict,
σ of the dimension as `jaxscan.measure` has it: an error beyond three times both is one that the calibration does not
know of.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.errors import InputError, error_context
from jaxscan.files.artefact_file import FORMS, Artefact
from jaxscan.files.part_file import Dimension, Feature, Part
from jaxscan.files.region import Region
from jaxscan.files.rig_file import RigFile
from jaxscan.measurement.known_balls import BEYOND, known_balls
from jaxscan.measurement.measure import MeasuredDimension, MeasuredFeature, measure
from jaxscan.measurement.scanned import scanned_image
from jaxscan.measurement.verdict import Verdict, verdict, worst_of
from jaxscan.measurement.zone import zone
from jaxscan.reconstruction import RangeImage

# Part of the points in a band of form.
_SHARE: Final = 0.95
# Points of a ball reach so far beyond its radius at most, in radii: what is nearer is not of the plane.
_CLEAR: Final = BEYOND + 0.2
# Of an expanded uncertainty over σ.
EXPANDED: Final = 2.0
_UNEXPLAINED: Final = 3.0
# A length that is off by more than this part of it is no error of a scanner.
_ANOTHER: Final = 0.1
# σ of such a band over that of a standard deviation, of 100 to 1600 independent normal numbers.
_OF_BAND: Final = 1.3
# VDI/VDE 2634 part 2 allows for this part of the points to be left out.
_MANY_OUTLIERS: Final = 0.003
# What a figure is tested by.
_OF: Final = {"probing_form": "ball", "probing_size": "ball", "distance": "distance", "flatness": "plane"}
# How many places of the artefact VDI/VDE 2634 part 2 asks for.
PLACES: Final = {"probing_form": 10, "probing_size": 10, "distance": 7, "flatness": 6}


@dataclass(frozen=True)
class AcceptanceFigure:
    """One figure of one scan.

    Attributes:
        figure: one of `FIGURES`.
        of: the ball, the two balls, or the plane.
        scan: the name of the scan.
        error: mm; of a form its width.
        uncertainty: of the test, expanded: what the artefact is not known by, mm.
        limit: the maker's, mm; None without one.
        verdict: by this limit; None without one.
        sigma: what the noise of the points does to it, mm.
        sigma_rig: what the rig's covariance predicts, mm; None of a form, and without a covariance.
        points: how many it was made of; of a form outliers and all (`jaxscan.measurement.zone`).
        left_out: how many of the region were not; of a form how many of its points are outliers.
    """

    figure: str
    of: str
    scan: str
    error: float
    uncertainty: float
    limit: float | None
    verdict: Verdict | None
    sigma: float | None
    sigma_rig: float | None
    points: int
    left_out: int

    @property
    def unexplained(self) -> bool:
        """Whether neither the calibration nor the certificate knows of so large an error."""
        predicted = expanded(self.sigma, self.sigma_rig)
        if predicted is None:
            return False
        return abs(self.error) > _UNEXPLAINED / EXPANDED * float(np.hypot(predicted, self.uncertainty))


@dataclass(frozen=True)
class Acceptance:
    """A test.

    Attributes:
        artefact: what was scanned.
        figures: of every scan.
        scans: their names.
        problems: what could not be tested, and why.
        notes: sentences about it.
    """

    artefact: Artefact
    figures: tuple[AcceptanceFigure, ...]
    scans: tuple[str, ...]
    problems: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def verdict(self) -> Verdict | None:
        """Conforming if every figure with a limit is and everything was found and tested; None without limits."""
        tested = {each.figure for each in self.figures}
        whole = not self.problems and tested.issuperset(self.artefact.limits)
        undecided: Verdict | None = "not decided" if self.artefact.limits and not whole else None
        return worst_of((undecided, *(each.verdict for each in self.figures)))

    @property
    def places(self) -> str:
        """In how many places, of those that the standard asks for, the figure with the fewest was tested."""
        each = [(len({row.scan for row in self.of(figure)}), asked) for figure, asked in PLACES.items()]
        few = min((pair for pair in each if pair[0]), key=lambda pair: pair[0] / pair[1], default=(0, 0))
        return "" if few[0] >= few[1] else f"({few[0]} of the {few[1]} recommended places)"

    def of(self, figure: str) -> tuple[AcceptanceFigure, ...]:
        """All of one kind."""
        return tuple(each for each in self.figures if each.figure == figure)


def accept(scans: Sequence[tuple[str, RangeImage]], rig: RigFile, artefact: Artefact) -> Acceptance:
    """Test a scanner.

    Args:
        scans: a name and a range image each: the artefact in one place after another.
        rig: by which they were made: it says where errors move a point to. Without its covariance nothing is predicted.
        artefact: by `read_artefact`.

    Raises:
        InputError: there are no scans, two have one name or the same points, or the rig is not theirs.
    """
    names = tuple(name for name, _ in scans)
    if not names:
        raise InputError("there are no scans: name one or more range images (.npz) that show the artefact")
    if len(set(names)) < len(names):
        raise InputError("one scan is named twice: name each once, because each counts as one place")
    first: dict[bytes, str] = {}
    for name, image in scans:
        same = first.setdefault(image.points[image.valid].tobytes(), name)
        if same != name:
            raise InputError(
                f"{name}: holds the same points as {same}: leave it out, because each scan counts as one place"
            )
    figures: list[AcceptanceFigure] = []
    problems: list[str] = []
    for name, image in scans:
        with error_context(name):
            scanned_image(image, rig)
        try:
            figures += _figures(name, image, rig, artefact)
        except InputError as error:
            problems.append(f"{name}: {error}")
    of_the_scans = (f"{name}: {note}" for name, image in scans for note in image.notes)
    notes = (*_notes(figures, rig, artefact), *of_the_scans)
    return Acceptance(artefact, tuple(figures), names, tuple(problems), notes)


def _figures(name: str, image: RangeImage, rig: RigFile, artefact: Artefact) -> list[AcceptanceFigure]:
    regions = known_balls(scanned_image(image, rig), artefact)
    features = tuple(Feature(ball, "ball", region) for ball, region in regions.items())
    sizes = tuple(Dimension(ball.name, "diameter", (ball.name,)) for ball in artefact.balls)
    spacings = tuple(Dimension(_between(d.of), "distance", d.of) for d in artefact.distances)
    part = Part(artefact.path, artefact.name, features, (*sizes, *spacings))
    found = measure(scanned_image(image, rig, part), part)
    if found.problems:
        raise InputError("; ".join(found.problems))
    certified = [*(ball.diameter for ball in artefact.balls), *(d.length for d in artefact.distances)]
    for measured, length in zip(found.dimensions, certified, strict=True):
        if measured.value is not None and abs(measured.value - length) > _ANOTHER * length:
            raise InputError(
                f"{measured.dimension.name}: {measured.value:.4g} mm were found, {length:.4g} mm are certified, and no "
                "scanner errs so much: the artefact is not in this scan, or is another one"
            )
    by_name = {each.feature.name: each for each in found.features}
    figures = []
    for ball, size in zip(artefact.balls, found.dimensions, strict=False):
        figures.append(_form("probing_form", name, by_name[ball.name], image, ball.form, artefact))
        figures.append(_error("probing_size", name, size, ball.diameter, ball.uncertainty, artefact))
    for distance, spacing in zip(artefact.distances, found.dimensions[len(sizes) :], strict=True):
        figures.append(_error("distance", name, spacing, distance.length, distance.uncertainty, artefact))
    if artefact.plane is not None:
        clear = replace(image, valid=image.valid & ~_on_balls(image, regions.values()))
        if not clear.valid.any():
            raise InputError("no point of the plane is left beside the balls: scan the plate beside them too")
        plate = Part(artefact.path, artefact.name, (Feature(artefact.plane.name, "plane"),), ())
        (plane,) = measure(scanned_image(clear, rig), plate).features
        if plane.problem:
            raise InputError(f"{artefact.plane.name}: {plane.problem}")
        figures.append(_form("flatness", name, plane, clear, artefact.plane.flatness, artefact))
    return figures


def _on_balls(image: RangeImage, regions: Iterable[Region]) -> Bool[np.ndarray, "frames columns"]:
    near = np.zeros(image.valid.shape, bool)
    for region in regions:
        away = np.linalg.norm(image.points - np.asarray(region.low, np.float32), axis=-1)
        with np.errstate(invalid="ignore"):
            near |= away < region.radius * _CLEAR / BEYOND
    return near


def _between(of: tuple[str, str]) -> str:
    return f"{of[0]} - {of[1]}"


def _error(
    figure: str, scan: str, measured: MeasuredDimension, certified: float, uncertainty: float, artefact: Artefact
) -> AcceptanceFigure:
    assert measured.value is not None
    error, limit = measured.value - certified, artefact.limits.get(figure)
    own = None
    if measured.sigma is not None and measured.sigma_rig is not None:
        own = float(np.sqrt(max(measured.sigma**2 - measured.sigma_rig**2, 0.0)))
    return AcceptanceFigure(
        figure=figure,
        of=measured.dimension.name,
        scan=scan,
        error=error,
        uncertainty=uncertainty,
        limit=limit,
        verdict=None if limit is None else verdict((error - uncertainty, error + uncertainty), (-limit, limit)),
        sigma=own,
        sigma_rig=measured.sigma_rig,
        points=measured.points,
        left_out=measured.left_out,
    )


def _form(
    figure: str, scan: str, feature: MeasuredFeature, image: RangeImage, form: float, artefact: Artefact
) -> AcceptanceFigure:
    assert feature.fit is not None
    assert feature.known is not None
    assert feature.scanned is not None
    assert feature.scanned.place is not None
    fitted = np.zeros(image.valid.shape, bool)
    fitted[tuple(feature.scanned.place[feature.fit.used].T)] = True
    points = image.points[zone(fitted, image.valid)].astype(np.float64)
    width, limit = band(feature.fit.shape.distances(points)), artefact.limits.get(figure)
    interval = max(width - form, 0.0), width + form
    return AcceptanceFigure(
        figure=figure,
        of=feature.feature.name,
        scan=scan,
        error=width,
        uncertainty=form,
        limit=limit,
        verdict=None if limit is None else verdict(interval, (0.0, limit)),
        sigma=_OF_BAND * width / float(np.sqrt(2 * feature.known.freedom)),
        sigma_rig=None,
        points=len(points),
        left_out=len(points) - int(fitted.sum()),
    )


def expanded(sigma: float | None, sigma_rig: float | None) -> float | None:
    """What noise and rig together predict, expanded (95 %), mm; None where either is not known."""
    return None if sigma is None or sigma_rig is None else EXPANDED * float(np.hypot(sigma, sigma_rig))


def band(residuals: Float[np.ndarray, "points"], share: float = _SHARE) -> float:
    """The width of the narrowest band that holds this share of them."""
    ordered = np.sort(residuals)
    inside = int(np.ceil(share * len(ordered)))
    return float((ordered[inside - 1 :] - ordered[: len(ordered) - inside + 1]).min())


def _notes(figures: Sequence[AcceptanceFigure], rig: RigFile, artefact: Artefact) -> list[str]:
    notes = []
    for figure in artefact.limits:
        if figures and not any(each.figure == figure for each in figures):
            notes.append(
                f"{figure}: not tested, though it has a limit: {artefact.path.name} describes no {_OF[figure]}"
            )
    for figure, asked in PLACES.items():
        places = len({each.scan for each in figures if each.figure == figure})
        if 0 < places < asked:
            notes.append(f"{figure}: {places} of the {asked} places that VDI/VDE 2634 part 2 asks for")
    for each in figures:
        if each.figure in FORMS and each.left_out > _MANY_OUTLIERS * each.points:
            part = each.left_out / each.points
            notes.append(f"{each.figure} of {each.of}, {each.scan}: {part:.1%} of its points are outliers")
    unexplained = sorted({f"{each.figure} of {each.of}" for each in figures if each.unexplained})
    if unexplained:
        notes.append(
            f"larger than the calibration and the certificate explain: {', '.join(unexplained)}: calibrate again, "
            f"and see that nothing has moved since; or {artefact.path.name} states another size than the artefact has"
        )
    if rig.covariance is None:
        notes.append("nothing is predicted by a rig without a covariance: give the rig.json that `calibrate` wrote")
    return notes
