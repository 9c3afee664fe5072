"""What goes wrong with hardware: each text says what happened, what state the scanner may be in, and what to do.

Drivers import nothing of jaxscan, so this family stands beside `jaxscan.JaxscanError`.
"""


class HardwareError(Exception):
    """Whatever a device refused or failed to do, with what to do about it in its text."""


class SettingsError(HardwareError):
    """Something that was asked for cannot be: a place beyond the travel, a rate of 0, a port that is not there."""


class NotHomedError(HardwareError):
    """The stage has no reference yet."""


class PositionUncertainError(HardwareError):
    """What the controller reports cannot be where the stage stands; only its reference switch helps."""


class NoAnswerError(HardwareError, TimeoutError):
    """A device did not answer, or did not arrive, in the time that follows from what was asked."""


class LineLostError(HardwareError):
    """The line carries nothing any more: what was under way may still be."""


class StoppedError(HardwareError):
    """Somebody called `stop`."""


class LeftOnError(HardwareError):
    """What ended, for whatever reason, left the stage or the laser in a state that nobody could see."""


class CameraError(HardwareError):
    """A camera is not there, or gives no photograph."""
