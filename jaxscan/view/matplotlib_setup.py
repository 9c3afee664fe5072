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


def with_dates(ax: Any) -> None:
    """Ticks of an axis of times that can be read: few, and each part of a date where it changes."""
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    dates = AutoDateLocator(maxticks=8)
    ax.xaxis.set(major_locator=dates, major_formatter=ConciseDateFormatter(dates))
