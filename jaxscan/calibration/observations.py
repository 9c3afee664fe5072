"""What calibration is given: where corners and stripe were seen, photograph by photograph.

Plain arrays that anyone can fill in; `observe` fills them in from the photographs of a session.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.axis_details import is_detail
from jaxscan.errors import InputError
from jaxscan.geometry import Pose
from jaxscan.images import Board
from jaxscan.rig import CARRIED_BY, run_of, runs

# An error names at most this number of the items that were left out.
_NAMED = 12


@dataclass(frozen=True)
class StripePoints:
    """Where a stripe was seen in one photograph of the board.

    Attributes:
        pixels: (u, v) of each stripe point; NaN for one that is missing.
        columns: True where the stripe was found column by column (v is measured), False for row by row (u is).
        laser: which of the observations' lasers.
        half_width_px: how far the stripe's light reaches to either side; within it the board must have one colour.
        sigmas: σ of each as the detector predicts it, px, where there was one.
        brighter: the colour in which the stripe is far brighter than in that of its laser; None where there is none.
        odd: whether its cross-section is not bell-shaped, all along it.
        light: read noise, gain, speckle contrast and saturation of the photograph, where there was a detector.
        widths: full width of the stripe at half its height at each, px, where there was a detector.
        black: which part of the pixels beside it is 0.
        position: motor steps of the axis that moves the laser's light, where one does.
    """

    pixels: Float[np.ndarray, "points 2"]
    columns: bool = True
    laser: int = 0
    half_width_px: float = 3.0
    sigmas: Float[np.ndarray, "points"] | None = None
    brighter: str | None = None
    odd: bool = False
    light: Float[np.ndarray, "4"] | None = None
    widths: Float[np.ndarray, "points"] | None = None
    black: float = 0.0
    position: float = 0.0


@dataclass(frozen=True)
class View:
    """One photograph of the board.

    Attributes:
        name: how messages call it, usually the file's name.
        corners: pixel of each board point, in the order of `Board.points`; NaN for one that was not found. OpenCV's
            arrays of shape (points, 1, 2) are taken too.
        weights: relative weight (1 / σ) of each corner, or None for equal ones; 0 leaves a corner out.
        stripes: the stripes seen on the board in this pose.
        session: which session it is from; empty for the only one.
        given: the pose T_base_hand at which robot, gantry or tracker says that it was taken, mm.
    """

    name: str
    corners: Float[np.ndarray, "corners *one 2"]
    weights: Float[np.ndarray, "corners"] | None = None
    stripes: tuple[StripePoints, ...] = ()
    session: str = ""
    given: Pose[np.ndarray] | None = None

    def __post_init__(self) -> None:
        """Take OpenCV's arrays as well.

        Raises:
            InputError: the corners are no list of pixels.
        """
        corners = np.asarray(self.corners, np.float64)
        if corners.ndim == 3 and corners.shape[1] == 1:
            corners = corners[:, 0]
        if corners.ndim != 2 or corners.shape[1] != 2:
            raise InputError(
                f"{self.name}: corners has the shape {corners.shape}: give (points, 2), or OpenCV's (points, 1, 2)"
            )
        object.__setattr__(self, "corners", corners)

    def used(self) -> Bool[np.ndarray, "corners"]:
        """Which corners take part."""
        seen = np.all(np.isfinite(self.corners), axis=1)
        return seen if self.weights is None else seen & (self.weights > 0)


@dataclass(frozen=True)
class BoardSequence:
    """Photographs of one board that an axis moves, along its travel or its turn.

    Attributes:
        positions: motor steps of each axis at each photograph, in the order they were taken; all but one axis stand
            still. For an axis with play also its run (`rig.run_of`).
        views: the photographs, all with the corners in the same order; stripes on the board take part.
        axis: the axis that moves.
        kind: how it moves the board, a kind of `rig.MOTIONS`.
    """

    positions: Mapping[str, Float[np.ndarray, "images"]]
    views: tuple[View, ...]
    axis: str = "stage"
    kind: str = "linear"

    @property
    def steps(self) -> Float[np.ndarray, "images"]:
        """Motor steps of the axis that moves, one for each photograph."""
        return np.asarray(self.positions[self.axis], np.float64)

    @property
    def runs(self) -> Float[np.ndarray, "images"]:
        """How far the axis that moves has come at each photograph since it last turned (`rig.play`)."""
        known = self.positions.get(run_of(self.axis))
        return np.asarray(runs(self.steps) if known is None else known, np.float64)

    def only(self, kept: Sequence[int]) -> "BoardSequence":
        """Some of its photographs."""
        positions = {axis: np.asarray(steps)[list(kept)] for axis, steps in self.positions.items()}
        return replace(self, positions=positions, views=tuple(self.views[i] for i in kept))


@dataclass(frozen=True)
class InlierMask:
    """Which corners and stripe points of one photograph take part.

    Attributes:
        corners: one for each board point.
        stripes: for each of the photograph's stripes, one for each point.
    """

    corners: Bool[np.ndarray, "corners"]
    stripes: tuple[Bool[np.ndarray, "_"], ...] = ()

    @staticmethod
    def none(view: View) -> "InlierMask":
        """Nothing of a photograph."""
        return InlierMask(np.zeros(len(view.corners), bool), tuple(np.zeros(len(s.pixels), bool) for s in view.stripes))

    def of(self, view: View) -> View:
        """The photograph with NaN in place of all else."""
        if self.corners.shape != view.corners.shape[:1] or [s.shape for s in self.stripes] != [
            s.pixels.shape[:1] for s in view.stripes
        ]:
            raise InputError(
                f"{view.name}: the mask of what to keep has {self.corners.size} corners and "
                f"{[s.size for s in self.stripes]} stripe points, the photograph {len(view.corners)} and "
                f"{[len(s.pixels) for s in view.stripes]}: take the mask from a calibration of the same observations"
            )
        stripes = tuple(
            replace(stripe, pixels=np.where(mask[:, None], stripe.pixels, np.nan))
            for stripe, mask in zip(view.stripes, self.stripes, strict=True)
        )
        return replace(view, corners=np.where(self.corners[:, None], view.corners, np.nan), stripes=stripes)


@dataclass(frozen=True)
class Unused:
    """What was seen and does not take part, in words.

    Attributes:
        left_out: photographs and stripes of which nothing does.
        rejected: how many corners or stripe points of a photograph do not.
    """

    left_out: tuple[str, ...] = ()
    rejected: tuple[str, ...] = ()

    def add(self, line: str, wholly: bool) -> "Unused":
        """The same with one more line."""
        return self.and_then(Unused((line,)) if wholly else Unused((), (line,)))

    def and_then(self, other: "Unused") -> "Unused":
        """The same, followed by the lines of another."""
        return Unused((*self.left_out, *other.left_out), (*self.rejected, *other.rejected))


@dataclass(frozen=True)
class HandSettings:
    """What is known of the device that carries head or object by given poses.

    Attributes:
        moves: "head": the camera is on the hand and the board is fixed; or "object": the board is on the hand.
        sigma_mm: σ of a given position along each axis; None where it is to be found.
        sigma_deg: σ of a given rotation about each axis; None where it is to be found.
        table: of the poses, a file's name, for errors; "" for none.
    """

    moves: str = "head"
    sigma_mm: float | None = None
    sigma_deg: float | None = None
    table: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        """Refuse what does not move."""
        if self.moves not in CARRIED_BY:
            raise InputError(f'moves = "{self.moves}": must be one of {", ".join(CARRIED_BY)}')


@dataclass(frozen=True)
class Observations:
    """All input of the joint solve.

    Attributes:
        image_size: columns and rows of every photograph.
        board: the board, for the millimetres of its points.
        views: the board held in many poses.
        sequences: of the board on an axis.
        lasers: the names of the lasers, "" for the only one.
        left_out: what was searched and not found, in words.
        notes: what a reader should know of the photographs: ambiguities, guesses.
        radius_mm: of a board's circles, whose centres of gravity `corners` are; 0 for points.
        hand: what is known of the device that carries head or object, where views have given poses.
        light_axes: of each laser whose light is moved, by its name, the axis that moves it.
    """

    image_size: tuple[int, int]
    board: Board
    views: tuple[View, ...]
    sequences: tuple[BoardSequence, ...] = ()
    lasers: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default=())
    radius_mm: float = 0.0
    hand: HandSettings | None = None
    light_axes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit together."""
        count = len(self.board.points())
        for view in self.photographs():
            if view.corners.shape != (count, 2):
                raise InputError(
                    f"{view.name}: corners has the shape {view.corners.shape}, and the board {count} points: give "
                    f"({count}, 2), NaN for a point that was not found"
                )
            if view.weights is not None and view.weights.shape != (count,):
                raise InputError(f"{view.name}: weights has the shape {view.weights.shape}, not ({count},)")
            for stripe in view.stripes:
                if not 0 <= stripe.laser < len(self.lasers):
                    raise InputError(f"{view.name}: a stripe names laser {stripe.laser} of {len(self.lasers)}")
        if (posed := [view for view in self.views if view.given is not None]) and self.hand is None:
            raise InputError(f"{posed[0].name}: has a given pose: say with hand=HandSettings(moves=…) what it moves")
        if posed and self.sequences:
            raise InputError(
                f"{posed[0].name} has a given pose, and {self.sequences[0].views[0].name} motor steps of the "
                f"{self.sequences[0].axis}: calibrate what moves by poses and by an axis apart"
            )
        for sequence in self.sequences:
            for axis, steps in sequence.positions.items():
                if len(steps) != len(sequence.views):
                    raise InputError(f"{len(steps)} step counts of the {axis} for {len(sequence.views)} photographs")
                if axis != sequence.axis and not is_detail(axis) and len(set(np.asarray(steps).tolist())) > 1:
                    raise InputError(
                        f"{sequence.views[0].name} … {sequence.views[-1].name}: the board was moved by the {axis} as "
                        f"well as by the {sequence.axis}: photograph it along one axis at a time"
                    )

    def photographs(self) -> tuple[View, ...]:
        """All photographs of the board: the views, then those along the axes, sequence by sequence."""
        return *self.views, *(view for sequence in self.sequences for view in sequence.views)

    def with_photographs(self, photographs: Sequence[View]) -> "Observations":
        """The same with others in their places, in the order of `photographs`."""
        rest = iter(photographs)
        views = tuple(next(rest) for _ in self.views)
        sequences = tuple(replace(each, views=tuple(next(rest) for _ in each.views)) for each in self.sequences)
        return replace(self, views=views, sequences=sequences)

    def unweighted(self) -> "Observations":
        """The same with equal weights for all corners that take part."""
        return self.with_photographs(
            [
                view if view.weights is None else replace(view, weights=view.used().astype(np.float64))
                for view in self.photographs()
            ]
        )

    def in_order(self) -> list[int]:
        """Places in `photographs` as they were taken: session by session, the views, then along the axes."""
        sessions = list(dict.fromkeys(view.session for view in self.photographs()))
        at = [sessions.index(view.session) for view in self.photographs()]
        return sorted(range(len(at)), key=at.__getitem__)

    def since(self, name: str) -> "Observations":
        """Without the photographs before the one of this name: what was seen after something was changed."""
        before = self.before(name)
        left_out = (*self.left_out, *(f"{each}: before {name}" for each in before))
        return replace(self.parted(before)[1], left_out=left_out)

    def parted(self, names: Collection[str]) -> tuple["Observations", "Observations"]:
        """The photographs of these names, and the others; a board on an axis that is in both has a sequence in each."""

        def those(wanted: bool) -> Observations:
            sequences = [
                sequence.only([i for i, view in enumerate(sequence.views) if (view.name in names) == wanted])
                for sequence in self.sequences
            ]
            return replace(
                self,
                views=tuple(view for view in self.views if (view.name in names) == wanted),
                sequences=tuple(sequence for sequence in sequences if sequence.views),
            )

        return those(True), those(False)

    def before(self, name: str) -> list[str]:
        """The names of the photographs before the one of this name, in the order in which they were taken.

        Raises:
            InputError: there is no such photograph.
        """
        photographs = self.photographs()
        names = [photographs[i].name for i in self.in_order()]
        if name not in names:
            raise no_such_photograph(name, names, "those with a board are")
        return names[: names.index(name)]

    def remarks(self) -> str:
        """Notes and what was left out, a line each, to follow an error's text."""
        more = len(self.left_out) - _NAMED
        lines = [f"note: {note}" for note in self.notes] + [f"left out: {line}" for line in self.left_out[:_NAMED]]
        return "".join(f"\n  {line}" for line in (*lines, *([f"left out: {more} more"] if more > 0 else [])))

    def only(self, keep: Sequence[InlierMask]) -> "Observations":
        """The same with NaN in place of all that is not kept.

        Args:
            keep: for each photograph, in the order of `photographs`.
        """
        photographs = self.photographs()
        if len(keep) != len(photographs):
            raise InputError(
                f"keep has masks for {len(keep)} photographs, there are {len(photographs)}: take them from a "
                "calibration of the same observations"
            )
        return self.with_photographs([mask.of(view) for mask, view in zip(keep, photographs, strict=True)])


