#!/usr/bin/env python3
"""A plug-in of cotorra: moves navigation to the next dearer server when six answers in a row are late.

A run starts it. It needs Python 3.9 or newer, and only the standard library.
"""
import json
import os
import sys
from http.client import HTTPException
from urllib import error, request

API = os.environ["COTORRA_API"].rstrip("/") + "/api/v1"
HEADERS = {"Content-Type": "application/json", "Authorization": "Bearer " + os.environ.get("COTORRA_TOKEN", "")}
PATIENCE = json.loads(os.environ.get("COTORRA_SETTINGS") or "{}").get("patience", 6)
http = request.build_opener(request.ProxyHandler({}))  # The API is on this machine, behind no proxy.


def call(path, body=None):
    """Gets a path of the API, or posts a body to it. Returns the answer."""
    data = None if body is None else json.dumps(body).encode()
    with http.open(request.Request(f"{API}/{path}", data, HEADERS)) as answer:
        return json.load(answer)


def instruct(reason, **instruction):
    """Gives an instruction. The history records it with the reason and its result."""
    try:
        call("instructions", {"instruction": instruction, "reason": reason})
        print(instruction, reason, flush=True)
    except error.HTTPError as refused:
        print(instruction, "refused:", refused.read().decode(), flush=True)


def events(*kinds):
    """Yields events of these kinds until the run ends."""
    with http.open(request.Request(f"{API}/events?kinds={','.join(kinds)}", headers=HEADERS)) as stream:
        for line in stream:
            if line.startswith(b"data: {"):
                yield json.loads(line[6:])
            elif line.startswith(b"id: "):  # Virtual time waits until all events so far are handled.
                call(f"marks/{int(line[4:])}", {})


def main():
    testbed = call("testbed")
    servers = [node for node in testbed["graph"]["nodes"] if node["kind"] == "server"]
    servers = [node["id"] for node in sorted(servers, key=lambda node: node["cost"])]
    services = {service["id"]: service for service in testbed["services"]}
    late = dict.fromkeys(services, 0)
    for event in events("service_time"):
        service, took_ms = services[event["service"]], event.get("service_time_ms")
        is_late = took_ms is None or took_ms > service["kpis"]["service_time_target_ms"]
        late[service["id"]] = late[service["id"]] + 1 if is_late else 0
        dearer = servers[servers.index(event["server"]) + 1:] if event["server"] in servers else []
        if late[service["id"]] == PATIENCE and dearer:
            late[service["id"]] = 0
            vnf = next(vnf["id"] for vnf in service["vnfs"] if not vnf.get("pinned_to"))
            instruct(f"{PATIENCE} answers in a row were late", instruction="place", vnf=vnf, node=dearer[0])


try:
    main()
except (OSError, HTTPException, KeyboardInterrupt) as end:  # The run has ended, or there is none.
    sys.exit(f"no API at {API}: {end}" if isinstance(end, error.URLError) else 0)
