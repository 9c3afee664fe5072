"""Which way the surface of a range image faces, from each point's linked neighbours."""

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.reconstruction import RangeImage
from jaxscan.surface.links import Links, next_frame, of_both_gaps


def normals(image: RangeImage, linked: Links) -> Float[np.ndarray, "frames columns 3"]:
    """The unit normal at each point, on the camera's side; NaN where it is not linked in both directions.

    It is at right angles to the mean difference to the linked neighbours in the frame, and to that over the frames.
    """
    across = _mean_difference(image.points.swapaxes(0, 1), linked.across.T).swapaxes(0, 1)
    along = _mean_difference(image.points, linked.along)
    normal = np.cross(across, along)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        away = (normal * (image.points - image.cameras().astype(np.float32)[:, None])).sum(axis=-1) > 0
    return np.where(away[..., None], -normal, normal)


def incidence(image: RangeImage, linked: Links) -> Float[np.ndarray, "frames columns"]:
    """The angle between the camera's ray and the surface's normal, radians; NaN where that is not known."""
    to_camera = image.cameras().astype(np.float32)[:, None] - image.points
    with np.errstate(invalid="ignore"):
        cosine = (normals(image, linked) * to_camera).sum(axis=-1) / np.linalg.norm(to_camera, axis=-1)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def _mean_difference(
    points: Float[np.ndarray, "lines items 3"], linked: Bool[np.ndarray, "gaps items"]
) -> Float[np.ndarray, "lines items 3"]:
    """Mean of the differences to the linked neighbours along the first axis; zero where there is none."""
    apart = next_frame(points, len(linked)) - points[: len(linked)]
    return of_both_gaps(np.where(linked[..., None], apart, np.float32(0)), len(points))
