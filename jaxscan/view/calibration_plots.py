"""The figures of a calibration's report: each function draws one, from the diagnostics alone."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxscan.calibration import Calibration, Observations
from jaxscan.calibration.diagnostics import (
    Diagnostics,
    Ladder,
    Normality,
    PhotographStatistics,
    StageErrors,
    TurntableErrors,
)
from jaxscan.calibration.diagnostics.halves import Agreement
from jaxscan.calibration.diagnostics.stripe_shapes import StripeShape
from jaxscan.calibration.next_pose import NextPose
from jaxscan.calibration.on_board import pose_of
from jaxscan.reconstruction.point_sigma import rig_part
from jaxscan.reconstruction.working_volume import WorkingVolume
from jaxscan.rig import Light
from jaxscan.rig.light import section, sheet_axes
from jaxscan.view.matplotlib_setup import pyplot

BLUE, RED, PINK, GREY, LIGHT = "#1f5a94", "#c0392b", "#e8a9a2", "#666666", "#b9c9da"
_WIDTH = 7.5
# In one picture.
MOST_PHOTOGRAPHS = 30
_MOST_STRIPES = 24
# A mean is clear of noise beyond this number of standard errors.
_CLEAR = 3.0
# A cell has a mean with this number of corners or more.
_FEWEST_IN_CELL = 10
_MOST_ARROWS = 4000


def photographs(each: Sequence[PhotographStatistics]) -> Any:
    """RMS of each photograph, the worst first."""
    shown = each[:MOST_PHOTOGRAPHS]
    figure, axes = _figure(0.9 + 0.19 * len(shown))
    y = np.arange(len(shown))
    corner = np.array([p.corner_rms_px for p in shown])
    stripe = np.array([p.stripe_rms_px if p.stripe_rms_px is not None else np.nan for p in shown])
    axes.barh(y - 0.2, corner, 0.38, color=[LIGHT if p.staged else BLUE for p in shown], label="corners")
    if np.isfinite(stripe).any():
        axes.barh(y + 0.2, stripe, 0.38, color=RED, label="stripe")
        axes.legend(loc="lower right", fontsize=8)
    for i, p in enumerate(shown):
        if not np.isfinite(p.corner_rms_px):
            axes.text(0, i - 0.2, " no corner fits", va="center", fontsize=7, color=RED)
    axes.axvline(float(np.nanmedian([p.corner_rms_px for p in each])), color=BLUE, linewidth=0.8, linestyle="--")
    axes.set_yticks(y, [p.name for p in shown], fontsize=7)
    axes.invert_yaxis()
    axes.set(xlabel="RMS / px", ylim=(len(shown) - 0.4, -0.6))
    return figure


def residual_vectors(diagnostics: Diagnostics, image_size: tuple[int, int]) -> Any:
    """Every corner's residual, and the mean of each cell of the image."""
    figure, axes = _figure(_WIDTH * 0.8 * image_size[1] / image_size[0] + 0.6)
    corners, cells = diagnostics.corners, diagnostics.over_image
    thin = slice(None, None, 1 + len(corners.pixels) // _MOST_ARROWS)
    rms = float(np.sqrt((corners.errors**2).sum(axis=1).mean()))
    # An arrow of the RMS is a fiftieth of the image wide.
    scale = rms / (image_size[0] / 50)
    common: dict[str, Any] = {"angles": "xy", "scale_units": "xy"}
    x, e = corners.pixels[thin], corners.errors[thin]
    arrows = axes.quiver(*x.T, *e.T, scale=scale, color=LIGHT, width=0.0015, **common)
    axes.quiverkey(arrows, 0.08, 0.04, rms, f"one corner, {rms:.2g} px", labelpos="E", fontproperties={"size": 8})
    rows, columns = cells.count.shape
    u = (np.arange(columns) + 0.5) * image_size[0] / columns
    v = (np.arange(rows) + 0.5) * image_size[1] / rows
    mean = cells.mean_px
    clear = np.nanmax(np.abs(mean) / cells.error_px, axis=-1, initial=0.0, where=np.isfinite(mean)) > _CLEAR
    # Of a few corners a standard error is chance itself.
    clear &= cells.count >= _FEWEST_IN_CELL
    common |= {"scale": scale / 4, "width": 0.005}
    for shown, colour in ((~clear, PINK), (clear, RED)):
        each = np.where(shown[..., None], mean, np.nan)
        means = axes.quiver(*np.meshgrid(u, v), each[..., 0], each[..., 1], color=colour, **common)
    axes.quiverkey(
        means, 0.55, 0.04, rms / 4, f"mean of a cell, {rms / 4:.2g} px", labelpos="E", fontproperties={"size": 8}
    )
    axes.set(xlim=(-0.5, image_size[0] - 0.5), ylim=(image_size[1] - 0.5, -0.5), aspect="equal", xlabel="u / px")
    axes.set_ylabel("v / px")
    return figure


def histograms(corners: Normality, stripe: Normality | None) -> Any:
    """Residuals in σ against the standard normal."""
    kinds = [("corner coordinates", corners, BLUE)] + ([("stripe points", stripe, RED)] if stripe else [])
    figure, all_axes = _figure(2.9, columns=len(kinds))
    z = np.linspace(-4.5, 4.5, 200)
    for axes, (name, normality, colour) in zip(np.atleast_1d(all_axes), kinds, strict=True):
        axes.stairs(normality.density, normality.edges, fill=True, color=colour, alpha=0.55)
        axes.plot(z, np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi), color="black", linewidth=1, label="normal")
        axes.set(xlabel="residual / σ", title=f"{normality.count} {name}")
        axes.legend(fontsize=8)
    return figure


