"""How the path of a stage differs from what it was taken for, in numbers and in words."""

from dataclasses import dataclass

from jaxscan.phrases import first_few
from jaxscan.rig.guide import Guide, Screw, ScrewOnGuide
from jaxscan.rig.linear import Linear
from jaxscan.rig.play import kind_with_play

_FEW = 3


@dataclass(frozen=True)
class StageShape:
    """What the photographs of an axis show of its path that the solve did not follow.

    Attributes:
        axis: its name.
        taken: the kind of motion that it was taken for.
        kind: the kind that follows it.
        p: how often chance would show as much, the likelier of what was found.
        travel_mm: over which it was photographed.
        bow_mm: how far the middle of its path is off the line through its ends; 0 where it is not said to be bowed.
        bow_sigma_mm: its σ.
        turn_mrad: by how much the carriage turns over that travel.
        turn_sigma_mrad: its σ.
        wave_mm: the amplitude of the screw's wave; 0 where it is not said to have one.
        wave_sigma_mm: its σ.
        period_steps: steps of one turn of the screw; None without a wave.
        aliases: other periods that fit nearly as well, the longest first.
        play_mm: by how much farther on it stands when approached by falling steps than by rising ones; 0 where it is
            not said to have play.
        play_sigma_mm: its σ.
        play_steps: the same, motor steps.
    """

    axis: str
    taken: str
    kind: str
    p: float
    travel_mm: float
    bow_mm: float = 0.0
    bow_sigma_mm: float = 0.0
    turn_mrad: float = 0.0
    turn_sigma_mrad: float = 0.0
    wave_mm: float = 0.0
    wave_sigma_mm: float = 0.0
    period_steps: float | None = None
    aliases: tuple[float, ...] = ()
    play_mm: float = 0.0
    play_sigma_mm: float = 0.0
    play_steps: float = 0.0

    @property
    def statements(self) -> tuple[tuple[str, str], ...]:
        """What is the case and what to do."""
        said = []
        if self.bow_mm:
            said.append(
                f"is bowed by {self.bow_mm:.2g} ± {self.bow_sigma_mm:.1g} mm over {self.travel_mm:.3g} mm, and turns "
                f"its load by {self.turn_mrad:.2g} ± {self.turn_sigma_mrad:.1g} mrad on the way"
            )
        if self.period_steps is not None:
            said.append(
                f"is alternately ahead of its steps and behind them by {self.wave_mm:.2g} ± {self.wave_sigma_mm:.1g} "
                "mm, with a "
                f"period of {self.period_steps:.5g} steps, as of a screw's turn"
            )
        if self.play_mm:
            much = f"{abs(self.play_mm):.2g} mm farther {'on' if self.play_mm > 0 else 'back'}"
            said.append(
                f"has a play of {self.play_mm:.3g} ± {self.play_sigma_mm:.1g} mm ({self.play_steps:.3g} steps): "
                f"photographs approached by falling steps are {much} than those approached by rising ones"
            )
        what = f"The {self.axis} {', and '.join(said)}; it was assumed to be {_TAKEN[self.taken]}"
        uneven = ""
        if self.aliases:
            uneven = f". {aliases_in_words(self.aliases)}"
        return ((what + uneven, f"Calibrate with --motion {self.kind}."),)


_TAKEN = {
    Linear.kind: "a straight line in equal steps",
    Guide.kind: "a bowed guide in equal steps",
    Screw.kind: "a straight line",
    ScrewOnGuide.kind: "a bowed guide and a screw",
}
_TAKEN |= {kind_with_play(kind): f"{words} with play" for kind, words in _TAKEN.items()}


def aliases_in_words(aliases: tuple[float, ...]) -> str:
    """That a period is not the only one, and how to find out which it is."""
    some = first_few([f"{period:.5g}" for period in aliases], _FEW)
    return (
        f"Its photographs do not distinguish that period from those of {some} steps: photograph the board at uneven "
        "steps, or give the screw's turn as screw_steps under [stage]"
    )
