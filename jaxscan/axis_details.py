"""Names among the positions of a scanner's axes; without JAX, so that whatever drives motors starts at once."""

from typing import Final

# The axis whose positions are given poses (`rig.given_poses`).
POSES: Final = "poses"


def is_detail(name: str) -> bool:
    """Whether an entry of positions is no axis, but says more of one; no name of an axis has a dot."""
    return "." in name