def radius(diagnostics: Diagnostics) -> Any:
    """Corner residuals against the distance from the principal point."""
    figure, axes = _figure(2.8)
    by = diagnostics.by_radius
    axes.axhline(0, color=GREY, linewidth=0.7)
    axes.errorbar(
        by.radius_px,
        by.radial_px,
        2 * by.radial_error_px,
        color=BLUE,
        marker="o",
        markersize=4,
        capsize=3,
        label="mean residual outwards, ± 2 standard errors",
    )
    axes.plot(by.radius_px, by.rms_px, color=GREY, marker=".", linestyle=":", label="RMS distance")
    axes.set(xlabel="distance from the principal point / px", ylabel="px")
    axes.legend(fontsize=8)
    return figure


def stripes(shapes: Sequence[StripeShape]) -> Any:
    """Distance of each stripe from the light plane, along the stripe: small pictures of one scale."""
    shown = shapes[:_MOST_STRIPES]
    columns = 4
    rows = -(-len(shown) // columns)
    figure, grid = pyplot().subplots(
        rows, columns, figsize=(_WIDTH, 0.8 + 1.25 * rows), layout="constrained", sharey=True, squeeze=False
    )
    reach = 1.1 * float(np.max([np.percentile(np.abs(s.distance_mm), 99) for s in shown]))
    for axes, stripe in zip(grid.ravel(), shown, strict=False):
        axes.axhline(0, color=GREY, linewidth=0.6)
        axes.plot(stripe.along_px, stripe.distance_mm, ".", markersize=1.5, color=LIGHT)
        axes.plot(stripe.along_px, stripe.smooth_mm, color=RED, linewidth=1.3)
        axes.set_title(f"{stripe.name} {stripe.laser}".strip(), fontsize=7, pad=2)
        axes.tick_params(labelsize=6)
        axes.set_ylim(-reach, reach)
    for axes in grid.ravel()[len(shown) :]:
        axes.axis("off")
    figure.supxlabel("along the stripe / px", fontsize=8)
    figure.supylabel("off the light plane / mm", fontsize=8)
    return figure


def stage(each: Sequence[StageErrors]) -> Any:
    """Step error and straightness against the travel."""
    lines = [(s.names, s.travel_mm, s.error_mm, s.sigma_mm) for s in each]
    return _motion(lines, ("step error / mm", "off the line / mm", "travel / mm"))


def turntable(each: Sequence[TurntableErrors]) -> Any:
    """Error of the angle and tilt of the axis against the turn."""
    lines = [(t.names, t.turn_deg, t.turn_error_deg, t.turn_sigma_deg) for t in each]
    return _motion(lines, ("error of the angle / °", "tilt of the axis / °", "turn / °"))


def _motion(
    lines: Sequence[tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]], labels: tuple[str, str, str]
) -> Any:
    """Errors along a motion, and in the two directions across it, each of them with its σ.

    Args:
        lines: of each sequence, names, how far it has come, errors (images, 3) and their σ.
        labels: of the errors along and across, and of the way.
    """
    plt = pyplot()
    figure, (along, across) = plt.subplots(2, 1, figsize=(_WIDTH, 4.4), layout="constrained", sharex=True)
    for names, x, e, sigma in lines:
        style: dict[str, Any] = {"capsize": 2, "markersize": 3.5, "linewidth": 1, "elinewidth": 0.7}
        along.errorbar(x, e[:, 0], sigma[:, 0], marker="o", label=f"{names[0]} … {names[-1]}", color=BLUE, **style)
        across.errorbar(x, e[:, 2], sigma[:, 2], marker="s", label="towards the camera or away", color=LIGHT, **style)
        across.errorbar(x, e[:, 1], sigma[:, 1], marker="o", label="sideways", color=RED, **style)
    for axes in (along, across):
        axes.axhline(0, color=GREY, linewidth=0.7)
        axes.legend(fontsize=7)
    along.set(ylabel=labels[0])
    across.set(ylabel=labels[1], xlabel=labels[2])
    return figure


