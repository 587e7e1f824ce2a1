"""Navigates a robot along its walk in open space, or to a goal: answers each position packet with a velocity.

crates/plugin/src/wire.rs describes the packets.
"""

import math
import os
import signal
import socket
import struct
import sys

import yaml

# Magic, version, kind, length of the robot's name, goal, sequence, waypoint, time of emission, nonce.
HEADER = struct.Struct("<4sBBBBIIQQ")
MAGIC, VERSION, POSITION, NAVIGATION = b"ctra", 3, 1, 2
ENCODING = b"\0\1\0\0"  # CDR, little endian
REACHED, SPEED, TURN = 0.15, 0.3, 1.0  # m, m/s, rad/s

# The first process of a container gets no SIGTERM without this.
signal.signal(signal.SIGTERM, lambda *_: sys.exit())


def steer(x, y, yaw, target):
    """Returns the speed and the turn that lead from a pose to a target."""
    ahead = math.remainder(math.atan2(target[1] - y, target[0] - x) - yaw, math.tau)
    return SPEED * max(0.0, math.cos(ahead)), max(-TURN, min(TURN, 2 * ahead))


def answer(datagram, waypoints):
    """Returns the navigation packet that answers a position packet."""
    *_, name, goal, sequence, waypoint, emitted, nonce = HEADER.unpack_from(datagram)
    # Behind the header: the robot's name, the goal if there is one, 4 bytes that name the encoding, and the pose.
    at = HEADER.size + name
    target, progress = None, b""
    if goal:
        target = struct.unpack_from("<2d", datagram, at)
        at += 24
    x, y, _, _, _, z, w = struct.unpack_from("<7d", datagram, at + 4)
    if goal:
        left = math.dist(target, (x, y))
        if left <= REACHED:
            goal, target = 2, None
        else:
            progress = struct.pack("<d", left)
    else:
        while waypoint < len(waypoints) and math.dist(waypoints[waypoint], (x, y)) <= REACHED:
            waypoint += 1
        if waypoint < len(waypoints):
            target = waypoints[waypoint]
    speed, turn = steer(x, y, 2 * math.atan2(z, w), target) if target else (0.0, 0.0)
    header = HEADER.pack(MAGIC, VERSION, NAVIGATION, 0, goal, sequence, waypoint, emitted, nonce)
    return header + progress + ENCODING + struct.pack("<6d", speed, 0, 0, 0, 0, turn)


with open(os.environ["COTORRA_TESTBED"]) as file:
    walk = yaml.safe_load(file)["walks"][os.environ["COTORRA_ROBOT"]]
there = walk["waypoints"]
waypoints = there + there[-2::-1] if walk.get("and_back") else there

receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
receiver.bind(("0.0.0.0", int(os.environ["COTORRA_PORT"])))
print(os.environ["COTORRA_ROBOT"], "is navigated on", os.environ["COTORRA_NODE"], "past", len(waypoints), "waypoints")
while True:
    datagram, robot = receiver.recvfrom(2048)
    if datagram[:6] == MAGIC + bytes([VERSION, POSITION]):
        receiver.sendto(answer(datagram, waypoints), robot)
