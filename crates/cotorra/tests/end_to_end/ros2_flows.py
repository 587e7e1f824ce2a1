"""Programs over Cyclone DDS that know nothing of cotorra: python3 ros2_flows.py DOMAIN ROLE

ROLE: `client` sends images, calls a service and an action, and prints the time of each in ms; `server` answers all of
them; `follow` answers each scan of an offered robot with a command; `watch` only subscribes to images. Calls and goals have
the format of rmw_cyclonedds: they begin with the client and the number of its call.
"""

import itertools
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int8, int32, int64, sequence, uint8, uint32, uint64
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

Uuid = array[uint8, 16]


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


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
class PlanRequest(IdlStruct, typename="test::srv::dds_::Plan_Request_"):
    client: uint64
    call: int64
    goal: float64


@dataclass
class PlanReply(IdlStruct, typename="test::srv::dds_::Plan_Response_"):
    client: uint64
    call: int64
    length: float64


@dataclass
class GoalRequest(IdlStruct, typename="test::action::dds_::Dock_SendGoal_Request_"):
    client: uint64
    call: int64
    goal_id: Uuid
    station: str


@dataclass
class GoalReply(IdlStruct, typename="test::action::dds_::Dock_SendGoal_Response_"):
    client: uint64
    call: int64
    accepted: bool
    stamp: Time


@dataclass
class ResultRequest(IdlStruct, typename="test::action::dds_::Dock_GetResult_Request_"):
    client: uint64
    call: int64
    goal_id: Uuid


@dataclass
class ResultReply(IdlStruct, typename="test::action::dds_::Dock_GetResult_Response_"):
    client: uint64
    call: int64
    status: int8
    result: int32


TOPICS = [
    ("rt/camera", Image, "rt/camera_back", Image),
    ("rq/planRequest", PlanRequest, "rr/planReply", PlanReply),
    ("rq/dock/_action/send_goalRequest", GoalRequest, "rr/dock/_action/send_goalReply", GoalReply),
    ("rq/dock/_action/get_resultRequest", ResultRequest, "rr/dock/_action/get_resultReply", ResultReply),
]
CLIENT = 0x1234567890
reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))


class Ends:
    """A writer of one topic and a reader of another."""

    def __init__(self, participant, said, its_type, heard, their_type, qos=reliable):
        self.writer = DataWriter(participant, Topic(participant, said, its_type, qos=reliable), qos=reliable)
        self.reader = DataReader(participant, Topic(participant, heard, their_type, qos=qos), qos=qos)

    def await_peer(self):
        while not (self.writer.get_matched_subscriptions() and self.reader.get_matched_publications()):
            time.sleep(0.01)

    def take(self):
        """What has come; None if nothing has."""
        return next((sample for sample in self.reader.take(N=1) if not isinstance(sample, InvalidSample)), None)

    def ask(self, message, is_answer):
        """Says that, and gives the answer and how long it took, in ms; None if there is none for two seconds."""
        began = time.perf_counter()
        self.writer.write(message)
        while time.perf_counter() - began < 2:
            answer = self.take()
            if answer and is_answer(answer):
                return answer, (time.perf_counter() - began) * 1000
            if not answer:
                time.sleep(0.0005)
        return None


def client(participant):
    ends = [Ends(participant, *topics) for topics in TOPICS]
    camera, plan, goals, results = ends
    for end in ends:
        end.await_peer()
    for number in itertools.count():
        image = Image(Header(Time(number, 7), "camera"), 100, 100, "rgb8", 0, 300, [number % 256] * 30_000)
        if answered := camera.ask(image, lambda back: back.header.stamp.sec == number):
            print("image", number, answered[1], flush=True)
        mine = lambda reply: (reply.client, reply.call) == (CLIENT, number)
        if answered := plan.ask(PlanRequest(CLIENT, number, 1.5), mine):
            print("plan", number, answered[1], flush=True)
        began = time.perf_counter()
        goal = [number % 256] * 16
        accepted = goals.ask(GoalRequest(CLIENT, number, goal, "station"), mine)
        if accepted and accepted[0].accepted:
            if results.ask(ResultRequest(CLIENT, number, goal), mine):
                print("dock", number, (time.perf_counter() - began) * 1000, flush=True)


def server(participant):
    camera, plan, goals, results = [Ends(participant, back, b, there, a) for there, a, back, b in TOPICS]
    while True:
        time.sleep(0.0005)
        if image := camera.take():
            camera.writer.write(image)
        if call := plan.take():
            plan.writer.write(PlanReply(call.client, call.call, call.goal * 2))
        if goal := goals.take():
            goals.writer.write(GoalReply(goal.client, goal.call, goal.call % 4 != 3, Time(1, 2)))
        if ask := results.take():
            # It takes a while to get there.
            time.sleep(0.02)
            results.writer.write(ResultReply(ask.client, ask.call, 4, 1))


def follow(participant):
    ends = Ends(participant, "rt/tb2/cmd_vel", TwistStamped, "rt/tb2/scan", LaserScan, Qos(Policy.Reliability.BestEffort))
    while True:
        if scan := ends.take():
            ends.writer.write(TwistStamped(scan.header, Twist(Vector3(0, 0, 0), Vector3(0, 0, 0.1))))
        time.sleep(0.0005)


def watch(participant):
    images = Ends(participant, "rt/unused", Image, "rt/camera", Image)
    while True:
        if image := images.take():
            print("seen", image.header.stamp.sec, flush=True)
        time.sleep(0.0005)


domain, role = sys.argv[1:]
print("ready", flush=True)
{"client": client, "server": server, "follow": follow, "watch": watch}[role](DomainParticipant(int(domain)))
