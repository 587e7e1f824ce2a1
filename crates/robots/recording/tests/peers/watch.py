"""Watches a Foxglove WebSocket server as a viewer does: prints `subscribed`, then the messages of a latched topic, which was
told before, and of another one, decoded by rosbags with nothing but the advertised schema.
"""

import asyncio
import json
import struct
import sys

import websockets
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

LATCHED, LIVE = "/testbed", "/tb2/odom"


def decode(channel, payload):
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
    return store.deserialize_cdr(payload, channel["schemaName"])


async def watch(address):
    async with websockets.connect(f"ws://{address}", subprotocols=["foxglove.sdk.v1"], proxy=None) as server:
        channels = {}
        while not {LATCHED, LIVE} <= channels.keys():
            told = json.loads(await server.recv())
            if told["op"] == "serverInfo":
                print(json.dumps(told["name"]), flush=True)
            if told["op"] == "advertise":
                channels |= {channel["topic"]: channel for channel in told["channels"]}
        for channel in channels.values():
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg"), channel
        # In this order: when the latched message comes, the other one is subscribed to.
        wanted = [channels[LIVE], channels[LATCHED]]
        for number, channel in enumerate(wanted):
            subscription = {"id": number, "channelId": channel["id"]}
            await server.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
        while True:
            told = await server.recv()
            if isinstance(told, str):
                continue
            kind, number, time = struct.unpack_from("<BIQ", told)
            assert kind == 1
            message = decode(wanted[number], told[13:])
            if number == 1:
                names = [marker.text for marker in message.markers if marker.text]
                print(json.dumps({"t": time, "names": names}), flush=True)
            else:
                place = message.pose.pose.position
                print(json.dumps({"t": time, "frame": message.header.frame_id, "x": place.x, "y": place.y}))
                return


asyncio.run(watch(sys.argv[1]))
