"""What is shown in the browser (extra `viewer`): viser on this machine alone, coordinates in float32."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import trimesh
from jaxtyping import Float, Int, UInt8
from scipy.spatial.transform import Rotation

from jaxscan.extras import extra
from jaxscan.files.cloud import shown_colours
from jaxscan.files.srgb import light_of
from jaxscan.images.shaded import TextureMap
from jaxscan.measurement.scanned import Scanned
from jaxscan.surface.colours import sequential
from jaxscan.view.measuring import Measuring
from jaxscan.view.picked import Picker
from jaxscan.view.view_data import PHOTOGRAPH, UNITS, ViewData

HOST: Final = "127.0.0.1"
# Of the colours' range, percentiles.
_SHOWN: Final = (1.0, 99.0)
_GRID, _SCALE = (150, 150, 150), (30, 30, 30)
# Cells of the grid across what is shown, about.
_CELLS: Final = 12
# Colours of the bar, and what is written below it.
_STOPS, _MARKS = 9, 3
_CAMERA, _LIGHT, _TRAVEL = (60, 60, 60), (220, 40, 40), (40, 90, 200)


def serve(
    shown: ViewData, port: int, read: Callable[[], Scanned], colour: str | None = None, name: str = "part"
) -> Any:
    """Show what `view_data` read at http://127.0.0.1:port until the server that is returned is stopped.

    Args:
        shown: what to show.
        port: of this machine; if it is taken, the next one that is free.
        read: reads the surface again as what is measured, when a face is clicked first.
        colour: the values to colour by; others are chosen in the browser.
        name: of the part that is measured.

    Raises:
        InputError: viser is not installed, or the values are not known.
    """
    colour = shown.colour(colour)
    viser = extra("viewer")
    server = viser.ViserServer(host=HOST, port=port, label="jaxscan", verbose=False)
    points = shown.points.astype(np.float64)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    scene = server.scene
    scene.set_up_direction(shown.up)
    server.initial_camera.up = tuple(shown.up)
    server.initial_camera.look_at = (0.0, 0.0, 0.0)
    server.initial_camera.position = tuple(size * (0.6 * shown.up + 0.7 * aside_of(shown.up)))
    centred = (points - middle).astype(np.float32)

    def draw(name: str) -> None:
        colours = painted(shown, name)
        if name == PHOTOGRAPH and shown.texture is not None:
            scene.add_mesh_trimesh("/mesh", _textured(centred, shown.triangles, shown.texture))
        elif shown.triangles is None:
            spacing = size / np.sqrt(len(points))
            scene.add_point_cloud(
                "/points", centred, colours, point_size=0.6 * spacing, point_shape="circle", precision="float32"
            )
        else:
            # The browser is sent glTF, which stores amounts of light.
            light = np.rint(255 * light_of(colours)).astype(np.uint8)
            scene.add_mesh_trimesh(
                "/mesh", trimesh.Trimesh(centred, shown.triangles, vertex_colors=light, process=False)
            )

    cell = cell_mm(size)
    aside, up = aside_of(shown.up), np.asarray(shown.up, np.float64)
    below = float((centred @ up).min()) * up
    turned = Rotation.from_matrix(np.stack([aside, np.cross(up, aside), up], axis=1))
    across = 2 * cell * float(np.ceil(0.6 * size / cell))
    grid = scene.add_grid(
        "/grid",
        across,
        across,
        cell_size=cell,
        section_size=5 * cell,
        cell_color=_GRID,
        section_color=_GRID,
        section_thickness=1.5,
        fade_distance=100 * size,
        shadow_opacity=0.0,
        wxyz=turned.as_quat(scalar_first=True),
        position=below,
    )
    # The side of one cell, with its length beside it, on the side that is looked at first.
    near = cell * float(np.ceil(0.3 * size / cell))
    start, end = (below + turned.apply([near, y, 0.0]) for y in (-near, cell - near))
    bar = scene.add_line_segments("/scale", np.array([[start, end]], np.float32), _SCALE, thickness=0.008 * size)
    label = scene.add_label("/scale/length", f"{cell:g} mm", position=(start + end) / 2, anchor="top-center")
    with server.gui.add_folder("jaxscan"):
        words = server.gui.add_markdown(_words(shown, colour))
        choice = server.gui.add_dropdown("colour", shown.looks, initial_value=colour)
        legend = server.gui.add_html(colour_bar(shown, colour))
        ruled = server.gui.add_checkbox(f"grid, squares of {cell:g} mm", initial_value=True)

    Picker(server, shown, middle, size, Measuring(server, read, middle, size, name).clicked)

    @choice.on_update
    def _(_: Any) -> None:
        draw(choice.value)
        words.content = _words(shown, choice.value)
        legend.content = colour_bar(shown, choice.value)

    @ruled.on_update
    def _(_: Any) -> None:
        grid.visible = bar.visible = label.visible = ruled.value

    draw(colour)
    if shown.setup is not None:
        setup = shown.setup
        places = setup.at.translation - middle
        for name, i in (("first", 0), ("last", -1)):
            scene.add_camera_frustum(
                f"/scanner/{name}",
                setup.fov,
                setup.aspect,
                scale=0.12 * size,
                color=_CAMERA,
                wxyz=Rotation.from_rotvec(setup.at.rotation[i]).as_quat(scalar_first=True),
                position=places[i],
            )
        line = np.stack([places[:-1], places[1:]], axis=1).astype(np.float32)
        if len(line):
            scene.add_line_segments("/scanner/travel", line, _TRAVEL, thickness=0.005 * size)
        if len(setup.sheet):
            corners = (setup.sheet - middle).astype(np.float32)
            faces = np.array([[0, 1, 2], [0, 2, 3]])
            scene.add_mesh_simple("/scanner/light", corners, faces, color=_LIGHT, opacity=0.25, side="double")
    server.flush()
    return server


def _textured(
    vertices: Float[np.ndarray, "vertices 3"], triangles: Int[np.ndarray, "triangles 3"] | None, texture: TextureMap
) -> trimesh.Trimesh:
    """The mesh with its texture."""
    from PIL.Image import fromarray
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    rows, columns = texture.picture.shape[:2]
    # trimesh has v upwards.
    uv = (texture.pixels + 0.5) / [columns, rows] * [1.0, -1.0] + [0.0, 1.0]
    material = PBRMaterial(baseColorTexture=fromarray(texture.picture), metallicFactor=0.0, roughnessFactor=1.0)
    return trimesh.Trimesh(vertices, triangles, visual=TextureVisuals(uv, material=material), process=False)


def aside_of(up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """A unit vector at right angles to a direction."""
    aside = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    return aside / np.linalg.norm(aside)


def cell_mm(size_mm: float) -> float:
    """The side of a grid's cells for something of a size: 1, 2 or 5 times a power of ten, mm."""
    rough = max(size_mm, 1e-6) / _CELLS
    power = 10.0 ** np.floor(np.log10(rough))
    return float(next(by * power for by in (1.0, 2.0, 5.0, 10.0) if by * power >= rough * (1 - 1e-9)))


