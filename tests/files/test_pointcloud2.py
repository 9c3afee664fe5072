"""ROS messages, made without ROS: read back by the definition of the message, and handed to a stand-in of rclpy."""

import struct

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.cloud import Cloud
from jaxscan.files.packed_colours import packed, unpacked
from jaxscan.files.pointcloud2 import PointCloud2, pointcloud2


def cloud(n: int = 50) -> Cloud:
    random = np.random.default_rng(7)
    return Cloud(
        random.uniform([-150, -100, 250], [150, 100, 500], (n, 3)).astype(np.float32),
        sigma=random.random(n, dtype=np.float32),
        strength=250 * random.random(n, dtype=np.float32),
        colours=random.integers(0, 256, (n, 3), dtype=np.uint8),
    )


def read(message: PointCloud2) -> dict[str, list]:
    """One number after the other, as any reader of the message does."""
    assert len(message.data) == message.row_step * message.height
    assert message.row_step == message.width * message.point_step
    content = {}
    for name, offset, datatype, count in message.fields:
        assert (datatype, count) == (7, 1)
        kind = "<I" if name == "rgb" else "<f"
        places = range(offset, len(message.data), message.point_step)
        content[name] = [struct.unpack_from(kind, message.data, place)[0] for place in places]
    return content


def test_points_are_in_metres_and_the_rest_has_the_names_of_ros() -> None:
    written = cloud()
    message = pointcloud2(written, "map")
    assert (message.frame_id, message.height, message.width) == ("map", 1, 50)
    assert not message.is_bigendian
    assert message.is_dense
    content = read(message)
    assert list(content) == ["x", "y", "z", "sigma", "intensity", "rgb"]
    points = np.stack([content[axis] for axis in "xyz"], axis=-1)
    np.testing.assert_allclose(points, written.points / 1000, rtol=1e-6)
    np.testing.assert_allclose(content["sigma"], written.sigma / 1000, rtol=1e-6)
    np.testing.assert_array_equal(np.float32(content["intensity"]), written.strength)
    r, g, b = written.colours.astype(int).T
    np.testing.assert_array_equal(content["rgb"], 65536 * r + 256 * g + b)


def test_points_alone() -> None:
    message = pointcloud2(Cloud(cloud().points))
    assert [name for name, *_ in message.fields] == ["x", "y", "z"]
    assert message.point_step == 12


def test_colours_come_back_from_one_number() -> None:
    every = np.stack(np.meshgrid([0, 1, 127, 128, 255], [0, 64, 255], [0, 200, 255]), axis=-1).reshape(-1, 3)
    np.testing.assert_array_equal(unpacked(packed(every.astype(np.uint8))), every)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.array([[0.0, np.nan, 1.0]])])
def test_what_is_no_message_is_refused(points: np.ndarray) -> None:
    with pytest.raises(InputError, match="one point or more"):
        pointcloud2(Cloud(points.astype(np.float32)))
