"""How a sheet of light that was taken as flat is curved, in numbers and in words."""

from dataclasses import dataclass

from jaxscan.phrases import of_laser


@dataclass(frozen=True)
class SheetCurve:
    """How a sheet that was taken as flat is curved.

    Attributes:
        laser: its name, "" for the only one.
        curve_mm: how far it is off its plane in the middle, about the ends of `width_mm`; positive away from the
            camera.
        sigma_mm: of that.
        width_mm: a round number near the length of the stripes.
        depth_mm: where: the mean depth of the stripes.
    """

    laser: str
    curve_mm: float
    sigma_mm: float
    width_mm: float
    depth_mm: float

    @property
    def in_words(self) -> str:
        """The finding, a sentence without its full stop."""
        return (
            f"The sheet of light{of_laser(self.laser)} is curved by {abs(self.curve_mm):.2g} ± {self.sigma_mm:.1g} mm "
            f"over {self.width_mm:g} mm, and was taken as flat: points will be off by up to as much. --sheet bowed "
            "fixes it"
        )
