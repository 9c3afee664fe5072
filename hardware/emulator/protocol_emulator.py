"""Where pyserial looks for the class behind URLs that begin with `emulator://`."""

from hardware.emulator.port import EmulatedPort as Serial

__all__ = ["Serial"]
