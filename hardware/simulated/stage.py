"""The simulated stage: the driver of a real controller on an emulated one."""

from urllib.parse import urlencode

from hardware.stages import BiStep2A04, Travel, register_stage

# Further than the travel says, on the side away from the switch.
_SPARE = 1000


class SimulatedStage(BiStep2A04):
    """A stage whose true position is known.

    Args:
        travel: its way and pace.
        play: of the screw, steps.
        speed: how many times faster than real time it runs, 0 for as fast as it can.
        faults: of its line, as in the URLs of `hardware.emulator.port`.
    """

    def __init__(self, travel: Travel | None = None, *, play: int = 0, speed: float = 0.0, **faults: float):
        travel = travel or Travel()
        start = min(3000, travel.span)
        values = {"length": travel.span + _SPARE, "start": start, "play": play, "speed": speed, **faults}
        super().__init__(f"emulator://bistep?{urlencode(values)}", travel)

    def true_position(self) -> float:
        """Where the load is, in steps from where it was when it stood at step 0 and had come from below."""
        port = self.line.port
        return port.axis.load(port.clock.now_s()) + self.travel.switch


register_stage("simulated", SimulatedStage, play=int, speed=float)
