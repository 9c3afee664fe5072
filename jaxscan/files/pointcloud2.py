"""Points as the content of a ROS 2 message of the type `sensor_msgs/PointCloud2`, made without ROS.

Its numbers are those of the message's definition (sensor_msgs/msg/PointCloud2.msg and PointField.msg). Lengths are in
metres, as REP 103 has them; the frame is the camera's, x right, y down, z forward: an optical frame of REP 103.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from jaxscan.errors import InputError
from jaxscan.files.cloud import Cloud
from jaxscan.files.packed_colours import packed

# PointField.FLOAT32.
FLOAT32: Final = 7
_M_PER_MM: Final = 1e-3
# What is a length, and by which name ROS knows the strength of a return.
_LENGTHS: Final = ("sigma", "sigma_pixel")
_NAMES: Final = {"strength": "intensity"}


@dataclass(frozen=True)
class PointCloud2:
    """The content of a message, by the names of its definition.

    Attributes:
        frame_id: of its header.
        height: 1: the points are in no order.
        width: how many points.
        fields: of each number of a point its name, its place in bytes, its type, and how many there are of it.
        is_bigendian: never.
        point_step: bytes of a point.
        row_step: bytes of all.
        data: the points.
        is_dense: always: there are no points that are not known.
    """

    frame_id: str
    width: int
    fields: tuple[tuple[str, int, int, int], ...]
    point_step: int
    data: bytes
    height: int = 1
    is_bigendian: bool = False
    is_dense: bool = True

    @property
    def row_step(self) -> int:
        """Bytes of all points."""
        return self.point_step * self.width


def pointcloud2(cloud: Cloud, frame_id: str = "scanner_optical_frame") -> PointCloud2:
    """A message of points: x, y, z (m), and `sigma` (m), `sigma_pixel` (m), `intensity`, `albedo`, `rgb` where known.

    Args:
        cloud: in mm.
        frame_id: the name of the object frame in the tree of ROS's frames.

    Raises:
        InputError: there are no points, or a coordinate is not finite.
    """
    if not len(cloud.points) or not np.isfinite(cloud.points).all():
        raise InputError("a message takes one point or more, all of finite coordinates: leave missing points out")
    columns = dict(zip("xyz", (cloud.points.astype(np.float64) * _M_PER_MM).T, strict=True))
    for name in ("sigma", "sigma_pixel", "strength", "albedo"):
        known = getattr(cloud, name)
        if known is not None:
            columns[_NAMES.get(name, name)] = known * (_M_PER_MM if name in _LENGTHS else 1.0)
    table = np.empty((len(cloud.points), len(columns) + (cloud.colours is not None)), "<f4")
    for i, values in enumerate(columns.values()):
        table[:, i] = values
    names = [*columns]
    if cloud.colours is not None:
        # Bytes, and no numbers: as numbers they could be rounded.
        table.view("<u4")[:, -1] = packed(cloud.colours).view("<u4")
        names.append("rgb")
    size = table.itemsize
    fields = tuple((name, size * i, FLOAT32, 1) for i, name in enumerate(names))
    return PointCloud2(frame_id, len(table), fields, size * len(names), table.tobytes())
