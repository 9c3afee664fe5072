"""Matplotlib where it is installed (extra `plots`), drawing without a display."""

from typing import Any

from jaxscan.errors import InputError


def pyplot() -> Any:
    """`matplotlib.pyplot`.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise InputError('pictures need matplotlib: pip install "jaxscan[plots]"') from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
