"""A MEC application: watches stations over the WLAN Access Information Service alone (ETSI GS MEC 028, GET and POST under
/wai/v2), and asks the testbed for a handover when a station hears another access point clearly better.

    COTORRA_TOKEN=… COTORRA_API=http://127.0.0.1:7700 python3 examples/wais_handover.py

The token is that which the run was started with.

Nothing of what it watches is cotorra's own API: it would watch any service of the standard. Only the handover is asked for
there, because the standard has no word for it. A station's own radio is let scan, so that there is something to hear.
"""

import json
import os
import sys
import time
import urllib.error
import urllib.parse
import urllib.request

API = os.environ["COTORRA_API"]
NAME = os.environ.get("COTORRA_PLUGIN", "wais-handover")
CLEARLY = 8  # RCPI has half decibels: 4 dB
SCAN_EVERY_S = 10


def ask(path, body=None):
    """What the testbed answers; a refusal is an answer, too."""
    head = {"X-Cotorra-Plugin": NAME, "Content-Type": "application/json"}
    if "COTORRA_TOKEN" in os.environ:
        head["Authorization"] = "Bearer " + os.environ["COTORRA_TOKEN"]
    data = None if body is None else json.dumps(body).encode()
    try:
        with urllib.request.urlopen(urllib.request.Request(API + path, data, head), timeout=10) as answer:
            return json.load(answer)
    except urllib.error.HTTPError as refused:
        return json.load(refused)


def stations(*expressions, **selectors):
    """Stations that meet all expressions, as in "(gt,rssi/rssi,100)"."""
    query = urllib.parse.urlencode({**({"filter": ";".join(expressions)} if expressions else {}), **selectors})
    return ask("/wai/v2/queries/sta/sta_information?" + query)


def names():
    """The testbed's names of nodes by MAC address: its own API wants them where the standard has addresses."""
    nodes = [ask("/api/v1/network/nodes/" + node["id"]) for node in ask("/api/v1/testbed")["graph"]["nodes"]]
    return {
        ":".join(f"{octet:02x}" for octet in node["address"]["mac"]): node["id"] for node in nodes if node["address"]
    }


def measure(mac):
    """Configures that beacons which a station hears are reported with it."""
    beacons = {
        "operatingClass": 81,
        "channelId": 0,
        "measurementMode": 2,
        "beaconReportingConf": {"reportingCondition": 0, "threshold": 0},
    }
    config = {"measurementId": "hears-" + mac, "staId": [{"macId": mac}]}
    return ask("/wai/v2/measurements", {**config, "measurementInfo": {"beaconRequestConf": beacons}})


def better(station):
    """The access point that a station hears clearly better than its own, and by how many dB; or None."""
    heard = {report["bssid"]: report["rcpi"] for report in station.get("beaconReport", [])}
    own = heard.get(station["apAssociated"]["bssid"])
    best = max(heard, key=heard.get, default=None)
    if own is None or heard[best] < own + CLEARLY:
        return None
    return best, (heard[best] - own) / 2


def instruct(reason, **instruction):
    return ask("/api/v1/instructions", {"instruction": instruction, "reason": reason})


def main():
    known, measured, scan_at = names(), set(), 0.0
    while True:
        scan, now = False, time.monotonic()
        if now >= scan_at:
            scan, scan_at = True, now + SCAN_EVERY_S
        for station in stations(exclude_fields="timeStamp"):
            mac = station["staId"]["macId"]
            if mac not in measured:
                measure(mac)
                measured.add(mac)
            if scan:
                instruct("to hear other access points", instruction="scan", robot=known[mac])
            elif found := better(station):
                bssid, gain = found
                reason = f"WAIS reports {known[bssid]} {gain:.1f} dB above its own access point"
                print(f"{known[mac]} to {known[bssid]}: {reason}", flush=True)
                instruct(reason, instruction="attach", robot=known[mac], radio_unit=known[bssid])
        time.sleep(0.5)


if __name__ == "__main__":
    try:
        main()
    except (KeyboardInterrupt, urllib.error.URLError, ConnectionError) as end:
        sys.exit(f"the testbed is gone: {end}" if isinstance(end, OSError) else 0)
