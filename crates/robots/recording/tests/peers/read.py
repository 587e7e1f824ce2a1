"""Reads an MCAP file with two independent readers, types from nothing but the file, and prints what both agree on.

Each line is a message as JSON: topic, type, time and value. Numbers that JSON has not are their names as text.
"""

import json
import math
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore


def plain(value):
    """A message as what JSON knows."""
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, bytes):
        return list(value)
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(part) for part in value]
    names = value.__slots__ if hasattr(value, "__slots__") else vars(value)
    return {name: plain(getattr(value, name)) for name in names if not name.startswith("_")}


def by_rosbags(path):
    with AnyReader([Path(path)]) as reader:
        for connection, time, data in reader.messages():
            value = reader.deserialize(data, connection.msgtype)
            # Every byte is accounted for: what was read is written the same.
            again = reader.typestore.serialize_cdr(value, connection.msgtype)
            assert bytes(again)[: len(data)] == bytes(data), connection.topic
            yield connection.topic, connection.msgtype, time, plain(value)


def by_mcap(path):
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, value in reader.iter_decoded_messages():
            assert message.log_time == message.publish_time
            yield channel.topic, schema.name, message.log_time, plain(value)


def check_types(path):
    """Standard types are those of ROS 2 Jazzy, by their hashes."""
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    for channel in summary.channels.values():
        name = summary.schemas[channel.schema_id].name
        told = channel.metadata["topic_type_hash"]
        if not name.startswith("cotorra_msgs/"):
            assert told == jazzy.hash_rihs01(name), f"{name}: {told}"
    with AnyReader([Path(path)]) as reader:
        for connection in reader.connections:
            # The hash follows from the definition in the file.
            told = [c for c in summary.channels.values() if c.topic == connection.topic]
            told = told[0].metadata["topic_type_hash"]
            assert reader.typestore.hash_rihs01(connection.msgtype) == told, connection.topic
            assert len(connection.ext.offered_qos_profiles) == 1, connection.topic


def key(told):
    topic, kind, time, value = told
    return time, topic, json.dumps(value, sort_keys=True)


path = sys.argv[1]
check_types(path)
one, other = sorted(by_rosbags(path), key=key), sorted(by_mcap(path), key=key)
assert len(one) == len(other)
for ours, theirs in zip(one, other):
    assert ours == theirs, (ours, theirs)
for topic, kind, time, value in one:
    print(json.dumps({"topic": topic, "type": kind, "t": time, "value": value}))
