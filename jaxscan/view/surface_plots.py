"""Still pictures of range images, meshes and comparisons, by matplotlib (extra `plots`), drawn without a display."""

import os
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import KDTree

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.files.cloud import shown_colours
from jaxscan.reconstruction import RangeImage
from jaxscan.reconstruction.point_colours import least_depths, visible
from jaxscan.surface import views
from jaxscan.surface.clean import RULES
from jaxscan.surface.colours import sequential
from jaxscan.surface.compare import Comparison
from jaxscan.surface.floor import Floor, find_floor
from jaxscan.surface.links import sampling
from jaxscan.view.matplotlib_setup import pyplot
from jaxscan.view.mesh_picture import AZIMUTH, brightened, look, shaded_panel
from jaxscan.view.view_data import PHOTOGRAPH, UNITS, ViewData
from jaxscan.view.viewer import limits, painted

# Values beyond these percentiles are shown in the colours of the ends.
_SHOWN: Final = (1.0, 99.0)
# Of what stayed, and of what each rule took.
_REMOVED: Final = ("0.85", "tab:red", "tab:orange", "tab:blue")
# Of a mesh without colours.
_CLAY: Final = (240.0, 228.0, 204.0)
_MOST_POINTS: Final = 100_000
# The neighbour whose distance stands for that of lines of points; how many of these a hidden point is behind.
_NEIGHBOUR, _BEHIND = 8, 3.0
# Cells along the longer side of a panel.
_MOST_CELLS: Final = 2000
# A panel's side, and the least and greatest size of a point, in 1/72 inch (squared).
_PANEL_POINTS, _SIZES = 400.0, (1.0, 30.0)
# From here on distances are millimetres.
_MICROMETRES: Final = 1000.0


