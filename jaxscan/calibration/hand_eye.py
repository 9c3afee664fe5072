"""The pose of a hand in the camera's frame, from a board that was seen at given poses of a robot, gantry or tracker.

The board's pose in photograph i is T_i = K g_i B, with g_i the given pose or its inverse (`rig.given_poses`), K the
turn and offset that are sought, and B where the board is mounted, one for each session. Turned round, T_i says where
the hand really was; what differs from the given pose is the robot's error e_i, a position (mm) and a rotation (rad)
with the covariance

    V_i = diag(σ_t², σ_r²) + D_i C_i D_iᵀ,    D_i = ∂e_i/∂T_i,

C_i the covariance of T_i for known camera. K and B are those of the least Σ e_iᵀ V_i⁻¹ e_i; the two σ, where they are
not given, those of the largest restricted likelihood (H. D. Patterson and R. Thompson 1971).

Where nothing turns, the offset and the place of the board are found as their sum alone. Both stay free, because even
the smallest turns move a base that is far away; which directions are then not found is said afterwards.

Camera and boards are found before, without the given poses: a robot's errors are no noise but go on from pose to pose,
and would move the camera. How K moves with the camera is in its covariance.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import minimize

from jaxscan.errors import InputError
from jaxscan.geometry import Pose, matrix_to_vector, vector_to_matrix
from jaxscan.rig.given_poses import HeadPoses, ObjectPoses

Motion = HeadPoses | ObjectPoses

# Poses that turn by less, root mean square, in parts of the noise of a rotation, do not show where the hand is: noise
# looks like turns, and takes the share 1 / (1 + this²) of the offset away.
_A_TURN: Final = 10.0
# A turn that is known no better, rad, is not found.
_UNKNOWN_RAD: Final = 0.02
# What nothing is known of beforehand: rad and mm.
_ANY: Final = np.array([10.0] * 3 + [1e5] * 3)
# What is smaller than this beside the largest in normal equations of unit diagonal is rounding.
_NOTHING: Final = 1e-13
# Left out beyond this e V⁻¹ e: one good pose in 10 000 (χ² of six).
_LIMIT: Final = 27.9
_FEWEST: Final = 3
# Of fewer none can be told from the others.
_FEWEST_TO_JUDGE: Final = 5
_ROUNDS: Final = 12
_STEPS: Final = 20
_SETTLED: Final = 0.01
# A step shorter than this share of σ is the last.
_SMALL: Final = 1e-6
# Steps of differences: rad and mm; of the logarithm of a scale.
_STEP: Final = np.array([1e-6] * 3 + [1e-4] * 3)
_SCALE_STEP: Final = 1e-6
# No robot is better: mm and rad.
_LEAST: Final = np.array([1e-4, 1e-7])


@dataclass(frozen=True)
class Seen:
    """What photographs at given poses say.

    Attributes:
        given: T_base_hand of each, mm.
        boards: T_camera_board of each, mm.
        session: which mounting of the board each is of, from 0.
        covariance: of each board's pose for known camera: of a turn from the left (rad) and the place (mm).
        by_camera: how that pose moves with the camera's parameters.
    """

    given: Pose[np.ndarray]
    boards: Pose[np.ndarray]
    session: Int[np.ndarray, "photographs"]
    covariance: Float[np.ndarray, "photographs 6 6"]
    by_camera: Float[np.ndarray, "photographs 6 parameters"]

    def only(self, which: Bool[np.ndarray, "photographs"]) -> "Seen":
        """Some of the photographs."""
        return Seen(
            _some(self.given, which),
            _some(self.boards, which),
            self.session[which],
            self.covariance[which],
            self.by_camera[which],
        )


@dataclass(frozen=True)
class Fit:
    """Where K and B are; a stack of such fits has leading axes everywhere.

    Attributes:
        rotation: R of K.
        offset: what K adds before it, mm, in the axes of what stands behind K.
        board_rotations: R of B, of each mounting.
        board_places: translation of B, mm.
    """

    rotation: Float[np.ndarray, "*stack 3 3"]
    offset: Float[np.ndarray, "*stack 3"]
    board_rotations: Float[np.ndarray, "*stack sessions 3 3"]
    board_places: Float[np.ndarray, "*stack sessions 3"]

    def moved(self, by: Float[np.ndarray, "*stack unknowns"]) -> "Fit":
        """By turns from the left (rad) and shifts (mm): of K and its offset, then of each board."""
        each = by[..., 6:].reshape(*by.shape[:-1], -1, 6)
        return Fit(
            vector_to_matrix(by[..., :3]) @ self.rotation,
            self.offset + by[..., 3:6],
            vector_to_matrix(each[..., :3]) @ self.board_rotations,
            self.board_places + each[..., 3:],
        )

    def errors(
        self, kind: type[Motion], seen: Seen, by: Float[np.ndarray, "*stack 6"] | None = None
    ) -> Float[np.ndarray, "*stack photographs 6"]:
        """Where the hand was after the photographs, less where it is given: mm, and rad in the hand's axes.

        Args:
            kind: what moves.
            seen: the photographs.
            by: a turn from the left (rad) and a shift (mm) of all their boards, for derivatives.
        """
        R, t, at = seen.boards.matrix(), seen.boards.translation, seen.session
        if by is not None:
            R, t = vector_to_matrix(by[..., None, :3]) @ R, t + by[..., None, 3:]
        back = self.rotation.swapaxes(-1, -2)[..., None, :, :]
        # K⁻¹ T B⁻¹.
        H = back @ R @ self.board_rotations[..., at, :, :].swapaxes(-1, -2)
        h = (back @ t[..., None] - H @ self.board_places[..., at, :, None])[..., 0] - self.offset[..., None, :]
        if kind is HeadPoses:
            H = H.swapaxes(-1, -2)
            h = -(H @ h[..., None])[..., 0]
        turn = matrix_to_vector(seen.given.matrix().swapaxes(-1, -2) @ H)
        return np.concatenate([h - seen.given.translation, turn], axis=-1)


@dataclass(frozen=True)
class HandEye:
    """What was found of the hand.

    Attributes:
        fit: K and the boards.
        kept: which photographs took part.
        errors: of each given pose: mm, and rad.
        sigma: of a given position (mm) and rotation (rad) about each axis, as they were weighted.
        found: the two as the photographs show them; NaN for one that too few of them do.
        covariance: of K's turn (from the left, rad) and offset (mm) for known camera.
        by_camera: how these move with the camera's parameters.
        unknown: directions along which the offset is not found: too little turned there.
        scale: by which factor boards would have to lie farther for the given positions to fit best.
    """

    fit: Fit
    kept: Bool[np.ndarray, "photographs"]
    errors: Float[np.ndarray, "photographs 6"]
    sigma: Float[np.ndarray, "2"]
    found: Float[np.ndarray, "2"]
    covariance: Float[np.ndarray, "6 6"]
    by_camera: Float[np.ndarray, "6 parameters"]
    unknown: Float[np.ndarray, "directions 3"]
    scale: "Scale"


@dataclass(frozen=True)
class Scale:
    """The lengths of given positions over those that photographs show, which the squares of the board give.

    Attributes:
        ln: logarithm of that factor.
        sigma: of `ln`, for known camera.
        by_camera: how `ln` moves with the camera's parameters.
    """

    ln: float
    sigma: float
    by_camera: Float[np.ndarray, "parameters"]


def hand_eye(kind: type[Motion], seen: Seen, start: Fit, known: tuple[float | None, float | None]) -> HandEye:
    """Refine K and B, and leave out poses that do not go with the others.

    Args:
        kind: what moves.
        seen: the photographs.
        start: near the solution.
        known: σ of a given position (mm) and rotation (rad), each None where it is to be found.

    Raises:
        InputError: too few poses go with each other, or they do not show how camera and hand stand.
    """
    fit, sigma = start, _by_median(start.errors(kind, seen))
    given = np.array([np.nan if each is None else each for each in known])
    weigh = _Weights(kind, seen)
    limit = _LIMIT if len(seen.session) >= _FEWEST_TO_JUDGE else np.inf
    used, kept = weigh, weigh.distance(fit, sigma) <= limit
    found = sigma
    for _ in range(_ROUNDS):
        if kept.sum() < _FEWEST:
            raise InputError(
                f"of {len(kept)} given poses only {int(kept.sum())} fit together: check that the table has the "
                "pose of each photograph, taken where the robot stood still"
            )
        used = _Weights(kind, seen.only(kept))
        fit = used.solved(fit, sigma)
        found = used.likeliest(fit, sigma)
        # A robot that is worse than it was said to be is not trusted more than it can be.
        before, sigma = sigma, np.where(np.isfinite(given), np.fmax(given, found), found)
        wide = np.maximum(sigma, _by_median(fit.errors(kind, seen)[kept])) * used.of_few(given)
        again = weigh.distance(fit, wide) <= limit
        if np.allclose(before, sigma, rtol=_SETTLED) and (again == kept).all():
            break
        kept = again
    fit, wide = used.solved(fit, sigma), sigma * used.of_few(given)
    unknown = used.not_turned(sigma[1])
    covariance, by_camera = used.covariance(fit, wide, unknown)
    if np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]) > _UNKNOWN_RAD:
        raise InputError(
            "the given poses do not show how camera and hand are turned to each other: move in two directions at "
            "least, and turn about two where the hand can turn; what moves along one line is a [stage]"
        )
    scale = used.scale(fit, sigma, given)
    return HandEye(fit, kept, fit.errors(kind, seen), sigma, found, covariance, by_camera, unknown, scale)


class _Weights:
    """The least-squares problem of some photographs at a given σ."""

    def __init__(self, kind: type[Motion], seen: Seen) -> None:
        self._kind, self._seen = kind, seen

    def not_turned(self, sigma_rad: float) -> Float[np.ndarray, "directions 3"]:
        """Directions along which the offset is not found, where a given rotation has this σ about each axis."""
        of_boards = np.median(np.trace(self._seen.covariance[:, :3, :3], axis1=1, axis2=2)) / 3
        noise = float(np.sqrt(sigma_rad**2 + of_boards))
        return not_turned(self._kind.carry(self._seen.given), self._seen.session, noise)

    def solved(self, fit: Fit, sigma: Float[np.ndarray, "2"]) -> Fit:
        """The minimum, by Gauss-Newton steps."""
        for _ in range(_STEPS):
            N, g = _normal(*self._linear(fit, sigma))
            step = -_solved(N, g)
            fit = fit.moved(step)
            if np.sqrt(step @ N @ step) < _SMALL:
                break
        return fit

    def likeliest(self, fit: Fit, start: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        """The two σ of the largest restricted likelihood at a minimum."""
        J, _, e = self._linear(fit, start)
        return _likeliest(J, self._measured(fit), e, start)

    def of_few(self, known: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        """How much wider errors are spread whose σ is itself an estimate from few numbers: √(ν / (ν − 2)), as t's.

        Args:
            known: the σ that are given, NaN for those that are not.
        """
        numbers = (6 * len(self._seen.session) - 6 * (1 + len(np.unique(self._seen.session)))) / 2
        wider = np.sqrt(numbers / (numbers - 2)) if numbers > _FEWEST else np.sqrt(3.0)
        return np.where(np.isfinite(known), 1.0, wider)

    def distance(self, fit: Fit, sigma: Float[np.ndarray, "2"]) -> Float[np.ndarray, "photographs"]:
        """The sum e V⁻¹ e of each photograph."""
        e, V = fit.errors(self._kind, self._seen), self._measured(fit) + _of_robot(sigma)
        return np.einsum("pi,pi->p", e, np.linalg.solve(V, e[..., None])[..., 0])

    def covariance(
        self, fit: Fit, sigma: Float[np.ndarray, "2"], unknown: Float[np.ndarray, "directions 3"]
    ) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6 parameters"]]:
        """That of K for known camera, and how K moves with the camera's parameters; without what is not found."""
        J, V, _ = self._linear(fit, sigma)
        N, g = _normal(J, V, self._by_board(fit) @ self._seen.by_camera)
        N = _with_prior(N)
        # A basis of the unknowns without what is not found of the offset.
        known = np.linalg.svd(np.concatenate([unknown, np.zeros((1, 3))]))[2][len(unknown) :]
        offset, basis = np.pad(known.T, ((3, len(N) - 6), (0, 0))), np.eye(len(N))
        free = np.concatenate([basis[:, :3], offset, basis[:, 6:]], axis=1)
        S = free @ np.linalg.inv(free.T @ N @ free) @ free.T
        return S[:6, :6], -(S @ g)[:6]

    def scale(self, fit: Fit, sigma: Float[np.ndarray, "2"], known: Float[np.ndarray, "2"]) -> Scale:
        """By how much all lengths that photographs show would have to be longer.

        Args:
            fit: the minimum without it.
            sigma: near the σ of given positions (mm) and rotations (rad).
            known: those that are given, NaN for those that are not.
        """
        J, _, e = self._linear(fit, sigma)
        by = _differences(lambda ln: fit.errors(self._kind, _scaled(self._seen, ln[:, 0])), np.array([_SCALE_STEP]))
        J = np.concatenate([J, by], axis=-1)
        # A wrong scale is no error of the robot.
        found = _likeliest(J, self._measured(fit), e, sigma)
        sigma = np.where(np.isfinite(known), np.fmax(known, found), found) * self.of_few(known)
        by_camera = self._by_board(fit) @ self._seen.by_camera
        V = self._measured(fit) + _of_robot(sigma)
        N, g = _normal(J, V, np.concatenate([e[..., None], by_camera], axis=-1))
        S = np.linalg.inv(_with_prior(N))
        ln, *moves = -(S @ g)[-1]
        return Scale(float(ln), float(np.sqrt(S[-1, -1])), np.array(moves))

    def _linear(
        self, fit: Fit, sigma: Float[np.ndarray, "2"]
    ) -> tuple[Float[np.ndarray, "p 6 u"], Float[np.ndarray, "p 6 6"], Float[np.ndarray, "p 6"]]:
        """Derivatives of the errors by the unknowns, the errors' covariance, and the errors."""
        steps = np.tile(_STEP, 1 + fit.board_places.shape[-2])
        J = _differences(lambda by: fit.moved(by).errors(self._kind, self._seen), steps)
        return J, self._measured(fit) + _of_robot(sigma), fit.errors(self._kind, self._seen)

    def _measured(self, fit: Fit) -> Float[np.ndarray, "p 6 6"]:
        D = self._by_board(fit)
        return D @ self._seen.covariance @ D.swapaxes(-1, -2)

    def _by_board(self, fit: Fit) -> Float[np.ndarray, "p 6 6"]:
        return _differences(lambda by: fit.errors(self._kind, self._seen, by), _STEP)


