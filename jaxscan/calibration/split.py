"""`calibrate_split`: a session in which something was changed, solved as two parts with what they share.

Both parts are in one solve. Photographs before the change see the rig θ + δ, those behind it θ; of δ the parts of the
rig that differ are free, the others are 0. So what is shared is found from both parts, what differs from its own, and
no photograph counts twice. First all parts of δ are free that both sides show, then those that `choose_parts` takes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.calibration.assemble import rejected_points
from jaxscan.calibration.blocks import reference_positions, sequence_blocks, view_blocks
from jaxscan.calibration.by_photograph import ByPhotograph
from jaxscan.calibration.calibrate import calibrate
from jaxscan.calibration.diagnostics.sheet_curves import unclear_bows
from jaxscan.calibration.judged import judged
from jaxscan.calibration.observations import Observations, Unused
from jaxscan.calibration.parted import Difference, Parted, called
from jaxscan.calibration.refusals import check_solved
from jaxscan.calibration.residuals import Noise, far_away
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined, refine
from jaxscan.calibration.split_amounts import amounts, place_difference
from jaxscan.calibration.split_parts import Part, choose_parts, in_words, lent, parts_of, price, risen, scatter
from jaxscan.calibration.split_sides import side_of
from jaxscan.calibration.uncertainty import UNDETERMINED
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.precision import as_float64, as_jax, as_numpy, float64
from jaxscan.rig import Rig, System
from jaxscan.rig.rig import parameter_names
from jaxscan.rig.splined import Splined

# Fewer photographs on a side show no change: a single odd one is an outlier.
_FEWEST = 2
_OPEN = "one side alone does not determine it"
# Arguments of `calibrate` that a split does not take, and why.
_NOT_TAKEN = {
    "keep": "a mask belongs to a session that was solved whole",
    "factors": "a factor would have to apply to one of the two states of the rig",
}


@dataclass(frozen=True)
class Split:
    """A session that was solved in two parts.

    Attributes:
        before: the rig as it was before the change, with the photographs before. Its covariance is that of the joint
            solve, which has the shared numbers from both parts.
        after: the same of the photographs behind: the rig as it is now. Where the rig does not differ, both have one
            rig; where nothing does, both are the session solved whole.
        parted: what differs and by how much, and what is shared.
    """

    before: Calibration
    after: Calibration
    parted: Parted


def calibrate_split(
    observations: Observations,
    photograph: str,
    *,
    advance: Callable[[str], object] = lambda doing: None,
    **asked: Any,
) -> Split:
    """Calibrate a rig that was changed in the middle of its session, before and after the change.

    Which parts differ (focal lengths, principal point, distortion, each sheet of light, each axis, the board on the
    axis where it was changed) is chosen by an information criterion; everything else is found from both sides together.
    What one side does not show is taken from the other, and its warnings say so. A board on an axis whose photographs
    are on both sides has its own place on each.

    Args:
        observations: corners and stripes, of all photographs.
        photograph: the name of the first one after the change, in the order of `Observations.in_order`.
        advance: called as each solve begins, with what it is, in words.
        asked: other arguments of `calibrate`, except `keep` and `factors`.

    Raises:
        InputError: there is no such photograph, a side shows too little to be compared, or as `calibrate`.
        ObservabilityError: the photographs do not determine the rig.
        SolveError: no minimum was reached.
    """
    if unfit := [name for name in _NOT_TAKEN if asked.get(name)]:
        raise InputError(f"{unfit[0]} does not go with a split: {_NOT_TAKEN[unfit[0]]}: leave it out")
    names = observations.before(photograph)
    _check_sides(observations, names, photograph)
    start = asked.get("start")
    start = start.camera if isinstance(start, Rig) else start
    if (start.lens.kind if start else asked.get("lens")) == Splined.kind:
        raise InputError('lens = "splined": a field of shifts is not solved in two parts: split with another lens')
    whole = calibrate(observations, advance=advance, **asked)
    sides = whole.observations.parted(names)
    with float64():
        parts, untold = _comparable(whole, sides, photograph)
        joint = _Joint.create(whole, sides, advance)
        every, parts, undetermined = _all_free(joint, parts)
        refined, free, parted = _chosen(joint, every, parts)
        parted = replace(
            parted,
            before=names[-1],
            after=photograph,
            counts=(len(names), len(observations.photographs()) - len(names)),
            untested=in_words(
                [*untold, *undetermined],
                [*(part.reason(photograph) for part in untold), *(_OPEN for _ in undetermined)],
            ),
        )
        if not parted.differ:
            noted = replace(whole, parted=parted)
            return Split(noted, noted, parted)
        advance("uncertainty")
        if not parted.rig_differs:
            nothing = joint.observations.parted(())[0]
            one = _result(joint, refined, free, parted, (nothing, joint.observations), True)
            return Split(one, one, parted)
        before, after = (
            _result(
                joint,
                refined,
                free,
                replace(parted, later=later, lent=lent(untold, photograph, later)),
                sides,
                later,
            )
            for later in (False, True)
        )
    return Split(before, after, after.parted or parted)


def _chosen(joint: "_Joint", every: Refined, parts: list[Part]) -> tuple[Refined, Bool[np.ndarray, "shared"], Parted]:
    """The solve with the parts free that differ, and what they are."""
    n, at = joint.shared, [i for part in parts for i in part.at]
    d = _earlier(every.system)[at]
    wider = scatter(ByPhotograph.create(every, joint.observations, np.ones(2)))
    among = n + np.array(at)
    C = wider * every.precision.covariance[np.ix_(among, among)]
    numbers = [[at.index(i) for i in part.at] for part in parts]
    chosen = choose_parts(numbers, d, C)
    differ = [parts[k] for k in chosen.differ]
    refined, free = every, joint.free(differ)
    if len(differ) < len(parts):
        refined = joint.refined(_without(every.system, free[n:]), free, every.noise, "what is shared")
        check_solved(refined, joint.observations, as_jax(free))
    same = [i for k, own in enumerate(numbers) if k not in chosen.differ for i in own]
    alike = risen(same, d, C)
    found = [
        Difference(
            parts[k].kind,
            parts[k].name,
            risen([*same, *numbers[k]], d, C) - alike,
            len(numbers[k]),
            amounts(joint.whole, refined, parts[k], n),
        )
        for k in chosen.differ
    ]
    shared = [part.words for part in parts if part not in differ]
    if (cut := joint.cut()) is not None:
        each = ByPhotograph.create(refined, joint.observations, np.ones(2))
        place = place_difference(refined, each, joint.sides, cut, wider)
        if place.chi2 > price(place.numbers):
            found.append(place)
        else:
            shared.append(called("place", place.name))
    parted = Parted("", "", (0, 0), tuple(found), tuple(shared), gain=chosen.gain, scatter=wider)
    return refined, free, parted


def _check_sides(observations: Observations, names: Sequence[str], photograph: str) -> None:
    """Refuse sides with fewer photographs than a change shows in."""
    count = len(observations.photographs()) - len(names)
    for here, where, farther in (
        (len(names), f"before {photograph}", "a later one"),
        (count, f"from {photograph} on", "an earlier one"),
    ):
        if here < _FEWEST:
            raise InputError(
                f"{here} photograph{'' if here == 1 else 's'} {where}, and at least {_FEWEST} are needed on either "
                "side: so few determine neither camera nor lights nor axes, and a single one that is odd is no "
                f"change: name {farther}, or photograph the board more often as the scanner is there"
            )


def _comparable(
    whole: Calibration, sides: tuple[Observations, Observations], photograph: str
) -> tuple[list[Part], list[Part]]:
    """The parts that both sides show, and those that one does not.

    Raises:
        InputError: there is none that both show.
    """
    parts = parts_of(whole.rig, np.asarray(whole.adjustment.free), sides)
    told = [part for part in parts if part.told]
    if not told:
        counts = [len(side.photographs()) for side in sides]
        why = "; ".join(in_words(parts, [part.reason(photograph) for part in parts]))
        raise InputError(
            f"{counts[0]} usable photographs before {photograph} and {counts[1]} from it on: one side is too few to "
            f"determine anything that could be compared: {why}: "
            "photograph the board more often as the scanner is there"
        )
    return told, [part for part in parts if not part.told]


@dataclass(frozen=True)
class _Joint:
    """Both sides as one problem.

    Attributes:
        whole: the session solved as if nothing had changed.
        observations: the sides one after the other.
        sides: before and behind.
        start: where to begin: with no difference.
        shared: how many numbers stand before those of the difference.
        advance: told what is done.
        rounds: `refine` with what holds for all solves.
    """

    whole: Calibration
    observations: Observations
    sides: tuple[Observations, Observations]
    start: System
    shared: int
    advance: Callable[[str], object]
    rounds: Callable[..., Refined]

    @staticmethod
    def create(
        whole: Calibration,
        sides: tuple[Observations, Observations],
        advance: Callable[[str], object],
    ) -> "_Joint":
        """From the session solved whole; inside a `float64` block."""
        before, after = sides
        observations = replace(
            before, views=(*before.views, *after.views), sequences=(*before.sequences, *after.sequences)
        )
        views = view_blocks(observations)
        seen = [*(True for _ in before.views), *(False for _ in after.views)]
        groups = [replace(views, before=as_jax(np.pad(seen, (0, len(views.points) - len(seen)))))]
        if observations.sequences:
            along = [*(True for _ in before.sequences), *(False for _ in after.sequences)]
            groups.append(replace(sequence_blocks(observations), before=as_jax(np.array(along))))
        rig = as_float64(whole.rig)
        poses = _poses(whole, observations, len(views.points))
        nothing = jax.tree.map(np.zeros_like, as_numpy(rig))
        system = System(rig, as_jax(poses), as_float64(whole.system.shape), as_float64(nothing))
        rounds = partial(refine, candidates=tuple(groups), reject=not whole.plain, weigh=not whole.plain)
        shared = len(jax.tree.leaves((rig, system.shape)))
        return _Joint(whole, observations, sides, system, shared, advance, rounds)

    def free(self, parts: Sequence[Part]) -> Bool[np.ndarray, "shared"]:
        """What is refined where these parts differ."""
        earlier = np.zeros(len(jax.tree.leaves(self.start.rig)), bool)
        earlier[[i for part in parts for i in part.at]] = True
        return np.concatenate([np.asarray(self.whole.adjustment.free), earlier])

    def cut(self) -> tuple[int, int] | None:
        """Which sequences of the two sides show one board on an axis; None where none is on both sides."""
        before, after = self.sides
        for whole in self.whole.observations.sequences:
            names = {view.name for view in whole.views}
            at = [
                [i for i, each in enumerate(side.sequences) if each.views[0].name in names] for side in (before, after)
            ]
            if all(at):
                return at[0][0], at[1][0]
        return None

    def refined(self, system: System, free: Bool[np.ndarray, "shared"], noise: Noise, what: str) -> Refined:
        """Solved in rounds."""
        return self.rounds(
            system, as_jax(free), noise=noise, begins=lambda solve: self.advance(f"{what}, round {solve}")
        )


def _poses(whole: Calibration, observations: Observations, padded: int) -> tuple[Float[np.ndarray, "_ _"], ...]:
    """Where the boards stand to begin with: those on an axis at their sequence's positions of reference."""
    by_name = {view.name: i for i, view in enumerate(whole.observations.views)}
    known = np.asarray(whole.system.poses[0])
    size = known.shape[1]
    views = np.array(far_away(padded, size))
    for i, view in enumerate(observations.views):
        views[i] = known[by_name[view.name]]
    if not observations.sequences:
        return (views,)
    of = {view.name: i for i, each in enumerate(whole.observations.sequences) for view in each.views}
    moved = []
    for sequence in observations.sequences:
        at_0 = np.asarray(whole.system.poses[1])[of[sequence.views[0].name]]
        pose = whole.rig.pose(reference_positions(sequence)) @ Pose.from_vector(at_0[:6])
        moved.append(np.concatenate([np.asarray(pose.as_vector()), at_0[6:]]))
    return views, np.stack(moved)