def draw_range(
    path: str | os.PathLike[str],
    image: RangeImage,
    floor: Floor | None = None,
    removed: UInt8[np.ndarray, "frames columns"] | None = None,
) -> None:
    """A range image in its views: shaded, height over the floor, depth, strength, σ, and what cleaning took.

    Args:
        path: the PNG to write.
        image: before anything was taken from it.
        floor: as it was found; by default it is looked for, and the height is left out where there is none.
        removed: as `Cleaned` has it.

    Raises:
        InputError: matplotlib is not installed, there is no surface, or the file cannot be written.
    """
    plt = pyplot()
    from matplotlib.colors import ListedColormap

    how = sampling(image)
    panels: list[tuple[str, Any, str]] = [("shaded", views.shaded(image), "")]
    if floor is None:
        try:
            floor = find_floor(image)
        except InputError:
            floor = None
    if floor is not None:
        panels.append(("height over the floor", views.height(image, floor), "mm"))
    panels.append(("depth", views.depth(image), "mm"))
    # Profiles of other programs have none.
    if (image.strength[image.valid] > 0).any():
        panels.append(("strength", views.strength(image), "grey levels"))
    if np.isfinite(image.sigma[image.valid]).any():
        panels.append(("σ along the ray", 1000 * views.sigma(image), "µm"))
    if removed is not None:
        panels.append(("removed", np.where(image.valid, removed, np.nan), ""))
    rows = -(-len(panels) // 2)
    frames, columns = (np.flatnonzero(image.valid.any(axis=axis)) for axis in (1, 0))
    tall = how.along_mm * np.ptp(frames) / max(how.across_mm * np.ptp(columns), how.across_mm)
    size = (14, rows * (1.0 + np.clip(5.2 * tall, 1.2, 6.0)))
    figure, axes = plt.subplots(rows, 2, figsize=size, layout="constrained", squeeze=False)
    for ax in axes.flat[len(panels) :]:
        ax.axis("off")
    for ax, (title, values, unit) in zip(axes.flat, panels, strict=False):
        known = values[np.isfinite(values)]
        look: dict[str, Any] = {"cmap": "viridis"}
        if len(known):
            look |= dict(zip(("vmin", "vmax"), np.percentile(known, _SHOWN), strict=True))
        if title == "shaded":
            look = {"cmap": "gray", "vmin": 0.0, "vmax": 1.0}
        if title == "removed":
            look = {"cmap": ListedColormap(_REMOVED), "vmin": -0.5, "vmax": len(RULES) + 0.5}
        shown = ax.imshow(values, aspect=how.along_mm / how.across_mm, interpolation="nearest", **look)
        ax.set(title=title, xlabel="column (or row)", ylabel="frame")
        ax.set(xlim=(columns[0] - 0.5, columns[-1] + 0.5), ylim=(frames[-1] + 0.5, frames[0] - 0.5))
        if title == "removed":
            bar = figure.colorbar(shown, ax=ax, shrink=0.8, ticks=range(len(RULES) + 1))
            bar.ax.set_yticklabels(["kept", *RULES])
        elif title != "shaded":
            figure.colorbar(shown, ax=ax, label=unit, shrink=0.8)
    save_figure(plt, figure, path)


def draw_mesh(
    path: str | os.PathLike[str],
    vertices: Float[np.ndarray, "vertices 3"],
    triangles: Int[np.ndarray, "triangles 3"],
    up: Float[np.ndarray, "3"],
    title: str,
    height: Float[np.ndarray, "vertices"] | None = None,
    colours: UInt8[np.ndarray, "vertices 3"] | None = None,
) -> None:
    """A mesh from two sides, shaded, its nearer triangles over the farther ones.

    Args:
        path: the PNG to write.
        vertices: object frame, mm.
        triangles: three vertices each, anticlockwise from outside.
        up: the direction that is up in the picture.
        title: over the picture.
        height: of each vertex above the floor, mm: what it is coloured by where it is known.
        colours: of each vertex otherwise, 0, 0, 0 for one without; clay if None.

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    plt = pyplot()
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    figure, axes = plt.subplots(1, 2, figsize=(15, 6.5), layout="constrained")
    paint: Any = np.full((len(vertices), 3), _CLAY)
    if colours is not None:
        paint = brightened(shown_colours(colours).astype(np.float64))
    known = np.zeros(0, bool) if height is None else np.isfinite(height)
    if height is not None and known.any():
        scale = ScalarMappable(Normalize(*np.percentile(height[known], _SHOWN)), "viridis")
        paint[known] = 255 * scale.to_rgba(height[known])[:, :3]
        figure.colorbar(scale, ax=axes, label="height over the floor, mm", shrink=0.8)
    middle = vertices[triangles].reshape(-1, 3).mean(axis=0)
    for ax, turn in zip(axes, (AZIMUTH, AZIMUTH + np.pi), strict=True):
        shaded_panel(ax, vertices - middle, triangles, paint, look(up, turn))
    figure.suptitle(title)
    save_figure(plt, figure, path)


def draw_view_data(path: str | os.PathLike[str], shown: ViewData, colour: str, title: str) -> None:
    """What the viewer shows, from two sides, and where the scanner stood, as it is known; a mesh is shaded.

    Args:
        path: the PNG to write.
        shown: points or a mesh.
        colour: which of its values colours it.
        title: over the picture.

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    plt = pyplot()
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    panels = 2 if shown.setup is None else 3
    figure, axes = plt.subplots(1, panels, figsize=(7.5 * panels, 6.5), layout="constrained")
    points = shown.points.astype(np.float64)
    middle = points.mean(axis=0) if shown.triangles is None else points[shown.triangles].reshape(-1, 3).mean(axis=0)
    paint: Any = painted(shown, colour).astype(np.float64)
    if colour == PHOTOGRAPH:
        paint = brightened(paint if shown.texture is None else shown.texture)
    turns = (AZIMUTH, AZIMUTH + np.pi, AZIMUTH + np.pi / 2)
    for ax, turn, side in zip(axes, turns, ("from one side", "from the other side", "with the scanner"), strict=False):
        directions = look(shown.up, turn)
        ax.set(title=side)
        if shown.triangles is None:
            _scattered(ax, points - middle, paint, directions, None if ax is not axes[-1] or panels == 2 else 0.3)
        else:
            shaded_panel(ax, points - middle, shown.triangles, paint, directions)
        if shown.setup is not None and ax is axes[-1]:
            view = np.stack(directions[:2], axis=1)
            travel, sheet = ((place - middle) @ view for place in (shown.setup.at.translation, shown.setup.sheet))
            ax.fill(*sheet.T, color="tab:red", alpha=0.25, label="light plane at the first frame")
            ax.plot(*travel.T, ".-", color="tab:blue", label="camera, from the first frame to the last")
            ax.autoscale(tight=False)
            ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08))
    if colour != PHOTOGRAPH:
        ramp = ListedColormap(sequential(np.linspace(0.0, 1.0, 256)) / 255.0)
        scale = ScalarMappable(Normalize(*limits(shown.values[colour])), ramp)
        figure.colorbar(scale, ax=axes[-1], label=f"{colour}, {UNITS[colour]}", shrink=0.8)
    figure.suptitle(title)
    save_figure(plt, figure, path)


