"""Every reader of files, as the worker calls it: by the name of its target in `seeds`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hardware.cameras.folder import FolderCamera
from hardware.devices import read_photograph, read_scanner
from hardware.scan_plan import ScanFolder
from jaxscan.calibration.board_views import observations_from
from jaxscan.files.acceptance_history import read_history
from jaxscan.files.artefact_file import read_artefact
from jaxscan.files.camera_file import CameraFile
from jaxscan.files.cameras import read_camera_file
from jaxscan.files.cloud import cloud_of
from jaxscan.files.mesh import has_faces, mesh_of, read_mesh
from jaxscan.files.part_file import read_part
from jaxscan.files.ply_read import read_ply_file
from jaxscan.files.profiles import read_profiles
from jaxscan.files.range_npz import read_range_npz
from jaxscan.files.range_scanner import read_scanner as read_scanner_of_range
from jaxscan.files.rig_checks import image_rays
from jaxscan.files.rig_file import read_rig
from jaxscan.files.scan import read_scan
from jaxscan.files.scan_poses import read_scan_poses
from jaxscan.files.session import read_session
from jaxscan.files.units import cloud_in_millimetres
from jaxscan.images import image_size, read_image, read_video
from jaxscan.reconstruction.profiles import range_image_of_profiles
from jaxscan.rig import Camera
from jaxscan.simulation.folders import read_scan_truth


def _rig(path: Path) -> None:
    rig = read_rig(path).rig
    _use(rig.camera)
    rays = image_rays(rig.camera)
    for light in rig.lights:
        assert light.fault(rays) is None


def _camera(path: Path) -> CameraFile:
    content = read_camera_file(path)
    if content.camera is not None:
        _use(content.camera)
    return content


def _use(camera: Camera) -> None:
    """A camera that was read sees something: a ray somewhere is finite, and stays so in float32."""
    numbers = [float(leaf) for leaf in (*camera.focal, *camera.principal)]
    assert np.isfinite(np.float32(numbers)).all(), numbers
    assert np.isfinite(np.float32(1) / np.float32(numbers[:2])).all(), numbers
    assert (np.float32(numbers[:2]) > 0).all(), numbers


def _bouguet(path: Path) -> None:
    content = _camera(path)
    if content.views:
        observations_from(content, path)


def _ply(path: Path) -> None:
    content = read_ply_file(path)
    cloud_in_millimetres(str(path), cloud_of(path, content), "mm")
    if has_faces(content):
        _surface(mesh_of(path, content))


def _mesh(path: Path) -> None:
    _surface(read_mesh(path))


def _surface(mesh: Any) -> None:
    assert np.isfinite(np.asarray(mesh.triangles, np.float32)).all()
    assert np.isfinite(mesh.area)


def _image(path: Path) -> None:
    size = image_size(path)
    image = read_image(path)
    assert image.shape[1::-1] == size, (image.shape, size)
    image_size(path, to_its_end=True)


def _folder(path: Path) -> None:
    camera = FolderCamera([path], read_photograph)
    camera.open()
    camera.expose({})


def _video(path: Path) -> None:
    for _ in read_video(path):
        pass


def _range(path: Path) -> None:
    read_scanner_of_range(path, read_range_npz(path))


def _profiles(path: Path) -> None:
    image = range_image_of_profiles(read_profiles(path.parent))
    assert np.isfinite(image.points[image.valid]).all()


READERS: dict[str, Callable[[Path], Any]] = {
    "session": read_session,
    "scan": read_scan,
    "scanner": read_scanner,
    "plan": lambda path: ScanFolder.resume(path.parent),
    "rig 1": _rig,
    "rig 2": _rig,
    "opencv yaml": _camera,
    "opencv xml": _camera,
    "ros": _camera,
    "ros message": _camera,
    "kalibr": _camera,
    "mrcal": _camera,
    "bouguet": _bouguet,
    "ply ascii": _ply,
    "ply binary": _ply,
    "ply mesh": _ply,
    "range image": _range,
    "truth": lambda path: read_scan_truth(path.parent),
    "stl": _mesh,
    "stl ascii": _mesh,
    "obj": _mesh,
    "glb": _mesh,
    "off": _mesh,
    "png": _image,
    "jpeg": _image,
    "bmp": _image,
    "tiff": _image,
    "pgm": _image,
    "webp": _image,
    "npy": _image,
    "folder camera": _folder,
    "avi": _video,
    "mp4": _video,
    "part": read_part,
    "artefact": read_artefact,
    "history": read_history,
    "profiles": _profiles,
    "profiles csv": _profiles,
    "profiles lines": _profiles,
    "profiles raw": _profiles,
    "poses json": lambda path: read_scan_poses(path, [Path("a.ply"), Path("b.ply")]),
    "poses conf": lambda path: read_scan_poses(path, [Path("a.ply"), Path("b.ply")]),
}
