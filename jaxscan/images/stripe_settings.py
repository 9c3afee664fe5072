"""What is said of a laser so that its stripe can be found. It is part of files that are written without JAX."""

from dataclasses import dataclass
from typing import Final, Literal

from jaxscan.errors import InputError

# The laser's own channel, then the other two.
CHANNELS: Final = {"red": (0, 1, 2), "green": (1, 0, 2), "blue": (2, 0, 1)}
COLORS: Final = (*CHANNELS, "grey")


@dataclass(frozen=True)
class StripeSettings:
    """How the stripe is searched: the `[laser]` section of a session or scan.

    Attributes:
        color: of the laser; grey for a monochrome camera.
        columns: one point for each image column (True) or for each row (False).
        name: which laser of several this is.
    """

    color: Literal["red", "green", "blue", "grey"] = "red"
    columns: bool = True
    name: str = ""

    def __post_init__(self) -> None:
        """Refuse what cannot be meant."""
        if self.color not in COLORS:
            raise InputError(f'color = "{self.color}": use one of {", ".join(COLORS)}')
        if not isinstance(self.columns, bool):
            raise InputError(f"columns = {self.columns}: write true (a point for each column) or false (for each row)")
