#!/usr/bin/env python3
"""A cotorra plug-in: lets robots scan every few seconds, and attaches each to the radio unit that it receives best.

Usage: strongest_signal.py [SECONDS BETWEEN SCANS]. Needs nothing but Python; the testbed's address is in COTORRA_API.
"""
import json
import os
import sys
from http.client import HTTPException
from urllib import error, request

API = os.environ["COTORRA_API"].rstrip("/") + "/api/v1"
SCAN_EVERY_S = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
HYSTERESIS_DB = 4.0  # A robot changes only for a radio unit that is so much stronger, lest it goes back and forth.

HEADERS = {"Content-Type": "application/json", "X-Cotorra-Plugin": os.environ.get("COTORRA_PLUGIN", "strongest-signal")}
if token := os.environ.get("COTORRA_TOKEN"):
    HEADERS["Authorization"] = f"Bearer {token}"
http = request.build_opener(request.ProxyHandler({}))  # Past any proxy in the environment: the testbed is near.


def robot_contexts():
    """Every context of every robot as it comes, until the run ends (server-sent events, JSON after `data: `)."""
    with http.open(request.Request(f"{API}/events?kinds=robot", headers=HEADERS)) as stream:
        for line in stream:
            if line.startswith(b"data: {"):
                yield json.loads(line.removeprefix(b"data: "))
            elif line.startswith(b"id: "):  # Virtual time waits until this is given back; real time has none.
                http.open(request.Request(f"{API}/marks/{int(line[4:])}", b"", HEADERS)).close()


def instruct(reason, **instruction):
    """Gives an instruction, and tells what became of it."""
    body = json.dumps({"instruction": instruction, "reason": reason}).encode()
    try:
        http.open(request.Request(f"{API}/instructions", body, HEADERS)).close()
        print(f"{instruction['instruction']}: {reason}", flush=True)
    except error.HTTPError as failure:
        print(f"{instruction['instruction']}: {reason}, but {failure.read().decode()}", flush=True)


def main():
    last_scan_s = {}
    for context in robot_contexts():
        robot, now_s = context["robot"], context["at_ns"] / 1e9  # Times are nanoseconds since the run began.
        heard = [a for a in context["attachments"] if a["signal_dbm"] is not None]  # Signals in dBm.
        present = next((a["signal_dbm"] for a in heard if a["attached"]), float("-inf"))
        best = max(heard, key=lambda a: a["signal_dbm"], default=None)
        if best and best["signal_dbm"] > present + HYSTERESIS_DB:
            reason = f"{best['radio_unit']} is received with {best['signal_dbm']:.1f} dBm"
            instruct(reason, instruction="attach", robot=robot, radio_unit=best["radio_unit"])
        elif now_s - last_scan_s.get(robot, 0.0) >= SCAN_EVERY_S:
            last_scan_s[robot] = now_s  # Only a scan tells how strong the radio units are that it is not attached to.
            instruct(f"one every {SCAN_EVERY_S:g} s", instruction="scan", robot=robot)


try:
    main()
except (OSError, HTTPException, KeyboardInterrupt) as end:  # Broken off: the run has ended, or there is none.
    sys.exit(f"no API at {API}: {end}" if isinstance(end, error.URLError) else 0)
