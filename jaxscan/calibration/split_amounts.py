"""How much the parts of a rig differ before and behind a change, each amount with its σ."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from jaxscan.calibration.adjustment import pose_at_0
from jaxscan.calibration.by_photograph import ByPhotograph
from jaxscan.calibration.determined import inverse_where_determined
from jaxscan.calibration.observations import Observations
from jaxscan.calibration.parted import Amount, Difference
from jaxscan.calibration.result import Calibration
from jaxscan.calibration.rounds import Refined
from jaxscan.calibration.split_parts import Part
from jaxscan.geometry import Pose
from jaxscan.precision import as_numpy
from jaxscan.rig import Motion, Positions, Rig
from jaxscan.rig.light import turned_and_moved
from jaxscan.rig.rig import is_place, leaves_of, parameter_names

# What an amount is made of: the rig before and the rig now.
_Of = Callable[[Rig, Rig], float]
_POSE = 6


def amounts(whole: Calibration, refined: Refined, part: Part, shared: int) -> tuple[Amount, ...]:
    """How much one part differs.

    Args:
        whole: the session solved as one.
        refined: where the joint solve ended.
        part: it.
        shared: how many numbers stand before those of the difference.
    """
    system = as_numpy(refined.system)
    numbers, unravel = ravel_pytree(as_numpy(system.rig))
    now = np.asarray(numbers)
    earlier = np.asarray(ravel_pytree(system.earlier)[0])
    at = np.array(part.at)
    covariance = refined.precision.covariance[np.ix_(shared + at, shared + at)]
    rig_now = as_numpy(unravel(jnp.asarray(now)))

    def value(of: _Of, by: Float[np.ndarray, "numbers"]) -> float:
        before = now + earlier
        before[at] += by
        return of(as_numpy(unravel(jnp.asarray(before))), rig_now)

    found = []
    for of, unit, words in _measures(whole, part, parameter_names(system.rig)):
        steps = np.sqrt(np.diagonal(covariance))
        slopes = [(value(of, step) - value(of, -step)) / (2 * step.sum()) for step in np.diag(steps)]
        sigma = float(np.sqrt(np.array(slopes) @ covariance @ np.array(slopes)))
        found.append(Amount(value(of, np.zeros(len(at))), sigma, unit, words))
    return tuple(found)


def _measures(whole: Calibration, part: Part, names: Sequence[str]) -> list[tuple[_Of, str, str]]:
    """What is measured of a part, the unit, and the words for it."""
    if part.kind == "focus":
        return [(_focus, "%", "became longer by {}")]
    if part.kind == "image":
        return [
            (
                lambda a, b: float(b.camera.principal[0]) - float(a.camera.principal[0]),
                "px",
                "moved by {} to the right",
            ),
            (lambda a, b: float(b.camera.principal[1]) - float(a.camera.principal[1]), "px", "by {} down"),
        ]
    if part.kind == "light":
        points, light = whole.stripe_points(part.which), whole.rig.lights[part.which]
        base = np.asarray(ravel_pytree(as_numpy(light))[0])

        def pushed(a: Rig, b: Rig) -> tuple[float, float]:
            was, now = (np.asarray(ravel_pytree(as_numpy(rig.lights[part.which]))[0]) - base for rig in (a, b))
            return turned_and_moved(light, was, now, *points)

        return [
            (lambda a, b: pushed(a, b)[0], "°", "turned by {}"),
            (lambda a, b: pushed(a, b)[1], "mm", "moved by {}"),
        ]
    if part.kind == "motion":
        stands = any(is_place(names[i]) for i in part.at)
        return [
            (lambda a, b: _turned(a, b, part.name), "°", "turned by {}"),
            *([(lambda a, b: _aside(a, b, part.name), "mm", "moved by {}")] if stands else []),
            (lambda a, b: _longer(a, b, part.name), "%", "goes farther by {} with each step"),
        ]
    return [(_leaf(i), "", f"has {names[i]} larger by {{}}") for i in part.at]


def _focus(before: Rig, now: Rig) -> float:
    shares = [float(b) / float(a) - 1 for a, b in zip(before.camera.focal, now.camera.focal, strict=True)]
    return 100 * float(np.mean(shares))


def _turned(before: Rig, now: Rig, axis: str) -> float:
    a, b = before.axis(axis).direction(), now.axis(axis).direction()
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def _aside(before: Rig, now: Rig, axis: str) -> float:
    """How far an axis that something turns about has moved."""
    at = leaves_of(now, f"motion.{axis}.centre.")
    a, b = (np.array([float(leaf) for leaf in jax.tree.leaves(rig.normal())])[at] for rig in (before, now))
    return float(np.linalg.norm(b - a))


def _longer(before: Rig, now: Rig, axis: str) -> float:
    return 100 * (now.axis(axis).amount(1.0)[0] / before.axis(axis).amount(1.0)[0] - 1)


def _leaf(i: int) -> _Of:
    def larger(before: Rig, now: Rig) -> float:
        return float(jax.tree.leaves(now)[i]) - float(jax.tree.leaves(before)[i])

    return larger


def place_difference(
    refined: Refined,
    each: ByPhotograph,
    sides: tuple[Observations, Observations],
    cut: tuple[int, int],
    wider: float,
) -> Difference:
    """How a board on an axis stands elsewhere behind the change, and by how much χ² would rise if it did not.

    Args:
        refined: where the joint solve ended; inside a `float64` block.
        each: the normal equations of its photographs.
        sides: the photographs before and behind.
        cut: which sequence of the first side, and of the second, show the board.
        wider: by what σ² is larger than the solve has it.
    """
    b, a = cut[0], len(sides[0].sequences) + cut[1]
    system, group = refined.system, refined.groups[1]
    rig, unravel = ravel_pytree(system.rig.motion)
    stems = [i for i, name in enumerate(parameter_names(system.rig)) if name.startswith("motion.")]
    first = len(system.shared_names()) - len(parameter_names(system.rig))
    references = [{axis: steps[i] for axis, steps in group.reference.items()} for i in (b, a)]

    def apart(v: Float[Array, "numbers"], references: Sequence[Positions]) -> Float[Array, "6"]:
        k = len(rig)
        now, more, before, after = v[:k], v[k : 2 * k], v[2 * k : 2 * k + _POSE], v[2 * k + _POSE :]
        was = _at_0(unravel(now + more), before, references[0])
        return (was.inverse() @ _at_0(unravel(now), after, references[1])).as_vector()

    poses = system.poses[1]
    earlier = ravel_pytree(system.earlier)[0][jnp.array(stems)]
    v = jnp.concatenate([rig, earlier, poses[b, :_POSE], poses[a, :_POSE]])
    # Where axes stood is given, and no constant of the program: JAX keeps it for other sessions.
    d, J = map(np.asarray, jax.jit(lambda *of: (apart(*of), jax.jacfwd(apart)(*of)))(v, references))
    at = [*stems, *(first + i for i in stems), *each.own[b][:_POSE], *each.own[a][:_POSE]]
    C = J @ each.inverse()[np.ix_(at, at)] @ J.T
    chi2 = float(d @ inverse_where_determined(wider * C, 0.0)[0] @ d)
    by = []
    for some, unit, words in ((slice(0, 3), "°", "turned by {}"), (slice(3, 6), "mm", "moved by {} beside its axis")):
        scale = np.degrees(1.0) if unit == "°" else 1.0
        size = float(np.linalg.norm(d[some]))
        along = d[some] / size if size else np.zeros(3)
        by.append(Amount(scale * size, scale * float(np.sqrt(along @ C[some, some] @ along)), unit, words))
    return Difference("place", sides[0].sequences[cut[0]].axis, chi2, _POSE, tuple(by))


def _at_0(motion: Motion, pose: Float[Array, "6"], reference: Positions) -> Pose:
    return Pose.from_vector(pose_at_0(motion, pose, reference))
