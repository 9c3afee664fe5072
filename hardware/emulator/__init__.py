"""Controllers in software, for trying and testing drivers: a motor between two switches at the end of a bad line.

`emulator://bistep`, `emulator://grbl` and `emulator://marlin` are URLs that pyserial opens once this package is among
its protocol handlers; `python -m hardware.emulator bistep` offers one as a terminal, for any program.
"""
