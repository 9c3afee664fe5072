"""The camera of a `rig.json`, and a rig of a camera alone."""

from pathlib import Path

from jaxscan.files.camera_file import CameraFile, one_camera, other_size
from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.rig import Rig


def read(path: Path, name: str | None, image_size: tuple[int, int] | None) -> CameraFile:
    """The camera of a rig, its standard deviations, and the names of whatever stands beside it."""
    one_camera(path, name)
    content = read_rig(path)
    rig, covariance = content.rig, content.covariance
    if image_size is not None and image_size != rig.camera.image_size:
        raise other_size(path, rig.camera.image_size, image_size)
    sigma = {name: covariance.sigma(name) for name in covariance.names} if covariance else {}
    beside = [f"the light {light.name}".rstrip() for light in rig.lights]
    beside += [f"the {axis}" for axis in rig.axes()]
    beside += ["the covariances"] if covariance else []
    return CameraFile(
        rig.camera.image_size,
        rig.camera,
        {name: value for name, value in sigma.items() if name.startswith("camera.") and value is not None},
        beside=tuple(beside),
        rig=rig,
    )


def write(path: Path, content: CameraFile) -> None:
    """A rig without laser and stage."""
    camera = content.the_camera(path)
    write_rig(path, RigFile(Rig(camera)))
