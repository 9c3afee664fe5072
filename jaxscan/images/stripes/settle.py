"""Which of what was measured in some frames is the stripe, line by line: verdicts, and looks at other places.

In most frames the block that stands out most is the stripe in every line: one run of points, and nothing strong beside
it. Where it is not so, the other candidates of the frame are measured too, and the likeliest runs are taken; where the
light is weak, faint points are that go on from one another.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int8

from jaxscan.images.stripes.candidates import highest, rivals
from jaxscan.images.stripes.coarse import level_of
from jaxscan.images.stripes.faint import faint_runs, near_enough
from jaxscan.images.stripes.runs import Points, likeliest
from jaxscan.images.stripes.survey import LEAST_SIGNAL
from jaxscan.images.stripes.validity import Verdict, in_a_line

# A frame is in doubt if at least this number of its strong lines have no point.
_DOUBTFUL: Final = 3
# A candidate rises by this part of what a stripe must.
_RISES: Final = 0.7
# White light is left with at most this part of its response, within this number of pixels, because white cancels. Most
# of a stripe that can be distinguished from it keeps more than the second part.
_WHITE, _IN_COLOUR, _FLANK_PX = 0.2, 0.6, 8
# What is found lies near what it was looked for by: within so much, and half of its own width.
_NEAR_PX: Final = 3.0
# In weak light a stripe's strength is below this multiple of the least strength. What stands alone is as bright as the
# stripe divided by it, for edges in the room's light have runs of faint points too. Faint points are above the second
# multiple of the noise, where most of the greatest peaks of noise are.
_WEAK, _FAINT = 4.0, 2.0

# Frame, line and row of each place.
Places = tuple[Int[np.ndarray, "some"], ...]
# The first and the last row at which the stripe can be in each line.
# Of all frames alike, or of each.
Band = tuple[Float[np.ndarray, "*frames lines"], Float[np.ndarray, "*frames lines"]]
# Of a frame, and of rows in some of its lines.
RisesAlone = Callable[[int, Int[np.ndarray, "some"], Int[np.ndarray, "some"]], Bool[np.ndarray, "some"]]
# Of a frame, in some of its lines.
NarrowPeaks = Callable[[int, Int[np.ndarray, "some"]], tuple[Int[np.ndarray, "peaks"], Int[np.ndarray, "peaks"]]]


class Looked(NamedTuple):
    """What was measured at some places, or in each line of each frame.

    Attributes:
        measured: by the detector: `Measured` of NumPy's arrays.
        strong: whether something stands out, whole or not.
        cramped: whether it was measured in a wide window.
        burnt: whether it is burnt out.
    """

    measured: Any
    strong: Bool[np.ndarray, "*of"]
    cramped: Bool[np.ndarray, "*of"]
    burnt: Bool[np.ndarray, "*of"]

    def near(self, rows: Int[np.ndarray, "*of"]) -> Bool[np.ndarray, "*of"]:
        """Whether what was found lies near what it was looked for by; a burnt-out core may be as thick as it likes."""
        off = np.abs(self.measured.position - rows)
        return (off <= _NEAR_PX + self.measured.width / 2) | self.burnt | self.cramped


@dataclass
class MeasuredFrames:
    """Some frames as they are measured.

    Attributes:
        looked: what was found in each line.
        peak: at which row it was looked for.
        least: how much a stripe must stand out in each frame.
        ground: the noise of each frame.
        ln_widths: by how much the logarithms of neighbours' widths may differ in each frame.
        length: rows of the image.
        look: measures at other places.
        band: where the sheet can be.
    """

    looked: Looked
    peak: Int[np.ndarray, "frames lines"]
    least: Float[np.ndarray, "frames"]
    ground: Float[np.ndarray, "frames"]
    ln_widths: Float[np.ndarray, "frames"]
    length: int
    look: Callable[[Places], Looked]
    band: Band | None

    def take(self, at: Places, found: Looked, which: np.ndarray) -> None:
        """Put what was measured at some of these places into their lines."""
        lines = at[0][which], at[1][which]
        self.looked, self.peak = jax.tree.map(
            lambda old, new: replaced(old, lines, new[which]), (self.looked, self.peak), (found, at[2])
        )

    def within(
        self, frame: Int[np.ndarray, "*of one"], line: Int[np.ndarray, "*some"], position: Float[np.ndarray, "*of some"]
    ) -> Bool[np.ndarray, "*of some"]:
        """Whether positions in some lines of some frames lie in the band."""
        if self.band is None:
            return np.ones(position.shape, bool)
        low, high = (edge[line] if edge.ndim == 1 else edge[frame, line] for edge in self.band)
        return (position >= low) & (position <= high)


def replaced(old: np.ndarray, at: np.ndarray | tuple[np.ndarray, ...], new: np.ndarray) -> np.ndarray:
    """A copy with new values at some places."""
    values = np.array(old)
    values[at] = new
    return values


def settle(
    frames: MeasuredFrames,
    peaks: Array,
    columns: bool,
    contested: bool,
    of_colour: Callable[[], np.ndarray | None],
    rises_alone: RisesAlone,
    narrow_peaks: NarrowPeaks | None,
) -> Int8[np.ndarray, "frames lines"]:
    """The verdict of each line of some frames; what is measured elsewhere is put into `frames`.

    Args:
        frames: as they were measured.
        peaks: of each block, packed.
        columns: whether lines are columns.
        contested: whether other candidates are looked at.
        of_colour: the peaks where neutral light cancels however bright it is; None where there are no colours.
        rises_alone: whether the laser's channel rises alone at rows of some lines of a frame; asked where there are
            colours.
        narrow_peaks: where something narrow stands out in some lines of a frame, lines and rows; None where colours
            do not show it.
    """
    shape = frames.peak.shape
    numbers, lines = np.arange(shape[0])[:, None], np.arange(shape[1])
    measured = frames.looked.measured
    bright = measured.whole & (measured.strength > frames.least[:, None])
    if contested:
        bright &= frames.looked.near(frames.peak)
    inside = frames.within(numbers, lines, measured.position)
    found, runs = in_a_line(measured, bright & inside, frames.least, frames.ln_widths)
    second = np.zeros(shape, bool)
    if contested:
        lost = frames.looked.strong & ~found
        doubtful = np.flatnonzero((runs > 1) | (lost.sum(axis=1) >= _DOUBTFUL))
        if doubtful.size:
            standing = bright & inside
            down = np.asarray(peaks)
            coloured = of_colour()
            if not columns:
                down = np.swapaxes(down, 1, 2)
                coloured = None if coloured is None else np.swapaxes(coloured, 1, 2)
            _contest(frames, doubtful, down, coloured, rises_alone, lost, narrow_peaks, standing, second)
            measured = frames.looked.measured
            found, _ = in_a_line(measured, standing, frames.least, frames.ln_widths)
    verdict = np.where(found, Verdict.STRIPE, Verdict.NOTHING).astype(np.int8)
    verdict[bright & ~found] = Verdict.SPOT
    verdict[second & ~found] = Verdict.SECOND
    verdict[bright & ~inside & ~found] = Verdict.OUTSIDE
    _add_faint(frames, verdict)
    return verdict


def _contest(
    frames: MeasuredFrames,
    doubtful: Int[np.ndarray, "some"],
    peaks: Int[np.ndarray, "frames down lines"],
    of_colour: Int[np.ndarray, "frames down lines"] | None,
    rises_alone: RisesAlone,
    lost: Bool[np.ndarray, "frames lines"],
    narrow_peaks: NarrowPeaks | None,
    standing: Bool[np.ndarray, "frames lines"],
    second: Bool[np.ndarray, "frames lines"],
) -> None:
    """Measure what else is bright in doubtful frames, and take the likeliest; `standing` and `second` are updated."""

    def colour(n: int, line: Int[np.ndarray, "some"], row: Int[np.ndarray, "some"]) -> Float[np.ndarray, "some"]:
        """How much of the response is left where white cancels: of what shines white nothing, on its flanks neither."""
        if of_colour is None:
            return np.ones(len(line))
        own = highest(peaks[n], line, row, _FLANK_PX, frames.length)
        return highest(of_colour[n], line, row, _FLANK_PX, frames.length) / np.maximum(own, 1)

    places = []
    for n in doubtful:
        lines = np.flatnonzero(standing[n])
        line, row = rivals(peaks[n], frames.peak[n], _RISES * float(frames.least[n]), frames.length)
        if narrow_peaks is not None and lost[n].any():
            line, row = _with_narrow(line, row, *narrow_peaks(n, np.flatnonzero(lost[n])), frames.peak[n])
        mains, others = colour(n, lines, frames.peak[n, lines]), colour(n, line, row)
        # Where the stripe is itself burnt out to white, colour shows nothing.
        if lines.size and np.median(mains) > _IN_COLOUR:
            white = mains <= _WHITE
            if white.any():
                # A surface of another colour outdoes the laser's light.
                white[white] = ~rises_alone(n, lines[white], frames.peak[n, lines[white]])
            standing[n, lines] = ~white
            line, row = line[others > _WHITE], row[others > _WHITE]
        places.append(np.stack([np.full_like(line, n), line, row]))
    at = tuple(index.astype(np.int32) for index in np.concatenate(places, axis=1))
    if not at[0].size:
        return
    looked = frames.look(at)
    found = looked.measured
    good = found.whole & (found.strength > frames.least[at[0]]) & frames.within(at[0], at[1], found.position)
    # A wide window may see again what stands out most in its line.
    again = np.abs(found.position - frames.looked.measured.position[at[:2]]) <= _NEAR_PX + found.width
    which = np.flatnonzero(good & looked.near(at[2]) & ~(again & standing[at[:2]]))
    own, taken = frames.looked.measured, [np.empty(0, int)]
    for n in doubtful:
        mine = which[at[0][which] == n]
        if not mine.size:
            continue
        lines = np.flatnonzero(standing[n])
        line = np.concatenate([lines, at[1][mine]])
        order = np.argsort(line, kind="stable")
        values = (
            np.concatenate([mains[n][lines], others[mine]])[order]
            for mains, others in (
                (own.position, found.position),
                (own.strength, found.strength),
                (own.width, found.width),
                (own.thickness, found.thickness),
            )
        )
        response = _Responses(peaks[n], frames.length)
        points, most = Points(line[order], *values), float(frames.ln_widths[n])
        chosen, others = (x[np.argsort(order)] for x in likeliest(points, response, most))
        second[n, line[others]] = True
        standing[n] = False
        standing[n, line[chosen]] = True
        taken.append(mine[chosen[len(lines) :]])
    frames.take(at, looked, np.concatenate(taken))


def _with_narrow(
    line: Int[np.ndarray, "some"],
    row: Int[np.ndarray, "some"],
    narrow_line: Int[np.ndarray, "peaks"],
    narrow_row: Int[np.ndarray, "peaks"],
    taken: Int[np.ndarray, "lines"],
) -> tuple[Int[np.ndarray, "more"], Int[np.ndarray, "more"]]:
    """Candidates and narrow peaks of a frame, without those that are where another one is."""
    new = np.abs(narrow_row - taken[narrow_line]) > _NEAR_PX
    for i in np.flatnonzero(new):
        same = line == narrow_line[i]
        new[i] = not (np.abs(row[same] - narrow_row[i]) <= _NEAR_PX).any()
    return np.concatenate([line, narrow_line[new]]), np.concatenate([row, narrow_row[new]])


@dataclass(frozen=True)
class _Responses:
    """How far the response about places of a frame is above what is usual in their lines; 0 beyond the image.

    Attributes:
        peaks: of each block, packed.
        length: rows of the image.
    """

    peaks: Int[np.ndarray, "down lines"]
    length: int

    @cached_property
    def _usual(self) -> Float[np.ndarray, "lines"]:
        return np.median(level_of(self.peaks), axis=0)

    def __call__(
        self, line: Int[np.ndarray, "points"], row: Float[np.ndarray, "points"]
    ) -> Float[np.ndarray, "points"]:
        inside = (row >= 0) & (row < self.length)
        at = np.rint(np.where(inside, row, 0)).astype(np.int32)
        return np.where(inside, highest(self.peaks, line, at, int(_NEAR_PX), self.length) - self._usual[line], 0.0)


def _add_faint(frames: MeasuredFrames, verdict: Int8[np.ndarray, "frames lines"]) -> None:
    """In weak light, lines that are faint and in company; the verdicts are updated.

    Beside a bright stripe those alone that stand out from noise by themselves, where they go on from it.
    """
    measured = frames.looked.measured
    here = measured.whole & (verdict == Verdict.NOTHING)
    here &= frames.within(np.arange(len(verdict))[:, None], np.arange(verdict.shape[1]), measured.position)
    places, rows = [np.empty((2, 0), np.int32)], [np.empty(0, np.float32)]
    for n in range(len(verdict)):
        found = verdict[n] == Verdict.STRIPE
        usual = float(np.median(measured.strength[n][found])) if found.any() else 0.0
        bright = usual > _WEAK * frames.least[n]
        faint = here[n] & (measured.strength[n] > (LEAST_SIGNAL if bright else _FAINT) * frames.ground[n])
        if faint.sum() < _DOUBTFUL:
            continue
        one = measured.position[n], measured.strength[n], measured.width[n]
        least_alone = np.inf if bright else usual / _WEAK
        runs = faint_runs(faint | found, *one, frames.length, found, least_alone)
        verdict[n][runs.runs] = Verdict.STRIPE
        verdict[n][runs.weak & ~found] = Verdict.WEAK
        # Gaps of a bright stripe are what they are.
        line = np.flatnonzero(runs.between & ~(found | bright))
        places.append(np.stack([np.full_like(line, n), line]).astype(np.int32))
        rows.append(runs.rows[line])
    between, row = np.concatenate(places, axis=1), np.concatenate(rows)
    if not row.size:
        return
    at = (*between, np.rint(row).astype(np.int32))
    looked = frames.look(at)
    again = looked.measured
    good = again.whole & (again.strength > _FAINT * frames.ground[at[0]]) & near_enough(again.position, row)
    good &= frames.within(at[0], at[1], again.position)
    verdict[at[0], at[1]] = np.where(good, Verdict.STRIPE, Verdict.WEAK)
    frames.take(at, looked, np.flatnonzero(good))
