"""A peer that is Cyclone DDS: python3 cyclone.py DOMAIN ACTION TYPE TOPIC QOS

ACTION: print (each message on a line), publish (one message repeatedly), latch (one message once), echo (each message to
TOPIC_back), pitch (2000 scans to an echo, 100 each second; prints their round-trip times).
QOS: sensors, commands or latched, as in ROS 2.
"""

import sys
import time
from dataclasses import dataclass

from cyclonedds.core import InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.internal import InvalidSample
from cyclonedds.idl.types import array, float32, float64, int8, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Text(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Vector3
    orientation: Quaternion


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TwistStamped_"):
    header: Header
    twist: Twist


@dataclass
class LaserScan(IdlStruct, typename="sensor_msgs::msg::dds_::LaserScan_"):
    header: Header
    angle_min: float32
    angle_max: float32
    angle_increment: float32
    time_increment: float32
    scan_time: float32
    range_min: float32
    range_max: float32
    ranges: sequence[float32]
    intensities: sequence[float32]


@dataclass
class MapMetaData(IdlStruct, typename="nav_msgs::msg::dds_::MapMetaData_"):
    map_load_time: Time
    resolution: float32
    width: uint32
    height: uint32
    origin: Pose


@dataclass
class OccupancyGrid(IdlStruct, typename="nav_msgs::msg::dds_::OccupancyGrid_"):
    header: Header
    info: MapMetaData
    data: sequence[int8]


@dataclass
class Clock(IdlStruct, typename="rosgraph_msgs::msg::dds_::Clock_"):
    clock: Time


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 16]


@dataclass
class NodeEntitiesInfo(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class ParticipantEntitiesInfo(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: Gid
    node_entities_info_seq: sequence[NodeEntitiesInfo]


header = Header(Time(5, 7), "from cyclone")
nowhere = Pose(Vector3(0, 0, 0), Quaternion(0, 0, 0, 1))
twist = Twist(Vector3(0.25, 0, 0), Vector3(0, 0, -0.5))
samples = {
    Twist: twist,
    TwistStamped: TwistStamped(header, twist),
    LaserScan: LaserScan(header, -3, 3, 0.5, 0, 0.1, 0.15, 12, [1.5, float("inf"), 2.25], []),
    OccupancyGrid: OccupancyGrid(header, MapMetaData(Time(1, 2), 0.5, 2, 1, nowhere), [-1, 100]),
    Clock: Clock(Time(5, 7)),
}
reliable = Policy.Reliability.Reliable(100_000_000)
profiles = {
    "sensors": Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5)),
    "commands": Qos(reliable, Policy.History.KeepLast(10)),
    "latched": Qos(reliable, Policy.Durability.TransientLocal, Policy.History.KeepLast(1)),
}


def received(reader):
    # By default, it leaves what has come from a writer that has gone since.
    whatever = ReadCondition(reader, ViewState.Any | InstanceState.Any | SampleState.NotRead)
    while True:
        for sample in reader.take_iter(condition=whatever, timeout=3600 * 1_000_000_000):
            if not isinstance(sample, InvalidSample):
                yield sample


def pitch(there, back):
    sample, took, warm_up, count = samples[LaserScan], [], 100, 2000
    sample.ranges = [1 + beam / 100 for beam in range(360)]
    coming = received(back)
    deadline = time.monotonic() + 60
    while not (there.get_matched_subscriptions() and back.get_matched_publications()):
        assert time.monotonic() < deadline, "no echo"
        time.sleep(0.01)
    time.sleep(1)
    due = time.perf_counter()
    for number in range(warm_up + count):
        due += 0.01
        time.sleep(max(0, due - time.perf_counter()))
        began = time.perf_counter()
        sample.header.stamp.sec = number
        there.write(sample)
        while next(coming).header.stamp.sec != number:
            pass
        took.append((time.perf_counter() - began) * 1000)
    took = sorted(took[warm_up:])
    at = lambda share: took[min(count - 1, int(share * count))]
    print(f"| from Cyclone DDS, in Python, to the same | {at(0.5):.3f} ms | {at(0.99):.3f} ms | {took[-1]:.3f} ms | 0 |", flush=True)


def main(domain, action, kind, topic, qos):
    kind, qos = globals()[kind], profiles[qos]
    participant = DomainParticipant(int(domain))
    topic_of = lambda name: Topic(participant, name, kind, qos=qos)
    print("ready", flush=True)
    if action == "print":
        for sample in received(DataReader(participant, topic_of(topic), qos=qos)):
            print(sample, flush=True)
    elif action == "echo":
        back = DataWriter(participant, topic_of(topic + "_back"), qos=qos)
        for sample in received(DataReader(participant, topic_of(topic), qos=qos)):
            back.write(sample)
    elif action == "pitch":
        pitch(DataWriter(participant, topic_of(topic), qos=qos), DataReader(participant, topic_of(topic + "_back"), qos=qos))
    else:
        writer = DataWriter(participant, topic_of(topic), qos=qos)
        while True:
            writer.write(samples[kind])
            time.sleep(3600 if action == "latch" else 0.02)


main(*sys.argv[1:])