def _scattered(
    ax: Any,
    points: Float[np.ndarray, "points 3"],
    paint: Float[np.ndarray, "points 3"],
    directions: tuple[Float[np.ndarray, "3"], ...],
    size: float | None,
) -> None:
    """Draw points, without those that others hide; of very many every Nth.

    `size` is that of a point, in matplotlib's unit; None for as large as they are apart.
    """
    across, above, toward = directions
    every = max(1, len(points) // _MOST_POINTS)
    seen, paint = points[::every], paint[::every]
    flat, depth = np.stack([seen @ across, seen @ above], axis=-1), -seen @ toward
    # A neighbour's distance: a point in a cell of some of these is hidden by one that is nearer by as much.
    apart = float(np.median(KDTree(seen).query(seen[:: max(1, len(seen) // 2000)], k=_NEIGHBOUR + 1)[0][:, -1]))
    wide = max(float(np.ptp(flat, axis=0).max()), 1e-9)
    # One stray point far away must not make a grid that no memory holds.
    cell = max(apart, wide / _MOST_CELLS)
    pixels = (flat - flat.min(axis=0)) / cell
    nearest = least_depths(pixels, depth, tuple((np.ceil(pixels.max(axis=0)).astype(int) + 1)[::-1]))
    shown = np.flatnonzero(visible(nearest, pixels, depth, _BEHIND * cell))
    order = shown[np.argsort(-depth[shown])]
    ax.set(aspect="equal", xlabel="mm", ylabel="mm")
    if size is None:
        size = float(np.clip((_PANEL_POINTS * cell / wide) ** 2, *_SIZES))
    ax.scatter(*flat[order].T, c=paint[order] / 255.0, s=size, linewidths=0)


def draw_comparison(path: str | os.PathLike[str], comparison: Comparison, title: str) -> None:
    """Signed distances as colours from two sides, and how they are spread.

    Raises:
        InputError: matplotlib is not installed, or the file cannot be written.
    """
    plt = pyplot()
    known = np.isfinite(comparison.distance)
    points, off = comparison.points[known], 1000 * comparison.distance[known]
    limit, unit = max(float(np.percentile(np.abs(off), 98)), 1e-9), "µm"
    if limit > _MICROMETRES:
        off, limit, unit = off / 1000, limit / 1000, "mm"
    size = float(np.clip(_PANEL_POINTS**2 / max(len(points), 1) / 4, *_SIZES))
    figure, (front, side, right) = plt.subplots(
        1, 3, figsize=(17, 5), layout="constrained", width_ratios=[1.2, 1.2, 0.8]
    )
    shown = None
    for ax, axis, label in ((front, 1, "y / mm"), (side, 2, "z / mm")):
        shown = ax.scatter(
            points[:, 0],
            points[:, axis],
            c=off,
            s=size,
            linewidths=0,
            cmap="coolwarm",
            vmin=-limit,
            vmax=limit,
        )
        # Points without an error are pale.
        ax.set(xlabel="x / mm", ylabel=label, aspect="equal", facecolor="0.25")
        ax.invert_yaxis()
    figure.colorbar(shown, ax=side, label=f"in front (+) or behind (−), {unit}", shrink=0.8)
    right.hist(np.clip(off, -1.5 * limit, 1.5 * limit), bins=80, color="0.4")
    right.set(xlabel=f"signed distance / {unit}", ylabel="points")
    right.locator_params(axis="x", nbins=5)
    figure.suptitle(title)
    save_figure(plt, figure, path)


def save_figure(plt: Any, figure: Any, path: str | os.PathLike[str]) -> None:
    """A matplotlib figure as a PNG, whole or not at all; it is closed."""
    with replacing(path) as file:
        figure.savefig(file, format="png", dpi=90)
    plt.close(figure)