def colour_bar(shown: ViewData, name: str) -> str:
    """The colours from the least value to the greatest, with numbers and unit, as HTML; "" for photographs."""
    if name == PHOTOGRAPH:
        return ""
    low, high = limits(shown.values[name])
    stops = ", ".join(f"rgb({r}, {g}, {b})" for r, g, b in sequential(np.linspace(0.0, 1.0, _STOPS)).tolist())
    marks = "".join(f"<span>{value:.3g}</span>" for value in np.linspace(low, high, _MARKS))
    return (
        '<div style="padding: 0 1em 0.5em; font-size: 0.85em">'
        f'<div role="img" aria-label="colours from {low:.3g} to {high:.3g} {UNITS[name]}" '
        f'style="height: 0.9em; border-radius: 3px; background: linear-gradient(to right, {stops})"></div>'
        f'<div style="display: flex; justify-content: space-between">{marks}</div>'
        f"<div>{name}, {UNITS[name]}</div></div>"
    )


def coloured(values: Float[np.ndarray, "points"]) -> UInt8[np.ndarray, "points 3"]:
    """A colour for each value, the ends of the range without the extremes; grey where there is no number."""
    low, high = limits(values)
    return sequential((values - low) / max(high - low, 1e-12))


def limits(values: Float[np.ndarray, "points"]) -> tuple[float, float]:
    """The values that have the first and the last colour."""
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, _SHOWN) if len(known) else (0.0, 1.0)
    return float(low), float(high)


def painted(shown: ViewData, name: str) -> UInt8[np.ndarray, "points 3"]:
    """The colours of what is shown by its values of this name, or as photographed; grey for a point without."""
    if name != PHOTOGRAPH or shown.colours is None:
        return coloured(shown.values[name])
    return shown_colours(shown.colours)


def _words(shown: ViewData, name: str) -> str:
    what = f"{len(shown.points)} points" if shown.triangles is None else f"{len(shown.triangles)} triangles"
    if name == PHOTOGRAPH:
        return f"{what}; colours as photographed"
    low, high = limits(shown.values[name])
    return f"{what}; {name} from {low:.3g} (dark) to {high:.3g} {UNITS[name]} (bright)"
