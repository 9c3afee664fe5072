"""Points of a scan as a ROS 2 topic: `sensor_msgs/PointCloud2`, in metres, once a second until Ctrl-C.

It needs nothing of ROS but `rclpy` and `sensor_msgs`, which come with every ROS 2: run it in a shell where ROS is set
up (`source /opt/ros/jazzy/setup.bash`), and look at the topic `/jaxscan/points` in RViz, with the fixed frame
`scanner_optical_frame`. The message itself is made without ROS, by `jaxscan.files.pointcloud2`: σ, strength, albedo and
colour of each point are in it where they are known. Without ROS this example makes the message and says what is in it.
"""

import photographs

import jaxscan
from jaxscan.files.pointcloud2 import PointCloud2, pointcloud2


def publish(cloud: PointCloud2, topic: str) -> None:
    """Publish a message once a second, until Ctrl-C; ImportError where ROS is not set up."""
    import rclpy  # pyright: ignore[reportMissingImports]
    from sensor_msgs.msg import PointCloud2 as Message  # pyright: ignore[reportMissingImports]
    from sensor_msgs.msg import PointField  # pyright: ignore[reportMissingImports]

    rclpy.init()
    node = rclpy.create_node("jaxscan")
    publisher = node.create_publisher(Message, topic, 1)
    message = Message(height=cloud.height, width=cloud.width, is_bigendian=cloud.is_bigendian, is_dense=cloud.is_dense)
    message.point_step, message.row_step, message.data = cloud.point_step, cloud.row_step, cloud.data
    message.fields = [PointField(name=n, offset=o, datatype=t, count=c) for n, o, t, c in cloud.fields]
    message.header.frame_id = cloud.frame_id

    def send() -> None:
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)

    node.create_timer(1.0, send)
    print(f"published on {topic} until Ctrl-C")
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        node.destroy_node()


path = photographs.folder() / "cup.ply"  # of example 2, or the same made now
if not path.exists():
    scan = jaxscan.read_scan(photographs.world() / "scan")
    jaxscan.write_points(path, jaxscan.reconstruct(photographs.rig(), scan))
cloud = pointcloud2(jaxscan.read_ply(path))
print(f"{cloud.width} points of {cloud.point_step} bytes: {', '.join(name for name, *_ in cloud.fields)}")
try:
    publish(cloud, "/jaxscan/points")
except ImportError as error:
    print(f"{error.name} is not there, so nothing is published: set ROS 2 up in this shell, by `source")
    print("/opt/ros/jazzy/setup.bash` or that of your ROS, and run this with the Python that ROS uses")
