"""From a surface and a part to its dimensions: features are fitted, dimensions follow, each with its interval.

A dimension h(p₁, p₂ …) of the numbers of some shapes has the variance Σ hᵢ cov(pᵢ) hᵢᵀ + b Σ bᵀ, with hᵢ = ∂h/∂pᵢ, the
points' part of each shape by itself, and b = Σ hᵢ Bᵢ how it follows the rig, Bᵢ = ∂pᵢ/∂θ: errors of the rig that two
features share may cancel in their distance, and are seen to. The interval is that of Student's t, with the degrees of
freedom of the points' part (B. L. Welch, 1947).
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree
from scipy.stats import t as students_t

from jaxscan.errors import InputError, error_context
from jaxscan.files.part_file import FITTED, IN_A_SECTION, OF_TWO_PLANES, SIGNED, Dimension, Feature, Part
from jaxscan.measurement.alike import Alike, Place, how_alike
from jaxscan.measurement.border import without_borders
from jaxscan.measurement.dimensions import Fold, Shapes, edge_of, fold_of, skew, slot_of
from jaxscan.measurement.fit import Fit, Settled, few, finish, settle
from jaxscan.measurement.folded import interval_of_length
from jaxscan.measurement.form import CONFIDENCE, Form, form_of
from jaxscan.measurement.known import Known, known, with_smooth_errors
from jaxscan.measurement.placed import placed
from jaxscan.measurement.profile import profile_of
from jaxscan.measurement.scanned import Scanned
from jaxscan.measurement.section import outline
from jaxscan.measurement.seen import check_is_one_plane, seen_part
from jaxscan.measurement.shapes import Plane, Shape
from jaxscan.measurement.verdict import Verdict, another_unit, verdict, worst_of
from jaxscan.measurement.volume import volume_above

# Numbers of a shape are moved by so much for derivatives, mm.
_MOVE: Final = 1e-4
_SEAM: Final = 3000
_FORMS: Final = ("flatness", "roundness", "straightness")
# What depends on the side to which planes face.
_FACING: Final = ("step", "flush", "angle")
_WHICH_SIDE: Final = (
    "a cloud does not say which side of a plane is outside: it is taken to be that of the origin, and from the other "
    "side a step has the other sign and an angle is 180° less this one; mesh the cloud, or measure the range image"
)
# Of the points of a region, the part beyond which those that are not of the feature may be a second face.
_HALF_OF_ANOTHER: Final = 0.4


@dataclass(frozen=True)
class MeasuredFeature:
    """A feature as it was found.

    Attributes:
        feature: what was asked for.
        fit: the fitted shape; None for what is not fitted.
        scanned: the points it was fitted to: all, or a section's outline.
        points: how many are of it.
        left_out: how many of its region are not.
        notes: sentences about it.
        problem: why there is none; "" where there is.
        known: how well the shape's numbers are known; None for what is not fitted.
    """

    feature: Feature
    fit: Fit | None
    scanned: Scanned | None
    points: int
    left_out: int
    notes: tuple[str, ...] = ()
    problem: str = ""
    known: Known | None = None

    @property
    def shape(self) -> Shape | None:
        """As it was fitted."""
        return None if self.fit is None else self.fit.shape

    def some_points(self, most: int) -> Float[np.ndarray, "points 3"]:
        """At most `most` of its points, evenly chosen, mm; none of what is made of other features."""
        if self.scanned is None:
            return np.zeros((0, 3))
        used = np.arange(len(self.scanned.points)) if self.fit is None else self.fit.used
        return self.scanned.points[used[few(len(used), most)]]


@dataclass(frozen=True)
class MeasuredDimension:
    """A dimension as it was measured; mm, degrees or mm³, as `dimension.unit` says.

    Attributes:
        dimension: what was asked for.
        value: None where it could not be measured.
        uncertainty: half of `interval`; None without one.
        interval: from where to where, what holds the true value with 95 %; None without one. It is about the value, but
            where errors only make it larger, as of a distance near 0 (`jaxscan.measurement.folded`).
        sigma: standard uncertainty of the value; None where there is none, or for a form.
        sigma_rig: the part of it that the rig has, which no number of points makes smaller.
        by_rig: the derivative by each of the rig's parameters, by name.
        form_mm: of its features' points, from the lowest to the highest, the largest of them.
        points: of its features.
        left_out: of their regions.
        verdict: by its tolerance; None without one.
        notes: sentences about it.
        problem: why it could not be measured; "" where it could.
    """

    dimension: Dimension
    value: float | None
    uncertainty: float | None = None
    interval: tuple[float, float] | None = None
    sigma: float | None = None
    sigma_rig: float | None = None
    by_rig: Mapping[str, float] = field(default_factory=dict)
    form_mm: float | None = None
    points: int = 0
    left_out: int = 0
    verdict: Verdict | None = None
    notes: tuple[str, ...] = ()
    problem: str = ""


@dataclass(frozen=True)
class Measurement:
    """What was measured of a part.

    Attributes:
        part: what was asked for.
        features: in the part's order.
        dimensions: in the part's order.
        notes: sentences about all of it, such as why nothing has an interval.
    """

    part: Part
    features: tuple[MeasuredFeature, ...]
    dimensions: tuple[MeasuredDimension, ...]
    notes: tuple[str, ...]

    @property
    def every_note(self) -> tuple[str, ...]:
        """The notes on all of it and on its dimensions, each sentence once."""
        return tuple(dict.fromkeys((*self.notes, *(note for each in self.dimensions for note in each.notes))))

    @property
    def problems(self) -> tuple[str, ...]:
        """What could not be measured, and why."""
        features = [f"{each.feature.name}: {each.problem}" for each in self.features if each.problem]
        return (*features, *(f"{each.dimension.name}: {each.problem}" for each in self.dimensions if each.problem))

    @property
    def verdict(self) -> Verdict | None:
        """The verdict on the part: conforming if every toleranced dimension is; None where none has a tolerance."""
        return worst_of(each.verdict for each in self.dimensions)


def measure(scanned: Scanned, part: Part) -> Measurement:
    """Measure a part.

    What cannot be measured is reported in `problem` of the feature or dimension; the others are measured.

    Args:
        scanned: its surface, by `scanned_image` or `scanned_points`.
        part: by `read_part`.

    Raises:
        InputError: the part's reference mesh is to be moved onto the surface, and does not fit it.
    """
    part, moved = placed(part, scanned.points)
    features = _features(scanned, part)
    alike = how_alike(_left(features.values()))
    # Surfaces first: of their many points the scale is better known than of an outline's few.
    for outlines in (False, True):
        before = [(each.known.scale, each.known.freedom) for each in features.values() if each.known is not None]
        scale, freedom = np.median(before, axis=0).tolist() if outlines and before else (0.0, 1.0)
        for name, each in features.items():
            if each.fit is not None and each.scanned is not None and (each.scanned.image is None) == outlines:
                try:
                    features[name] = replace(each, known=known(each.scanned, each.fit, alike, (scale, freedom)))
                except InputError as error:
                    features[name] = replace(each, problem=str(error), fit=None)
    by_scan = with_smooth_errors({name: each.known for name, each in features.items() if each.known is not None})
    features |= {name: replace(features[name], known=each) for name, each in by_scan.items()}
    shapes = Shapes(
        {name: each.shape for name, each in features.items() if each.shape is not None},
        {name: each.feature for name, each in features.items() if each.feature.kind in OF_TWO_PLANES},
        {},
    )
    dimensions = []
    for dimension in part.dimensions:
        try:
            measured = _dimension(scanned, dimension, features, shapes, alike)
        except InputError as error:
            measured = MeasuredDimension(dimension, None, problem=str(error))
        if dimension.tolerance is not None and dimension.nominal is not None:
            low, high = (dimension.nominal + off for off in dimension.tolerance)
            measured = replace(measured, verdict=verdict(measured.interval, (low, high)))
        if (note := another_unit(dimension, measured.value)) is not None:
            measured = replace(measured, notes=(*measured.notes, note))
        dimensions.append(measured)
    without = (f"measured without intervals: {scanned.why_not}",) if scanned.why_not else ()
    of_the_scan = () if scanned.image is None else (f"the scan: {note}" for note in scanned.image.notes)
    notes = (*moved, *without, *of_the_scan)
    return Measurement(part, tuple(features[each.name] for each in part.features), tuple(dimensions), notes)


def _features(scanned: Scanned, part: Part) -> dict[str, MeasuredFeature]:
    """All features, fitted: the borders of all shapes of a scan are looked at together."""
    features: dict[str, MeasuredFeature] = {}
    settled: dict[str, Settled] = {}
    for feature in part.features:
        if feature.kind in FITTED:
            try:
                inside = scanned.not_empty(feature.region)
                settled[feature.name] = settle(scanned, feature.kind, inside, grow=feature.grow, region=feature.region)
            except InputError as error:
                features[feature.name] = MeasuredFeature(feature, None, None, 0, 0, problem=str(error))
    settled = without_borders(scanned, settled)
    for feature in part.features:
        if feature.name not in features:
            try:
                features[feature.name] = _feature(scanned, feature, features, settled)
            except InputError as error:
                features[feature.name] = MeasuredFeature(feature, None, None, 0, 0, problem=str(error))
    return features


def _feature(
    scanned: Scanned, feature: Feature, before: Mapping[str, MeasuredFeature], settled: Mapping[str, Settled]
) -> MeasuredFeature:
    of = [_sound(before[name]) for name in feature.of]
    if feature.kind in OF_TWO_PLANES:
        a, b = (each.shape for each in of)
        assert isinstance(a, Plane)
        assert isinstance(b, Plane)
        (edge_of if feature.kind == "edge" else slot_of)(a, b)
        return MeasuredFeature(feature, None, None, sum(e.points for e in of), sum(e.left_out for e in of))
    if feature.kind == "section":
        cut = outline(scanned, feature)
        return MeasuredFeature(feature, None, cut, len(cut.points), 0)
    if feature.kind == "surface":
        inside = scanned.not_empty(feature.region)
        return MeasuredFeature(feature, None, scanned.part(inside), len(inside), 0)
    if feature.kind in FITTED:
        source, fit = scanned, finish(scanned, settled[feature.name])
        if isinstance(fit.shape, Plane) and scanned.stripe is not None:
            check_is_one_plane(fit.shape, scanned.points[fit.used], float(np.median(fit.spread)))
    else:
        assert feature.kind in IN_A_SECTION
        cut, asked = of[0].scanned, of[0].feature.normal
        assert cut is not None
        normal = np.asarray(asked) / np.linalg.norm(np.asarray(asked))
        inside = cut.within(feature.region)
        source = cut
        fit = finish(cut, settle(cut, feature.kind, inside, normal=normal, region=feature.region))
    notes = seen_part(fit.shape, source.points[fit.used])
    if fit.left_out > _HALF_OF_ANOTHER * (len(fit.used) + fit.left_out):
        part = fit.left_out / (len(fit.used) + fit.left_out)
        notes = (
            *notes,
            f"{part:.0%} of the points of {feature.name} lie on something else: see that its region holds one face",
        )
    return MeasuredFeature(feature, fit, source, len(fit.used), fit.left_out, notes)


def _left(features: Iterable[MeasuredFeature]) -> list[tuple[Place, Float[np.ndarray, "points"], int]]:
    """What is left of fits to the grid, in units of σ: of surfaces, or where there are none of outlines."""
    of_surfaces, of_outlines = [], []
    for each in features:
        if each.fit is not None and each.scanned is not None and each.scanned.place is not None:
            left = each.scanned.place[each.fit.used], each.fit.residuals / each.fit.spread, each.fit.shape.numbers
            (of_surfaces if each.scanned.image is not None else of_outlines).append(left)
    return of_surfaces or of_outlines


def _sound(feature: MeasuredFeature) -> MeasuredFeature:
    if feature.problem:
        raise InputError(f'"{feature.feature.name}" was not measured: {feature.problem}')
    return feature


def _dimension(
    scanned: Scanned, dimension: Dimension, features: Mapping[str, MeasuredFeature], shapes: Shapes, alike: Alike
) -> MeasuredDimension:
    of = [_sound(features[name]) for name in dimension.of]
    base = MeasuredDimension(
        dimension,
        None,
        points=sum(each.points for each in of),
        left_out=sum(each.left_out for each in of),
        notes=tuple(dict.fromkeys(note for each in of for note in each.notes)),
    )
    if dimension.kind in _FACING and scanned.camera is None and scanned.mesh is None and _is_of_planes(of):
        base = replace(base, notes=(*base.notes, _WHICH_SIDE))
    if dimension.kind in _FORMS:
        fit, source = of[0].fit, of[0].scanned
        assert fit is not None
        assert source is not None
        assert of[0].known is not None
        return _of_form(base, form_of(source, fit, of[0].known), fit.form_mm)
    if dimension.kind == "profile":
        assert of[0].scanned is not None
        with error_context(str(dimension.reference)):
            form, largest, notes = profile_of(of[0].scanned, dimension)
        return replace(_of_form(base, form, largest), notes=(*base.notes, *notes))
    if dimension.kind == "volume":
        source, plane = of[0].scanned, of[1]
        assert source is not None
        assert plane.fit is not None
        assert plane.known is not None
        found = volume_above(source, plane.fit, plane.known, alike)
        b = None if found.by_rig is None else found.by_rig[None]
        base = replace(base, value=found.value, notes=(*base.notes, *found.notes))
        return _with_interval(scanned, base, np.array([[found.own]]), np.inf, b, None)
    if dimension.kind == "flush":
        shapes = replace(shapes, seams={dimension.name: _seam(of)})
    if dimension.kind == "distance":
        _refuse_lines_that_meet(of, shapes)
    fold = fold_of(shapes, dimension)

    def numbers(moved: Shapes) -> Float[np.ndarray, "1+k"]:
        return np.r_[moved.value(dimension), [] if fold is None else fold.sideways(moved)]

    size = len(numbers(shapes))
    own, squares, b, forms = np.zeros((size, size)), 0.0, None, []
    for name in shapes.fitted_of(dimension.of):
        fit, found, slope = features[name].fit, features[name].known, _slope(shapes, name, numbers)
        assert fit is not None
        assert found is not None
        part = slope @ found.own @ slope.T
        own, squares = own + part, squares + float(part[0, 0]) ** 2 / found.freedom
        forms.append(fit.form_mm)
        if found.by_rig is not None:
            follows = slope @ found.by_rig
            b = follows if b is None else b + follows
    base = replace(base, value=shapes.value(dimension), form_mm=max(forms))
    return _with_interval(scanned, base, own, squares, b, fold)


def _is_of_planes(of: list[MeasuredFeature]) -> bool:
    return all(each.feature.kind == "plane" for each in of)


def _refuse_lines_that_meet(of: list[MeasuredFeature], shapes: Shapes) -> None:
    """The common perpendicular of two lines in one plane is 0 by its construction, whatever they are.

    Raises:
        InputError: they are of one section, or two edges of one plane, and not parallel.
    """
    a, b = (each.feature for each in of)
    edges, lines = (all(each.kind == kind for each in (a, b)) for kind in ("edge", "line"))
    shared = sorted(set(a.of) & set(b.of)) if edges or lines else []
    if shared and skew(shapes.place(a.name), shapes.place(b.name)):
        raise InputError(
            f'the two are at more than 10° to each other, and both lie in "{shared[0]}", so that they meet: ask for a '
            "gap, which is taken at the middle of the second, or for an angle"
        )


def _of_form(base: MeasuredDimension, form: Form, largest: float) -> MeasuredDimension:
    note = f"from means over {form.patches} patches: shorter waves are not seen"
    u = form.uncertainty
    interval = None if u is None else (max(form.value - u, 0.0), form.value + u)
    return replace(base, value=form.value, uncertainty=u, interval=interval, form_mm=largest, notes=(*base.notes, note))


def _with_interval(
    scanned: Scanned,
    base: MeasuredDimension,
    own: Float[np.ndarray, "1+k 1+k"],
    squares: float,
    b: Float[np.ndarray, "1+k leaves"] | None,
    fold: Fold | None,
) -> MeasuredDimension:
    """With the interval of a value and of what errs sideways to it.

    Args:
        scanned: what was measured.
        base: the dimension, with its value.
        own: covariance of the points' part.
        squares: Σ part² / freedom of the value; infinite for a variance that is known.
        b: derivatives by the rig's leaves; None without a rig.
        fold: where the value is turned back; None where it is not.
    """
    if b is None or scanned.covariance is None or base.value is None:
        return base
    total = own + b @ scanned.covariance @ b.T
    rig, variance = max(float(total[0, 0] - own[0, 0]), 0.0), float(total[0, 0])
    freedom = max(variance**2 / squares if squares > 0 and np.isfinite(squares) else np.inf, 1.0)
    sigma, value, notes = float(np.sqrt(variance)), base.value, base.notes
    if fold is None:
        half = sigma * float(students_t.ppf((1 + CONFIDENCE) / 2, freedom))
        low, high = value - half if base.dimension.kind in SIGNED else max(value - half, 0.0), value + half
    else:
        near, far = interval_of_length(abs(value - fold.at), sigma, total[1:, 1:], freedom, CONFIDENCE)
        low, high = (near, far) if fold.at == 0 else (max(fold.at - far, 0.0), fold.at - near)
        half = (high - low) / 2
        if near == 0:
            end = "large it is at most" if fold.at == 0 else "small it is at least"
            unit = "°" if base.dimension.unit == "°" else f" {base.dimension.unit}"
            notes = (*notes, f"{fold.at:g}{unit} cannot be excluded: the interval says how {end}")
    return replace(
        base,
        uncertainty=half,
        interval=(low, high),
        sigma=sigma,
        sigma_rig=float(np.sqrt(rig)),
        by_rig=dict(zip(scanned.parameters, b[0].tolist(), strict=True)),
        notes=notes,
    )


def _slope(
    shapes: Shapes, name: str, numbers: Callable[[Shapes], Float[np.ndarray, "1+k"]]
) -> Float[np.ndarray, "1+k numbers"]:
    """How a dimension, and what errs sideways to it, change with the numbers of a shape."""
    slope = []
    for by in _MOVE * np.eye(shapes.fitted[name].numbers):
        up, down = (numbers(shapes.moved(name, way * by)) for way in (1.0, -1.0))
        slope.append((up - down) / (2 * _MOVE))
    return np.stack(slope, axis=1)


def _seam(of: list[MeasuredFeature]) -> Float[np.ndarray, "3"]:
    """Midway between the points of two features that are nearest to each other, mm."""
    clouds = []
    for each in of:
        assert each.fit is not None
        assert each.scanned is not None
        clouds.append(each.scanned.points[each.fit.used[few(len(each.fit.used), _SEAM)]])
    away, index = KDTree(clouds[1]).query(clouds[0])
    nearest = int(np.argmin(away))
    return (clouds[0][nearest] + clouds[1][np.asarray(index)[nearest]]) / 2