def no_such_photograph(name: str, names: Sequence[str], those: str) -> InputError:
    """The error for a name that none of these photographs has."""
    known = ", ".join(names[:_NAMED]) + (" …" if len(names) > _NAMED else "")
    nearest = get_close_matches(name, names)
    like = f"; the nearest names are {', '.join(nearest)}" if nearest else ""
    return InputError(f'there is no photograph "{name}"{like}: {those} {known}')


def join(names: Sequence[str], each: Sequence[Observations]) -> Observations:
    """Several sessions of one rig as one; photographs are then called by their session and name.

    Args:
        names: of the sessions, for messages and reports.
        each: what was seen in each.

    Raises:
        InputError: they differ in the size of their photographs, their board or their lasers.
    """
    first = each[0]
    for name, other in zip(names[1:], each[1:], strict=True):
        if other.image_size != first.image_size:
            raise InputError(
                f"the photographs of {name} have {other.image_size} pixels, those of {names[0]} {first.image_size}: "
                "sessions of one rig have one camera, so calibrate them apart"
            )
        if other.board != first.board:
            raise InputError(
                f"{name} has the board {_board(other.board)}, {names[0]} has {_board(first.board)}: one calibration "
                "takes one board. If it is the same, measure ten squares of it with a ruler and correct [board] where "
                "it is wrong; if not, calibrate the sessions apart"
            )
        if other.lasers != first.lasers:
            raise InputError(
                f"{name} has the lasers {list(other.lasers)}, {names[0]} has {list(first.lasers)}: give both the same "
                "[laser] tables, or calibrate them apart"
            )
        if other.light_axes != first.light_axes:
            raise InputError(
                f"{name} has lights that are moved by {list(other.light_axes.values())}, {names[0]} by "
                f"{list(first.light_axes.values())}: give both the same [laser] tables, or calibrate them apart"
            )
        if None not in (other.hand, first.hand) and other.hand != first.hand:
            raise InputError(
                f"{name} has other moves or σ under [poses] than {names[0]}: sessions of one rig have one robot, so "
                "give both the same, or calibrate them apart"
            )

    def called(view: View, name: str) -> View:
        return replace(view, name=f"{name}/{view.name}", session=name)

    pairs = list(zip(names, each, strict=True))
    common = [note for note in first.notes if all(note in own.notes for own in each)]
    notes = [f"{name}: {note}" for name, own in pairs for note in own.notes if note not in common]
    return replace(
        first,
        views=tuple(called(view, name) for name, own in pairs for view in own.views),
        sequences=tuple(
            replace(sequence, views=tuple(called(view, name) for view in sequence.views))
            for name, own in pairs
            for sequence in own.sequences
        ),
        left_out=tuple(f"{name}/{line}" for name, own in pairs for line in own.left_out),
        notes=(*common, *notes),
        radius_mm=sum(own.radius_mm for own in each) / len(each),
        hand=next((own.hand for own in each if own.hand is not None), None),
    )


def _board(board: Board) -> str:
    return f"{board.counts[0]} x {board.counts[1]} at {board.pitch_mm:g} mm"