def not_turned(
    behind: Pose[np.ndarray], session: Int[np.ndarray, "photographs"], noise_rad: float
) -> Float[np.ndarray, "directions 3"]:
    """Directions along which the offset is not found.

    With a board of its own in each session, whose place is unknown too, places say of an offset o, per photograph,
    oᵀ (I − R̄ R̄ᵀ) o, R̄ the mean rotation of the session: about the square of its turns across o.

    Args:
        behind: what stands behind K in each photograph.
        session: which mounting of the board each is of.
        noise_rad: of a rotation about each axis, rad.
    """
    R = behind.matrix()
    means = [R[session == each].mean(axis=0) for each in session]
    turn, ways = np.linalg.eigh(np.eye(3) - np.mean([mean @ mean.T for mean in means], axis=0))
    still = np.sqrt(np.maximum(turn, 0.0)) < _A_TURN * max(noise_rad, float(_LEAST[1]))
    return np.eye(3) if still.all() else ways[:, still].T


def _scaled(seen: Seen, ln: Float[np.ndarray, "stack"]) -> Seen:
    """Photographs of boards that lie farther by these factors, given by their logarithms."""
    boards = seen.boards
    places = np.exp(ln)[:, None, None] * boards.translation
    return replace(seen, boards=Pose(np.broadcast_to(boards.rotation, places.shape), places))