def _all_free(joint: _Joint, parts: list[Part]) -> tuple[Refined, list[Part], list[Part]]:
    """Solved with all parts free that are determined on both sides; those that are, and those that are not."""
    left, dropped = list(parts), []
    while True:
        free = joint.free(left)
        noise = joint.whole.adjustment.noise
        noise = noise.of(float(noise.corner), float(noise.stripe))
        refined = joint.refined(joint.start, free, noise, "both parts apart")
        if float(refined.precision.eigenvalues[0]) >= UNDETERMINED or not left:
            break
        weak = refined.precision.directions[joint.shared :, 0]
        scale = np.sqrt(np.diagonal(refined.precision.covariance))[joint.shared :]
        shares = [float(np.abs(weak[list(part.at)] / scale[list(part.at)]).max()) for part in left]
        dropped.append(left.pop(int(np.argmax(shares))))
    if not left:
        raise InputError(
            "nothing of the rig is determined by either side alone: "
            f"{'; '.join(part.words for part in dropped)}: photograph the board more often on either side"
        )
    check_solved(refined, joint.observations, as_jax(joint.free(left)))
    return refined, left, dropped


def _earlier(system: System) -> Float[np.ndarray, "leaves"]:
    return np.array([float(leaf) for leaf in jax.tree.leaves(system.earlier)])


