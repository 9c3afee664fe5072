"""What is shown in the browser (extra `viewer`): viser on this machine alone, coordinates in float32."""

from typing import Any, Final

import numpy as np
import trimesh
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from jaxscan.extras import extra
from jaxscan.files.cloud import shown_colours
from jaxscan.surface.colours import sequential
from jaxscan.view.view_data import PHOTOGRAPH, UNITS, ViewData

HOST: Final = "127.0.0.1"
# Of the colours' range, percentiles.
_SHOWN: Final = (1.0, 99.0)
_CAMERA, _LIGHT, _TRAVEL = (60, 60, 60), (220, 40, 40), (40, 90, 200)


def serve(shown: ViewData, port: int, colour: str | None = None) -> Any:
    """Show what `view_data` read at http://127.0.0.1:port until the server that is returned is stopped.

    Args:
        shown: what to show.
        port: of this machine; if it is taken, the next one that is free.
        colour: the values to colour by; others are chosen in the browser.

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
    aside = np.cross(shown.up, [1.0, 0.0, 0.0] if abs(shown.up[0]) < 0.9 else [0.0, 1.0, 0.0])
    server.initial_camera.up = tuple(shown.up)
    server.initial_camera.look_at = (0.0, 0.0, 0.0)
    server.initial_camera.position = tuple(size * (0.6 * shown.up + 0.7 * aside / np.linalg.norm(aside)))
    centred = (points - middle).astype(np.float32)

    def draw(name: str) -> None:
        colours = painted(shown, name)
        if shown.triangles is None:
            spacing = size / np.sqrt(len(points))
            scene.add_point_cloud(
                "/points", centred, colours, point_size=0.6 * spacing, point_shape="circle", precision="float32"
            )
        else:
            scene.add_mesh_trimesh(
                "/mesh", trimesh.Trimesh(centred, shown.triangles, vertex_colors=colours, process=False)
            )

    with server.gui.add_folder("jaxscan"):
        words = server.gui.add_markdown(_words(shown, colour))
        choice = server.gui.add_dropdown("colour", shown.looks, initial_value=colour)

    @choice.on_update
    def _(_: Any) -> None:
        draw(choice.value)
        words.content = _words(shown, choice.value)

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
