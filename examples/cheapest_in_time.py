#!/usr/bin/env python3
"""A cotorra plug-in with a placement algorithm of its own, to be set beside OKpi: after each scan a robot gets the radio
unit that it receives best, and its navigation the cheapest server from which the answer is back in time, by the delays
of the radio and of the links on the shortest way. Links count as measured, and at least as configured. A link over which a packet or
its answer is lost more often than 1 in 100 is not used, if there is another way. It knows nothing of rates, loads or
reliability, and forgets what it measured: OKpi does not.

Usage: cheapest_in_time.py [SECONDS BETWEEN SCANS]. Needs nothing but Python; the testbed's address is in COTORRA_API.
"""
import heapq
import json
import os
import sys
from http.client import HTTPException
from urllib import error, request

API = os.environ["COTORRA_API"].rstrip("/") + "/api/v1"
SCAN_EVERY_S = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
HYSTERESIS_DB = 4.0  # A robot changes only for a radio unit that is so much stronger, lest it goes back and forth.
MARGIN_MS = 1.0  # For what no link's delay says, such as the time of the server.
MOST_LOST = 0.01  # Share of probes that a link may lose.
LOSSY_MS = 1000.0  # What a link counts for in addition that loses more.

HEADERS = {"Content-Type": "application/json", "X-Cotorra-Plugin": os.environ.get("COTORRA_PLUGIN", "cheapest-in-time")}
if token := os.environ.get("COTORRA_TOKEN"):
    HEADERS["Authorization"] = f"Bearer {token}"
http = request.build_opener(request.ProxyHandler({}))  # Past any proxy in the environment: the testbed is near.


def ask(path, body=None):
    """What the API says: to a question, or to a body that is posted."""
    data = None if body is None else json.dumps(body).encode()
    with http.open(request.Request(f"{API}/{path}", data, HEADERS)) as answer:
        return json.load(answer)


def instruct(reason, **instruction):
    """Gives an instruction, and tells what became of it."""
    try:
        ask("instructions", {"instruction": instruction, "reason": reason})
        print(f"{instruction['instruction']}: {reason}", flush=True)
    except error.HTTPError as failure:
        print(f"{instruction['instruction']}: {reason}, but {failure.read().decode()}", flush=True)


def events(*kinds):
    """What happens, as it happens, until the run ends. Virtual time waits until all of it has been taken in."""
    with http.open(request.Request(f"{API}/events?kinds={','.join(kinds)}", headers=HEADERS)) as stream:
        for line in stream:
            if line.startswith(b"data: {"):
                yield json.loads(line.removeprefix(b"data: "))
            elif line.startswith(b"id: "):
                ask(f"marks/{int(line[4:])}", {})


def expected_ms(figures):
    """The delay of one direction: as measured, and at least as configured."""
    return max(figures[name]["delay_ms"] for name in ("configured", "measured") if figures[name])


def one_way_ms(context):
    """The delay of one direction of a link, with what its losses count for."""
    lost = (context["probed"] or {}).get("loss") or 0.0
    return expected_ms(context["figures"]["delay"]) + (LOSSY_MS if lost > MOST_LOST else 0.0)


def round_trips_ms(graph, start):
    """Milliseconds from a node over wires to every other and back, by Dijkstra, as the links are now."""
    delay = {(c["link"], c["direction"]): one_way_ms(c) for c in ask("network/links")}
    near = {node["id"]: [] for node in graph["nodes"]}
    for link in graph["links"]:
        (a, b), way = link["ends"], delay[link["id"], "forward"] + delay[link["id"], "backward"]
        near[a].append((b, way))
        near[b].append((a, way))
    # Radio units forward for robots and switches for all; what only carries VNFs forwards for nobody.
    forwards = {node["id"] for node in graph["nodes"] if node["kind"] == "switch"} | {start}
    known, open_ = {}, [(0.0, start)]
    while open_:
        so_far, node = heapq.heappop(open_)
        if node not in known:
            known[node] = so_far
            if node in forwards:
                for other, way in near[node]:
                    heapq.heappush(open_, (so_far + way, other))
    return known


def place(testbed, service, radio_unit):
    """Puts a service's navigation where it is cheapest in time; where nothing is, where it is quickest."""
    graph, robot = testbed["graph"], service["robot"]
    network = next(node["network"] for node in graph["nodes"] if node["id"] == robot)
    air_ms = 2 * graph["wireless"][network]["delay_ms"]  # What is measured right after a scan has the scan in it.
    target_ms = service["kpis"]["service_time_target_ms"]
    took_ms = {node: air_ms + way for node, way in round_trips_ms(graph, radio_unit).items()}
    servers = [node for node in graph["nodes"] if node["kind"] == "server" and node["id"] in took_ms]
    in_time = [s for s in servers if took_ms[s["id"]] + MARGIN_MS <= target_ms]
    quickest = min(servers, key=lambda server: took_ms[server["id"]])
    chosen = min(in_time, key=lambda server: server["cost"], default=quickest)["id"]
    for vnf in (vnf for vnf in service["vnfs"] if not vnf.get("pinned_to")):
        if {"vnf": vnf["id"], "node": chosen} not in ask("network/placements"):
            instruct(f"{took_ms[chosen]:.1f} ms by way of {radio_unit}", instruction="place", vnf=vnf["id"], node=chosen)


def main():
    testbed, last_scan_s, scanned = ask("testbed"), {}, set()
    for event in events("robot", "scanned"):
        robot, now_s = event["robot"], event["at_ns"] / 1e9  # Times are nanoseconds since the run began.
        if event["event"] == "scanned":
            scanned.add(robot)  # The next context has what it heard.
        elif robot in scanned:
            scanned.remove(robot)
            heard = [a for a in event["attachments"] if a["signal_dbm"] is not None]  # Signals in dBm.
            present = next((a for a in heard if a["attached"]), None)
            best = max(heard, key=lambda a: a["signal_dbm"], default=None)
            if best and (not present or best["signal_dbm"] > present["signal_dbm"] + HYSTERESIS_DB):
                reason = f"{best['radio_unit']} is received with {best['signal_dbm']:.1f} dBm"
                instruct(reason, instruction="attach", robot=robot, radio_unit=best["radio_unit"])
                present = best
            for service in (s for s in testbed["services"] if s["robot"] == robot and present):
                place(testbed, service, present["radio_unit"])
        elif now_s - last_scan_s.get(robot, 0.0) >= SCAN_EVERY_S:
            last_scan_s[robot] = now_s
            instruct(f"one every {SCAN_EVERY_S:g} s", instruction="scan", robot=robot)


try:
    main()
except (OSError, HTTPException, KeyboardInterrupt) as end:  # Broken off: the run has ended, or there is none.
    sys.exit(f"no API at {API}: {end}" if isinstance(end, error.URLError) else 0)
