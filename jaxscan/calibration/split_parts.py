"""Which parts of a rig differ between two parts of a session: the smallest criterion over all sets of them.

With d the difference of all that both parts show, estimated with all of it free, and C its covariance, χ² rises by
d_Sᵀ C_SS⁻¹ d_S where the numbers S are taken as shared. Each number that differs costs 2 (H. Akaike 1974), and each
part twice the logarithm of the odds against its having changed: so parts of one number and of six are found by chance
about equally rarely, in 0.3 to 0.8 sessions of 1000.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration.by_photograph import ByPhotograph
from jaxscan.calibration.determined import inverse_where_determined
from jaxscan.calibration.observations import Observations
from jaxscan.calibration.parted import called, listed
from jaxscan.calibration.refusals import FEWEST_STRIPE_POINTS, FEWEST_STRIPES, FEWEST_VIEWS
from jaxscan.rig import MOTIONS, Rig
from jaxscan.rig.rig import parameter_names

# Eigenvalues of a photograph's scaled normal equations below this are rounding.
_UNSEEN = 1e-7
# Odds against a part having changed, of those that both sides show.
_ODDS = 250.0
_CAMERA = {"focus": "camera.focal.", "image": "camera.principal."}


@dataclass(frozen=True)
class Part:
    """Numbers of a rig that change together.

    Attributes:
        kind: as `Difference.part` has it.
        name: which laser or axis.
        at: where they stand among the rig's leaves.
        seen: what of it the photographs of either side show: views, stripes or positions.
        fewest: how many of them tell it.
        which: of several lasers.
    """

    kind: str
    name: str
    at: tuple[int, ...]
    seen: tuple[int, int]
    fewest: int
    which: int = 0

    @property
    def words(self) -> str:
        """What it is."""
        return called(self.kind, self.name)

    @property
    def told(self) -> bool:
        """Whether both sides show enough of it to be compared."""
        return min(self.seen) >= self.fewest

    def reason(self, photograph: str) -> str:
        """Why it cannot be compared, in words.

        Args:
            photograph: the first one behind the change.
        """
        few = [self.seen_by(photograph, later) for later in (False, True) if self.seen[later] < self.fewest]
        return f"{' and '.join(few)}, {self.fewest} are needed"

    def seen_by(self, photograph: str, later: bool) -> str:
        """How much of it one side shows, in words."""
        count = self.seen[later]
        thing = {"light": "stripe", "motion": "position"}.get(self.kind, "view")
        where = f"from {photograph} on" if later else f"before {photograph}"
        return f"{count} {thing}{'' if count == 1 else 's'} {where}"


def lent(parts: Sequence[Part], photograph: str, later: bool) -> tuple[str, ...]:
    """What a user of one side's rig has to know: what of it the other side alone gave.

    Args:
        parts: those that one of the sides does not show.
        photograph: the first one behind the change.
        later: which side.
    """
    own = [part for part in parts if part.seen[later] < part.fewest]
    reasons = [f"{part.seen_by(photograph, later)}, and {part.fewest} are needed" for part in own]
    where = f"before {photograph}" if later else f"from {photograph} on"
    return tuple(
        f"{each} ({reason}): taken from the photographs {where}. If it changed too, this rig has the value from "
        f"{'before' if later else 'later'}"
        for each, reason in _together(own, reasons)
    )


def in_words(parts: Sequence[Part], reasons: Sequence[str]) -> tuple[str, ...]:
    """Parts that cannot be compared, each with its reason."""
    return tuple(f"{each} ({reason})" for each, reason in _together(parts, reasons))


def _together(parts: Sequence[Part], reasons: Sequence[str]) -> list[tuple[str, str]]:
    """Those of one reason in one, in words."""
    pairs = list(zip(parts, reasons, strict=True))
    return [(listed([part.words for part, why in pairs if why == each]), each) for each in dict.fromkeys(reasons)]


def parts_of(rig: Rig, free: Bool[np.ndarray, "shared"], sides: tuple[Observations, Observations]) -> list[Part]:
    """What may differ, of those numbers of a rig that were sought.

    Args:
        rig: it.
        free: which of its leaves were refined; what follows them is not read.
        sides: the photographs before and behind.
    """
    names = parameter_names(rig)
    before, after = sides
    views = len(before.views), len(after.views)
    found = []

    def add(kind: str, name: str, stems: tuple[str, ...], seen: tuple[int, int], fewest: int, which: int = 0) -> None:
        at = tuple(i for i, each in enumerate(names) if free[i] and each.startswith(stems))
        if at:
            found.append(Part(kind, name, at, seen, fewest, which))

    for kind, stem in _CAMERA.items():
        add(kind, "", (stem,), views, FEWEST_VIEWS)
    own = tuple(n for n in names if n.startswith("camera.") and not n.startswith(tuple(_CAMERA.values())))
    if own:
        add("lens", "", own, views, FEWEST_VIEWS)
    for i, light in enumerate(rig.lights):
        seen = _stripes(before, i), _stripes(after, i)
        add("light", light.name, (f"lights.{i}.",), seen, FEWEST_STRIPES, i)
    for part in rig.motion.parts():
        seen = _positions(before, part.axis), _positions(after, part.axis)
        add("motion", part.axis, (f"motion.{part.axis}.",), seen, MOTIONS[part.kind].fewest)
    return found


def _stripes(side: Observations, laser: int) -> int:
    points = [
        sum(int(np.isfinite(s.pixels).all(axis=1).sum()) for s in view.stripes if s.laser == laser)
        for view in side.photographs()
    ]
    return sum(count >= FEWEST_STRIPE_POINTS for count in points)


def _positions(side: Observations, axis: str) -> int:
    """The most places along an axis at which one board was seen."""
    return max((len(np.unique(each.steps)) for each in side.sequences if each.axis == axis), default=0)


@dataclass(frozen=True)
class Chosen:
    """Which parts differ.

    Attributes:
        differ: their places among the parts.
        gain: by how much the criterion is lower than with nothing that differs.
    """

    differ: tuple[int, ...]
    gain: float


def choose_parts(numbers: Sequence[Sequence[int]], d: Float[np.ndarray, "d"], C: Float[np.ndarray, "d d"]) -> Chosen:
    """The set of parts that differ with the smallest criterion.

    Args:
        numbers: of each part, where its numbers stand in d.
        d: the differences, with all parts free.
        C: their covariance.
    """
    everything = {i for each in numbers for i in each}

    def criterion(differ: tuple[int, ...]) -> float:
        own = {i for k in differ for i in numbers[k]}
        return risen(sorted(everything - own), d, C) + sum(price(len(numbers[k])) for k in differ)

    sets = [each for count in range(len(numbers) + 1) for each in combinations(range(len(numbers)), count)]
    criteria = [criterion(each) for each in sets]
    best = int(np.argmin(criteria))
    return Chosen(sets[best], criteria[0] - criteria[best])


def price(numbers: int) -> float:
    """The fall of χ² that is needed for a part of this many numbers to be taken as another."""
    return 2 * numbers + 2 * float(np.log(_ODDS))


def risen(shared: Sequence[int], d: Float[np.ndarray, "d"], C: Float[np.ndarray, "d d"]) -> float:
    """The rise of χ² where these numbers are taken to be the same."""
    at = list(shared)
    inverse, _ = inverse_where_determined(C[np.ix_(at, at)], 0.0)
    return float(d[at] @ inverse @ d[at])


def scatter(each: ByPhotograph) -> float:
    """The factor in σ² by which photographs contradict each other more than the covariance has it; at least 1.

    At the solution the gradients g_i of the photographs have the covariance N_i: Σ gᵢᵀ N_i⁻¹ gᵢ follows χ² with as many
    degrees of freedom as the photographs show numbers, less those that were found from them.
    """
    inverses, ranks = inverse_where_determined(each.N, _UNSEEN)
    degrees = int(ranks.sum()) - int(inverse_where_determined(each.total())[1])
    if degrees < 1:
        return 1.0
    return max(float(np.einsum("pi,pij,pj->", each.g, inverses, each.g)) / degrees, 1.0)