def _solved(N: Float[np.ndarray, "u u"], g: Float[np.ndarray, "u"]) -> Float[np.ndarray, "u"]:
    """N⁻¹ g, and nothing along what N does not determine."""
    scale = np.sqrt(np.where(np.diagonal(N) > 0, np.diagonal(N), 1.0))
    return np.linalg.lstsq(N / np.outer(scale, scale), g / scale, rcond=_NOTHING)[0] / scale


def _with_prior(N: Float[np.ndarray, "u u"]) -> Float[np.ndarray, "u u"]:
    """What nothing is known of has a σ as large as that; what follows the turns and shifts is known."""
    prior = np.tile(_ANY**-2, len(N) // 6)
    return N + np.diag(np.pad(prior, (0, len(N) - len(prior))))


def _likeliest(
    J: Float[np.ndarray, "p 6 u"],
    measured: Float[np.ndarray, "p 6 6"],
    e: Float[np.ndarray, "p 6"],
    start: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "2"]:
    """σ of given positions (mm) and rotations (rad) of the largest restricted likelihood.

    Args:
        J: derivatives of the errors by the unknowns.
        measured: the errors' covariance by the photographs alone.
        e: the errors.
        start: near it.
    """

    def unlikeliness(log_sigma: Float[np.ndarray, "2"]) -> float:
        V = measured + _of_robot(np.maximum(np.exp(log_sigma), _LEAST))
        N, g = _normal(J, V, e)
        squares = np.einsum("pi,pi->", e, np.linalg.solve(V, e[..., None])[..., 0]) - g @ _solved(N, g)
        # A board all of whose poses are left out, or a direction in which nothing turned, has no normal equations.
        return float(squares + np.linalg.slogdet(V)[1].sum() + np.linalg.slogdet(_with_prior(N))[1])

    best = minimize(unlikeliness, np.log(np.maximum(start, _LEAST)), method="Nelder-Mead", options={"xatol": 1e-3})
    return np.maximum(np.exp(best.x), _LEAST)


def _normal(
    J: Float[np.ndarray, "p 6 u"], V: Float[np.ndarray, "p 6 6"], e: Float[np.ndarray, "p 6 *columns"]
) -> tuple[Float[np.ndarray, "u u"], Float[np.ndarray, "u *columns"]]:
    W = np.linalg.solve(V, J)
    return np.einsum("piu,piv->uv", W, J), np.einsum("piu,pi...->u...", W, e)


def _of_robot(sigma: Float[np.ndarray, "2"]) -> Float[np.ndarray, "6 6"]:
    return np.diag(np.repeat(sigma, 3) ** 2)


def median_lengths(errors: Float[np.ndarray, "photographs 6"]) -> Float[np.ndarray, "2"]:
    """The median length of errors of positions, mm, and of rotations, rad."""
    return np.median(np.linalg.norm(errors.reshape(-1, 2, 3), axis=2), axis=0)


def _by_median(errors: Float[np.ndarray, "photographs 6"]) -> Float[np.ndarray, "2"]:
    """σ of positions and rotations that half of the poses may spoil."""
    # The median length of three normal numbers is 1.54 σ.
    return np.maximum(median_lengths(errors) / 1.538, _LEAST)


def _differences(
    function: Callable[[Float[np.ndarray, "steps unknowns"]], Float[np.ndarray, "steps p 6"]],
    steps: Float[np.ndarray, "unknowns"],
) -> Float[np.ndarray, "p 6 unknowns"]:
    """Central differences."""
    by = np.diag(steps)
    return np.moveaxis((function(by) - function(-by)) / (2 * steps[:, None, None]), 0, -1)


def _some(pose: Pose[np.ndarray], which: Bool[np.ndarray, "photographs"]) -> Pose[np.ndarray]:
    return Pose(pose.rotation[which], pose.translation[which])