def coverage(diagnostics: Diagnostics) -> Any:
    """Where in the image corners were, how the boards were tilted, and how far away they and the stripes were."""
    plt = pyplot()
    cover = diagnostics.coverage
    figure = plt.figure(figsize=(_WIDTH, 2.9), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=[1.35, 1, 0.9])
    counts = np.where(cover.corners_in_cells > 0, cover.corners_in_cells, np.nan)
    left.imshow(counts, cmap="Blues", vmin=0)
    for row, column in np.ndindex(*cover.corners_in_cells.shape):
        n = int(cover.corners_in_cells[row, column])
        dark = n > 0.6 * cover.corners_in_cells.max()
        left.text(
            column, row, n, ha="center", va="center", fontsize=7, color="white" if dark else RED if n == 0 else "black"
        )
    left.set(xticks=[], yticks=[], title="corners in the image")
    tilt = cover.tilts_deg[:, None] * cover.normals[:, :2]
    tilt /= np.maximum(np.linalg.norm(cover.normals[:, :2], axis=1, keepdims=True), 1e-12)
    for ring in (15, 30, 45):
        middle.add_patch(plt.Circle((0, 0), ring, fill=False, color=LIGHT, linewidth=0.8))
        middle.text(0, -ring, f"{ring}°", fontsize=6, color=GREY, ha="center", va="bottom")
    middle.plot(*tilt.T, "o", color=BLUE, markersize=4)
    reach = max(48.0, 1.05 * float(cover.tilts_deg.max()))
    middle.set(
        aspect="equal", xlim=(-reach, reach), ylim=(reach, -reach), title="tilts of the boards", xticks=[], yticks=[]
    )
    right.plot(np.zeros(len(cover.distances_mm)), cover.distances_mm, "o", color=BLUE, markersize=4, alpha=0.7)
    labels = ["boards"]
    for i, stripe in enumerate(cover.stripes, start=1):
        right.plot([i, i], stripe.depths_mm, color=RED, linewidth=5, solid_capstyle="butt")
        labels.append(f"stripes {stripe.laser}".strip())
    right.set_xticks(range(len(labels)), labels, fontsize=8)
    right.set(title="distance / mm", xlim=(-0.6, len(labels) - 0.4))
    right.tick_params(axis="y", labelsize=7)
    return figure


def volume(each: WorkingVolume) -> Any:
    """Predicted σ over the sheet, and its two parts against the depth."""
    figure, (left, right) = pyplot().subplots(1, 2, figsize=(_WIDTH, 3.2), layout="constrained", width_ratios=[1.5, 1])
    unit, per_mm = ("µm", 1000.0) if each.worst_mm < 1 else ("mm", 1.0)
    sigma, pixel = per_mm * each.sigma_mm, per_mm * each.pixel_mm
    shown = left.pcolormesh(each.positions_mm, each.depths_mm, sigma, cmap="viridis", shading="nearest")
    lines = left.contour(each.positions_mm, each.depths_mm, sigma, levels=6, colors="white", linewidths=0.6)
    left.clabel(lines, fontsize=6, fmt="%.3g")
    figure.colorbar(shown, ax=left, label=f"σ of a point / {unit}")
    left.set(xlabel="along the sheet / mm", ylabel="depth / mm")
    left.invert_yaxis()
    rig = rig_part(sigma, pixel)
    for values, name, colour in ((sigma, "together", "black"), (rig, "rig", BLUE), (pixel, "pixel", RED)):
        right.plot(np.nanmedian(values, axis=1), each.depths_mm, color=colour, label=name)
    right.set(xlabel=f"median σ / {unit}", ylabel="depth / mm", xlim=(0, None))
    right.invert_yaxis()
    right.legend(fontsize=8)
    return figure


