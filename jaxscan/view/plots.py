"""Still pictures, by matplotlib (extra `plots`), drawn without a display."""

import os
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxscan.atomic import replacing
from jaxscan.view.matplotlib_setup import pyplot

# From where the profiles are looked at: so far above the plane that most points lie in.
_ELEVATION = np.radians(38.0)


def draw_scan(
    path: str | os.PathLike[str],
    photograph: UInt8[np.ndarray, "rows columns 3"],
    points: Float[np.ndarray, "frames columns 3"],
    valid: Bool[np.ndarray, "frames columns"],
    errors_mm: Float[np.ndarray, "frames columns"],
    title: str,
) -> None:
    """A scan in three pictures: a photograph, the profiles seen from the side, and each point's error from above.

    Args:
        path: the PNG to write.
        photograph: one frame, with what was detected drawn over it.
        points: object frame, mm.
        valid: where there is a point.
        errors_mm: distance of each point from the truth.
        title: over the picture.

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    plt = pyplot()
    figure, (left, middle, right) = plt.subplots(
        1, 3, figsize=(17, 5), layout="constrained", width_ratios=[1, 1.2, 1.2]
    )
    left.imshow(photograph)
    left.set(title="a photograph, and the stripe found in it", xticks=[], yticks=[])
    _profiles(middle, points, valid)
    middle.set(title="all profiles, hidden lines removed", xticks=[], yticks=[])
    x, y, _ = points[valid].T
    micrometres = 1000 * errors_mm[valid]
    shown = right.scatter(
        x, y, c=micrometres, s=2.0, linewidths=0, vmin=0, vmax=np.percentile(micrometres, 98), cmap="viridis"
    )
    right.set(xlabel="x / mm", ylabel="y / mm", title="distance from the true surface", aspect="equal")
    right.invert_yaxis()
    figure.colorbar(shown, ax=right, label="µm", shrink=0.8)
    figure.suptitle(title)
    with replacing(path) as file:
        figure.savefig(file, format="png", dpi=100)
    plt.close(figure)


def _profiles(
    axes: Any, points: Float[np.ndarray, "frames columns 3"], valid: Bool[np.ndarray, "frames columns"]
) -> None:
    """Every frame's profile as a line coloured by its height, each hiding what is behind it."""
    from matplotlib.collections import LineCollection

    across, along, height = _side_view(points, valid)
    low, high = np.percentile(height[valid], [1, 99])
    up = np.sin(_ELEVATION) * along + np.cos(_ELEVATION) * (height - low)
    bottom = float(np.nanmin(up)) - 5.0
    for i in np.argsort(-np.nanmedian(np.where(valid, along, np.nan)[valid.any(axis=1)], axis=1)):
        row = np.flatnonzero(valid.any(axis=1))[i]
        x, y = across[row], np.where(valid[row], up[row], np.nan)
        axes.fill_between(x, y, bottom, color="white", linewidth=0, zorder=i * -2.0)
        ends = np.stack([np.stack([x[:-1], y[:-1]], axis=-1), np.stack([x[1:], y[1:]], axis=-1)], axis=1)
        keep = np.isfinite(ends).all(axis=(1, 2)) & (np.abs(np.diff(ends[:, :, 1], axis=1)[:, 0]) < 5.0)
        line = LineCollection(ends[keep].tolist(), cmap="viridis", linewidths=1.6, zorder=i * -2.0 + 1)
        line.set_array(height[row][:-1][keep])
        line.set_clim(low, high)
        axes.add_collection(line)
    axes.autoscale_view()
    axes.set_aspect("equal")


def _side_view(
    points: Float[np.ndarray, "frames columns 3"], valid: Bool[np.ndarray, "frames columns"]
) -> tuple[Float[np.ndarray, "frames columns"], ...]:
    """Coordinates across the view, away from the viewer, and above the plane that most points lie in (mm)."""
    cloud = points[valid].astype(np.float64)
    centre = np.median(cloud, axis=0)
    near, normal = cloud - centre, np.zeros(3)
    for _ in range(5):
        normal = np.linalg.svd(near, full_matrices=False)[2][2]
        distance = np.abs((cloud - centre) @ normal)
        near = (cloud - centre)[distance <= np.median(distance) + 1e-9]
        near = near - near.mean(axis=0)
    up = normal * -np.sign(normal[2])
    across = np.array([1.0, 0.0, 0.0]) - up[0] * up
    across /= np.linalg.norm(across)
    away = np.cross(across, -up)
    away *= -np.sign(away[1]) or 1.0
    moved = np.where(valid[..., None], points, np.nan) - centre
    return moved @ across, moved @ away, moved @ up
