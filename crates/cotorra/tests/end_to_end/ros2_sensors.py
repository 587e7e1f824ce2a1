"""A robot in ROS 2, over Cyclone DDS, that stands still and publishes its sensors ten times a second:
python3 ros2_sensors.py DOMAIN NAMESPACE. It publishes the same as ros1_sensors.py."""

import sys
import time
import types
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic


def message(package, name, **fields):
    """A type of ROS 2's, with these fields."""
    typename = f"{package}::msg::dds_::{name}_"
    declare = lambda namespace: namespace["__annotations__"].update(fields)
    return dataclass(types.new_class(name, (IdlStruct,), {"typename": typename}, declare))


Time = message("builtin_interfaces", "Time", sec=int32, nanosec=uint32)
Header = message("std_msgs", "Header", stamp=Time, frame_id=str)
Vector3 = message("geometry_msgs", "Vector3", x=float64, y=float64, z=float64)
Quaternion = message("geometry_msgs", "Quaternion", x=float64, y=float64, z=float64, w=float64)
Pose = message("geometry_msgs", "Pose", position=Vector3, orientation=Quaternion)
Twist = message("geometry_msgs", "Twist", linear=Vector3, angular=Vector3)
PoseWith = message("geometry_msgs", "PoseWithCovariance", pose=Pose, covariance=array[float64, 36])
TwistWith = message("geometry_msgs", "TwistWithCovariance", twist=Twist, covariance=array[float64, 36])
Odometry = message("nav_msgs", "Odometry", header=Header, child_frame_id=str, pose=PoseWith, twist=TwistWith)
Imu = message(
    "sensor_msgs",
    "Imu",
    header=Header,
    orientation=Quaternion,
    orientation_covariance=array[float64, 9],
    angular_velocity=Vector3,
    angular_velocity_covariance=array[float64, 9],
    linear_acceleration=Vector3,
    linear_acceleration_covariance=array[float64, 9],
)
BatteryState = message(
    "sensor_msgs",
    "BatteryState",
    header=Header,
    **{name: float32 for name in "voltage temperature current charge capacity design_capacity percentage".split()},
    **{f"power_supply_{name}": uint8 for name in ("status", "health", "technology")},
    present=bool,
    cell_voltage=sequence[float32],
    cell_temperature=sequence[float32],
    location=str,
    serial_number=str,
)
Image = message(
    "sensor_msgs",
    "Image",
    header=Header,
    height=uint32,
    width=uint32,
    encoding=str,
    is_bigendian=uint8,
    step=uint32,
    data=sequence[uint8],
)
CompressedImage = message("sensor_msgs", "CompressedImage", header=Header, format=str, data=sequence[uint8])
LaserScan = message(
    "sensor_msgs",
    "LaserScan",
    header=Header,
    **{f"angle_{name}": float32 for name in ("min", "max", "increment")},
    **{name: float32 for name in ("time_increment", "scan_time", "range_min", "range_max")},
    ranges=sequence[float32],
    intensities=sequence[float32],
)
Dimension = message("std_msgs", "MultiArrayDimension", label=str, size=uint32, stride=uint32)
Layout = message("std_msgs", "MultiArrayLayout", dim=sequence[Dimension], data_offset=uint32)
Float64MultiArray = message("std_msgs", "Float64MultiArray", layout=Layout, data=sequence[float64])

domain, namespace = sys.argv[1:]
header = lambda: Header(Time(int(time.time()), 0), "odom")
zero, upright, nan = Vector3(0, 0, 0), Quaternion(0, 0, 0, 1), float("nan")
odometry = Odometry(
    header(), "base", PoseWith(Pose(zero, upright), [0] * 36), TwistWith(Twist(zero, zero), [0] * 36)
)
imu = Imu(header(), upright, [0] * 9, Vector3(0, 0, 0.25), [0] * 9, Vector3(0, 0, 9.75), [0.5] * 9)
battery = BatteryState(header(), 16.5, nan, nan, nan, nan, nan, nan, 0, 0, 0, True, [], [], "", "")
# Of each pixel, blue is its column and red its row; each row has four bytes of padding.
row = lambda y: b"".join(bytes([x % 256, 7, y % 256]) for x in range(640)) + b"\0\1\2\3"
camera = Image(header(), 480, 640, "bgr8", 0, 1924, list(b"".join(map(row, range(480)))))
depth = Image(header(), 1, 1, "16UC1", 0, 2, [0, 0])
png = CompressedImage(header(), "png", list(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x02\x80\0\0\x01\xe0\x08\x02\0\0\0"))
turn = LaserScan(header(), -1, 1, 1, 0, 0, 0.1, 20, [2.5, 3.5, 4.5], [])
layout = Layout([], 0)
said = [
    ("odom", odometry),
    ("imu", imu),
    ("power", battery),
    ("camera/image_raw", camera),
    ("depth/image_raw", depth),
    ("pi/image/compressed", png),
    ("fingers", Float64MultiArray(layout, [0.5, -2.0])),
    ("toes", Float64MultiArray(layout, [1.0] * 5)),
    ("scan", turn),
]
participant = DomainParticipant(int(domain))
# As the drivers of cameras and IMUs publish.
qos = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5))
writers = [
    (DataWriter(participant, Topic(participant, f"rt{namespace}/{name}", type(message), qos=qos), qos=qos), message)
    for name, message in said
]
print("ready", flush=True)
while True:
    for writer, message in writers:
        if hasattr(message, "header"):
            message.header = header()
        writer.write(message)
    time.sleep(0.1)
