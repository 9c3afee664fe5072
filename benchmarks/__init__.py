"""Measurements of accuracy and speed, with a committed baseline and a gate: `python -m benchmarks --help`."""
