"""A click on what the viewer shows: where it meets the surface, and the region around it as part.toml has it."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int

from jaxscan.view.view_data import ViewData

# A point of a cloud is hit where the ray passes it by less than this many spacings.
_NEAR: Final = 1.5
_SPHERE: Final = (230, 120, 20)
# The first radius of a region, in parts of the size of what is shown.
_RADIUS: Final = 0.05


def hit(
    points: Float[np.ndarray, "points 3"],
    triangles: Int[np.ndarray, "triangles 3"] | None,
    origin: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
    spacing: float,
) -> Float[np.ndarray, "3"] | None:
    """Where a ray first meets a mesh, or the first point of a cloud beside which it passes; None where it meets none.

    Args:
        points: mm.
        triangles: of a mesh; None for a cloud.
        origin: of the ray, in the frame of the points.
        direction: of the ray; any length.
        spacing: of a cloud's points, mm.

    A triangle is met as T. Möller and B. Trumbore have it (Journal of Graphics Tools 2, 1997), from either side.
    """
    direction = direction / np.linalg.norm(direction)
    if triangles is None:
        along = (points - origin) @ direction
        beside = np.linalg.norm(points - origin - along[:, None] * direction, axis=1)
        near = np.flatnonzero((along > 0) & (beside < _NEAR * spacing))
        return points[near[along[near].argmin()]] if len(near) else None
    a, b, c = (points[triangles[:, k]] for k in range(3))
    p = np.cross(direction, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        over = 1.0 / np.einsum("tc,tc->t", b - a, p)
        u = np.einsum("tc,tc->t", origin - a, p) * over
        q = np.cross(origin - a, b - a)
        v = q @ direction * over
        along = np.einsum("tc,tc->t", c - a, q) * over
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0)
    return origin + along[met].min() * direction if met.any() else None


def region_lines(place: Float[np.ndarray, "3"], radius: float) -> tuple[str, str]:
    """A ball and a box around a place, as lines of a `[[feature]]` of part.toml, mm."""
    x, y, z = (f"{c:.2f}" for c in place)
    low, high = (f"[{', '.join(f'{c:.2f}' for c in place + sign * radius)}]" for sign in (-1, 1))
    return f"ball = [{x}, {y}, {z}, {radius:.2f}]", f"box = [{low}, {high}]"


class Picker:
    """The part of the viewer's panel that shows what was clicked.

    Args:
        server: viser's.
        shown: what it shows.
        middle: the place of the object frame that stands in the scene's origin, mm.
        size: of what is shown, mm.
        clicked: is told each place, and the radius of the region around it, mm.
    """

    def __init__(
        self,
        server: Any,
        shown: ViewData,
        middle: Float[np.ndarray, "3"],
        size: float,
        clicked: Callable[[Float[np.ndarray, "3"], float], None],
    ) -> None:
        self._told = clicked
        self._points, self._triangles = shown.points.astype(np.float64), shown.triangles
        self._scene, self._middle, self._spacing = server.scene, middle, size / np.sqrt(len(shown.points))
        self._place: np.ndarray | None = None
        with server.gui.add_folder("a place on the surface"):
            self._words = server.gui.add_markdown("Click the surface: its coordinates stand here.")
            first = float(f"{max(_RADIUS * size, 1e-3):.1g}")
            self._radius = server.gui.add_number("radius, mm", first, min=first / 1000, step=first / 10, visible=False)
            self._lines = [
                server.gui.add_text(kind, "", visible=False, hint=f"the {kind} around it, for part.toml: copy it")
                for kind in ("ball", "box")
            ]
        server.scene.on_click()(self._clicked)
        self._radius.on_update(self._show)

    def _clicked(self, event: Any) -> None:
        origin = np.asarray(event.ray_origin, np.float64) + self._middle
        direction = np.asarray(event.ray_direction, np.float64)
        place = hit(self._points, self._triangles, origin, direction, self._spacing)
        if place is not None:
            self._place = place
            self._show()
            self._told(place, float(self._radius.value))

    def _show(self, _: Any = None) -> None:
        if self._place is None:
            return
        radius = float(self._radius.value)
        inside = int((np.linalg.norm(self._points - self._place, axis=1) <= radius).sum())
        x, y, z = (f"{c:.2f}" for c in self._place)
        what = "points" if self._triangles is None else "vertices"
        self._words.content = f"x, y, z = {x}, {y}, {z} mm; {inside} {what} within the radius"
        for field, line in zip(self._lines, region_lines(self._place, radius), strict=True):
            field.value, field.visible = line, True
        self._radius.visible = True
        self._scene.add_icosphere(
            "/picked", radius, _SPHERE, opacity=0.4, position=self._place - self._middle, cast_shadow=False
        )
