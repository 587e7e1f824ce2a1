"""Receives a camera's images, and prints a line for each: camera, number, size, bytes, CRC-32 of these, mean brightness.

The argument is the folder of cotorra's client.
"""

import os
import socket
import sys
import zlib

sys.path.append(sys.argv[1])

from cotorra import images

receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
# An image comes at once: room for several.
receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
receiver.bind(("0.0.0.0", int(os.environ["COTORRA_PORT"])))
for image in images(receiver):
    size, mean = f"{image.width}x{image.height}", sum(image.data) / len(image.data)
    print(image.sensor, image.sequence, size, len(image.data), zlib.crc32(image.data), f"{mean:.1f}", flush=True)
