"""The laser stripe: where it is in each column (or row) of a photograph, and how well that is known."""
