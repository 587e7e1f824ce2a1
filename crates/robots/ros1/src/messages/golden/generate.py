"""Writes the golden messages and MD5 sums beside this file with rosbags (pip install rosbags), an independent encoder."""

from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

store = get_typestore(Stores.ROS1_NOETIC)
store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage"))
here = Path(__file__).parent


def make(name, **fields):
    return store.types[name.replace("/", "/msg/")](**fields)


def header(frame):
    stamp = make("builtin_interfaces/Time", sec=1, nanosec=400_000_123)
    return make("std_msgs/Header", seq=7, stamp=stamp, frame_id=frame)


def vector(kind, x, y, z):
    return make(f"geometry_msgs/{kind}", x=x, y=y, z=z)


covariance = np.arange(36, dtype=np.float64)
turn = make("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.6, w=0.8)
twist = make("geometry_msgs/Twist", linear=vector("Vector3", 0.3, 0.0, 0.0), angular=vector("Vector3", 0.0, 0.0, -0.1))
bare_pose = make("geometry_msgs/Pose", position=vector("Point", 25.5, -27.8, 0.0), orientation=turn)
pose = make("geometry_msgs/PoseWithCovariance", pose=bare_pose, covariance=covariance)
moving = make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=covariance)
step = make("geometry_msgs/Transform", translation=vector("Vector3", 1.0, 2.0, 0.0), rotation=turn)
map_info = make(
    "nav_msgs/MapMetaData",
    map_load_time=make("builtin_interfaces/Time", sec=5, nanosec=6),
    resolution=0.05,
    width=3,
    height=2,
    origin=bare_pose,
)

imu = {
    "header": header("imu"),
    "orientation": turn,
    "orientation_covariance": np.arange(-1, 8, dtype=np.float64),
    "angular_velocity": vector("Vector3", 0.1, 0.2, 0.3),
    "angular_velocity_covariance": np.arange(10, 19, dtype=np.float64),
    "linear_acceleration": vector("Vector3", 0.5, -0.25, 9.75),
    "linear_acceleration_covariance": np.arange(20, 29, dtype=np.float64),
}
battery = {
    "header": header("pack"),
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
}
image = {
    "header": header("camera"),
    "height": 2,
    "width": 3,
    "encoding": "mono8",
    "is_bigendian": 0,
    "step": 4,
    "data": np.arange(8, dtype=np.uint8),
}
compressed = {"header": header("camera"), "format": "jpeg", "data": np.array([0xFF, 0xD8, 7], dtype=np.uint8)}
fingers = make("std_msgs/MultiArrayDimension", label="fingers", size=2, stride=2)
layout = make("std_msgs/MultiArrayLayout", dim=[fingers], data_offset=0)

messages = {
    "std_msgs/String": {"data": "käse"},
    "std_msgs/Header": {"seq": 7, "stamp": header("").stamp, "frame_id": "map"},
    "rosgraph_msgs/Clock": {"clock": header("").stamp},
    "geometry_msgs/Twist": {"linear": twist.linear, "angular": twist.angular},
    "geometry_msgs/PoseWithCovarianceStamped": {"header": header("map"), "pose": pose},
    "tf2_msgs/TFMessage": {
        "transforms": [
            make("geometry_msgs/TransformStamped", header=header("odom"), child_frame_id=child, transform=step)
            for child in ["base_footprint", "laser"]
        ]
    },
    "nav_msgs/Odometry": {"header": header("odom"), "child_frame_id": "base_footprint", "pose": pose, "twist": moving},
    "nav_msgs/OccupancyGrid": {
        "header": header("map"),
        "info": map_info,
        "data": np.array([-1, 0, 100, 50, -1, 0], dtype=np.int8),
    },
    "sensor_msgs/LaserScan": {
        "header": header("laser"),
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
    "sensor_msgs/Imu": imu,
    "sensor_msgs/BatteryState": battery,
    "sensor_msgs/Image": image,
    "sensor_msgs/CompressedImage": compressed,
    "std_msgs/Float64MultiArray": {"layout": layout, "data": np.array([0.5, -2.0])},
}
for name, fields in messages.items():
    raw = store.serialize_ros1(make(name, **fields), name.replace("/", "/msg/"))
    (here / f"{name.split('/')[1]}.ros1").write_bytes(raw)

summed = """
std_msgs/String std_msgs/Bool std_msgs/Float64 std_msgs/Empty std_msgs/Duration std_msgs/Header rosgraph_msgs/Clock
geometry_msgs/Vector3 geometry_msgs/Point geometry_msgs/Quaternion geometry_msgs/Pose geometry_msgs/PoseStamped
geometry_msgs/PoseWithCovariance geometry_msgs/PoseWithCovarianceStamped geometry_msgs/PoseArray geometry_msgs/Twist
geometry_msgs/TwistStamped geometry_msgs/TwistWithCovariance geometry_msgs/Transform geometry_msgs/TransformStamped
tf2_msgs/TFMessage nav_msgs/Odometry nav_msgs/Path nav_msgs/MapMetaData nav_msgs/OccupancyGrid sensor_msgs/LaserScan
sensor_msgs/Imu sensor_msgs/BatteryState sensor_msgs/Image sensor_msgs/CompressedImage std_msgs/MultiArrayDimension
std_msgs/MultiArrayLayout std_msgs/Float64MultiArray
""".split()
lines = [f"{name} {store.generate_msgdef(name.replace('/', '/msg/'), ros_version=1)[1]}\n" for name in summed]
(here / "md5sums").write_text("".join(lines))
