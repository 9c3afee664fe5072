"""Matplotlib where it is installed (extra `plots`), drawing without a display."""

from typing import Any

from jaxscan.extras import extra


def pyplot() -> Any:
    """`matplotlib.pyplot`.

    Raises:
        InputError: matplotlib is not installed.
    """
    extra("plots").use("Agg")
    import matplotlib.pyplot as plt

    return plt
