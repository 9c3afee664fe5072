"""Still pictures, by matplotlib (extra `plots`), drawn without a display."""

import os
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.atomic import replacing
from jaxscan.errors import InputError

# What the shading counts as lit from: over the camera's left shoulder.
_LIGHT = np.array([-0.4, -0.5, -0.77])


def draw_scan(
    path: str | os.PathLike[str],
    points: Float[np.ndarray, "frames columns 3"],
    valid: Bool[np.ndarray, "frames columns"],
    title: str,
    errors_mm: Float[np.ndarray, "frames columns"] | None = None,
) -> None:
    """A scan as its shaded surface seen in perspective, and beside it its depth or, where given, its errors.

    Args:
        path: the PNG to write.
        points: object frame, mm.
        valid: where there is a point.
        title: over the picture.
        errors_mm: distance of each point from the truth, to be shown in colours.
    """
    plt = _matplotlib()
    shaded = shade(points, valid)
    figure = plt.figure(figsize=(12, 5.4), layout="constrained")
    axes: Any = figure.add_subplot(1, 2, 1, projection="3d")
    x, y, z = points[valid].T
    axes.scatter(x, z, -y, c=shaded[valid], cmap="bone", vmin=0, vmax=1, s=1.5, linewidths=0)
    axes.set_aspect("equal")
    axes.set(xlabel="x / mm", ylabel="z / mm", zlabel="−y / mm")
    axes.view_init(elev=38, azim=-68)
    axes.set_title(title)
    flat = figure.add_subplot(1, 2, 2)
    values = points[..., 2] if errors_mm is None else 1000 * errors_mm
    words = "depth z / mm" if errors_mm is None else "distance from the true surface / µm"
    low, high = np.nanpercentile(values[valid], [2, 98]) if valid.any() else (0, 1)
    shown = flat.scatter(x, y, c=values[valid], s=1.5, linewidths=0, vmin=low, vmax=high, cmap="viridis")
    flat.set_aspect("equal")
    flat.invert_yaxis()
    flat.set(xlabel="x / mm", ylabel="y / mm", title=words)
    figure.colorbar(shown, ax=flat)
    with replacing(path) as file:
        figure.savefig(file, format="png", dpi=110)
    plt.close(figure)


def shade(
    points: Float[np.ndarray, "frames columns 3"], valid: Bool[np.ndarray, "frames columns"]
) -> Float[np.ndarray, "frames columns"]:
    """Brightness from 0 to 1 of each point under a light: the normal is that of its neighbours in frame and column."""
    known = np.where(valid[..., None], points, np.nan).astype(np.float64)
    along, across = (np.gradient(known, axis=axis) for axis in (0, 1))
    normal = np.cross(along, across)
    length = np.linalg.norm(normal, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        lit = np.abs(normal @ _LIGHT) / length
    return np.nan_to_num(0.15 + 0.85 * lit, nan=0.5)


def _matplotlib() -> Any:
    try:
        import matplotlib
    except ImportError as error:
        raise InputError('pictures need matplotlib: pip install "jaxscan[plots]"') from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
