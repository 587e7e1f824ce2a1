"""An application that asks for bandwidth when its packets do not arrive, the sender of its packets, and that of others'."""

import json
import os
import socket
import struct
import sys
import time
import urllib.error
import urllib.request

CLOUD, EDGE, FOG = "10.77.0.3", "10.77.0.2", "10.77.0.1"
# Packets between two shares: 2 s.
WINDOW = 1000


def send(port, size, per_second):
    """Sends numbered packets. What is late is made up for, so that the rate holds."""
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    begin, number = time.monotonic(), 0
    while True:
        while number < (time.monotonic() - begin) * per_second:
            out.sendto(struct.pack("!Q", number).ljust(size), (CLOUD, port))
            number += 1
        time.sleep(0.005)


def ask(method, path="", body=None):
    """Status and JSON of an answer; None without a body."""
    head = {"Authorization": f"Bearer {os.environ['COTORRA_MEC_TOKEN']}", "Content-Type": "application/json"}
    url = f"{os.environ['COTORRA_MEC']}/bwm/v1/bw_allocations{path}"
    data = None if body is None else json.dumps(body).encode()
    try:
        with urllib.request.urlopen(urllib.request.Request(url, data, head, method=method)) as answer:
            text = answer.read()
            return answer.status, json.loads(text) if text else None
    except urllib.error.HTTPError as refused:
        return refused.code, json.load(refused)


def allocation(rate, source=EDGE, of="receiver"):
    session = [{"sourceIp": source, "dstAddress": CLOUD}]
    return {"appInsId": of, "requestType": 1, "sessionFilter": session, "fixedAllocation": str(rate),
            "allocationDirection": "01"}


def receive():
    """Prints the share of its packets that arrive: until others fill the wire, then with an allocation, and then without."""
    others = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    others.bind(("", 9001))
    own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    own.bind(("", 9000))

    def number():
        return struct.unpack("!Q", own.recv(2000)[:8])[0]

    def share():
        first, count = number(), 1
        while True:
            last = number()
            count += 1
            if last >= first + WINDOW:
                return count / (last - first + 1)

    def until(step, holds):
        while True:
            now = share()
            print("share", step, f"{now:.3f}")
            if holds(now):
                return

    until("beside others", lambda now: now < 0.85)
    print("too much", ask("POST", "", allocation(20_000_000))[0])
    print("of another", ask("POST", "", allocation(1_000_000, of="sender"))[0])
    print("between others", ask("POST", "", allocation(1_000_000, source="10.77.0.9"))[0])
    status, made = ask("POST", "", allocation(5_000_000))
    print("allocated", status, made["fixedAllocation"])
    until("allocated", lambda now: now > 0.97)
    print("taken", ask("POST", "", allocation(1_000_000))[0])
    print("all", len(ask("GET")[1]))
    print("deleted", ask("DELETE", f"/{made['allocationId']}")[0])
    until("deleted", lambda now: now < 0.85)
    print("done")


if sys.argv[1] == "send":
    send(*map(int, sys.argv[2:]))
else:
    receive()
