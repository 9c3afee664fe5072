"""Parts of the photographs, solved apart: do they agree within the σ that they predict?

With θ_a, θ_b from disjoint photographs and their covariances Σ_a, Σ_b, the difference has the covariance Σ_a + Σ_b and
d² = (θ_a − θ_b)ᵀ (Σ_a + Σ_b)⁻¹ (θ_a − θ_b) follows χ² with as many degrees of freedom as there are parameters. √(d²/n)
is then about 1. Where it is larger, the model is wrong: multiply the predicted σ by √(d²/n).
"""

import math
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax.scipy.special import gammaincc
from jaxtyping import Bool, Float

from jaxscan.calibration.diagnostics.resolve import Part, PartialRig, resolve
from jaxscan.calibration.observations import Observations
from jaxscan.calibration.result import Calibration
from jaxscan.precision import float64
from jaxscan.rig.rig import is_place

# Parts disagree where chance would bring them so far apart less than once in a thousand times.
_P = 1e-3
# What a part needs for a rig of its own.
_FEWEST_VIEWS = 3
_FEWEST_STRIPES = 2
_FEWEST_MOVED = 2


@dataclass(frozen=True)
class Agreement:
    """Two parts' rigs compared.

    Attributes:
        parts: the names of both.
        views: how many views each has.
        names: the parameters.
        values: of both.
        differences_in_sigma: second minus first, in σ of the difference.
        chi2_per_parameter: d² / n.
        p: how often d² would be as large by chance.
        scale: by how much the second part's millimetres are longer than the first's, as a share: the one direction in
            which light planes and stage move when a board's pitch is wrong.
        scale_sigma: its σ.
    """

    parts: tuple[str, str]
    views: tuple[int, int]
    names: tuple[str, ...]
    values: tuple[Float[np.ndarray, "parameters"], Float[np.ndarray, "parameters"]]
    differences_in_sigma: Float[np.ndarray, "parameters"]
    chi2_per_parameter: float
    p: float
    scale: float | None
    scale_sigma: float | None

    @property
    def disagree(self) -> bool:
        """Whether they differ by more than chance explains."""
        return self.p < _P

    @property
    def sigma_factor(self) -> float:
        """The factor by which predicted σ would have to be larger for the parts to agree."""
        return math.sqrt(self.chi2_per_parameter)


def halves(observations: Observations) -> tuple[Part, Part] | None:
    """Two halves alike in stripes and distance; None where there are too few photographs for two rigs.

    Views are sorted by how much stripe they show and how large the board is in them, photographs on stage and turntable
    by their order, and dealt in turn.
    """
    views = observations.views
    seen = [sum(int(np.isfinite(s.pixels).all(axis=1).sum()) for s in view.stripes) for view in views]
    size = [float(np.nanstd(view.corners)) for view in views]
    order = sorted(range(len(views)), key=lambda i: (seen[i] > 0, size[i]))
    first = np.zeros(len(views), bool)
    first[order[::2]] = True
    along = np.concatenate(
        [np.arange(len(sequence.views)) % 2 == 0 for sequence in observations.sequences] or [np.zeros(0)]
    )
    along = along.astype(bool)
    parts = Part("one half", first, along), Part("the other half", ~first, ~along)
    return parts if all(stands_alone(observations, part) for part in parts) else None


def stands_alone(observations: Observations, part: Part) -> bool:
    """Whether a part has what a rig needs."""
    views = [view for view, used in zip(observations.views, part.views, strict=True) if used]
    moved = [view for sequence in observations.sequences for view in sequence.views]
    striped_views = [*views, *(view for view, used in zip(moved, part.moved, strict=True) if used)]
    striped = [
        sum(
            any(s.laser == i and np.isfinite(s.pixels).all(axis=1).any() for s in view.stripes)
            for view in striped_views
        )
        for i in range(len(observations.lasers))
    ]
    axes = np.array([sequence.axis for sequence in observations.sequences for _ in sequence.views])
    return (
        len(views) >= _FEWEST_VIEWS
        and all(count >= _FEWEST_STRIPES for count in striped)
        and all((axes[part.moved] == axis).sum() >= _FEWEST_MOVED for axis in set(axes))
    )


def sessions(observations: Observations) -> tuple[Part, ...]:
    """One part for each session that stands alone; none where all photographs are of one session."""
    images = [view for sequence in observations.sequences for view in sequence.views]
    names = dict.fromkeys(view.session for view in (*observations.views, *images))

    def of(name: str) -> Part:
        def mine(views: list) -> Bool[np.ndarray, "views"]:
            return np.array([view.session == name for view in views], bool)

        return Part(name, mine(list(observations.views)), mine(images))

    parts = tuple(part for part in map(of, names) if stands_alone(observations, part))
    return parts if len(names) > 1 else ()


def solve_apart(calibration: Calibration, first: Part, second: Part) -> Agreement | None:
    """Both parts solved and compared; None where one of them has no minimum."""
    a, b = resolve(calibration, first), resolve(calibration, second)
    return None if a is None or b is None else compare(a, b)


def compare(a: PartialRig, b: PartialRig) -> Agreement:
    """Two independent estimates of the same parameters."""
    names = a.covariance.names
    difference = b.values - a.values
    both = a.covariance.matrix + b.covariance.matrix
    inverse = _inverse(both)
    chi2 = float(difference @ inverse @ difference)
    # Where b's millimetres are longer by ε, its planes 1/mm are shorter and its travel is longer by ε. What turns,
    # whose axis moves too, but by no share of numbers one of which is held, has no say; nor has a light's number of
    # which it is not known how it grows.
    turns = tuple({".".join(name.split(".")[:2]) + "." for name in names if is_place(name)})
    at = [i for i, name in enumerate(names) if not (turns and name.startswith(turns)) and _power(name) is not None]
    middle = (a.values + b.values)[at] / 2
    direction = np.array([_power(names[i]) for i in at]) * middle
    along = direction @ _inverse(both[np.ix_(at, at)])
    weight = float(along @ direction)
    with float64():
        p = float(gammaincc(jnp.asarray(len(names) / 2), jnp.asarray(chi2 / 2)))
    return Agreement(
        parts=(a.part.name, b.part.name),
        views=(int(a.part.views.sum()), int(b.part.views.sum())),
        names=names,
        values=(a.values, b.values),
        differences_in_sigma=difference / np.sqrt(np.diagonal(both)),
        chi2_per_parameter=chi2 / len(names),
        p=p,
        scale=float(along @ difference[at]) / weight if weight > 0 else None,
        scale_sigma=weight**-0.5 if weight > 0 else None,
    )


def _power(name: str) -> float | None:
    """The power of a length with which a parameter scales; None where that is not known."""
    if name.startswith("lights."):
        return {"plane": -1.0, "bow": 1.0}.get(name.split(".")[2])
    if name.startswith("motion."):
        return {"turn": 0.0, "period": 0.0}.get(name.split(".")[2], 1.0)
    return 0.0


def _inverse(covariance: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """The inverse, by the correlations: parameters have many units."""
    scale = np.sqrt(np.diagonal(covariance))
    return np.linalg.inv(covariance / np.outer(scale, scale)) / np.outer(scale, scale)
