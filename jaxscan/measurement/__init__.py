"""Measuring: features fitted to a surface, dimensions between them with their intervals, and verdicts."""
