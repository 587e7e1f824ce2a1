"""Writes the golden messages and type hashes beside this file with rosbags (pip install rosbags), an independent CDR
encoder."""

from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_JAZZY)


def make(name, **fields):
    return store.types[name](**fields)


def header(frame):
    stamp = make("builtin_interfaces/msg/Time", sec=1, nanosec=400_000_123)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def vector(kind, x, y, z):
    return make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


covariance = np.arange(36, dtype=np.float64)
twist = make(
    "geometry_msgs/msg/Twist", linear=vector("Vector3", 0.3, 0.0, 0.0), angular=vector("Vector3", 0.0, 0.0, -0.1)
)
bare_pose = make(
    "geometry_msgs/msg/Pose",
    position=vector("Point", 25.5, -27.8, 0.0),
    orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.6, w=0.8),
)
pose = make("geometry_msgs/msg/PoseWithCovariance", pose=bare_pose, covariance=covariance)
transform = make(
    "geometry_msgs/msg/TransformStamped",
    header=header("odom"),
    child_frame_id="base_footprint",
    transform=make(
        "geometry_msgs/msg/Transform", translation=vector("Vector3", 1.5, -2.5, 0.0), rotation=bare_pose.orientation
    ),
)
imu = {
    "header": header("imu"),
    "orientation": bare_pose.orientation,
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
fingers = make("std_msgs/msg/MultiArrayDimension", label="fingers", size=2, stride=2)
layout = make("std_msgs/msg/MultiArrayLayout", dim=[fingers], data_offset=0)
messages = [
    twist,
    bare_pose,
    make("geometry_msgs/msg/PoseWithCovarianceStamped", header=header("map"), pose=pose),
    make(
        "nav_msgs/msg/Odometry",
        header=header("odom"),
        child_frame_id="base_footprint",
        pose=pose,
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance),
    ),
    make(
        "sensor_msgs/msg/LaserScan",
        header=header("laser"),
        angle_min=-3.0,
        angle_max=3.0,
        angle_increment=0.5,
        time_increment=0.001,
        scan_time=0.1,
        range_min=0.15,
        range_max=12.0,
        ranges=np.array([1.0, 2.5, np.inf], dtype=np.float32),
        intensities=np.array([], dtype=np.float32),
    ),
    make("geometry_msgs/msg/TwistStamped", header=header("base_link"), twist=twist),
    make("tf2_msgs/msg/TFMessage", transforms=[transform, transform]),
    make(
        "nav_msgs/msg/OccupancyGrid",
        header=header("map"),
        info=make(
            "nav_msgs/msg/MapMetaData",
            map_load_time=header("").stamp,
            resolution=0.05,
            width=2,
            height=3,
            origin=bare_pose,
        ),
        data=np.array([-1, 0, 100, -1, 50, 0], dtype=np.int8),
    ),
    make("rosgraph_msgs/msg/Clock", clock=header("").stamp),
    make("sensor_msgs/msg/Imu", **imu),
    make("sensor_msgs/msg/BatteryState", **battery),
    make("sensor_msgs/msg/Image", **image),
    make("sensor_msgs/msg/CompressedImage", **compressed),
    make("std_msgs/msg/Float64MultiArray", layout=layout, data=np.array([0.5, -2.0])),
]
for message in messages:
    name = message.__msgtype__.split("/")[-1]
    for endianness in ("le", "be"):
        payload = store.serialize_cdr(message, message.__msgtype__, little_endian=endianness == "le")
        (Path(__file__).parent / f"{name}.{endianness}.cdr").write_bytes(bytes(payload))

hashed = [
    "builtin_interfaces/msg/Time",
    *(f"std_msgs/msg/{name}" for name in ("Header", "String")),
    *(
        f"geometry_msgs/msg/{name}"
        for name in (
            "Vector3", "Point", "Quaternion", "Pose", "PoseWithCovariance", "PoseWithCovarianceStamped", "Twist",
            "TwistStamped", "TwistWithCovariance", "Transform", "TransformStamped",
        )
    ),
    "tf2_msgs/msg/TFMessage",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/LaserScan",
    *(f"nav_msgs/msg/{name}" for name in ("MapMetaData", "OccupancyGrid")),
    "rosgraph_msgs/msg/Clock",
    *(f"sensor_msgs/msg/{name}" for name in ("Imu", "BatteryState", "Image", "CompressedImage")),
    *(f"std_msgs/msg/{name}" for name in ("MultiArrayDimension", "MultiArrayLayout", "Float64MultiArray")),
]
hashes = "".join(f"{name} {store.hash_rihs01(name)}\n" for name in hashed)
(Path(__file__).parent / "hashes").write_text(hashes)
