"""Sizes of padded arrays: a few for many counts, so that few are compiled."""

# This number of boards is solved in milliseconds, and compiled for in seconds.
_LEAST = 12


def bucket(count: int) -> int:
    """The next size of a coarse series: a few more views or stripe points do not compile again. Wastes at most 1/4.

    Few are solved for as many as a usual session has, none as none.
    """
    if count <= _LEAST:
        return _LEAST if count else 0
    unit = 1 << (count.bit_length() - 3)
    return -(-count // unit) * unit