def _without(system: System, free: Bool[np.ndarray, "leaves"]) -> System:
    """The same where what is shared does not differ."""
    leaves, tree = jax.tree.flatten(system.earlier)
    kept = [leaf if own else np.zeros(()) for leaf, own in zip(leaves, free, strict=True)]
    return replace(system, earlier=as_float64(jax.tree.unflatten(tree, kept)))


def _result(
    joint: _Joint,
    refined: Refined,
    free: Bool[np.ndarray, "shared"],
    parted: Parted,
    sides: tuple[Observations, Observations],
    later: bool,
) -> Calibration:
    """One side as a calibration."""
    whole = joint.whole
    one, own, known = side_of(refined, sides, later, free)
    held = set(parameter_names(whole.rig)) - set(whole.covariance.names)
    lost = rejected_points((*whole.fits, *whole.moved_fits))
    unused = Unused(
        whole.left_out[: len(whole.left_out) - len(lost.left_out)],
        whole.rejected[: len(whole.rejected) - len(lost.rejected)],
    )
    side = sides[int(later)]
    result = judged(one, as_jax(own), side, held, unused, (known,), whole.undetermined_periods, plain=whole.plain)
    said = set(unclear_bows(whole.rig, whole.covariance))
    notes = [note for note in whole.notes if note not in said]
    return replace(
        result,
        notes=(*notes, *unclear_bows(result.rig, result.covariance)),
        warnings=(*result.warnings, *parted.lent),
        parted=parted,
    )
