"""A shape of the board that a calibration did not follow, in numbers and in words."""

from dataclasses import dataclass

from jaxscan.rig.board_shape import FEWEST_VIEWS_FOR, bulges_in_words, rounded_mm

# A shape counts if chance shows it no more often than this, and if it moves the rig by this number of σ.
BY_CHANCE = 1e-4
_MOVES = 1.0


@dataclass(frozen=True)
class BoardFlatness:
    """A shape of the board that the solve did not follow.

    Attributes:
        taken: what the board was taken for, one of `BOARD_SHAPES`.
        bent_mm: from the lowest to the highest point of what all photographs share.
        bent_sigma_mm: its σ.
        bends_mm: σ of the additional bulges of each photograph.
        p: how often noise alone would show as much.
        p_bends: how often it would show bulges of each photograph's own as large.
        parameter: what of the rig it moves most, in σ.
        shift_in_sigma: by how much.
        session: the one whose board differs most from that of the first, "" where none does.
        differs_mm: by how much it does, from the lowest to the highest point.
        views: from how many views of the board it was determined.
    """

    taken: str
    bent_mm: float
    bent_sigma_mm: float
    bends_mm: float
    p: float
    p_bends: float
    parameter: str
    shift_in_sigma: float
    views: int
    session: str = ""
    differs_mm: float = 0.0

    @property
    def bent(self) -> bool:
        """Whether there is such a shape, and it matters."""
        return self.p < BY_CHANCE and self.shift_in_sigma > _MOVES

    @property
    def asks(self) -> str:
        """The simplest shape, one of `BOARD_SHAPES`, that follows what was found."""
        return "bend" if self.p_bends < BY_CHANCE or self.taken != "flat" else "warp"

    @property
    def statements(self) -> tuple[tuple[str, str], ...]:
        """What is the case and what to do, for each of what was found.

        The shape of two boards taken for one is that of neither, so it is not said beside the session that differs.
        """
        said: list[tuple[str, str]] = []
        if self.bent and not self.session:
            followed = "flat" if self.taken == "flat" else f'as board_shape = "{self.taken}" has it'
            by = f"{rounded_mm(self.bent_mm)} (± {self.bent_sigma_mm:.1g}) from its lowest to its highest point"
            by += f", and {bulges_in_words(self.bends_mm)}"
            what = (
                f"The board is not {followed}: it is bent by {by}. Taken so, it moves {self.parameter} by "
                f"{self.shift_in_sigma:.1f} of its σ"
            )
            lacking = FEWEST_VIEWS_FOR["bend"] - self.views
            more = (
                f"Take {lacking} more view{'s' if lacking > 1 else ''} of the board and calibrate"
                if lacking > 0
                else "Calibrate"
            )
            said.append((what, f"{more} with --board-shape bend, or glue the pattern to something stiff and flat."))
        if self.session:
            what = (
                f"The board of the session {self.session} has another shape than that of the first session: they "
                f"differ by {rounded_mm(self.differs_mm)} from the lowest to the highest point"
            )
            said.append((what, "If they are two boards, calibrate the sessions apart."))
        return tuple(said)
