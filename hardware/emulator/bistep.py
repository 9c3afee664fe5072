"""The stepper controller BiStep2A04, as far as public drivers show its language.

A number, then a letter; no terminator. `x`, `y`, `B` select motors, `g` goes to a count, `s` goes so far, `r` sets the
rate (steps/s), `p` the ramp (steps/s²), `i` waits until the motor stands, `=` defines the count, `?` reports
(−1: the count), `L` reports the latches and clears them, `!` resets. Every letter is answered with the prompt `*`.
"""

import math

from hardware.emulator.axis import Axis

_Y_BITS, _X_LOW, _X_HIGH, _RESET = 0, 4, 8, 16
_RATE, _RAMP = 400.0, 1000.0


class BiStep:
    """The controller with one motor, X; Y is there and has none."""

    def __init__(self, axis: Axis, echo: bool = False):
        self.axis = axis
        self._echo = echo
        self._number, self._negative, self._selected = "", False, "X"
        self._latches = _RESET
        self._waiting = False
        self._held = bytearray()
        axis.rate, axis.ramp = _RATE, _RAMP

    def receive(self, byte: int, now_s: float) -> bytes:
        """Take one byte. While it waits for the motor it keeps bytes for later, but for a reset."""
        echo = bytes([byte]) if self._echo else b""
        if self._waiting and byte != ord("!"):
            self._held.append(byte)
            return echo
        return echo + self._act(byte, now_s)

    def wakes_at_s(self) -> float:
        """When the motor stands, if that is waited for."""
        return self.axis.rests_at_s() if self._waiting else math.inf

    def wake(self, now_s: float) -> bytes:
        """The prompt of `i`, and the answers to what came meanwhile."""
        self._waiting = False
        answer, held = b"*", bytes(self._held)
        self._held.clear()
        for byte in held:
            if self._waiting:
                self._held.append(byte)
            else:
                answer += self._act(byte, now_s)
        return answer

    def _act(self, byte: int, now_s: float) -> bytes:
        character = chr(byte)
        if character.isascii() and character.isdigit():
            self._number += character
            return b""
        if character == "-":
            self._number, self._negative = "", True
            return b""
        if not 33 <= byte < 127:
            return b""
        value = (-1 if self._negative else 1) * int(self._number[-9:] or 0)
        self._number, self._negative = "", False
        return self._obey(character.upper(), value, now_s) + b"*"

    def _obey(self, letter: str, value: int, now_s: float) -> bytes:
        if letter == "!":
            return self._reset(now_s)
        if letter in "XYB":
            self._selected = letter
        elif letter == "L":
            switch = self.axis.at_switch(now_s)
            latches = self._latches | {-1: _X_LOW, 1: _X_HIGH, 0: _Y_BITS}[switch]
            self._latches = 0
            return b"L,%d\r\n" % latches
        elif letter == "?":
            count = self.axis.counter(now_s) if self._selected != "Y" else 0
            names = "XY" if self._selected == "B" else self._selected
            return b"".join(b"%c,%d,%d\r\n" % (ord(name), value, count if value == -1 else 0) for name in names)
        elif self._selected != "Y":
            self._drive(letter, value, now_s)
        return b""

    def _drive(self, letter: str, value: int, now_s: float) -> None:
        if letter == "G":
            self.axis.go(value, now_s)
        elif letter == "S":
            self.axis.go(self.axis.counter(now_s) + value, now_s)
        elif letter == "R":
            self.axis.rate = max(1, abs(value))
        elif letter == "P":
            self.axis.ramp = max(1, abs(value))
        elif letter == "=":
            self.axis.define(value, now_s)
        elif letter == "I":
            self._waiting = self.axis.moving(now_s)

    def _reset(self, now_s: float) -> bytes:
        self.axis.halt(now_s)
        self.axis.define(0, now_s)
        self.axis.rate, self.axis.ramp = _RATE, _RAMP
        self._selected, self._latches, self._waiting = "X", _RESET, False
        self._held.clear()
        return b"\r\nBiStep2A04\r\n"
