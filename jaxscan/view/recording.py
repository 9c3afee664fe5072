"""What `jaxscan view` shows, as a recording for Rerun (extra `rerun`): points or mesh, light, cameras, photographs.

Coordinates are those of the object frame, mm. Entities are `points` or `mesh`, `scanner/light` and `scanner/travel`. On
the timeline `frame` the entity `scanner/camera` has its pose, and `scanner/camera/image` the photograph. Rerun's
cameras have no lens: a photograph is resampled as a pinhole with the same focal lengths would have taken it.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from jaxscan.atomic import replacing
from jaxscan.errors import InputError
from jaxscan.extras import extra
from jaxscan.files.camera_file import matrix_of
from jaxscan.files.scan import Scan
from jaxscan.images.decode import eight_bits, read_image
from jaxscan.reconstruction.merged_steps import step_groups
from jaxscan.rig import Camera
from jaxscan.view.view_data import PHOTOGRAPH, ViewData
from jaxscan.view.viewer import painted

# Red, green, blue, opacity.
_LIGHT: Final = (220, 40, 40, 64)
_TRAVEL: Final = (40, 90, 200)
_JPEG_QUALITY: Final = 90
# Rerun puts (0, 0) at the corner of the top left pixel; `jaxscan` at its centre.
_CORNER: Final = 0.5
# How far before the camera its photograph hangs, in parts of the diagonal of what is shown.
_BEFORE: Final = 0.15


def write_recording(
    path: str | os.PathLike[str],
    shown: ViewData,
    colour: str,
    camera: Camera | None = None,
    photographs: Sequence[Path] = (),
) -> int:
    """Write a recording (.rrd) for Rerun.

    Args:
        path: where.
        shown: what is to be seen.
        colour: the name of the values to colour by, as `ViewData.colour` returns it.
        camera: of the rig that `shown` was read with; its poses are recorded where it is known.
        photographs: one for each frame of the scan; those of the recorded poses are read. None are recorded if empty.

    Returns:
        How many photographs it has.

    Raises:
        InputError: rerun-sdk is not installed, a photograph cannot be read or is not of the camera's size, or the file
            cannot be written.
    """
    rerun = extra("rerun")
    recording = rerun.RecordingStream("jaxscan")
    with replacing(path) as file:
        recording.save(file.name, _arranged(rerun, shown))
        _record_surface(rerun, recording, shown, colour)
        recorded = 0
        if shown.setup is not None and camera is not None:
            recorded = _record_scanner(rerun, recording, shown, camera, photographs)
        recording.disconnect()
    return recorded


def photographs_of(scan: Scan, frames: int) -> tuple[Path, ...]:
    """The photograph of each frame of a range image; of several exposures of a step the first.

    Args:
        scan: the scan that the range image was reconstructed from.
        frames: how many the range image has.

    Raises:
        InputError: the scan is a video, or has another number of steps.
    """
    if scan.video is not None:
        raise InputError(
            f"{scan.path}: --photographs takes single photographs, and {scan.video.name} is a video: save its frames "
            "as photographs, or leave --photographs out"
        )
    groups = step_groups(scan)
    if len(groups) != frames:
        raise InputError(
            f"{scan.path}: has {len(groups)} steps, and the range image {frames}: give the scan that it was "
            "reconstructed from"
        )
    return tuple(scan.frames[group.start] for group in groups)


def as_pinhole(
    photograph: UInt8[np.ndarray, "rows columns *rgb"], pixels: Float[np.ndarray, "rows columns 2"]
) -> UInt8[np.ndarray, "rows columns *rgb"]:
    """A photograph as a camera without a lens would have taken it; black where the lens does not see.

    Args:
        photograph: as it was taken.
        pixels: `pinhole_pixels` of its camera.
    """
    u, v = (np.nan_to_num(pixels[..., k], nan=-2.0).astype(np.float32) for k in range(2))
    return cv2.remap(photograph, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)


def pinhole_pixels(camera: Camera) -> Float[np.ndarray, "rows columns 2"]:
    """Where on the photograph that is which a pinhole of the same focal lengths sees in each pixel; (u, v), or NaN."""
    columns, rows = camera.image_size
    u, v = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64))
    K = np.array(matrix_of(camera))
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], axis=-1)
    pixels = np.array(camera.project(rays), np.float64)
    # Beyond its fold a lens's formula gives places of other rays.
    x, _ = jax.vmap(jax.vmap(camera.chart.coordinates))(jnp.asarray(rays))
    folded = np.linalg.norm(np.asarray(x), axis=-1) > float(camera.lens.invertible_radius(x.dtype))
    pixels[folded] = np.nan
    return pixels


def _arranged(rerun: Any, shown: ViewData) -> Any:
    """One view in space, with what is up above."""
    controls = rerun.blueprint.EyeControls3D(eye_up=[float(c) for c in shown.up])
    return rerun.blueprint.Blueprint(
        rerun.blueprint.Spatial3DView(origin="/", eye_controls=controls), collapse_panels=True
    )


def _record_surface(rerun: Any, recording: Any, shown: ViewData, colour: str) -> None:
    if shown.triangles is None:
        recording.log("points", rerun.Points3D(shown.points, colors=painted(shown, colour)), static=True)
        return
    mesh: dict[str, Any] = {"vertex_positions": shown.points, "triangle_indices": shown.triangles}
    if colour == PHOTOGRAPH and shown.texture is not None:
        rows, columns = shown.texture.picture.shape[:2]
        mesh["vertex_texcoords"] = (shown.texture.pixels + _CORNER) / [columns, rows]
        mesh["albedo_texture"] = shown.texture.picture
    else:
        mesh["vertex_colors"] = painted(shown, colour)
    recording.log("mesh", rerun.Mesh3D(**mesh), static=True)


def _record_scanner(rerun: Any, recording: Any, shown: ViewData, camera: Camera, photographs: Sequence[Path]) -> int:
    """Light, travel, and the camera at each recorded frame; returned is how many photographs it has."""
    setup = shown.setup
    assert setup is not None
    if len(setup.sheet):
        light = rerun.Mesh3D(
            vertex_positions=setup.sheet, triangle_indices=[[0, 1, 2], [0, 2, 3]], albedo_factor=_LIGHT
        )
        recording.log("scanner/light", light, static=True)
    places = setup.at.translation
    if len(places) > 1:
        recording.log("scanner/travel", rerun.LineStrips3D([places], colors=[_TRAVEL]), static=True)
    K = np.array(matrix_of(camera))
    K[:2, 2] += _CORNER
    size = float(np.linalg.norm(np.ptp(shown.points, axis=0)))
    pinhole = rerun.Pinhole(
        image_from_camera=K,
        resolution=list(camera.image_size),
        camera_xyz=rerun.ViewCoordinates.RDF,
        image_plane_distance=_BEFORE * size,
    )
    recording.log("scanner/camera/image", pinhole, static=True)
    pixels = pinhole_pixels(camera) if photographs else None
    for i, frame in enumerate(setup.frames.tolist()):
        recording.set_time("frame", sequence=frame)
        turned = Rotation.from_rotvec(setup.at.rotation[i]).as_matrix()
        recording.log("scanner/camera", rerun.Transform3D(translation=places[i], mat3x3=turned))
        if pixels is not None:
            seen = as_pinhole(_photograph_of(photographs[frame], camera), pixels)
            recording.log("scanner/camera/image", rerun.Image(seen).compress(jpeg_quality=_JPEG_QUALITY))
    return len(setup.frames) if photographs else 0


def _photograph_of(path: Path, camera: Camera) -> UInt8[np.ndarray, "rows columns *rgb"]:
    photograph = read_image(path)
    rows, columns = photograph.shape[:2]
    if (columns, rows) != camera.image_size:
        of_rig = "{} x {}".format(*camera.image_size)
        raise InputError(
            f"{path}: has {columns} x {rows} pixels, and the rig's camera {of_rig}: give the scan and the rig that the "
            "points were reconstructed with"
        )
    return eight_bits(photograph)
