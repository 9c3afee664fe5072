"""A whole scanner in software: the embedded default, and the one on which the others are tested."""
