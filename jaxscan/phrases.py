"""Phrases that messages of all parts share: which of several lasers, and the first few of many things."""

from collections.abc import Sequence


def of_laser(name: str) -> str:
    """Of which laser something is, to be put behind it; nothing for a laser without a name, which is the only one."""
    return f' of laser "{name}"' if name else ""


def laser_called(name: str) -> str:
    """A laser in a sentence."""
    return f'laser "{name}"' if name else "the laser"


def laser_prefix(name: str) -> str:
    """What a message about one laser begins with; nothing for a laser without a name, which is the only one."""
    return f'laser "{name}": ' if name else ""


def stripe_of(name: str) -> str:
    """The stripe of a laser, without its article."""
    return f"stripe of laser {name}" if name else "stripe"


def first_few(words: Sequence[str], most: int = 5) -> str:
    """The first of many, and how many more there are: `a, b, c and 7 more`."""
    more = len(words) - most
    return ", ".join(words[:most]) + (f" and {more} more" if more > 0 else "")
