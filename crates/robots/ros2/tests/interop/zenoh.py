"""A peer that speaks Zenoh as ROS 2's rmw_zenoh does: python3 zenoh.py PORT ACTION [DOMAIN TYPE TOPIC QOS]

ACTION: router (which all others need, at that port of loopback), graph (tokens, as they come and go), print (what comes,
a line each, and what is attached), publish (the same, again and again), latch (once).
QOS: sensors, commands or latched, as ROS 2 has them.
"""

import sys
import time

import numpy as np
import zenoh
import zenoh.ext
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_JAZZY)
types = store.types
packages = {"LaserScan": "sensor_msgs", "OccupancyGrid": "nav_msgs"}
attached = tuple[zenoh.ext.Int64, zenoh.ext.Int64, bytes]


def sample(kind):
    """What is published of a type."""
    new = lambda name, *fields: types[name](*fields)
    vector = lambda *xyz: new("geometry_msgs/msg/Vector3", *xyz)
    header = new("std_msgs/msg/Header", new("builtin_interfaces/msg/Time", 5, 7), "from zenoh")
    twist = new("geometry_msgs/msg/Twist", vector(0.25, 0, 0), vector(0, 0, -0.5))
    floats = lambda *values: np.array(values, dtype=np.float32)
    pose = lambda: new(
        "geometry_msgs/msg/Pose", new("geometry_msgs/msg/Point", 0, 0, 0), new("geometry_msgs/msg/Quaternion", 0, 0, 0, 1)
    )
    info = lambda: new("nav_msgs/msg/MapMetaData", new("builtin_interfaces/msg/Time", 1, 2), 0.5, 2, 1, pose())
    return {
        "geometry_msgs/msg/Twist": lambda: twist,
        "geometry_msgs/msg/TwistStamped": lambda: new(kind, header, twist),
        "sensor_msgs/msg/LaserScan": lambda: new(
            kind, header, -3, 3, 0.5, 0, 0.1, 0.15, 12, floats(1.5, float("inf"), 2.25), floats()
        ),
        "nav_msgs/msg/OccupancyGrid": lambda: new(kind, header, info(), np.array([-1, 100], dtype=np.int8)),
    }[kind]()


def open_session(**settings):
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key.replace("__", "/"), value)
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    return zenoh.open(config)


def show(text):
    print(text, flush=True)


def main(port, action, domain="0", kind="", topic="", qos=""):
    router = f'["tcp/127.0.0.1:{port}"]'
    if action == "router":
        session = open_session(mode='"router"', listen__endpoints=router)
        show("ready")
        time.sleep(3600)
    session = open_session(mode='"peer"', connect__endpoints=router, listen__endpoints='["tcp/127.0.0.1:0"]')
    if action == "graph":
        tell = lambda token: show(f"{'+' if token.kind == zenoh.SampleKind.PUT else '-'} {token.key_expr}")
        kept = session.liveliness().declare_subscriber(f"@ros2_lv/{domain}/**", tell, history=True)
        show("ready")
        time.sleep(3600)
    kind = f"{packages.get(kind, 'geometry_msgs')}/msg/{kind}"
    dds_type, type_hash = kind.replace("/msg/", "::msg::dds_::") + "_", store.hash_rihs01(kind)
    key = f"{domain}/{topic.strip('/')}/{dds_type}/{type_hash}"
    profile = {"sensors": "2:2:1,5", "commands": "::,10", "latched": ":1:,1"}[qos] + ":,:,:,,"
    token = lambda role: session.liveliness().declare_token(
        f"@ros2_lv/{domain}/{session.zid()}/0/1/{role}/%/%/peer/{topic.replace('/', '%')}/{dds_type}/{type_hash}/{profile}"
    )
    if action == "print":

        def received(sample):
            number, at, gid = zenoh.ext.z_deserialize(attached, sample.attachment)
            age = time.time() - at / 1e9
            show(f"{number} {-1 < age < 60} {len(gid)} {store.deserialize_cdr(sample.payload.to_bytes(), kind)}")

        history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1) if qos == "latched" else None
        kept = zenoh.ext.declare_advanced_subscriber(session, key, received, history=history), token("MS")
        show("ready")
        time.sleep(3600)
    cache = zenoh.ext.CacheConfig(max_samples=1) if qos == "latched" else None
    publisher = zenoh.ext.declare_advanced_publisher(
        session, key, cache=cache, publisher_detection=qos == "latched" or None
    )
    kept = token("MP")
    show("ready")
    number = 0
    while True:
        number += 1
        metadata = zenoh.ext.z_serialize((zenoh.ext.Int64(number), zenoh.ext.Int64(time.time_ns()), bytes(16)))
        publisher.put(bytes(store.serialize_cdr(sample(kind), kind)), attachment=metadata)
        time.sleep(3600 if action == "latch" else 0.02)


main(*sys.argv[1:])