def next_best_views(poses: Sequence[NextPose], observations: Observations) -> Any:
    """Outlines of the boards to photograph, numbered, over those that there are, in the frame of the image."""
    columns, rows = observations.image_size
    figure, axes = _figure(_WIDTH * 0.8 * rows / columns + 0.6)
    across, down = observations.board.counts
    outermost = [0, across - 1, across * down - 1, across * (down - 1), 0]
    for view in observations.views:
        axes.plot(*view.corners[outermost].T, color=LIGHT, linewidth=0.8)
    for i, pose in enumerate(poses, start=1):
        colour = f"C{i % 10}"
        axes.fill(*pose.outline_px.T, facecolor=colour, edgecolor=colour, alpha=0.15)
        axes.plot(*pose.outline_px[[0, 1, 2, 3, 0]].T, color=colour, linewidth=2)
        axes.text(*pose.outline_px.mean(axis=0), str(i), color=colour, fontsize=18, ha="center", va="bottom")
        for stripe in pose.stripes_px:
            axes.plot(*stripe.T, color=colour, linestyle=":", linewidth=1.5)
        what = f"\n{pose.distance_mm:.0f} mm\n{np.linalg.norm(pose.tilt_deg):.0f}°"
        axes.text(*pose.outline_px.mean(axis=0), what, color=colour, fontsize=7, ha="center", va="top")
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5), aspect="equal", xlabel="u / px", ylabel="v / px")
    return figure


def agreement(each: Agreement) -> Any:
    """Differences of two parts' rigs in units of their predicted σ."""
    figure, axes = _figure(0.9 + 0.2 * len(each.names))
    y = np.arange(len(each.names))
    axes.axvspan(-2, 2, color="#eef3f8")
    axes.barh(y, each.differences_in_sigma, 0.6, color=[RED if abs(d) > 3 else BLUE for d in each.differences_in_sigma])
    axes.axvline(0, color=GREY, linewidth=0.7)
    axes.set_yticks(y, each.names, fontsize=7)
    axes.invert_yaxis()
    reach = max(3.5, 1.1 * float(np.abs(each.differences_in_sigma).max()))
    axes.set(xlim=(-reach, reach), xlabel=f"{each.parts[1]} minus {each.parts[0]}, in σ of the difference")
    return figure


