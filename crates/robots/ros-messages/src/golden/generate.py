"""Writes the golden messages, MD5 sums and type hashes beside this file with rosbags (pip install rosbags), an
independent encoder."""

from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

here = Path(__file__).parent


class Ros:
    """The messages of one version of ROS."""

    def __init__(self, store, **header):
        self.store = store
        self.header_fields = header
        self.turn = self.make("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.6, w=0.8)
        self.stamp = self.time(1, 400_000_123)
        self.twist = self.make(
            "geometry_msgs/Twist", linear=self.vector(0.3, 0.0, 0.0), angular=self.vector(0.0, 0.0, -0.1)
        )
        position = self.make("geometry_msgs/Point", x=25.5, y=-27.8, z=0.0)
        self.pose = self.make("geometry_msgs/Pose", position=position, orientation=self.turn)

    def make(self, name, **fields):
        return self.store.types[name.replace("/", "/msg/")](**fields)

    def time(self, sec, nanosec):
        return self.make("builtin_interfaces/Time", sec=sec, nanosec=nanosec)

    def header(self, frame):
        return self.make("std_msgs/Header", **self.header_fields, stamp=self.stamp, frame_id=frame)

    def vector(self, x, y, z):
        return self.make("geometry_msgs/Vector3", x=x, y=y, z=z)

    def transform(self, x, y, child):
        step = self.make("geometry_msgs/Transform", translation=self.vector(x, y, 0.0), rotation=self.turn)
        header = self.header("odom")
        return self.make("geometry_msgs/TransformStamped", header=header, child_frame_id=child, transform=step)

    def map(self, loaded, width, height, cells):
        info = {"map_load_time": loaded, "resolution": 0.05, "width": width, "height": height, "origin": self.pose}
        info = self.make("nav_msgs/MapMetaData", **info)
        return {"header": self.header("map"), "info": info, "data": np.array(cells, dtype=np.int8)}

    def messages(self):
        """Name and fields of each message that is the same in both versions but for its header."""
        covariance = np.arange(36, dtype=np.float64)
        pose = self.make("geometry_msgs/PoseWithCovariance", pose=self.pose, covariance=covariance)
        moving = self.make("geometry_msgs/TwistWithCovariance", twist=self.twist, covariance=covariance)
        fingers = self.make("std_msgs/MultiArrayDimension", label="fingers", size=2, stride=2)
        layout = self.make("std_msgs/MultiArrayLayout", dim=[fingers], data_offset=0)
        return {
            "rosgraph_msgs/Clock": {"clock": self.stamp},
            "geometry_msgs/Twist": {"linear": self.twist.linear, "angular": self.twist.angular},
            "geometry_msgs/PoseWithCovarianceStamped": {"header": self.header("map"), "pose": pose},
            "nav_msgs/Odometry": {
                "header": self.header("odom"),
                "child_frame_id": "base_footprint",
                "pose": pose,
                "twist": moving,
            },
            "sensor_msgs/LaserScan": {
                "header": self.header("laser"),
                "angle_min": -3.0,
                "angle_max": 3.0,
                "angle_increment": 0.5,
                "time_increment": 0.001,
                "scan_time": 0.1,
                "range_min": 0.15,
                "range_max": 12.0,
                "ranges": np.array([1.0, 2.5, np.inf], dtype=np.float32),
                "intensities": np.array([], dtype=np.float32),
            },
            "sensor_msgs/Imu": {
                "header": self.header("imu"),
                "orientation": self.turn,
                "orientation_covariance": np.arange(-1, 8, dtype=np.float64),
                "angular_velocity": self.vector(0.1, 0.2, 0.3),
                "angular_velocity_covariance": np.arange(10, 19, dtype=np.float64),
                "linear_acceleration": self.vector(0.5, -0.25, 9.75),
                "linear_acceleration_covariance": np.arange(20, 29, dtype=np.float64),
            },
            "sensor_msgs/BatteryState": {
                "header": self.header("pack"),
                "voltage": 16.5,
                "temperature": 21.5,
                "current": -1.25,
                "charge": 1.5,
                "capacity": 2.0,
                "design_capacity": 2.25,
                "percentage": 0.75,
                "power_supply_status": 2,
                "power_supply_health": 1,
                "power_supply_technology": 2,
                "present": True,
                "cell_voltage": np.array([4.125, 4.25], dtype=np.float32),
                "cell_temperature": np.array([20.5], dtype=np.float32),
                "location": "slot 1",
                "serial_number": "A7",
            },
            "sensor_msgs/Image": {
                "header": self.header("camera"),
                "height": 2,
                "width": 3,
                "encoding": "mono8",
                "is_bigendian": 0,
                "step": 4,
                "data": np.arange(8, dtype=np.uint8),
            },
            "sensor_msgs/CompressedImage": {
                "header": self.header("camera"),
                "format": "jpeg",
                "data": np.array([0xFF, 0xD8, 7], dtype=np.uint8),
            },
            "std_msgs/Float64MultiArray": {"layout": layout, "data": np.array([0.5, -2.0])},
        }


def short(name):
    return name.split("/")[-1]


noetic = get_typestore(Stores.ROS1_NOETIC)
noetic.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage"))
ros1 = Ros(noetic, seq=7)
for name, fields in {
    **ros1.messages(),
    "std_msgs/String": {"data": "käse"},
    "std_msgs/Header": {"seq": 7, "stamp": ros1.stamp, "frame_id": "map"},
    "tf2_msgs/TFMessage": {"transforms": [ros1.transform(1.0, 2.0, child) for child in ("base_footprint", "laser")]},
    "nav_msgs/OccupancyGrid": ros1.map(ros1.time(5, 6), 3, 2, [-1, 0, 100, 50, -1, 0]),
}.items():
    raw = noetic.serialize_ros1(ros1.make(name, **fields), name.replace("/", "/msg/"))
    (here / f"{short(name)}.ros1").write_bytes(raw)

jazzy = get_typestore(Stores.ROS2_JAZZY)
ros2 = Ros(jazzy)
for name, fields in {
    **ros2.messages(),
    "geometry_msgs/Pose": {"position": ros2.pose.position, "orientation": ros2.turn},
    "geometry_msgs/TwistStamped": {"header": ros2.header("base_link"), "twist": ros2.twist},
    "tf2_msgs/TFMessage": {"transforms": [ros2.transform(1.5, -2.5, "base_footprint")] * 2},
    "nav_msgs/OccupancyGrid": ros2.map(ros2.stamp, 2, 3, [-1, 0, 100, -1, 50, 0]),
}.items():
    for order in ("le", "be"):
        message = ros2.make(name, **fields)
        raw = jazzy.serialize_cdr(message, name.replace("/", "/msg/"), little_endian=order == "le")
        (here / f"{short(name)}.{order}.cdr").write_bytes(bytes(raw))

summed = """
std_msgs/String std_msgs/Bool std_msgs/Float64 std_msgs/Empty std_msgs/Duration std_msgs/Header rosgraph_msgs/Clock
geometry_msgs/Vector3 geometry_msgs/Point geometry_msgs/Quaternion geometry_msgs/Pose geometry_msgs/PoseStamped
geometry_msgs/PoseWithCovariance geometry_msgs/PoseWithCovarianceStamped geometry_msgs/PoseArray geometry_msgs/Twist
geometry_msgs/TwistStamped geometry_msgs/TwistWithCovariance geometry_msgs/Transform geometry_msgs/TransformStamped
tf2_msgs/TFMessage nav_msgs/Odometry nav_msgs/Path nav_msgs/MapMetaData nav_msgs/OccupancyGrid sensor_msgs/LaserScan
sensor_msgs/Imu sensor_msgs/BatteryState sensor_msgs/Image sensor_msgs/CompressedImage std_msgs/MultiArrayDimension
std_msgs/MultiArrayLayout std_msgs/Float64MultiArray
""".split()
lines = [f"{name} {noetic.generate_msgdef(name.replace('/', '/msg/'), ros_version=1)[1]}\n" for name in summed]
(here / "md5sums").write_text("".join(lines))

hashed = """
builtin_interfaces/Time std_msgs/Header std_msgs/String geometry_msgs/Vector3 geometry_msgs/Point
geometry_msgs/Quaternion geometry_msgs/Pose geometry_msgs/PoseWithCovariance geometry_msgs/PoseWithCovarianceStamped
geometry_msgs/Twist geometry_msgs/TwistStamped geometry_msgs/TwistWithCovariance geometry_msgs/Transform
geometry_msgs/TransformStamped tf2_msgs/TFMessage nav_msgs/Odometry sensor_msgs/LaserScan nav_msgs/MapMetaData
nav_msgs/OccupancyGrid rosgraph_msgs/Clock sensor_msgs/Imu sensor_msgs/BatteryState sensor_msgs/Image
sensor_msgs/CompressedImage std_msgs/MultiArrayDimension std_msgs/MultiArrayLayout std_msgs/Float64MultiArray
""".split()
hashed = [name.replace("/", "/msg/") for name in hashed]
(here / "hashes").write_text("".join(f"{name} {jazzy.hash_rihs01(name)}\n" for name in hashed))
