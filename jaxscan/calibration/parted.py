"""What differs between two parts of a session and what they share, in numbers and in words."""

from collections.abc import Sequence
from dataclasses import dataclass

from jaxscan.phrases import of_laser


@dataclass(frozen=True)
class Amount:
    """How much something differs behind a photograph.

    Attributes:
        value: in its unit.
        sigma: its σ, in the same unit.
        unit: px, mm, ° or %; "" for a plain number.
        words: what is said of it, with {} where the amount stands.
    """

    value: float
    sigma: float
    unit: str
    words: str

    def __str__(self) -> str:
        """As it is said: value and σ to two digits of σ."""
        digits = 2 if self.sigma <= 0 else max(0, 1 - _order(self.sigma))
        space = "" if self.unit == "°" else " "
        return self.words.format(f"{self.value:.{digits}f} ± {self.sigma:.{digits}f}{space}{self.unit}".rstrip())


@dataclass(frozen=True)
class Difference:
    """A part of the rig, or the board on an axis, that is another before and behind a photograph.

    Attributes:
        part: "focus", the focal lengths; "image", the principal point; "lens", the terms of its distortion; "light",
            a sheet; "motion", an axis; "place", the board on an axis.
        name: which laser or axis; "" for the only laser and for the camera's.
        chi2: by how much χ² would rise if it were taken as shared.
        numbers: how many it has.
        amounts: by how much it differs.
    """

    part: str
    name: str
    chi2: float
    numbers: int
    amounts: tuple[Amount, ...]

    @property
    def words(self) -> str:
        """What differs and by how much, a main clause."""
        return f"{called(self.part, self.name)} {listed([str(amount) for amount in self.amounts])}"


@dataclass(frozen=True)
class Parted:
    """How the two parts of a session were solved.

    Attributes:
        before: the last photograph of the first part.
        after: the first photograph of the last part.
        counts: how many photographs either part has.
        differ: what differs, of what both parts show.
        shared: what does not, in words.
        untested: what one of the parts does not show, in words with the reason: it is taken from the other part.
        later: whether this is the part from `after` on.
        lent: what this part's rig has from the other part alone, sentences without their full stops.
        gain: by how much the information criterion is lower than with nothing that differs.
        scatter: by this factor the photographs contradict each other more than their σ have it; 1 or more.
    """

    before: str
    after: str
    counts: tuple[int, int]
    differ: tuple[Difference, ...]
    shared: tuple[str, ...]
    untested: tuple[str, ...] = ()
    later: bool = True
    lent: tuple[str, ...] = ()
    gain: float = 0.0
    scatter: float = 1.0

    @property
    def rig_differs(self) -> bool:
        """Whether the rig is another before and behind, and not the board on an axis alone."""
        return any(each.part != "place" for each in self.differ)

    @property
    def sentence(self) -> str:
        """What differs, and what is shared; without the last full stop."""
        between = f"between {self.before} and {self.after}"
        shared = f"shared by both parts: {listed(self.shared)}" if self.shared else ""
        untested = f". Not compared: {'; '.join(self.untested)}" if self.untested else ""
        if not self.differ:
            return f"{between} nothing differs ({shared}): the session was solved whole{untested}"
        differ = listed([each.words for each in self.differ])
        return f"{between} {differ}{f'; {shared}' if shared else ''}{untested}"


def called(part: str, name: str = "") -> str:
    """A part of the rig in words."""
    return {
        "focus": "the focal length",
        "image": "the principal point",
        "lens": "the lens's distortion",
        "light": f"the sheet of light{of_laser(name)}",
        "motion": f"the motion of the {name}",
        "place": f"the board on the {name}",
    }[part]


def listed(words: Sequence[str]) -> str:
    """A, B and C."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _order(value: float) -> int:
    """The power of ten of a number's first digit."""
    return int(f"{value:e}".partition("e")[2])
