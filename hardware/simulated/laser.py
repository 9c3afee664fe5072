"""The simulated laser."""


class SimulatedLaser:
    """A laser that can be looked up."""

    def __init__(self) -> None:
        self.lit = False

    @property
    def switchable(self) -> bool:
        """Yes."""
        return True

    def on(self) -> None:
        """Switch it on."""
        self.lit = True

    def off(self) -> None:
        """Switch it off."""
        self.lit = False
