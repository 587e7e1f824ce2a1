"""Asks both servers in turn, and prints how long each answer took by its own clock: `echo 3 12.345` is request 3, in ms."""

import http.client
import socket
import struct
import sys
import time

edge = sys.argv[1]
udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
udp.settimeout(1)


def echo(number):
    udp.sendto(struct.pack("!I", number) + bytes(60), (edge, 9000))
    while struct.unpack("!I", udp.recv(2048)[:4])[0] != number:
        pass


def connect():
    """Waits for the server, which may come up after its client."""
    while True:
        try:
            connection = http.client.HTTPConnection(edge, 8080, timeout=30)
            connection.connect()
            return connection
        except OSError:
            time.sleep(0.1)


def request(path):
    connection.request("POST", path, body=bytes(20_000))
    connection.getresponse().read()


def timed(name, number, ask):
    begin = time.perf_counter()
    ask()
    print(name, number, f"{(time.perf_counter() - begin) * 1e3:.3f}", flush=True)


connection = connect()
number = 0
while True:
    try:
        timed("echo", number, lambda: echo(number))
    except TimeoutError:
        pass
    timed("detect", number, lambda: request(f"/detect?image={number}"))
    timed("health", number, lambda: request("/health"))
    number += 1
    time.sleep(0.1)