def ladder(tried: Ladder) -> Any:
    """RMS of the fit and of held-out views for each lens."""
    from matplotlib.ticker import LogLocator, NullFormatter

    figure, axes = _figure(2.7)
    x = np.arange(len(tried.rungs))
    axes.plot(x, [r.rms_px for r in tried.rungs], color=LIGHT, marker="o", label="views that were fitted")
    axes.plot(x, [r.held_out_px for r in tried.rungs], color=BLUE, marker="s", label="views that were held out")
    labels = [f"{r.lens}\n{'supported' if r.supported else 'not supported'}" for r in tried.rungs]
    axes.set_xticks(x, labels, fontsize=8)
    at = [r.lens for r in tried.rungs].index(tried.chosen)
    axes.axvline(at, color=RED, linewidth=0.8, linestyle="--", label="the lens of this calibration")
    axes.set(ylabel="RMS / px", yscale="log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.3g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis="y", labelsize=7)
    axes.legend(fontsize=8)
    return figure


def scene(calibration: Calibration, diagnostics: Diagnostics, points_in_space: Sequence[np.ndarray]) -> Any:
    """Boards, stripes, light planes, stage and camera in space.

    Args:
        calibration: the rig and its boards.
        diagnostics: for the depths that the stripes span.
        points_in_space: of each laser, its stripe points in the camera frame, mm.
    """
    plt = pyplot()
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    figure = plt.figure(figsize=(_WIDTH, 5.2), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    points = calibration.observations.board.points()
    outline = _outline(points)

    # The page's axes: the camera looks away from the reader, its y points down.
    def place(X: np.ndarray) -> np.ndarray:
        return np.stack([X[..., 0], X[..., 2], -X[..., 1]], axis=-1)

    drawn, named = [np.zeros((1, 3))], {}

    def board(rotation: Any, translation: Any, colour: str, alpha: float) -> None:
        import cv2

        R = cv2.Rodrigues(np.asarray(rotation, np.float64))[0]
        X = place(outline @ R.T + np.asarray(translation))
        drawn.append(X)
        axes.add_collection3d(Poly3DCollection([X], facecolor=colour, edgecolor=colour, alpha=alpha, linewidth=0.8))
        named["boards" if colour == BLUE else "boards moved by motor"] = Patch(facecolor=colour, alpha=0.5)

    boards, rig = calibration.system.boards, calibration.rig
    for rotation, translation in zip(boards.rotation, boards.translation, strict=True):
        board(rotation, translation, BLUE, 0.12)
    places, at = calibration.photograph_poses(), len(calibration.observations.views)
    for sequence in calibration.observations.sequences:
        moved = [pose_of(places, i) for i in range(at, at + len(sequence.views))]
        at += len(sequence.views)
        for pose in (moved[0], moved[-1]):
            board(pose.rotation, pose.translation, "#2e8b57", 0.12)
        middles = place(np.stack([np.asarray(pose.translation) + _middle(points, pose.rotation) for pose in moved]))
        (named["their way"],) = axes.plot(*middles.T, color="#2e8b57", linewidth=2, marker=".", markersize=3)
    for i, X in enumerate(points_in_space):
        if len(X):
            axes.plot(*place(X[:: 1 + len(X) // 3000]).T, ".", color=RED, markersize=1)
            named["stripes"] = Line2D([], [], color=RED, marker=".", linestyle="")
            sheet = place(_sheet(rig.lights[i], X))
            drawn.append(sheet)
            axes.add_collection3d(Poly3DCollection([sheet], facecolor=RED, edgecolor=RED, alpha=0.12, linewidth=0.8))
            named["light plane"] = Patch(facecolor=RED, alpha=0.2)
    distances = diagnostics.coverage.distances_mm
    if not len(distances):
        distances = np.linalg.norm(np.asarray(places.translation), axis=1)
    (named["camera"],) = axes.plot(
        *place(_frustum(calibration) * 0.2 * float(np.median(distances))).T,
        color="black",
        linewidth=1,
    )
    everything = np.concatenate(drawn)
    low, high = everything.min(axis=0), everything.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.25)
    axes.set(xlabel="x / mm", ylabel="z / mm", zlabel="−y / mm")
    axes.tick_params(labelsize=7)
    axes.view_init(elev=22, azim=-62)
    axes.legend(named.values(), named.keys(), fontsize=8, loc="upper left")
    return figure


def _figure(height: float, columns: int = 1) -> Any:
    return pyplot().subplots(1, columns, figsize=(_WIDTH, height), layout="constrained")


def _outline(points: np.ndarray) -> np.ndarray:
    (x0, y0), (x1, y1) = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    return np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]], float)


def _middle(points: np.ndarray, rotation: Any) -> np.ndarray:
    import cv2

    return cv2.Rodrigues(np.asarray(rotation, np.float64))[0] @ points.mean(axis=0)


def _sheet(light: Light, X: np.ndarray) -> np.ndarray:
    """A part of the sheet that holds all stripe points, its outline in turn."""
    a = X @ sheet_axes(light)[0]
    corners = section(light, np.array([X[:, 2].min(), X[:, 2].max()]), np.array([a.min(), a.max()]))
    return corners.reshape(-1, 3)[[0, 1, 3, 2]]


def _frustum(calibration: Calibration) -> np.ndarray:
    """The camera as a line that runs round its field of view at unit depth, and to its centre."""
    camera = calibration.rig.camera
    columns, rows = camera.image_size
    f, c = np.stack(camera.focal), np.stack(camera.principal)
    corner = [np.append((np.array(p) - c) / f, 1.0) for p in ((0, 0), (columns, 0), (columns, rows), (0, rows))]
    o = np.zeros(3)
    path = [o, corner[0], corner[1], o, corner[2], corner[3], o, corner[0], corner[3], corner[2], corner[1]]
    return np.stack(path)
